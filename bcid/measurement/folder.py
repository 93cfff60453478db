"""The measurement folder: `measurement.toml` and plain CSV files that any lab can write from a spreadsheet."""

from __future__ import annotations

import csv
import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from bcid.base.errors import InputError, Problems
from bcid.base.text_file import read_lines, read_toml
from bcid.base.units import LEAST_SIGMA, measurable, unit_factor
from bcid.measurement import surface_table
from bcid.measurement.cloud import Cloud, Frame
from bcid.measurement.contents import (
    AXES,
    FORMAT,
    QUATERNION,
    SIGMAS,
    WRENCH,
    Contents,
    Units,
    frames_dataset,
    sigma_units,
    with_sigmas,
)
from bcid.measurement.frame_error import FrameError
from bcid.measurement.scale import SCALE_KEYS, checked_flag, checked_scale
from bcid.measurement.surface_files import SurfaceFiles
from bcid.scene.action import Action

_UNIT_KEYS = {"length_unit": "m", "time_unit": "s", "force_unit": "N"}
_KEYS = ("format", *_UNIT_KEYS, *SIGMAS, *SCALE_KEYS, "description")
_SIGMA = ["sigma_x", "sigma_y", "sigma_z"]
_TIME_TOLERANCE = 1e-9
_REST_TOLERANCE = 1e-6
# Steps times fiducials (or places): with their standard deviations they take 2.4 GB.
_MOST_POSITIONS = 50_000_000


@dataclass
class _Table:
    """Rows of one CSV file: where each frame's numbers stand, with the line for messages."""

    rows: list[tuple[int, dict[str, str]]] = field(default_factory=list)
    columns: list[str] = field(default_factory=list)


@dataclass
class _Header:
    units: Units
    length: float
    time: float
    force: float
    description: str
    sigmas: tuple[Any, ...] = ()
    scale: tuple[float | None, bool] = (None, False)
    surface: SurfaceFiles | None = None


def read_folder(folder: Path) -> Contents:
    """Read a measurement folder; see `bcid.measurement.Measurement.read`."""
    if not folder.is_dir():
        raise InputError(f"{folder}: no such measurement folder; expected a folder with measurement.toml and CSV files")
    problems = Problems(f"measurement {folder}")
    for name in ("measurement.toml", "grasps.csv"):
        if not (folder / name).is_file():
            hint = "; write its header line alone when nothing grasps the body" if name == "grasps.csv" else ""
            problems.add(folder / name, f"is missing{hint}")
    problems.raise_if_any()
    header = _read_header(folder / "measurement.toml", problems)
    if (header.surface is None or not header.surface.pattern) and not any(
        (folder / name).is_file() for name in ("fiducials.csv", surface_table.FILE)
    ):
        problems.add(folder / "fiducials.csv", f"is missing, and so is {surface_table.FILE}")
    reader = _FolderReader(folder, header, problems)
    data = reader.dataset()
    problems.raise_if_any()
    assert data is not None
    noise, force, torque = header.sigmas
    if isinstance(noise, tuple):
        data, noise = with_sigmas(data, noise), None
    file = folder / "frame.toml"
    error = FrameError.read(file, header.length) if file.is_file() else None
    about = header.units, header.description, str(folder), error
    found = Contents(data, noise, force, *about, torque_sigma=torque, cloud=reader.cloud)
    return replace(found, scale_sigma=header.scale[0], scale_of_gripper=header.scale[1])


def read_grasps(path: Path, units: Units) -> list[Action]:
    """The motions of the gripper in a grasps.csv that stands alone, numbered along one frame axis in the order of its rows.

    Raises:
        InputError: with every problem of the file.
    """
    problems = Problems(f"motions {path}")
    if not path.is_file():
        raise InputError(f"{path}: no such file with the poses of the gripper")
    reader = _FolderReader(path.parent, _Header(units, *units.factors, ""), problems, path.name)
    poses = reader.grasps()
    if not poses and not problems.found:
        reader.bad(None, "holds no pose")
    frames, actions = list(poses), []
    rows: dict[str, list[int]] = {}
    for number, (action, _) in enumerate(frames):
        rows.setdefault(action, []).append(number)
    for name, here in rows.items():
        if here[-1] - here[0] >= len(here):
            reader.bad(None, f"the rows of action {name} do not stand together")
        steps = [frames[number][1] for number in here]
        reader.check_steps(name, steps)
        reader.check_motion(name, steps, poses)
        _, grasps, translations, rotations = zip(*(poses[frames[number]] for number in here), strict=True)
        times = np.array([reader.times[frames[number]] for number in here])
        moved = np.array(translations), np.array(rotations)
        actions.append(Action(name, np.array(here), np.array(steps), grasps[0], *moved, times=times))
    problems.raise_if_any()
    return actions


