"""The measurement folder: `measurement.toml` and plain CSV files that any lab can write from a spreadsheet."""

from __future__ import annotations

import csv
import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from bcid.base.errors import InputError, Problems
from bcid.base.text_file import read_lines, read_toml
from bcid.base.units import LEAST_SIGMA, measurable
from bcid.measurement.contents import (
    AXES,
    FORMAT,
    QUATERNION,
    SIGMAS,
    WRENCH,
    Cloud,
    Contents,
    Frame,
    Sigma,
    Units,
    frames_dataset,
    with_noise,
)
from bcid.measurement.frame_error import FrameError
from bcid.measurement.stated import SCALE_KEYS, UNITS, Stated
from bcid.measurement.surface_files import SurfaceFiles
from bcid.scene.action import Action

# Number of the line, for messages, and cells by column.
Row = tuple[int, dict[str, str]]
_KEYS = ("format", *UNITS, *SIGMAS, *SCALE_KEYS, "description", "surface")
SURFACE = "surface.csv"
_SIGMA = ["sigma_x", "sigma_y", "sigma_z"]
_TIME_TOLERANCE = 1e-9
_REST_TOLERANCE = 1e-6
# Steps times fiducials (or places): with their standard deviations they take 2.4 GB.
_MOST_POSITIONS = 50_000_000
# Line, name of the grasp, translation (m) and unit quaternion.
_Pose = tuple[int, str, list[float], list[float]]


@dataclass(frozen=True)
class _Header:
    """What measurement.toml states, with SI per unit of length, time and force in `factors`."""

    units: Units
    factors: tuple[float, float, float]
    description: str = ""
    sigmas: tuple[Sigma, float | None, float | None] = (None, None, None)
    scale: tuple[float | None, bool] = (None, False)
    surface: SurfaceFiles | None = None

    @classmethod
    def read(cls, path: Path, problems: Problems) -> _Header:
        table, check = read_toml(path), Stated(path, problems)
        check.only(table, _KEYS)
        check.expect(table.get("format") == FORMAT, "format", f'"{FORMAT}"', table.get("format"))
        units, factors = check.units(table)
        description = table.get("description", "")
        check.expect(isinstance(description, str), "description", "text", description)
        sigmas, scale = check.sigmas(table, factors[0], factors[2]), (check.scale(table), check.flag(table))
        surface = SurfaceFiles.checked(table["surface"], factors[0], path, problems) if "surface" in table else None
        return cls(units, factors, str(description), sigmas, scale, surface)


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
    header = _Header.read(folder / "measurement.toml", problems)
    named = header.surface is not None and header.surface.pattern
    if not named and not any((folder / name).is_file() for name in ("fiducials.csv", SURFACE)):
        problems.add(folder / "fiducials.csv", f"is missing, and so is {SURFACE}")
    reader = _FolderReader(folder, header, problems)
    data = reader.dataset()
    problems.raise_if_any()
    assert data is not None
    data, noise = with_noise(data, header.sigmas[0])
    file = folder / "frame.toml"
    error = FrameError.read(file, header.factors[0]) if file.is_file() else None
    about = header.units, header.description, str(folder), error
    found = Contents(data, noise, header.sigmas[1], *about, torque_sigma=header.sigmas[2], cloud=reader.cloud)
    return replace(found, scale_sigma=header.scale[0], scale_of_gripper=header.scale[1])


def read_grasps(path: Path, units: Units) -> list[Action]:
    """The motions of the gripper in a grasps.csv that stands alone, numbered along one frame axis in the order of its rows.

    Raises:
        InputError: with every problem of the file.
    """
    problems = Problems(f"motions {path}")
    if not path.is_file():
        raise InputError(f"{path}: no such file with the poses of the gripper")
    reader = _FolderReader(path.parent, _Header(units, units.factors), problems, path.name)
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


