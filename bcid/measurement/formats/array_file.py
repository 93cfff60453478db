"""Arrays by path in MAT, HDF5 and NPZ files: markers as arrays over frames, or as rest positions and displacements.

Exports of image correlation are such files: MultiDIC and DuoDIC keep ``DIC3DPPresults/Points3D``, a cell for each frame; Ncorr
keeps ``data_dic_save/displacements/plot_u_ref_formatted`` on the grid of its pixels.
"""

from __future__ import annotations

import fnmatch
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bcid.base.errors import InputError, nearest
from bcid.measurement.formats.foreign import Foreign, How, fetched

Array = NDArray[np.float64]

DIMENSIONS = ("frame", "marker", "axis")


@dataclass(frozen=True)
class ArrayFile:
    """What is in a file: shapes by path, and which of them hold text; the arrays that were asked for.

    Attributes:
        shapes: by path.
        text: paths of arrays of text.
        arrays: those that were asked for and are there.
        pandas: whether pandas wrote it.
    """

    shapes: dict[str, tuple[int, ...]]
    text: frozenset[str]
    arrays: dict[str, Any]
    pandas: bool


def look(path: Path, wanted: list[str]) -> ArrayFile:
    """Paths and shapes of a MAT or HDF5 file, and some of its arrays.

    Raises:
        InputError: it is damaged, or its reader is not installed.
    """
    with path.open("rb") as stream:
        head = stream.read(128)
    matlab, old = head.startswith(b"MATLAB"), head.startswith(b"MATLAB 5.0")
    kind = "HDF5" if head[1:4] == b"HDF" or (matlab and not old) else "NPZ" if head.startswith(b"PK") else "MAT"
    what = "MAT file" if matlab else f"{kind} file"
    data = fetched("bcid.measurement.formats.array_tree", path, what, [kind, *(one.strip("/") for one in wanted)])
    paths = [str(one) for one in data["paths"]]
    shapes = [tuple(int(n) for n in str(one).split("x") if n) for one in data["shapes"]]
    text = frozenset(path for path, is_text in zip(paths, data["texts"], strict=True) if is_text)
    arrays = {one: data[str(i)] for i, one in enumerate(wanted) if str(i) in data}
    return ArrayFile(dict(zip(paths, shapes, strict=True)), text, arrays, bool(data.get("pandas", False)))


def read_series(paths: Sequence[Path], how: How) -> Foreign:
    """The markers, poses and wrenches that [arrays] and [columns] name by their paths, of a file or of a file a step.

    Raises:
        InputError: a path is not there, or an array is of another shape than its order says.
    """
    return _Arrays(paths, how).foreign()


