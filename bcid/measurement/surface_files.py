"""Clouds and depth images, a file a step, that the table [surface] of a measurement.toml names."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bcid.base.confined import read_in_child
from bcid.base.errors import InputError, Problems
from bcid.base.units import unit_factor
from bcid.measurement.contents import Cloud, Frame
from bcid.measurement.formats.cloud_file import CLOUDS, DEPTHS
from bcid.measurement.stated import Stated, is_number
from bcid.scene.rotation import as_rotation

Array = NDArray[np.float64]
_KEYS = ("clouds", "depth", "unit", "sigma", "box", "camera")
_LENS, _POSE = ("fx", "fy", "cx", "cy"), ("position", "rotation")
# So many points of a frame are taken, evenly spread over the file: of more, neighbours tell the same.
MOST_POINTS = 20_000
# Files that one process reads, and the time that it has for each, s.
_TOGETHER, _SECONDS = 50, 20.0


@dataclass(frozen=True)
class SurfaceFiles:
    """The table [surface]; lengths in m.

    Attributes:
        pattern: of the files, with {action} and {step}, relative to the folder; empty where the points stand in a table.
        depth: whether they are depth images.
        unit: of their numbers, m.
        sigma: standard deviation of a point along each axis; NaN where none is stated.
        box: the corners between which points count, in the body's frame, shape (2, 3).
        lens: fx, fy, cx, cy of the camera, pixels.
        position, rotation: of the camera in the frame of the body: a vector, and a unit quaternion (w first).
        placed_camera: whether its position is stated.
    """

    pattern: str
    depth: bool
    unit: float
    sigma: float
    box: Array
    lens: tuple[float, ...]
    position: Array
    rotation: Array
    placed_camera: bool

    @classmethod
    def checked(cls, table: Any, length: float, file: Path, problems: Problems) -> SurfaceFiles | None:
        """The table as a measurement.toml has it, lengths in units of `length` m; None where it cannot be used.

        What is wrong is noted among the problems.
        """
        check = Stated(file, problems)
        if not check.expect(isinstance(table, Mapping), "surface", "a table [surface]", table):
            return None
        before, check = len(problems.found), replace(check, prefix="surface.")
        check.only(table, _KEYS)
        camera, lens_check = check.table(table, "camera"), replace(check, prefix="surface.camera.")
        lens_check.only(camera, (*_LENS, *_POSE))
        named = [key for key in ("clouds", "depth") if isinstance(table.get(key), str)]
        if len(named) > 1 or not (named or camera):
            text = 'expected clouds = "clouds/{step}.ply", depth = "depth/{step}.png", or where the camera is'
            problems.add(file, f"[surface]: {text}")
            return None
        depth = named == ["depth"]
        lens = [_numbers(lens_check, camera, key, 1, [math.nan])[0] for key in _LENS] if depth else []
        for key, value in zip(_LENS, lens, strict=False):
            if math.isnan(value) or (key in ("fx", "fy") and value <= 0):
                lens_check.bad(key, "is needed for depth images, in pixels")
        sigma = _numbers(check, table, "sigma", 1, [math.nan])[0]
        check.expect(not sigma <= 0, "sigma", "a positive number", sigma)
        rotation = _numbers(lens_check, camera, "rotation", 4, [1.0, 0.0, 0.0, 0.0])
        unit_length = abs(math.hypot(*rotation) - 1) <= 1e-3
        lens_check.expect(unit_length, "rotation", "a unit quaternion, as [1, 0, 0, 0] (w first)", rotation)
        pattern = str(table[named[0]]) if named else ""
        if named:
            _check_pattern(check, named[0], pattern, DEPTHS if depth else CLOUDS)
        unit, box = _unit(check, table.get("unit"), length), _box(check, table.get("box")) * length
        position = np.array(_numbers(lens_check, camera, "position", 3, [0.0] * 3)) * length
        placed = "position" in camera or depth
        found = cls(pattern, depth, unit, sigma * length, box, tuple(lens), position, np.array(rotation), placed)
        return found if len(problems.found) == before else None

    def files(self, folder: Path) -> dict[Path, tuple[str | None, int]]:
        """The files that there are, with the action (None where the pattern does not name it) and the step of each."""
        parts = re.split(r"(\{action\}|\{step\})", self.pattern)
        named = {"{action}": r"(?P<action>[^/]+?)", "{step}": r"(?P<step>[0-9]{1,9})"}
        form = re.compile("".join(named.get(part, re.escape(part)) for part in parts))
        found = {}
        for file in sorted(folder.glob("".join("*" if part in named else part for part in parts))):
            match = form.fullmatch(file.relative_to(folder).as_posix())
            if match and file.is_file():
                found[file] = match.groupdict().get("action"), int(match["step"])
        return found

    def read(self, folder: Path, known: list[Frame]) -> Cloud:
        """The points of all steps.

        Args:
            folder: of the measurement.
            known: the steps whose times are known.

        Raises:
            InputError: there are no files, one cannot be read, or its step is not known.
        """
        files, actions = self.files(folder), list(dict.fromkeys(action for action, _ in known))
        problems = Problems(f"surface of {folder}")
        if not files:
            problems.add(folder, f"holds no file '{self.pattern}', which [surface] names")
        frames: dict[Path, Frame] = {}
        for file, (action, step) in files.items():
            frame = action or (actions[0] if len(actions) == 1 else ""), step
            if frame not in known:
                hint = "" if action or len(actions) == 1 else "; write {action} into the name, for there are several"
                problems.add(file, f"is of step {step} of action '{frame[0]}', whose time no table tells{hint}")
            frames[file] = frame
        problems.raise_if_any()
        points = [self.placed(array) for array in _contents(list(files))]
        counts = [len(one) for one in points]
        order = list(dict.fromkeys(frames.values()))
        numbers = np.array([order.index(frame) for frame in frames.values()])
        total = np.concatenate(points)
        return Cloud(total, np.full(len(total), self.sigma), tuple(order), np.repeat(numbers, counts), self.camera)

    @property
    def camera(self) -> Array | None:
        """Where the points are seen from, m; None where that is not stated."""
        return self.position if self.placed_camera else None

    def placed(self, array: Array) -> Array:
        """Points (n, 3), m, in the frame of the body, of what a file holds; at most `MOST_POINTS`."""
        points = self._seen(array) if self.depth else array[:, :3] * self.unit
        points = as_rotation(self.rotation[None])[0].apply(points[np.isfinite(points).all(axis=1)]) + self.position
        points = points[((points >= self.box[0]) & (points <= self.box[1])).all(axis=1)]
        return np.asarray(points[:: max(math.ceil(len(points) / MOST_POINTS), 1)])

    def _seen(self, depths: Array) -> Array:
        """Points in the axes of the camera (x right, y down, z ahead), m, of depths (rows, columns); zero is no depth."""
        rows, columns = np.nonzero(np.isfinite(depths) & (depths > 0))
        ahead = depths[rows, columns] * self.unit
        fx, fy, cx, cy = self.lens
        return np.column_stack([(columns - cx) * ahead / fx, (rows - cy) * ahead / fy, ahead])


def _contents(files: list[Path]) -> list[Array]:
    """The arrays of files, read by processes of their own, several files of a folder by each."""
    found: dict[Path, Array] = {}
    for folder in dict.fromkeys(file.parent for file in files):
        inside = [file for file in files if file.parent == folder]
        for first in range(0, len(inside), _TOGETHER):
            batch = inside[first : first + _TOGETHER]
            names = [f"body{batch[0].suffix}", *(file.name for file in batch[1:])]
            try:
                arrays = read_in_child(
                    "bcid.measurement.formats.cloud_file",
                    batch[0],
                    names,
                    seconds=_SECONDS * len(batch),
                    beside=batch[1:],
                )
            except (InputError, TimeoutError) as error:
                reason = str(error).removeprefix(f"{names[0]}: ")
                raise InputError(f"{folder}: a file of the surface cannot be read: {reason}") from None
            for file, name in zip(batch, names, strict=True):
                if arrays[name].ndim != 2 or not arrays[name].size:
                    raise InputError(
                        f"{file}: expected points (n, 3) or depths (rows, columns), found {arrays[name].shape}"
                    )
                found[file] = arrays[name]
    return [found[file] for file in files]


def _numbers(check: Stated, table: Mapping[str, Any], key: str, count: int, absent: list[float]) -> list[float]:
    value = table.get(key)
    if value is None:
        return absent
    values = value if isinstance(value, list) else [value]
    fine = len(values) == count and all(map(is_number, values))
    what = "a number" if count == 1 else f"{count} numbers"
    return [float(v) for v in values] if check.expect(fine, key, what, value) else absent


def _check_pattern(check: Stated, key: str, pattern: str, suffixes: tuple[str, ...]) -> None:
    inside = pattern.count("{step}") == 1 and pattern.count("{action}") < 2
    inside = inside and ".." not in pattern and not pattern.startswith("/")
    check.expect(inside, key, "a path in this folder that holds {step} once", pattern)
    check.expect(Path(pattern).suffix.lower() in suffixes, key, f"one of {', '.join(suffixes)}", pattern)


def _unit(check: Stated, value: Any, absent: float) -> float:
    try:
        return absent if value is None else unit_factor(str(value), "m")
    except InputError as error:
        check.bad("unit", str(error))
        return absent


def _box(check: Stated, value: Any) -> Array:
    everywhere = np.array([[-np.inf] * 3, [np.inf] * 3])
    if value is None:
        return everywhere
    corners = value if isinstance(value, list) and len(value) == 2 else [None, None]
    found = np.array([_numbers(check, {"box": corner}, "box", 3, [math.nan] * 3) for corner in corners])
    fine = bool((found[0] < found[1]).all())
    return found if check.expect(fine, "box", "two corners, the lower first", value) else everywhere