def _read_header(path: Path, problems: Problems) -> _Header:
    table = read_toml(path)
    problems.add_unknown(path, table, (*_KEYS, "surface"))
    if table.get("format") != FORMAT:
        problems.add(path, f'format: expected "{FORMAT}", found {table.get("format")!r}')
    factors = [_unit(path, table, key, like, problems) for key, like in _UNIT_KEYS.items()]
    units = sigma_units(factors[0], factors[2])
    stated: list[Any] = [_sigma(path, table, key, unit, problems) for key, unit in zip(SIGMAS, units, strict=True)]
    description = table.get("description", "")
    if not isinstance(description, str):
        problems.add(path, f"description: expected text, found {description!r}")
    return _Header(
        Units(*(str(table.get(key, like)) for key, like in _UNIT_KEYS.items())),
        factors[0],
        factors[1],
        factors[2],
        str(description),
        tuple(stated),
        (checked_scale(path, table, problems), checked_flag(path, table, problems)),
        SurfaceFiles.checked(table["surface"], factors[0], path, problems) if "surface" in table else None,
    )


def _unit(path: Path, table: dict[str, Any], key: str, like: str, problems: Problems) -> float:
    unit = table.get(key)
    if not isinstance(unit, str):
        found = "is missing" if unit is None else f"expected text, found {unit!r}"
        problems.add(path, f'{key}: {found}; write {key} = "{"mm" if like == "m" else like}"')
        return 1.0
    try:
        return unit_factor(unit, like)
    except InputError as error:
        problems.add(path, f"{key}: {error}")
        return 1.0


def _sigma(
    path: Path, table: dict[str, Any], key: str, unit: float, problems: Problems
) -> float | tuple[float | None, ...] | None:
    """A stated standard deviation, SI, or that of each axis."""
    value = table.get(key)
    if value is None:
        return None
    if key == "noise_sigma" and isinstance(value, list):
        if len(value) != len(AXES):
            problems.add(path, f"{key}: expected one number, or three for x, y and z, found {value!r}")
            return None
        return tuple(_number(path, {key: one}, key, unit, problems) for one in value)
    return _number(path, table, key, unit, problems)


def _number(path: Path, table: dict[str, Any], key: str, unit: float, problems: Problems) -> float | None:
    value = table[key]
    if isinstance(value, bool) or not isinstance(value, int | float) or not measurable(value * unit):
        allowed = f"from {LEAST_SIGMA / unit:.3g} to 1e30 (its unit is the folder's)"
        problems.add(path, f"{key}: expected a positive number {allowed}, found {value!r}")
        return None
    return float(value) * unit