class _Arrays:
    """Attributes: `content` of the first file, in which arrays of all steps are stacked; `stepwise`, the paths of these."""

    def __init__(self, paths: Sequence[Path], how: How) -> None:
        self.path, self.how, self.told = paths[0], how, how.arrays
        stepwise = _named(self.told, "positions", "displacements", "quality")
        others = [*_named(self.told, "rest", "names"), *_named(how.columns, "time", "pose", "wrench")]
        self.content = _expanded(self.path, list(dict.fromkeys([*stepwise, *others])))
        self.stepwise = set(stepwise) if len(paths) > 1 else set()
        parts = [(path, _expanded(path, sorted(self.stepwise))) for path in paths[1:]]
        for where in self.stepwise:
            arrays = [self.get(where), *(_array(where, *one) for one in parts)]
            for path, array in zip(paths, arrays, strict=True):
                if array.shape != arrays[0].shape:
                    raise InputError(
                        f"{path}: {where} is {shown(array.shape)}, in {self.path.name} it is {shown(arrays[0].shape)}; every "
                        "step needs the same points, NaN where one was not correlated"
                    )
            self.content.arrays[where] = np.stack(arrays)

    def get(self, where: str) -> Any:
        return _array(where, self.path, self.content)

    def numbers(self, where: str) -> Array:
        array = self.get(where)
        if array.dtype.kind == "U":
            raise InputError(f"{self.path}: {where} holds text; expected numbers")
        return np.asarray(array, dtype=float)

    def foreign(self) -> Foreign:
        rest = None
        if "displacements" in self.told:
            moved = self.field(self.told["displacements"], "displacements")
            rest = self.rest(moved)
            if "grid" in self.told:
                moved, rest = _within(moved, rest)
            positions = rest + moved
        else:
            positions = self.field(self.told["positions"], "positions")
        labels, numbered = self.labels(positions.shape[1])
        # Where one of the coordinates that were measured is missing the point was lost.
        measured = np.isfinite(positions).any(axis=(0, 1))
        lost = np.isnan(positions[:, :, measured]).any(axis=2, keepdims=True)
        positions = np.where(lost, np.nan, positions)
        if rest is not None and not np.isfinite(positions).any():
            raise InputError(f"{self.path}: no point has a rest position and a displacement, all are NaN")
        points = {label: positions[:, i] for i, label in enumerate(labels)}
        still = {} if rest is None else {label: rest[i] for i, label in enumerate(labels)}
        clock = self.times(len(positions))
        bodies, wrenches = self.rows("pose", 7, len(clock)), self.rows("wrench", 6, len(clock))
        clocked = "time" in self.how.columns or self.how.rate is not None
        found = Foreign("arrays", clock, points, bodies, wrenches, numbered=numbered, clocked=clocked, rest=still)
        found = replace(found, displacements=rest is not None)
        return found.correlated(self.quality(positions.shape[:2])) if "quality" in self.told else found

    def order(self, where: str, usual: str) -> list[str]:
        """Names of the dimensions of an array; where several were stacked, frames are in front."""
        told = str(self.told.get("order", usual)).split()
        return ["frame", *(d for d in told if d != "frame")] if "*" in where or where in self.stepwise else told

    def quality(self, shape: tuple[int, ...]) -> Array:
        """Of each point in each frame, shape (frames, markers)."""
        where = str(self.told["quality"])
        order = [d for d in self.order(where, "frame marker") if d != "axis"]
        found = self.ordered(self.numbers(where), order, where)[:, :, 0]
        if found.shape != shape:
            said = f"{shown(found.shape)} as frame x marker; expected {shown(shape)}, as the points are"
            raise InputError(f"{self.path}: {where} is {said}")
        return found

    def field(self, where: Any, what: str, still: bool = False) -> Array:
        """Vectors of shape (frames, markers, 3), or (1, markers, 3) without frames, of an array or one for each axis."""
        if isinstance(where, str):
            order = self.order(where, " ".join(DIMENSIONS))
            return self.ordered(self.numbers(where), [d for d in order if not (still and d == "frame")], where)
        order = [d for d in self.order(where[0], "frame marker") if d != "axis" and not (still and d == "frame")]
        parts = [self.ordered(self.numbers(one), order, one)[:, :, 0] for one in where]
        if any(part.shape != parts[0].shape for part in parts):
            raise InputError(
                f"{self.path}: the arrays of arrays.{what} have the shapes {[p.shape for p in parts]}; expected one"
            )
        # Plane image correlation sees no third coordinate; its points lie in a plane.
        parts += [np.full_like(parts[0], 0.0 if still else np.nan)] * (3 - len(parts))
        return np.stack(parts, axis=2)

    def ordered(self, array: Array, order: list[str], where: str) -> Array:
        """An array with its dimensions as frame, marker, axis; several of the markers, as those of an image, become one."""
        wanted = len(order)
        if "marker" in order and array.ndim > wanted:
            at = order.index("marker")
            more = array.ndim - wanted + 1
            array = array.reshape(*array.shape[:at], -1, *array.shape[at + more :])
        if array.ndim != wanted:
            said = f'{shown(array.shape)}; arrays.order = "{" ".join(order)}" has {wanted} dimensions'
            raise InputError(f"{self.path}: {where} is {said}")
        array = array.transpose([order.index(d) for d in DIMENSIONS if d in order])
        array = np.expand_dims(array, [i for i, d in enumerate(DIMENSIONS) if d not in order])
        if "axis" in order and array.shape[2] != 3:
            said = f"{shown(array.shape)} as frame x marker x axis; its axis must have 3: check arrays.order"
            raise InputError(f"{self.path}: {where} is {said}")
        return array

    def rest(self, moved: Array) -> Array:
        """Rest positions, shape (markers, 3)."""
        if "grid" in self.told:
            # The last two dimensions of the first array are rows and columns of the image.
            where = self.told["displacements"]
            shape = self.numbers(where if isinstance(where, str) else where[0]).shape
            if len(shape) < 2 or isinstance(where, str):
                raise InputError(
                    f"{self.path}: arrays.grid: needs displacements as images, one array for each axis; give arrays.rest"
                )
            rows, columns = shape[-2:]
            y, x = np.mgrid[0:rows, 0:columns].reshape(2, -1) * float(self.told["grid"])
            rest = np.stack([x, y, np.zeros_like(x)], axis=1)
        else:
            rest = self.along_axes() if self.spans_grid() else self.field(self.told["rest"], "rest", still=True)[0]
        if len(rest) != moved.shape[1]:
            raise InputError(
                f"{self.path}: {len(rest)} rest positions stand against displacements of {moved.shape[1]} points"
            )
        return rest

    def spans_grid(self) -> bool:
        """Whether rest positions are those of the planes of a grid, a vector for each axis."""
        where = self.told["rest"]
        if isinstance(where, str) or sum(n > 1 for n in self.grid()) < 2:
            return False
        return all(max(one.shape, default=0) == one.size for one in map(self.numbers, where))

    def grid(self) -> tuple[int, ...]:
        """The dimensions of the first array of displacements that are those of a grid."""
        where = _named(self.told, "displacements")[0]
        order = self.order(where, "frame marker")
        shape = list(self.numbers(where).shape)
        if "frame" in order:
            shape.pop(0 if order[0] == "frame" else -1)
        return tuple(shape)

    def along_axes(self) -> Array:
        """Rest positions of a grid, of vectors along its axes, shape (markers, 3)."""
        vectors = [self.numbers(one).ravel() for one in self.told["rest"]]
        lengths, shape = tuple(len(one) for one in vectors), self.grid()
        swapped = (lengths[1], lengths[0], *lengths[2:])
        if shape not in (lengths, swapped) or (swapped == lengths and lengths[0] > 1 and self.path.suffix == ".mat"):
            raise InputError(
                f"{self.path}: rest positions are vectors of {shown(lengths)} along the axes, the grid of displacements is "
                f"{shown(shape)}; which is which is not clear: write x, y and z of every point, as arrays of that shape"
            )
        parts = list(np.meshgrid(*vectors, indexing="ij" if shape == lengths else "xy"))
        parts += [np.zeros_like(parts[0])] * (3 - len(parts))
        return np.stack([part.ravel() for part in parts], axis=1)

    def labels(self, count: int) -> tuple[list[str], bool]:
        if "names" not in self.told:
            return [str(i + 1) for i in range(count)], True
        names = [str(name).strip() for name in np.ravel(self.get(self.told["names"]))]
        if len(set(names)) != count or len(names) != count:
            raise InputError(f"{self.path}: {self.told['names']} holds {len(set(names))} names for {count} markers")
        return names, False

    def times(self, frames: int) -> Array:
        if "time" not in self.how.columns:
            return self.how.count(frames)
        where = self.how.columns["time"]
        times = self.numbers(where).ravel()
        if len(times) != frames or not np.isfinite(times).all():
            raise InputError(
                f"{self.path}: {where} holds {len(times)} times for {frames} frames, all of which must be finite"
            )
        return times * self.how.time

    def rows(self, key: str, width: int, frames: int) -> dict[str, Array]:
        """The array of poses or wrenches, whichever way it lies."""
        where = self.how.columns.get(key)
        if where is None:
            return {}
        array = self.numbers(where)
        array = array if array.shape == (frames, width) else array.T
        if array.shape != (frames, width):
            raise InputError(f"{self.path}: {where} must be {frames} frames x {width}; found {array.shape[::-1]}")
        return {where: array}