class _FolderReader:
    """Reads the CSV files into one Dataset, noting every problem with its line."""

    def __init__(self, folder: Path, header: _Header, problems: Problems, motions: str = "grasps.csv") -> None:
        self.folder, self.motions, self.problems = folder, motions, problems
        self.surface = header.surface
        self.length, self.time, self.force = header.factors
        self.times: dict[Frame, float] = {}
        self.cloud: Cloud | None = None
        self.file = ""

    def bad(self, line: int | None, text: str) -> None:
        self.problems.add(self.folder / self.file, text, line)

    def dataset(self) -> xr.Dataset | None:
        seen = self.fiducials()
        self.surface_points()
        poses = self.grasps()
        self.surface_files()
        wrench = self.vectors("wrench.csv", [], WRENCH, [])
        loads = self.vectors("loads.csv", WRENCH[:3], [], ["place"])
        size = len(self.times) * max(len({name for _, name in seen}), len({name for _, name in loads}))
        if size > _MOST_POSITIONS:
            self.file = "fiducials.csv"
            rule = f"most without a row; at most {_MOST_POSITIONS} are read"
            self.bad(None, f"names and steps make {size} positions, {rule}")
        if not self.problems.found:
            self.check_frames(seen, poses)
        return None if self.problems.found else self.assemble(seen, poses, wrench, loads)

    def table(
        self, name: str, required: list[str], optional: list[str] | None = None
    ) -> tuple[list[str], Iterator[Row]]:
        """Columns of a CSV file, `required` and any of `optional` in any order, and its rows; none where it cannot be used."""
        self.file = name
        path = self.folder / name
        if not path.exists():
            return [], iter(())
        lines = csv.reader(read_lines(path))
        _, header = next(self.cells(lines), (0, []))
        names = [cell.strip() for cell in header]
        usable = self.columns(names, required, optional or [])
        return (names, self.rows(lines, names)) if usable else ([], iter(()))

    def cells(self, lines: Any) -> Iterator[tuple[int, list[str]]]:
        """Lines of a reader of tables, up to one that is none."""
        try:
            for row in lines:
                yield lines.line_num, row
        except csv.Error as error:
            self.bad(lines.line_num, f"is not a table: {error}")

    def rows(self, lines: Any, columns: list[str]) -> Iterator[Row]:
        """Line and cells by column, of rows that hold something."""
        for line, row in self.cells(lines):
            if not any(cell.strip() for cell in row):
                continue
            if len(row) != len(columns):
                self.bad(line, f"has {len(row)} values, the header names {len(columns)} columns")
            else:
                yield line, {column: cell.strip() for column, cell in zip(columns, row, strict=True)}

    def columns(self, columns: list[str], required: list[str], optional: list[str]) -> bool:
        """Whether the columns of a header can be used."""
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
        return not (missing or unknown or double)

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
        time = self.number(line, row, "time") * self.time
        if len(self.problems.found) > before:
            return False
        known = self.times.setdefault(frame, time)
        if abs(known - time) > _TIME_TOLERANCE * max(1.0, abs(known)):
            where = f"step {frame[1]} of action {frame[0]}"
            self.bad(line, f"time: {where} is at {known:g} s elsewhere, here at {time:g} s")
            return False
        return True

    def frames(self, rows: Iterator[Row], keys: list[str]) -> Iterator[tuple[int, dict[str, str], Frame]]:
        """Valid rows, refusing a second row for the same frame and `keys`."""
        last: dict[str, int] = {}
        seen: dict[tuple[Any, ...], int] = {}
        for line, row in rows:
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
        before = len(self.problems.found)
        columns, rows = self.table("fiducials.csv", ["action", "step", "time", "fiducial"], [*AXES, *_SIGMA])
        axes = [axis for axis in AXES if axis in columns]
        if columns and not axes:
            rule = "expected at least one of them, for the coordinates that were measured"
            self.bad(1, f"column x, y, z is missing; {rule}")
        result = {}
        for line, row, frame in self.frames(rows, ["fiducial"]):
            name = row["fiducial"]
            if not name:
                self.bad(line, "fiducial: its name is empty")
                continue
            position = [self.number(line, row, a) * self.length if row.get(a) else math.nan for a in AXES]
            result[frame, name] = position, [self.row_sigma(line, row, column) for column in _SIGMA]
        if columns and not result and len(self.problems.found) == before:
            self.bad(None, "is empty: expected one row for each step and fiducial")
        elif axes and result and not any(np.isfinite(position).any() for position, _ in result.values()):
            self.bad(None, "holds no position: no fiducial was ever seen")
        return result

    def surface_points(self) -> None:
        """Points of a table: any number in each step."""
        columns, rows = self.table(SURFACE, ["action", "step", "time", *AXES], ["sigma"])
        frames: dict[Frame, int] = {}
        known: dict[tuple[str, ...], int] = {}
        last: dict[str, int] = {}
        values: list[list[float]] = []
        for line, row in rows:
            key = row["action"], row["step"], row["time"]
            if key not in known:
                frame = self.frame(line, row, last)
                if frame is None:
                    continue
                known[key] = frames.setdefault(frame, len(frames))
            place = [self.number(line, row, axis) * self.length for axis in AXES]
            values.append([known[key], *place, self.row_sigma(line, row, "sigma")])
        if values:
            table = np.array(values)
            self.cloud = Cloud(table[:, 1:4], table[:, 4], tuple(frames), table[:, 0].astype(np.int64))
        elif columns:
            self.bad(None, "holds no point")

    def surface_files(self) -> None:
        """Points of the surface in files of their own, once the times of the steps are known."""
        if self.surface is None or self.problems.found:
            return
        if self.cloud is not None and not self.surface.pattern:
            self.cloud = replace(self.cloud, camera=self.surface.camera)
        elif self.cloud is not None:
            self.file = SURFACE
            self.bad(None, "stands beside files that [surface] in measurement.toml names: leave one of them out")
        elif not self.surface.pattern:
            self.file = "measurement.toml"
            self.bad(None, f"[surface]: names no files, and there is no {SURFACE}")
        else:
            self.cloud = self.surface.read(self.folder, list(self.times))

    def row_sigma(self, line: int, row: dict[str, str], column: str) -> float:
        if not row.get(column):
            return math.nan
        value = self.number(line, row, column) * self.length
        if not measurable(value):
            self.bad(line, f"{column}: expected a positive number of at least {LEAST_SIGMA:g} m, found '{row[column]}'")
        return value

    def grasps(self) -> dict[Frame, _Pose]:
        """Line, grasp name, translation (m) and unit quaternion by frame."""
        _, rows = self.table(self.motions, ["action", "step", "time", "grasp", *AXES, *QUATERNION])
        result = {}
        for line, row, frame in self.frames(rows, []):
            translation = [self.number(line, row, axis) * self.length for axis in AXES]
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
        given, rows = self.table(name, ["action", "step", "time", *keys, *required], optional)
        if given and not set(columns) & set(given):
            self.bad(1, f"column {', '.join(columns)} is missing; expected at least one of them")
        for line, row, frame in self.frames(rows, keys):
            if any(not row[key] or not row[key].isprintable() for key in keys):
                self.bad(line, f"{keys[0]}: expected the name of a place of the scene, found {row[keys[0]]!r}")
                continue
            result[frame, row[keys[0]] if keys else ""] = [
                self.number(line, row, column) * (self.force * (self.length if column.startswith("t") else 1.0))
                if column in required or row.get(column)
                else math.nan
                for column in columns
            ]
        return result

    def check_frames(self, seen: dict[tuple[Frame, str], Any], poses: dict[Frame, Any]) -> None:
        recorded = {action for (action, _), _ in seen}
        recorded |= {action for action, _ in (self.cloud.frames if self.cloud else ())}
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
                rule = "must be the rest pose: x,y,z = 0,0,0 and qw,qx,qy,qz = 1,0,0,0"
                self.bad(line, f"step 0 of action {action} {rule}")

    def assemble(
        self,
        seen: dict[tuple[Frame, str], tuple[list[float], list[float]]],
        poses: dict[Frame, _Pose],
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
