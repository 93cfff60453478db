"""CSV exports of Vicon: the sections "Trajectories" of Nexus and "Objects" of Tracker. Forces and segments are not read.

Source: Vicon Nexus User Guide, "Export ASCII data to file"; Vicon Tracker User Guide, "Export to CSV".
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bcid.base.errors import InputError
from bcid.base.text_file import read_export
from bcid.measurement.formats.foreign import Export, Foreign, How, Row, length_unit, read_grid, whole

Array = NDArray[np.float64]

# What a section may be called, and what of them is read.
_SECTIONS = ("Trajectories", "Devices", "Model Outputs", "Joints", "Segments", "Events", "Objects")
_POINT, _POSE = ["X", "Y", "Z"], ["RX", "RY", "RZ", "RW", "TX", "TY", "TZ"]
_READ = {"Trajectories": _POINT, "Objects": _POSE}
_KIND = re.compile(r"Global Angle( \([^)]*\))? ")


def recognised(head: str) -> bool:
    """Whether text begins as an export of Vicon does."""
    first = re.split(r"[\r\n,\t]", head, maxsplit=1)[0].strip().strip('"')
    return first in _SECTIONS


def read(path: Path, _how: How) -> Foreign:
    """The trajectories of markers, or the poses of objects, of an export of Vicon."""
    tabs = any(line.startswith("Frame\t") for line in read_export(path))
    rows = [(line, cells or [""]) for line, cells in read_grid(path, "\t" if tabs else ",")]
    begins = {cells[0]: i for i, (_, cells) in reversed(list(enumerate(rows))) if cells[0] in _SECTIONS}
    told = next((name for name in _READ if name in begins), None)
    if told is None:
        said = "has no section 'Trajectories', nor 'Objects'; export the trajectories of the markers"
        raise InputError(f"{path}: {said}")
    times, parts, unit = _section(path, rows[begins[told] :], told)
    notes = tuple(f"the section {name} is not read" for name in sorted(begins, key=begins.__getitem__) if name != told)
    if told == "Objects":
        return Foreign("CSV of Vicon Tracker", times, {}, _bodies(parts), unit=unit, notes=notes)
    points = {label: whole(part) for label, part in parts.items()}
    return Foreign("CSV of Vicon Nexus", times, points, unit=unit, notes=notes)


def _section(path: Path, rows: list[Row], name: str) -> tuple[Array, dict[str, Array], str]:
    """Times, what stands under each label, and the unit, of a section: name, rate, labels, axes, units, frames, an empty line."""
    axes = _READ[name]
    end = next((i for i, (_, cells) in enumerate(rows) if i > 4 and not any(cells)), len(rows))
    rows = rows[:end]
    export = Export(path, f"the section {name}", rows)
    export.need(5)
    rate = export.number(rows[1][1][0], f"rate of the {name.lower()}", rows[1][0])
    names, header, units = rows[2][1], rows[3][1], rows[4][1]
    # Tracker ends the lines of its header with a comma.
    width = max((i + 1 for i, cell in enumerate(header) if cell), default=0)
    starts = [i for i, label in enumerate(names) if label and header[i : i + len(axes)] == axes]
    if not starts:
        said = f"names no columns {', '.join(axes)}; export the {name.lower()} with them"
        raise InputError(f"{path}:{rows[3][0]}: {said}")
    # A label holds the subject's name as "subject:label".
    labels = [_label(names[i]) for i in starts]
    export.distinct(labels)
    values = export.numbers(rows[5:], width)
    times = (values[:, 0] - values[0, 0]) / rate
    if not np.isfinite(times).all():
        raise InputError(f"{path}: the column Frame has an empty cell; export it again")
    stated = {units[i + len(axes) - 1] for i in starts if i + len(axes) <= len(units)}
    parts = {label: values[:, i : i + len(axes)] for label, i in zip(labels, starts, strict=True)}
    return times, parts, length_unit(stated.pop()) if len(stated) == 1 else ""


def _label(text: str) -> str:
    """A label without the kind of its values; that of an object is its name twice."""
    plain = _KIND.sub("", text, count=1)
    subject, _, label = plain.partition(":")
    return label if subject == label and plain != text else plain


def _bodies(parts: dict[str, Array]) -> dict[str, Array]:
    """Position and quaternion (w, x, y, z) of objects; where an object was not seen, NaN."""
    poses = {}
    for label, part in parts.items():
        pose = part[:, [4, 5, 6, 3, 0, 1, 2]]
        seen = np.isfinite(pose).all(axis=1) & (np.abs(np.linalg.norm(pose[:, 3:], axis=1) - 1) < 0.01)
        poses[label] = np.where(seen[:, None], pose, np.nan)
    return poses