def _within(moved: Array, rest: Array) -> tuple[Array, Array]:
    """Displacements (frames, markers, 3) and rest positions, NaN outside the region that was correlated.

    Ncorr has exact zeros there. A frame that is zero everywhere is one before the motion.
    """
    still = (np.nan_to_num(moved) == 0).all(axis=2)
    lost = still & ~still.all(axis=1, keepdims=True) | still.all(axis=0)
    never = lost.all(axis=0)[:, None]
    return np.where(lost[:, :, None], np.nan, moved), np.where(never, np.nan, rest)


def _array(where: str, path: Path, content: ArrayFile) -> Any:
    if where not in content.arrays:
        raise InputError(f"{path}: has no array '{where}'; {nearest(where, content.shapes)}")
    return content.arrays[where]


def _expanded(path: Path, wanted: list[str]) -> ArrayFile:
    """What is in a file, and the wanted arrays; of a path with * all that fit are one array, in the order of their numbers."""
    patterns = [one for one in wanted if "*" in one]
    if not patterns:
        return look(path, wanted)
    known = look(path, [])
    fitting = {one: sorted(fnmatch.filter(known.shapes, one.strip("/")), key=_numbered) for one in patterns}
    content = look(
        path, [*(one for one in wanted if "*" not in one), *dict.fromkeys(p for f in fitting.values() for p in f)]
    )
    for one, paths in fitting.items():
        shapes = {shown(known.shapes[p]): p for p in paths}
        if len(shapes) > 1:
            said = ", ".join(f"{p} is {shape}" for shape, p in list(shapes.items())[:2])
            raise InputError(f"{path}: {said}; every step needs the same points, NaN where one was not correlated")
        if paths:
            content.arrays[one] = np.stack([content.arrays[p] for p in paths])
    return content


