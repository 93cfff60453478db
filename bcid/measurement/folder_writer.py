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
from bcid.measurement.contents import FORMAT, SIGMAS, WRENCH, Cloud, Contents, sigma_units
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
    data, units = measurement.data, measurement.units
    length, time, force = units.factors
    head = [
        f"{a},{s},{_written(t / time)}"
        for a, s, t in zip(*(data[n].values for n in ("action", "step", "time")), strict=True)
    ]
    texts = {"measurement.toml": _header_lines(measurement, length, force)}
    sigma = data["sigma"].values / length if "sigma" in data else None
    lines = ["action,step,time,fiducial,x,y,z" + (",sigma_x,sigma_y,sigma_z" if sigma is not None else "")]
    for i, start in enumerate(head):
        for j, name in enumerate(measurement.fiducial_names):
            cells = [_written(v) for v in measurement.positions[i, j] / length]
            cells += [] if sigma is None else [_written(v) for v in sigma[i, j]]
            lines.append(f"{start},{name},{','.join(cells)}")
    if measurement.fiducial_names:
        texts["fiducials.csv"] = lines
    if measurement.cloud is not None:
        texts[SURFACE] = _surface_lines(measurement.cloud, data, head, length)
    texts["grasps.csv"] = grasp_lines([action for action in measurement.actions if action.grasp], length, time)
    if "wrench" in data:
        scale = np.array([force] * 3 + [force * length] * 3)
        rows = [
            f"{start},{','.join(_written(v) for v in row / scale)}"
            for start, row in zip(head, data["wrench"].values, strict=True)
        ]
        rows = [row for row, values in zip(rows, data["wrench"].values, strict=True) if np.isfinite(values).any()]
        texts["wrench.csv"] = ["action,step,time," + ",".join(WRENCH), *rows]
    if "load" in data:
        texts["loads.csv"] = ["action,step,time,place,fx,fy,fz"] + [
            f"{start},{place},{','.join(_written(v) for v in data['load'].values[i, k] / force)}"
            for i, start in enumerate(head)
            for k, place in enumerate(data["place"].values)
        ]
    if measurement.frame_error is not None:
        texts["frame.toml"] = measurement.frame_error.lines(length)
    return texts


def _surface_lines(cloud: Cloud, data: xr.Dataset, head: list[str], length: float) -> list[str]:
    """Lines of a surface.csv; `head` has action, step and time of each frame."""
    numbers = cloud.numbers(data)
    stated = bool(np.isfinite(cloud.sigma).any())
    lines = ["action,step,time,x,y,z" + (",sigma" if stated else "")]
    for k in np.argsort(numbers, kind="stable"):
        if numbers[k] >= 0:
            values = [*cloud.points[k], cloud.sigma[k]] if stated else cloud.points[k]
            lines.append(f"{head[numbers[k]]},{','.join(_written(v / length) for v in values)}")
    return lines


def grasp_lines(actions: Iterable[Action], length: float, time: float) -> list[str]:
    """Lines of a grasps.csv: the poses of the gripper, in units of `length` m and `time` s."""
    lines = ["action,step,time,grasp,x,y,z,qw,qx,qy,qz"]
    for action in actions:
        rows = zip(action.steps, action.clock / time, action.translation / length, action.rotation, strict=True)
        for step, at, translation, rotation in rows:
            cells = [*map(_written, (at, *translation)), *(f"{v:.17g}" for v in rotation)]
            lines.append(f"{action.name},{step},{cells[0]},{action.grasp},{','.join(cells[1:])}")
    return lines


def _header_lines(measurement: Contents, length: float, force: float) -> list[str]:
    lines = [f'format = "{FORMAT}"']
    lines += [f'{name}_unit = "{unit}"' for name, unit in asdict(measurement.units).items()]
    for name, scale in zip(SIGMAS, sigma_units(length, force), strict=True):
        value = getattr(measurement, name)
        if value is not None:
            lines.append(f"{name} = {_written(value / scale)}")
    if measurement.scale_sigma is not None:
        lines.append(f"scale_sigma = {_written(measurement.scale_sigma)}")
    lines += ["scale_of_gripper = true"] if measurement.scale_of_gripper else []
    if measurement.cloud is not None and measurement.cloud.camera is not None:
        place = ", ".join(f"{v / length:.12g}" for v in measurement.cloud.camera)
        surface = ["", "[surface.camera]", f"position = [{place}]"]
    else:
        surface = []
    if measurement.description:
        escaped = measurement.description.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n")
        lines.append(f'description = "{escaped}"')
    return [*lines, *surface]


def _written(value: float) -> str:
    """A number as the tables have it; nothing for NaN."""
    return "" if math.isnan(value) else f"{value:.12g}"
