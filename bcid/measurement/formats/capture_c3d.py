"""C3D recordings: their points. Analog channels and force plates are not read."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from bcid.measurement.c3d import read_points
from bcid.measurement.formats.foreign import Foreign, How
from bcid.measurement.formats.grid import whole


def read(path: Path, _how: How) -> Foreign:
    """The points of a C3D file.

    Raises:
        InputError: it is damaged, or ezc3d is missing.
    """
    data = read_points(path)
    count = data.positions.shape[1]
    points = {label: whole(data.positions[:, i].T) for i, label in enumerate(data.labels[:count])}
    times = np.arange(data.positions.shape[2]) / data.rate
    return Foreign("C3D", times, points, unit=data.unit, empty=tuple(data.labels[count:]))
