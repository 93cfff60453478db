"""The tracks of a recording: of columns of a table, as a mapping names them, or of markers that a foreign file names itself."""

from __future__ import annotations

import itertools
import math
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bcid.base.errors import InputError, Problems, nearest
from bcid.measurement.formats.array_file import table_rows
from bcid.measurement.formats.foreign import Foreign, How, filled, read_grid
from bcid.measurement.mapping import BOUNDS, COLUMNS, Mapping

Array = NDArray[np.float64]
# Number of the line, for messages, and cells by column.
Row = tuple[int, dict[str, str]]
_MOVED = ("translation", "rotation", "pose", "wrench")
# Of the largest displacement (RMS), that of a frame in which the body is not at rest.
_AT_REST = 0.2
# What files call the unit of their pixels; nothing where they state none.
_PIXELS = ("", "px", "pixel", "pixels")


@dataclass
class Tracks:
    """What was read, in the file's units: one entry per frame; and by what the rigid motion of [align] misses its markers, m."""

    actions: list[str]
    steps: list[int]
    times: list[float]
    positions: dict[str, Array]
    translation: Array | None = None
    rotation: Array | None = None
    pose: Array | None = None
    wrench: Array | None = None
    grasps: list[str] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)
    aligned: float | None = None

    @property
    def rest(self) -> NDArray[np.int64]:
        """The first frame of the action of each frame."""
        first = {action: i for i, action in reversed(list(enumerate(self.actions)))}
        return np.array([first[action] for action in self.actions])

    def take(self, chosen: list[int], steps: list[int]) -> None:
        """Keep some of the frames, and number them so."""
        self.actions, self.steps = [self.actions[i] for i in chosen], steps
        self.times = [self.times[i] for i in chosen]
        self.positions = {name: values[chosen] for name, values in self.positions.items()}
        self.grasps = [self.grasps[i] for i in chosen] if self.grasps else []
        for part in _MOVED:
            values = getattr(self, part)
            setattr(self, part, None if values is None else values[chosen])

    def select(self, frames: tuple[int, int | None, int, int | None], source: Path) -> None:
        """Keep the frame of rest and every so many frames of each action, and number them from 0.

        Raises:
            InputError: the steps of an action do not rise.
        """
        first, last, every, rest = frames
        chosen: list[int] = []
        steps: list[int] = []
        places: dict[str, list[int]] = {}
        for i, action in enumerate(self.actions):
            places.setdefault(action, []).append(i)
        for action, mine in places.items():
            if any(self.steps[b] <= self.steps[a] for a, b in itertools.pairwise(mine)):
                said = f"the steps of action {action} do not rise: sort the rows, one for each step"
                raise InputError(f"{source}: {said}")
            kept = mine[first : None if last is None else last + 1 : every]
            if rest is not None and kept and rest != first:
                kept = [mine[rest], *kept]
            chosen += kept
            steps += range(len(kept))
        self.take(chosen, steps)


