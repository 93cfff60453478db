"""CSV exports of Vicon Nexus: the section "Trajectories". Forces and segments of the model are not read.

Source: Vicon Nexus User Guide, "Export ASCII data to file".
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from bcid.base.errors import InputError
from bcid.measurement.formats.foreign import Foreign, How
from bcid.measurement.formats.grid import distinct, need, number, numbers, read_grid, whole

# What a section may be called.
_SECTIONS = ("Trajectories", "Devices", "Model Outputs", "Joints", "Segments", "Events")


def recognised(head: str) -> bool:
    """Whether text begins as an export of Nexus does."""
    first = re.split(r"[\r\n,]", head, maxsplit=1)[0].strip().strip('"')
    return first in _SECTIONS


def read(path: Path, _how: How) -> Foreign:
    """The trajectories of an export of Nexus.

    Raises:
        InputError: it has none, is cut off, or its numbers are none.
    """
    rows = [(line, cells or [""]) for line, cells in read_grid(path, ",")]
    at = [i for i, (_, cells) in enumerate(rows) if cells and cells[0] == "Trajectories"]
    if not at:
        raise InputError(f"{path}: has no section 'Trajectories'; export the trajectories of the markers from Nexus")
    section = rows[at[0] :]
    end = next((i for i, (_, cells) in enumerate(section) if i > 4 and not any(cells)), len(section))
    section = section[:end]
    need(path, section, 5, "the section Trajectories")
    rate = number(path, section[1][1][0], "rate of the trajectories", section[1][0])
    names = section[2][1]
    width = len(section[3][1])
    starts = [i for i, name in enumerate(names) if name and section[3][1][i : i + 3] == ["X", "Y", "Z"]]
    # A label holds the subject's name as "subject:label".
    labels = [names[i] for i in starts]
    distinct(path, labels)
    units = {section[4][1][i] for i in starts if i < len(section[4][1])}
    values = numbers(path, section[5:], width, "the section Trajectories")
    points = {label: whole(values[:, i : i + 3]) for label, i in zip(labels, starts, strict=True)}
    others = [cells[0] for _, cells in rows if cells and cells[0] in _SECTIONS and cells[0] != "Trajectories"]
    notes = tuple(f"the section {name} is not read" for name in others)
    times = (values[:, 0] - values[0, 0]) / rate
    if not np.isfinite(times).all():
        raise InputError(f"{path}: the column Frame has an empty cell; export it again")
    return Foreign("CSV of Vicon Nexus", times, points, unit=units.pop() if len(units) == 1 else "", notes=notes)