def _numbered(path: str) -> list[tuple[int, str]]:
    """Key by which paths are sorted by the numbers in them."""
    return [(len(part), part) for part in re.findall(r"\d+|\D+", path)]


def _named(table: Mapping[str, Any], *keys: str) -> list[str]:
    """The paths that keys of a table name: one, or one for each axis."""
    values = [table[key] for key in keys if key in table]
    return [path for value in values for path in ([value] if isinstance(value, str) else value)]


def shown(shape: Sequence[int]) -> str:
    """A shape in words."""
    return " x ".join(map(str, shape)) or "one number"


def table_rows(path: Path, where: str) -> tuple[list[str], list[list[str]]]:
    """Names of the columns and cells, as text, of a table in an HDF5 file: a compound array, or a group of vectors.

    Raises:
        InputError: there is none.
    """
    prefix = where.strip("/") + "/"
    known = look(path, [])
    columns = {p: s for p, s in known.shapes.items() if p.startswith(prefix) and "/" not in p[len(prefix) :]}
    long = {max(s, default=1): None for s in columns.values() if np.prod(s) == max(s, default=1)}
    if not columns or len(long) != 1:
        tables = {p.rpartition("/")[0] for p in known.shapes if "/" in p}
        said = "its columns are of several lengths" if columns else nearest(where, sorted(tables))
        raise InputError(f"{path}: has no table '{where}'; {said}")
    arrays = look(path, list(columns)).arrays
    cells = [[_cell(value) for value in np.ravel(arrays[one])] for one in columns]
    return [one[len(prefix) :] for one in columns], [list(row) for row in zip(*cells, strict=True)]


def _cell(value: Any) -> str:
    """Text from which the same number is read."""
    if isinstance(value, str):
        return str(value)
    return f"{int(value)}" if np.isfinite(value) and value == int(value) and abs(value) < 2**53 else repr(float(value))