class Rows:
    """The rows of a table under its header line; what is wrong with their cells is noted among the problems.

    Args:
        file: for messages.
        rows: not empty.
        decimal: the sign in its numbers.
    """

    def __init__(self, file: Path, rows: list[Row], decimal: str = ".") -> None:
        self.file, self.rows, self.decimal = file, rows, decimal
        self.problems = Problems(f"recording {file}")

    @classmethod
    def read(cls, file: Path, delimiter: str, decimal: str) -> Rows:
        """The rows of a file that are not empty.

        Raises:
            InputError: it holds none, or rows of another length than its header.
        """
        problems, found = Problems(f"recording {file}"), list[Row]()
        (_, header), *rows = read_grid(file, delimiter) or [(0, [])]
        for line, cells in filled(rows):
            if len(cells) != len(header):
                problems.add(file, f"has {len(cells)} values, the header names {len(header)} columns", line)
            else:
                found.append((line, dict(zip(header, cells, strict=True))))
        if not found:
            problems.add(file, "holds no rows; is the delimiter right?")
        problems.raise_if_any()
        return cls(file, found, decimal)

    def require(self, columns: Iterable[str]) -> None:
        """Refuse columns that a file does not have; those without a name were not measured.

        Raises:
            InputError: with these, and the problems before.
        """
        known = self.rows[0][1]
        for column in dict.fromkeys(columns):
            if column and column not in known:
                self.problems.add(self.file, f"has no column '{column}'; {nearest(column, known)}", 1)
        self.problems.raise_if_any()

    def texts(self, column: str) -> list[str]:
        """The cells of a column."""
        return [row[column] for _, row in self.rows]

    def numbers(self, columns: Sequence[str], gaps: bool = False) -> Array:
        """Numbers, shape (rows, columns); NaN of columns without a name, and of empty cells where gaps are allowed."""
        values = np.full((len(self.rows), len(columns)), np.nan)
        for i, (line, row) in enumerate(self.rows):
            for j, column in enumerate(columns):
                cell = row[column] if column else ""
                if not column or (gaps and (not cell or cell.lower() == "nan")):
                    continue
                try:
                    values[i, j] = float(cell.replace(self.decimal, "."))
                except ValueError:
                    values[i, j] = np.inf
                if not math.isfinite(values[i, j]):
                    self.problems.add(self.file, f"{column}: expected a finite number, found '{cell}'", line)
                    values[i, j] = 0.0
        return values

    def steps(self, column: str) -> list[int]:
        """Whole numbers."""
        values = self.numbers([column])[:, 0]
        for (line, _), value in zip(self.rows, values, strict=True):
            if value < 0 or value != int(value):
                self.problems.add(self.file, f"{column}: expected a whole number from 0, found {value:g}", line)
        return [int(value) for value in values]


def read_table(mapping: Mapping) -> Tracks:
    """The tracks in a table, in its own units.

    Raises:
        InputError: with every problem of the table.
    """
    rows, columns = _rows(mapping), mapping.columns
    long = "fiducial" in columns
    for key in ("position", "step") if long else ():
        if key not in columns:
            rows.problems.add(mapping.path, f"columns.{key}: is needed when columns.fiducial is given")
    rows.problems.raise_if_any()
    wanted = [] if long else [column for marker in mapping.markers.values() for column in marker]
    named = [columns[key] for key in COLUMNS if key in columns]
    rows.require([*wanted, *(c for one in named for c in ([one] if isinstance(one, str) else one))])
    count = len(rows.rows)
    actions = rows.texts(columns["action"]) if "action" in columns else [str(mapping.table.get("action", "1"))] * count
    counted: dict[str, Iterator[int]] = defaultdict(itertools.count)
    steps = rows.steps(columns["step"]) if "step" in columns else [next(counted[action]) for action in actions]
    times = list(rows.numbers([columns["time"]])[:, 0]) if "time" in columns else [float(step) for step in steps]
    given = {} if long else mapping.markers
    positions = {name: rows.numbers(marker, gaps=True) for name, marker in given.items()}
    values = rows.numbers(columns["position"], gaps=True) if long else None
    moved = [rows.numbers(columns[key], gaps=key == "wrench") if key in columns else None for key in _MOVED]
    grasps = rows.texts(columns["grasp"]) if "grasp" in columns else []
    rows.problems.raise_if_any()
    translation, rotation, pose, wrench = moved
    tracks = Tracks(actions, steps, times, positions, translation, rotation, pose, wrench, grasps)
    if values is not None:
        _by_frame(mapping, rows, tracks, values)
    return tracks


