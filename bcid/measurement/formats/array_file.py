"""Arrays by path in MAT and HDF5 files: markers as arrays over frames, or as rest positions and displacements.

Exports of image correlation are such files: MultiDIC and DuoDIC keep ``DIC3DPPresults/Points3D``, a cell for each frame; Ncorr
keeps ``data_dic_save/displacements/plot_u_ref_formatted`` on the grid of its pixels.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bcid.base.errors import InputError, nearest
from bcid.measurement.formats.foreign import Foreign, How
from bcid.measurement.formats.in_child import fetched

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
    old = head.startswith(b"MATLAB 5.0") or not (head.startswith(b"MATLAB") or head[1:4] == b"HDF")
    name = "mat_file" if old else "hdf5_file"
    what = "HDF5 file" if head[1:4] == b"HDF" else "MAT file"
    data = fetched(f"bcid.measurement.formats.{name}", path, what, [one.strip("/") for one in wanted])
    paths = [str(one) for one in data["paths"]]
    kinds = [str(one).split() for one in data["shapes"]]
    shapes = {
        p: tuple(int(n) for n in (k[1] if k[1:] else "").split("x") if n) for p, k in zip(paths, kinds, strict=True)
    }
    text = frozenset(p for p, k in zip(paths, kinds, strict=True) if k[0] == "text")
    arrays = {one: data[str(i)] for i, one in enumerate(wanted) if str(i) in data}
    return ArrayFile(shapes, text, arrays, bool(data.get("pandas", False)))


def read(path: Path, how: How) -> Foreign:
    """The markers, poses and wrenches that [arrays] and [columns] name by their paths.

    Raises:
        InputError: a path is not there, or an array is of another shape than its order says.
    """
    return _Arrays(path, how).foreign()


class _Arrays:
    def __init__(self, path: Path, how: How) -> None:
        self.path, self.how, self.told = path, how, how.arrays
        named = [*_listed(self.told.get("positions")), *_listed(self.told.get("displacements"))]
        named += [*_listed(self.told.get("rest")), *_listed(self.told.get("names"))]
        named += [one for key in ("time", "pose", "wrench") for one in _listed(how.columns.get(key))]
        self.content = look(path, list(dict.fromkeys(named)))

    def get(self, where: str) -> Any:
        if where not in self.content.arrays:
            raise InputError(f"{self.path}: has no array '{where}'; {nearest(where, self.content.shapes)}")
        return self.content.arrays[where]

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
        points = {label: positions[:, i] for i, label in enumerate(labels)}
        still = {} if rest is None else {label: rest[i] for i, label in enumerate(labels)}
        times = self.times(len(positions))
        clocked = "time" in self.how.columns or self.how.rate is not None
        bodies, wrenches = self.rows("pose", 7, len(times)), self.rows("wrench", 6, len(times))
        return Foreign("arrays", times, points, bodies, wrenches, numbered=numbered, clocked=clocked, rest=still)

    def field(self, where: Any, what: str, still: bool = False) -> Array:
        """Vectors of shape (frames, markers, 3), or (1, markers, 3) without frames, of an array or one for each axis."""
        if isinstance(where, str):
            order = str(self.told.get("order", " ".join(DIMENSIONS))).split()
            return self.ordered(self.numbers(where), [d for d in order if not (still and d == "frame")], where)
        order = [
            d
            for d in str(self.told.get("order", "frame marker")).split()
            if d != "axis" and not (still and d == "frame")
        ]
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
        if "axis" not in order and "marker" in order and array.ndim > wanted:
            at = order.index("marker")
            more = array.ndim - wanted + 1
            array = array.reshape(*array.shape[:at], -1, *array.shape[at + more :])
        if array.ndim != wanted:
            shape = " x ".join(map(str, array.shape))
            raise InputError(
                f'{self.path}: {where} is {shape}; arrays.order = "{" ".join(order)}" has {wanted} dimensions'
            )
        present = [d for d in DIMENSIONS if d in order]
        array = array.transpose([order.index(d) for d in present])
        for i, dimension in enumerate(DIMENSIONS):
            if dimension not in order:
                array = np.expand_dims(array, i)
        if "axis" in order and array.shape[2] != 3:
            shape = " x ".join(map(str, array.shape))
            raise InputError(
                f"{self.path}: {where} is {shape} as frame x marker x axis; its axis must have 3: check arrays.order"
            )
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
            rest = self.field(self.told["rest"], "rest", still=True)[0]
        if len(rest) != moved.shape[1]:
            raise InputError(
                f"{self.path}: {len(rest)} rest positions stand against displacements of {moved.shape[1]} points"
            )
        return rest

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


def _listed(value: Any) -> list[str]:
    return [] if value is None else [value] if isinstance(value, str) else list(value)


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
