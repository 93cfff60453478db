"""The length of a pixel: a factor that all lengths from pictures share, as scene and measurement state it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from bcid.base.errors import Problems
from bcid.measurement.contents import Contents
from bcid.scene import Scene
from bcid.scene.uncertainty import MOST_SCALE

SCALE_KEYS = ("scale_sigma", "scale_of_gripper")


def checked_scale(path: Path, table: dict[str, Any], problems: Problems, key: str = "scale_sigma") -> float | None:
    """A stated relative standard deviation; what is wrong with it is noted."""
    value = table.get(key.rpartition(".")[2])
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value <= MOST_SCALE:
        problems.add(path, f"{key}: expected a number above 0 and up to {MOST_SCALE} (0.02 is 2 %), found {value!r}")
        return None
    return float(value)


def checked_flag(path: Path, table: dict[str, Any], problems: Problems, key: str = "scale_of_gripper") -> bool:
    """Whether something is so; no, where nothing is said."""
    value = table.get(key.rpartition(".")[2], False)
    if not isinstance(value, bool):
        problems.add(path, f"{key}: expected true or false, found {value!r}")
    return value is True


def scaled(scene: Scene, measurement: Contents) -> Scene:
    """A scene with what a measurement states of the length of a pixel, which is taken before what the scene does."""
    known = scene.uncertainty
    sigma = known.scale if measurement.scale_sigma is None else measurement.scale_sigma
    too = known.scale_of_gripper or measurement.scale_of_gripper
    return replace(scene, uncertainty=replace(known, scale=sigma, scale_of_gripper=too))


def check_scale(scene: Scene, measurement: Contents, problems: Problems) -> None:
    """Note where scene and measurement contradict each other in what they say of the length of a pixel."""
    known, source = scene.uncertainty, measurement.source
    stated = measurement.scale_sigma
    if stated is not None and known.scale == 0:
        problems.add(
            source,
            f"scale_sigma is {stated:g}, but [uncertainty] of the scene says scale = 0: its lengths share no factor with pictures. "
            "Leave scale out of the scene where they do; otherwise leave scale_sigma out, and state the scale of the "
            "positions alone in frame.toml",
        )
    if measurement.scale_of_gripper and known.scale_of_gripper is False:
        problems.add(
            source,
            "the gripper's path was measured in the pictures (scale_of_gripper), but [uncertainty] of the scene says "
            "scale_of_gripper = false; leave one of them out",
        )
    error = measurement.frame_error
    if error is not None and error.covariance[6, 6] > 0 and scaled(scene, measurement).uncertainty.scale:
        problems.add(
            source,
            "the scale is stated twice: of the positions alone by the error of the frame (last element of its covariance, "
            f"{error.covariance[6, 6]:.2g}), and of all lengths from pictures (scale of [uncertainty], or scale_sigma). Set the "
            "last row and column of the covariance to 0 where body and fiducials were measured in the same pictures; otherwise "
            "leave the other out",
        )