def _by_frame(mapping: Mapping, rows: Rows, tracks: Tracks, values: Array) -> None:
    """Give the tracks of a table with one row per frame and fiducial, at `values` (rows, 3), their frames and positions."""
    labels, problems = rows.texts(mapping.columns["fiducial"]), rows.problems
    given = mapping.markers or {label: label for label in labels}
    if not mapping.fiducials:
        mapping.fiducials = [name for name in given if name]
    names = {label: name for name, label in given.items()}
    known = dict.fromkeys(labels)
    for label, fiducial in names.items():
        if label not in known:
            problems.add(mapping.file, f"has no marker '{label}' (fiducial {fiducial}); {nearest(label, known)}")
    problems.raise_if_any()
    frames = list(zip(tracks.actions, tracks.steps, strict=True))
    number = {frame: i for i, frame in enumerate(dict.fromkeys(frames))}
    positions: dict[str, Array] = {name: np.full((len(number), 3), np.nan) for name in given}
    seen: dict[tuple[str, int, str], int] = {}
    for (line, _), frame, label, value in zip(rows.rows, frames, labels, values, strict=True):
        earlier = seen.setdefault((*frame, label), line)
        if earlier < line:
            what = f"a second row for marker {label}, step {frame[1]} of action {frame[0]}"
            problems.add(mapping.file, f"{what}; the first is in line {earlier}", line)
        elif label in names:
            positions[names[label]][number[frame]] = value
    problems.raise_if_any()
    first = {frame: i for i, frame in reversed(list(enumerate(frames)))}
    tracks.take([first[frame] for frame in number], [step for _, step in number])
    tracks.positions = positions


def _rows(mapping: Mapping) -> Rows:
    decimal = str(mapping.table.get("decimal", "."))
    if "table" not in mapping.table:
        return Rows.read(mapping.file, str(mapping.table.get("delimiter", ",")), decimal)
    names, cells = table_rows(mapping.file, where := str(mapping.table["table"]))
    if not cells:
        raise InputError(f"{mapping.file}: the table '{where}' holds no rows")
    rows: list[Row] = [(i, dict(zip(names, row, strict=True))) for i, row in enumerate(cells, 1)]
    return Rows(mapping.file, rows, decimal)


def read_points_of(mapping: Mapping) -> Tracks:
    """The tracks of the markers that a mapping chooses, in the file's units.

    Raises:
        InputError: the file is damaged, states another unit, or lacks what the mapping names.
    """
    seen = read_foreign(mapping)
    problems = Problems(f"recording {mapping.file}")
    name, length = mapping.file.name, mapping.units.length
    if mapping.pixel is not None and seen.unit not in _PIXELS:
        problems.add(mapping.path, f"pixels: {name} states '{seen.unit}', not pixels; leave [pixels] out")
    elif mapping.pixel is None and seen.unit in _PIXELS[1:]:
        problems.add(mapping.path, f"{name} states pixels; say how long one is, by [pixels] with length")
    elif mapping.pixel is None and seen.unit not in ("", length):
        problems.add(mapping.path, f"length_unit is '{length}', but {name} states '{seen.unit}'")
    if not mapping.fiducials:
        # Every n-th point is a fiducial under its own label.
        known, every = set(mapping.markers.values()), mapping.table["points"].get("every", 1)
        mapping.fiducials = [label for label in seen.points if label not in known][::every]
        mapping.markers = {label: label for label in mapping.fiducials} | mapping.markers
    positions = {}
    for name, label in mapping.markers.items():
        if label in seen.points:
            positions[name] = _trusted(seen, label, mapping.table["points"])
        elif label in seen.empty:
            problems.add(mapping.file, f"holds no data for point '{label}' (fiducial {name})")
        else:
            problems.add(mapping.file, f"has no point '{label}' (fiducial {name}); {nearest(label, seen.points)}")
    problems.add_unknown(mapping.path, mapping.align, mapping.markers, "align.{}: is no marker; {}".format)
    pose = _named(mapping, "pose", seen.bodies, problems)
    wrench = _named(mapping, "wrench", seen.wrenches, problems)
    problems.raise_if_any()
    action = str(mapping.table.get("action", "1"))
    times = [float(time) / mapping.time for time in seen.times]
    tracks = Tracks([action] * seen.frames, list(range(seen.frames)), times, positions, pose=pose, wrench=wrench)
    return _from_reference(mapping, seen, tracks) if mapping.from_reference else tracks


