"""What the columns of a table with one header line are, guessed from their names."""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from bcid.base.text_file import read_lines

# A name and its axis: tip_x, tip.X, "tip x [mm]", tip_x_mm, x_tip.
_BEHIND = re.compile(r"(?P<name>.*[^\s_.:-])?[\s_.:-]*(?P<axis>[xyzXYZ])")
_BEFORE = re.compile(r"(?P<axis>[xyzXYZ])[\s_.:-]+(?P<name>.+)")
_UNIT = re.compile(r"\s*[\[(](?P<unit>[^\])]*)[\])]\s*$")
_UNIT_BEHIND = re.compile(r"(?<=[xyzXYZ])_(?P<unit>mm|cm|um|m|in)$|(?<=^t)_s$|(?<=^time)_s$")
_DECIMAL_COMMA = re.compile(r"[+-]?\d+,\d+([eE][+-]?\d+)?")
_NAMES = {
    "time": ("t", "time", "timestamp", "seconds", "zeit"),
    "action": ("action", "trial", "run"),
    "step": ("step", "frame", "state", "stage", "k"),
    "fiducial": ("fiducial", "marker", "label", "name", "point"),
    "grasp": ("grasp",),
}
_WRENCH = (("fx", "fy", "fz", "tx", "ty", "tz"), ("fx", "fy", "fz", "mx", "my", "mz"))
_ROTATION = ("qw", "qx", "qy", "qz")
# Triples of these are no markers.
_NO_MARKERS = ("q", "f", "t", "m", "rot", "force", "torque")


def guess_delimiter(lines: Sequence[str]) -> str:
    """The sign that divides the header into most columns."""
    header = lines[0] if lines else ""
    return max(";\t,", key=lambda sign: len(next(csv.reader([header], delimiter=sign), [])))


def guess_table(path: Path) -> dict[str, Any]:
    """Keys of a mapping for a table of text: delimiter, decimal, columns, fiducials, and units that the header states.

    Raises:
        InputError: it is no text.
    """
    lines = read_lines(path)[:50]
    delimiter = guess_delimiter(lines)
    rows = list(csv.reader(lines, delimiter=delimiter))
    told = guess_columns([name.strip() for name in rows[0]] if rows else [])
    if delimiter != ",":
        told["delimiter"] = delimiter
        if any(_DECIMAL_COMMA.fullmatch(cell.strip()) for row in rows[1:] for cell in row):
            told["decimal"] = ","
    return told


def guess_columns(names: Sequence[str]) -> dict[str, Any]:
    """Columns and fiducials by names, and the unit of the positions if a name states it."""
    columns: dict[str, Any] = {key: name for key, words in _NAMES.items() for name in names if _bare(name) in words}
    by_name = {_bare(name): name for name in names}
    wrench = next((group for group in _WRENCH if set(group) <= set(by_name)), ())
    told: dict[str, Any] = {"columns": columns, "fiducials": {}}
    if wrench:
        columns["wrench"] = [by_name[name] for name in wrench]
    if set(_ROTATION) <= set(by_name):
        told["rotation"] = [by_name[name] for name in _ROTATION]
    triples = _triples(names)
    alone = triples.pop("", None)
    if alone is not None and "fiducial" in columns and "step" in columns:
        columns["position"] = alone
        triples = {}
    else:
        columns.pop("fiducial", None)
        # In a row for each frame these may be words.
        if _bare(columns.get("step", "")) in ("state", "stage"):
            del columns["step"]
        if alone is not None:
            triples["marker"] = alone
    if "grasp" not in names:
        columns.pop("grasp", None)
    told["fiducials"] = triples
    used = [name for triple in [*triples.values(), alone or []] for name in triple]
    unit = {match["unit"] for name in used if (match := _stated(name)) and match["unit"]}
    return told | ({"length_unit": unit.pop()} if len(unit) == 1 else {})


def _stated(name: str) -> re.Match[str] | None:
    """The unit at the end of a column's name."""
    return _UNIT.search(name) or _UNIT_BEHIND.search(name.strip())


def _plain(name: str) -> str:
    """A column's name without its unit."""
    return _UNIT_BEHIND.sub("", _UNIT.sub("", name).strip()).strip()


def _bare(name: str) -> str:
    return _plain(name).lower()


def _triples(names: Sequence[str]) -> dict[str, list[str]]:
    """Columns of the three axes by the name that they share; "" for x, y, z alone."""
    found: dict[str, dict[str, str]] = {}
    for column in names:
        bare = _plain(column)
        match = _BEHIND.fullmatch(bare) or _BEFORE.fullmatch(bare)
        if match and (match["name"] or "").lower() not in _NO_MARKERS:
            found.setdefault(match["name"] or "", {})[match["axis"].lower()] = column
    return {name: [axes[a] for a in "xyz"] for name, axes in found.items() if set(axes) == set("xyz")}
