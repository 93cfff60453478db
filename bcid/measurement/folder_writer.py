"""Writing a measurement folder; `bcid.measurement.folder` reads it."""

from __future__ import annotations

import math
import shutil
from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path

import numpy as np
import xarray as xr

from bcid.base.errors import InputError, unwritable
from bcid.measurement.contents import FORMAT, SIGMAS, WRENCH, Cloud, Contents
from bcid.measurement.folder import SURFACE
from bcid.scene.action import Action


def write_folder(measurement: Contents, folder: Path) -> None:
    """Write the folder format; the folder appears whole or not at all.

    Raises:
        InputError: the folder exists.
        MachineError: it cannot be written.
    """
    if folder.exists():
        raise InputError(f"{folder}: exists already; choose another place or remove it")
    partial = folder.with_name(folder.name + ".partial")
    try:
        shutil.rmtree(partial, ignore_errors=True)
        partial.mkdir(parents=True)
        for name, lines in _texts(measurement).items():
            (partial / name).write_text("\n".join(lines) + "\n", encoding="utf-8")
        partial.rename(folder)
    except OSError as error:
        shutil.rmtree(partial, ignore_errors=True)
        raise unwritable(folder, error) from None


def _texts(measurement: Contents) -> dict[str, list[str]]:
    data = measurement.data
    length, time, force = measurement.units.factors
    frames = zip(*(data[name].values for name in ("action", "step", "time")), strict=True)
    head = [f"{action},{step},{_cells([at / time])}" for action, step, at in frames]
    texts = {"measurement.toml": _header_lines(measurement, length, force)}
    if names := measurement.fiducial_names:
        stated = [data["sigma"].values] if "sigma" in data else []
        values = np.concatenate([measurement.positions, *stated], axis=2) / length
        texts["fiducials.csv"] = ["action,step,time,fiducial,x,y,z" + (",sigma_x,sigma_y,sigma_z" if stated else "")]
        texts["fiducials.csv"] += _each(head, names, values)
    if measurement.cloud is not None:
        texts[SURFACE] = _surface_lines(measurement.cloud, data, head, length)
    texts["grasps.csv"] = grasp_lines([action for action in measurement.actions if action.grasp], length, time)
    if "wrench" in data:
        rows = zip(head, data["wrench"].values / ([force] * 3 + [force * length] * 3), strict=True)
        texts["wrench.csv"] = ["action,step,time," + ",".join(WRENCH)]
        texts["wrench.csv"] += [f"{start},{_cells(row)}" for start, row in rows if np.isfinite(row).any()]
    if "load" in data:
        texts["loads.csv"] = ["action,step,time,place,fx,fy,fz"]
        texts["loads.csv"] += _each(head, data["place"].values, data["load"].values / force)
    if measurement.frame_error is not None:
        texts["frame.toml"] = measurement.frame_error.lines(length)
    return texts


def _each(head: Iterable[str], names: Iterable[str], values: np.ndarray) -> list[str]:
    """A line for each frame and name, of values (frames, names, columns)."""
    return [f"{start},{name},{_cells(values[i, k])}" for i, start in enumerate(head) for k, name in enumerate(names)]


def _surface_lines(cloud: Cloud, data: xr.Dataset, head: list[str], length: float) -> list[str]:
    """Lines of a surface.csv; `head` has action, step and time of each frame."""
    numbers = cloud.numbers(data)
    stated = bool(np.isfinite(cloud.sigma).any())
    lines = ["action,step,time,x,y,z" + (",sigma" if stated else "")]
    for k in np.argsort(numbers, kind="stable"):
        if numbers[k] >= 0:
            values = [*cloud.points[k], cloud.sigma[k]] if stated else cloud.points[k]
            lines.append(f"{head[numbers[k]]},{_cells(np.array(values) / length)}")
    return lines


def grasp_lines(actions: Iterable[Action], length: float, time: float) -> list[str]:
    """Lines of a grasps.csv: the poses of the gripper, in units of `length` m and `time` s."""
    lines = ["action,step,time,grasp,x,y,z,qw,qx,qy,qz"]
    for action in actions:
        rows = zip(action.steps, action.clock / time, action.translation / length, action.rotation, strict=True)
        for step, at, translation, rotation in rows:
            turn = ",".join(f"{v:.17g}" for v in rotation)
            lines.append(f"{action.name},{step},{_cells([at])},{action.grasp},{_cells(translation)},{turn}")
    return lines


def _header_lines(measurement: Contents, length: float, force: float) -> list[str]:
    lines = [f'format = "{FORMAT}"']
    lines += [f'{name}_unit = "{unit}"' for name, unit in asdict(measurement.units).items()]
    for name, scale in zip(SIGMAS, (length, force, length * force), strict=True):
        value = getattr(measurement, name)
        if value is not None:
            lines.append(f"{name} = {_cells([value / scale])}")
    if measurement.scale_sigma is not None:
        lines.append(f"scale_sigma = {_cells([measurement.scale_sigma])}")
    lines += ["scale_of_gripper = true"] if measurement.scale_of_gripper else []
    if measurement.description:
        escaped = measurement.description.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n")
        lines.append(f'description = "{escaped}"')
    if measurement.cloud is not None and measurement.cloud.camera is not None:
        lines += ["", "[surface.camera]", f"position = [{_cells(measurement.cloud.camera / length)}]"]
    return lines


def _cells(values: Iterable[float]) -> str:
    """Numbers as the tables have them; nothing for NaN."""
    return ",".join("" if math.isnan(value) else f"{value:.12g}" for value in values)