class _FolderReader:
    """Reads the CSV files into one Dataset, noting every problem with its line."""

    def __init__(self, folder: Path, header: _Header, problems: Problems, motions: str = "grasps.csv") -> None:
        self.folder, self.motions = folder, motions
        self.header = header
        self.problems = problems
        self.times: dict[Frame, float] = {}
        self.cloud: Cloud | None = None
        self.file = ""

    def bad(self, line: int | None, text: str) -> None:
        self.problems.add(self.folder / self.file, text, line)

    def dataset(self) -> xr.Dataset | None:
        seen = self.fiducials()
        self.file = surface_table.FILE
        self.cloud = surface_table.read_table(self, self.folder / self.file, self.header.length)
        poses = self.grasps()
        self.surface_files()
        wrench = self.vectors("wrench.csv", [], WRENCH, [])
        loads = self.vectors("loads.csv", WRENCH[:3], [], ["place"])
        size = len(self.times) * max(len({name for _, name in seen}), len({name for _, name in loads}))
        if size > _MOST_POSITIONS:
            self.file = "fiducials.csv"
            self.bad(
                None, f"names and steps make {size} positions, most without a row; at most {_MOST_POSITIONS} are read"
            )
        if self.problems.found:
            return None
        self.check_frames(seen, poses)
        if self.problems.found:
            return None
        return self.assemble(seen, poses, wrench, loads)

    def table(self, name: str, required: list[str], optional: list[str] | None = None) -> _Table:
        """Rows of a CSV file whose columns are `required` and any of `optional`, in any order."""
        self.file = name
        path = self.folder / name
        if not path.exists():
            return _Table()
        return self.rows(csv.reader(read_lines(path)), required, optional or [])

    def rows(self, lines: Any, required: list[str], optional: list[str]) -> _Table:
        try:
            columns = [name.strip() for name in next(lines, [])]
            table = self.columns(columns, required, optional)
            for row in lines:
                if not any(cell.strip() for cell in row):
                    continue
                if len(row) != len(columns):
                    self.bad(lines.line_num, f"has {len(row)} values, the header names {len(columns)} columns")
                elif table.columns:
                    cells = {column: cell.strip() for column, cell in zip(columns, row, strict=True)}
                    table.rows.append((lines.line_num, cells))
        except csv.Error as error:
            self.bad(lines.line_num, f"is not a table: {error}")
            return _Table()
        return table

    def columns(self, columns: list[str], required: list[str], optional: list[str]) -> _Table:
        counts = Counter(columns)
        missing = [name for name in required if name not in counts]
        unknown = [name for name in columns if name not in required + optional]
        double = sorted(name for name, count in counts.items() if count > 1)
        if missing:
            self.bad(1, f"column {', '.join(missing)} is missing; expected {','.join(required)}")
        text = "unknown column '{}'; {}".format
        self.problems.add_unknown(self.folder / self.file, unknown, required + optional, text, 1)
        if double:
            self.bad(1, f"column {', '.join(double)} stands twice")
        return _Table() if missing or unknown or double else _Table(columns=columns)

    def number(self, line: int, row: dict[str, str], column: str) -> float:
        text = row[column]
        try:
            value = float(text) if text.isascii() and "_" not in text else math.nan
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            hint = "; leave a cell empty where a coordinate was not measured" if column in AXES else ""
            self.bad(line, f"{column}: expected a finite number, found '{text}'{hint}")
            return 0.0
        return value

    def frame(self, line: int, row: dict[str, str], last: dict[str, int]) -> Frame | None:
        """Action and step of a row; steps must not go back within an action."""
        action, step = row["action"], row["step"]
        if not action or any(c in action for c in "\"'\\/") or not action.isprintable() or len(action) > 64:
            self.bad(line, f"action: expected a short name without quotes or slashes, found '{action}'")
            return None
        if not step.isascii() or not step.isdigit() or len(step) > 9:
            self.bad(line, f"step: expected a whole number from 0, found '{step}'")
            return None
        frame = action, int(step)
        if frame[1] < last.get(action, 0):
            self.bad(line, f"step {step} of action {action} stands after step {last[action]}: sort the rows by step")
            return None
        last[action] = frame[1]
        return frame if self.timed(line, row, frame) else None

    def timed(self, line: int, row: dict[str, str], frame: Frame) -> bool:
        before = len(self.problems.found)
        time = self.number(line, row, "time") * self.header.time
        if len(self.problems.found) > before:
            return False
        known = self.times.setdefault(frame, time)
        if abs(known - time) > _TIME_TOLERANCE * max(1.0, abs(known)):
            self.bad(
                line, f"time: step {frame[1]} of action {frame[0]} is at {known:g} s elsewhere, here at {time:g} s"
            )
            return False
        return True

    def frames(self, table: _Table, keys: list[str]) -> Iterator[tuple[int, dict[str, str], Frame]]:
        """Valid rows, refusing a second row for the same frame and `keys`."""
        last: dict[str, int] = {}
        seen: dict[tuple[Any, ...], int] = {}
        for line, row in table.rows:
            frame = self.frame(line, row, last)
            if frame is None:
                continue
            key = (*frame, *(row[k] for k in keys))
            if key in seen:
                what = ", ".join(f"{k} {v}" for k, v in zip(["action", "step", *keys], key, strict=True))
                self.bad(line, f"a second row for {what}; the first is in line {seen[key]}")
                continue
            seen[key] = line
            yield line, row, frame

    def fiducials(self) -> dict[tuple[Frame, str], tuple[list[float], list[float]]]:
        """Positions and sigmas (m) by frame and fiducial."""
        table = self.table("fiducials.csv", ["action", "step", "time", "fiducial"], [*AXES, *_SIGMA])
        axes = [axis for axis in AXES if axis in table.columns]
        if table.columns and not axes:
            self.bad(
                1, "column x, y, z is missing; expected at least one of them, for the coordinates that were measured"
            )
        result = {}
        for line, row, frame in self.frames(table, ["fiducial"]):
            name = row["fiducial"]
            if not name:
                self.bad(line, "fiducial: its name is empty")
                continue
            position = [self.number(line, row, a) * self.header.length if row.get(a) else math.nan for a in AXES]
            result[frame, name] = position, [self.row_sigma(line, row, column) for column in _SIGMA]
        if table.columns and not table.rows:
            self.bad(None, "is empty: expected one row for each step and fiducial")
        elif axes and result and not any(np.isfinite(position).any() for position, _ in result.values()):
            self.bad(None, "holds no position: no fiducial was ever seen")
        return result

    def surface_files(self) -> None:
        """Points of the surface in files of their own, once the times of the steps are known."""
        if self.header.surface is None or self.problems.found:
            return
        if self.cloud is not None and not self.header.surface.pattern:
            self.cloud = replace(self.cloud, camera=self.header.surface.camera)
        elif self.cloud is not None:
            self.file = surface_table.FILE
            self.bad(None, "stands beside files that [surface] in measurement.toml names: leave one of them out")
        elif not self.header.surface.pattern:
            self.file = "measurement.toml"
            self.bad(None, f"[surface]: names no files, and there is no {surface_table.FILE}")
        else:
            self.cloud = self.header.surface.read(self.folder, list(self.times))

    def row_sigma(self, line: int, row: dict[str, str], column: str) -> float:
        if not row.get(column):
            return math.nan
        value = self.number(line, row, column) * self.header.length
        if not measurable(value):
            self.bad(line, f"{column}: expected a positive number of at least {LEAST_SIGMA:g} m, found '{row[column]}'")
        return value

    def grasps(self) -> dict[Frame, tuple[int, str, list[float], list[float]]]:
        """Line, grasp name, translation (m) and unit quaternion by frame."""
        table = self.table(self.motions, ["action", "step", "time", "grasp", *AXES, *QUATERNION])
        result = {}
        for line, row, frame in self.frames(table, []):
            translation = [self.number(line, row, axis) * self.header.length for axis in AXES]
            rotation = np.array([self.number(line, row, q) for q in QUATERNION])
            norm = math.hypot(*rotation)
            if not row["grasp"]:
                self.bad(line, "grasp: its name is empty; leave out the rows of an action without a grasp")
            if abs(norm - 1) > 1e-3:
                self.bad(line, f"qw,qx,qy,qz: expected a unit quaternion, found one of length {norm:.4g}")
                norm = norm or 1.0
            # What is of unit length already stays as it is, so that writing and reading again changes no bit.
            unit = rotation if abs(norm - 1) < 1e-14 else rotation / norm
            result[frame] = line, row["grasp"], translation, list(unit)
        return result

    def vectors(
        self, name: str, required: list[str], optional: list[str], keys: list[str]
    ) -> dict[tuple[Frame, str], list[float]]:
        """Forces (N) and torques (N m) of a file that may be missing, by frame and place; NaN where one is not given."""
        result, columns = {}, [*required, *optional]
        table = self.table(name, ["action", "step", "time", *keys, *required], optional)
        if table.columns and not set(columns) & set(table.columns):
            self.bad(1, f"column {', '.join(columns)} is missing; expected at least one of them")
        for line, row, frame in self.frames(table, keys):
            if any(not row[key] or not row[key].isprintable() for key in keys):
                self.bad(line, f"{keys[0]}: expected the name of a place of the scene, found {row[keys[0]]!r}")
                continue
            unit = [self.header.force * (self.header.length if column.startswith("t") else 1.0) for column in columns]
            given = [column in required or bool(row.get(column)) for column in columns]
            values = [
                self.number(line, row, column) * u if there else math.nan
                for column, u, there in zip(columns, unit, given, strict=True)
            ]
            result[frame, row[keys[0]] if keys else ""] = values
        return result

    def check_frames(self, seen: dict[tuple[Frame, str], Any], poses: dict[Frame, Any]) -> None:
        recorded = {action for (action, _), _ in seen} | {
            action for action, _ in (self.cloud.frames if self.cloud else ())
        }
        actions: dict[str, list[int]] = {}
        for action, step in self.times:
            actions.setdefault(action, []).append(step)
        for action, unsorted in actions.items():
            self.file = "fiducials.csv"
            steps = sorted(unsorted)
            self.check_steps(action, steps)
            if action not in recorded:
                self.bad(None, f"action {action} has a motion but no fiducial was recorded")
            self.file = self.motions
            self.check_motion(action, steps, poses)

    def check_steps(self, action: str, steps: list[int]) -> None:
        """The steps of an action begin with 0, and their times do not go back."""
        if steps[0] != 0:
            self.bad(None, f"action {action} starts at step {steps[0]}: step 0, the rest pose, is missing")
        times = [self.times[action, step] for step in steps]
        back = next((i for i in range(1, len(times)) if times[i] < times[i - 1]), None)
        if back is not None:
            self.bad(None, f"time: goes back at step {steps[back]} of action {action}, to {times[back]:g} s")

    def check_motion(self, action: str, steps: list[int], poses: dict[Frame, Any]) -> None:
        present = [step for step in steps if (action, step) in poses]
        if present and present != steps:
            absent = ", ".join(str(step) for step in steps if step not in present)
            self.bad(None, f"action {action}: no pose of the gripper for step {absent}")
        names = list(dict.fromkeys(poses[action, step][1] for step in present))
        if len(names) > 1:
            self.bad(None, f"action {action} uses grasps {', '.join(names)}: start another action for another grasp")
        if (action, 0) in poses:
            line, _, translation, rotation = poses[action, 0]
            if max(map(abs, translation)) > _REST_TOLERANCE or abs(rotation[0]) < 1 - _REST_TOLERANCE:
                self.bad(
                    line, f"step 0 of action {action} must be the rest pose: x,y,z = 0,0,0 and qw,qx,qy,qz = 1,0,0,0"
                )

    def assemble(
        self,
        seen: dict[tuple[Frame, str], tuple[list[float], list[float]]],
        poses: dict[Frame, tuple[int, str, list[float], list[float]]],
        wrench: dict[tuple[Frame, str], list[float]],
        loads: dict[tuple[Frame, str], list[float]],
    ) -> xr.Dataset:
        actions = list(dict.fromkeys(action for action, _ in self.times))
        order = {action: number for number, action in enumerate(actions)}
        frames = sorted(self.times, key=lambda frame: (order[frame[0]], frame[1]))
        names = list(dict.fromkeys(name for _, name in seen))
        identity = (0, "", [0.0] * 3, [1.0, 0.0, 0.0, 0.0])
        held = [poses.get(frame, identity) for frame in frames]
        positions = _stack(frames, names, {key: position for key, (position, _) in seen.items()}, math.nan)
        sigma = _stack(frames, names, {key: sigmas for key, (_, sigmas) in seen.items()}, math.nan)
        data = frames_dataset(frames, [self.times[frame] for frame in frames], names, positions)
        data["grasp"] = ("frame", [pose[1] for pose in held])
        data["translation"] = (("frame", "axis"), np.array([pose[2] for pose in held]))
        data["rotation"] = (("frame", "quaternion"), np.array([pose[3] for pose in held]))
        if np.isfinite(sigma).any():
            data["sigma"] = (("frame", "fiducial", "axis"), sigma)
        if wrench:
            values = [wrench.get((frame, ""), [math.nan] * 6) for frame in frames]
            data = data.assign_coords(component=WRENCH)
            data["wrench"] = (("frame", "component"), np.array(values))
        if loads:
            places = list(dict.fromkeys(place for _, place in loads))
            data = data.assign_coords(place=places)
            stacked = _stack(frames, places, loads, 0.0)
            data["load"] = (("frame", "place", "axis"), stacked)
        return data


def _stack(
    frames: list[Frame], names: list[str], rows: dict[tuple[Frame, str], list[float]], absent: float
) -> np.ndarray:
    """Vectors of each frame and name, shape (frames, names, 3), `absent` where there is no row."""
    stacked = np.full((len(frames), len(names), 3), absent)
    if rows:
        frame_number = {frame: number for number, frame in enumerate(frames)}
        name_number = {name: number for number, name in enumerate(names)}
        places = np.array([(frame_number[frame], name_number[name]) for frame, name in rows])
        stacked[places[:, 0], places[:, 1]] = list(rows.values())
    return stacked
