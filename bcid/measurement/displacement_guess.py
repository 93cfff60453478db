"""Which arrays of a file are displacements of points or of a grid, and where these are at rest, guessed from names and shapes."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bcid.measurement.formats.array_file import ArrayFile

Shape = tuple[int, ...]

# Names of the three components, and of one array of all, in lower case; so of rest positions.
_MOVED: tuple[tuple[str, ...], ...] = (
    ("u", "v", "w"),
    ("ux", "uy", "uz"),
    ("u_x", "u_y", "u_z"),
    ("disp_x", "disp_y", "disp_z"),
    ("dx", "dy", "dz"),
)
_MOVED += (("displacement_x", "displacement_y", "displacement_z"),)
_MOVED_ALL = ("displacement", "displacements", "disp", "u")
_REST = (("x", "y", "z"), ("x0", "y0", "z0"), ("pos_x", "pos_y", "pos_z"), ("grid_x", "grid_y", "grid_z"))
_REST_ALL = (
    "points",
    "point",
    "positions",
    "position",
    "rest",
    "reference",
    "coords",
    "coordinates",
    "xyz",
    "nodes",
    "x",
)
_QUALITY = ("corr", "zncc", "ncc", "cc", "correlation", "quality")
_TIMES = ("t", "time", "times", "timestamp", "timestamps")


@dataclass(frozen=True)
class Guess:
    """Keys of a mapping, or why there are none, in words; both empty where nothing looks like displacements."""

    arrays: dict[str, Any]
    missing: str = ""


def guess_displacements(content: ArrayFile) -> Guess:
    """Arrays of displacements and rest positions with the order of their dimensions, and what goes with them."""
    moved, missing = _components(content, _MOVED, _MOVED_ALL)
    if not moved:
        return Guess({}, missing)
    rest, _ = _components(content, _REST, _REST_ALL, beside=moved)
    if not rest:
        names = ", ".join(moved)
        return Guess({}, f"it has displacements ({names}), but no positions at rest of the same points, as x, y, z")
    if len(moved) > 1 and len(rest) > len(moved):
        # A plane field has two of both.
        return Guess({}, f"it has rest positions {', '.join(rest)}, but displacements {', '.join(moved)} alone")
    shape = _shape(content, moved[0])
    order = _order(shape, [_shape(content, one) for one in rest], alone=len(moved) == 1)
    if order is None:
        text = "displacements {} are {}, and rest positions {} are {}: they are not of the same points"
        return Guess({}, text.format(moved[0], _times(shape), rest[0], _times(_shape(content, rest[0]))))
    arrays: dict[str, Any] = {
        "displacements": moved if len(moved) > 1 else moved[0],
        "rest": rest if len(rest) > 1 else rest[0],
    }
    arrays["order"] = " ".join(order)
    field = (
        shape if len(moved) > 1 else tuple(n for n, d in zip(shape, _spread(order, shape), strict=True) if d != "axis")
    )
    for path in _steps(content):
        if _last(path) in _QUALITY and _shape(content, path) == field:
            arrays["quality"] = path
    frames = {shape[0 if order[0] == "frame" else -1]} if "frame" in order else set()
    clock = [p for p, s in content.shapes.items() if _last(p) in _TIMES and {int(np.prod(s))} == frames]
    return Guess({"arrays": arrays, "columns": {"time": clock[0]} if clock else {}})


def _last(path: str) -> str:
    return path.rpartition("/")[2].lower()


def _steps(content: ArrayFile) -> Iterator[str]:
    """Paths; those that are the same but for a number in a group, as step_01/u, as one with * in its place."""
    patterns: dict[str, list[str]] = {}
    for path in content.shapes:
        if path not in content.text:
            group, slash, name = path.rpartition("/")
            patterns.setdefault(re.sub(r"\d+", "*", group) + slash + name, []).append(path)
    for pattern, paths in patterns.items():
        several = len(paths) > 1 and len({content.shapes[p] for p in paths}) == 1
        yield from [pattern] if several else paths


def _shape(content: ArrayFile, path: str) -> Shape:
    """Of an array in each step where a path has *."""
    if "*" not in path:
        return content.shapes[path]
    group, _, name = path.rpartition("/")
    fits = re.compile(re.escape(group).replace(r"\*", r"\d+") + "/" + re.escape(name))
    return next(shape for one, shape in content.shapes.items() if fits.fullmatch(one))


def _components(
    content: ArrayFile, triples: Sequence[Sequence[str]], alone: Sequence[str], beside: Sequence[str] = ()
) -> tuple[list[str], str]:
    """Paths of two or three arrays with names of components, in one group, or of one array of all; else what is missing."""
    groups: dict[str, dict[str, str]] = {}
    missing = ""
    for path in _steps(content):
        if path not in beside:
            groups.setdefault(path.rpartition("/")[0], {})[_last(path)] = path
    # Rest positions may stand in another group than the displacements.
    for triple in triples:
        for names in groups.values():
            there = [names[name] for name in triple if name in names]
            alike = len({_shape(content, one) for one in there}) == 1 or bool(beside)
            if len(there) == 3 and alike:
                return there, ""
            if (
                len(there) == 2
                and not beside
                and alike
                and triple[2] not in names
                and triple[:2] == tuple(map(_last, there))
            ):
                if not any({"z", "z0", "pos_z", "grid_z"} & set(other) for other in groups.values()):
                    return there, ""
                missing = (
                    f"it has the displacements {there[0]} and {there[1]}, but no {triple[2]}, and its points have a z"
                )
            if len(there) == 2 and len(beside) == 2:
                return there, ""
    if missing:
        return [], missing
    for name in alone:
        for names in groups.values():
            if name in names and 3 in _shape(content, names[name]):
                return [names[name]], ""
    return [], missing


def _order(shape: Shape, rest: list[Shape], alone: bool) -> list[str] | None:
    """Names of the dimensions of displacements, by the shapes of their rest positions; None where they do not fit."""
    axis = ["marker", "axis"] if alone else ["marker"]
    if alone and len(rest) > 1:
        return None
    fits = {rest[0]} | ({_plain(rest[0])} if not alone else set())
    if len(rest) > 1 and all(int(np.prod(one)) == max(one, default=0) for one in rest):
        lengths = tuple(max(one) for one in rest)
        fits |= {lengths, (lengths[1], lengths[0], *lengths[2:])}
    if alone and (len(rest[0]) < 2 or rest[0][-1] != 3):
        return None
    if shape in fits or (not alone and _plain(shape) in fits):
        return axis
    if shape[1:] in fits:
        return ["frame", *axis]
    return [*axis, "frame"] if shape[:-1] in fits else None


def _plain(shape: Shape) -> Shape:
    """Without dimensions of one, which MATLAB adds to vectors."""
    return tuple(n for n in shape if n != 1)


def _spread(order: Sequence[str], shape: Shape) -> list[str]:
    """The name of each dimension, where several may be those of the markers."""
    more = len(shape) - len(order) + 1
    return [one for name in order for one in [name] * (more if name == "marker" else 1)]


def _times(shape: Shape) -> str:
    return " x ".join(map(str, shape)) or "one number"