def displaced_at_first(seen: Foreign) -> bool:
    """Whether the first frame of a file of displacements shows a body that is no longer where they count from."""
    labels = [label for label in seen.points if label in seen.rest]
    if not labels or not seen.displacements:
        return False
    moved = np.stack([seen.points[label] - seen.rest[label] for label in labels])
    if not np.isfinite(moved[:, 0]).any():
        return False
    sizes = np.sqrt(np.nanmean(moved**2, axis=(0, 2)))
    return bool(sizes[0] > _AT_REST * np.nanmax(sizes))


def _from_reference(mapping: Mapping, seen: Foreign, tracks: Tracks) -> Tracks:
    """The same with the state from which displacements count as the first frame, one interval before the others."""
    lost = [label for label in mapping.markers.values() if not np.isfinite(seen.rest.get(label, np.nan)).all()]
    key = 'frames.rest = "reference"'
    if lost or not seen.displacements:
        what = f"has no position at rest of point '{lost[0]}'" if lost else "holds no displacements"
        raise InputError(
            f"{mapping.file}: {what}, and {key} needs it; give the number of the frame in which the body rests"
        )
    if tracks.pose is not None:
        said = 'columns.pose has no pose of that state; give grasps = "grasps.csv" instead'
        raise InputError(f"{mapping.path}: {key}: {said}")
    before = tracks.times[0] - (tracks.times[1] - tracks.times[0] if len(tracks.times) > 1 else 1.0)
    positions = {
        name: np.vstack([np.where(np.isfinite(at).any(axis=0), seen.rest[mapping.markers[name]], np.nan), at])
        for name, at in tracks.positions.items()
    }
    # Nothing pulls at rest; what the sensor shows then is not known.
    wrench = None if tracks.wrench is None else np.vstack([np.full(6, np.nan), tracks.wrench])
    steps = list(range(len(tracks.steps) + 1))
    return Tracks([tracks.actions[0], *tracks.actions], steps, [before, *tracks.times], positions, wrench=wrench)


def read_foreign(mapping: Mapping) -> Foreign:
    """What the file of a mapping holds, read as the mapping says."""
    table = mapping.table
    clock = next(iter(mapping.markers.values()), "")
    how = How(table["arrays"], mapping.columns, mapping.time, table.get("rate"), clock)
    assert mapping.format.read is not None
    return mapping.format.read(mapping.files, how)


def _trusted(seen: Foreign, label: str, bounds: dict[str, Any]) -> Array:
    """Positions of a marker, NaN where what the file says of their quality is beyond the bounds of [points]."""
    positions = seen.points[label]
    for key, (kind, least) in BOUNDS.items():
        if key in bounds and label in seen.quality.get(kind, {}):
            quality = seen.quality[kind][label]
            good = quality >= bounds[key] if least else quality <= bounds[key]
            positions = np.where(good[:, None], positions, np.nan)
    return positions


def _named(mapping: Mapping, key: str, given: dict[str, Array], problems: Problems) -> Array | None:
    """The poses or wrenches of the label in columns.pose or columns.wrench."""
    label = mapping.columns.get(key)
    if label is None or label in given:
        return None if label is None else given[label]
    what = "rigid body" if key == "pose" else "wrench"
    problems.add(mapping.file, f"has no {what} '{label}' (columns.{key}); {nearest(str(label), given)}")
    return None


def with_rest(seen: Foreign) -> Foreign:
    """The same with a rest position of every point that is seen: where the file has none, that of its first frame."""
    first = {label: at[0] for label, at in seen.points.items() if np.isfinite(at[0]).all()}
    return replace(seen, rest=first | seen.rest)
