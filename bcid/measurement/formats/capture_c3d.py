"""C3D recordings: their points. Analog channels and force plates are not read."""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bcid.base.confined import read_in_child, serve
from bcid.base.errors import InputError
from bcid.measurement.formats.foreign import Foreign, How
from bcid.measurement.formats.grid import whole

# Time of the reader, s, and how much more a byte of the file may take.
_SECONDS = 30.0
_SECONDS_PER_BYTE = 1e-6


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


@dataclass(frozen=True)
class C3dPoints:
    """The points of a recording.

    Attributes:
        positions: shape (3, points, frames), in `unit`; not finite where a point was not seen.
        labels: names of the points.
        rate: frames per second.
        unit: of the positions; "" if it is not stated.
    """

    positions: NDArray[np.float64]
    labels: list[str]
    rate: float
    unit: str


def read_points(path: Path) -> C3dPoints:
    """Read the points of a C3D file.

    Raises:
        InputError: the file is damaged, or ezc3d is missing.
    """
    limit = _SECONDS + _SECONDS_PER_BYTE * path.stat().st_size
    try:
        data = read_in_child("bcid.measurement.formats.capture_c3d", path, seconds=limit)
    except (InputError, TimeoutError) as error:
        raise InputError(f"{path}: is not a readable C3D file: {error}") from None
    return C3dPoints(data["positions"], [str(x) for x in data["labels"]], float(data["rate"]), str(data["unit"]))


def _points(source: Path, _arguments: Sequence[str]) -> dict[str, Any]:
    try:
        import ezc3d
    except ImportError:
        raise InputError("reading C3D needs the package ezc3d; install bcid[mocap]") from None
    content = ezc3d.c3d(str(source))
    about = content["parameters"]["POINT"]
    labels = [str(label) for label in about["LABELS"]["value"]]
    rate = float(about["RATE"]["value"][0])
    unit = next((str(unit) for unit in about.get("UNITS", {}).get("value", [])), "")
    positions = np.asarray(content["data"]["points"], dtype=float)[:3]
    if positions.ndim != 3 or len(labels) < positions.shape[1] or not (math.isfinite(rate) and rate > 0):
        raise ValueError(f"it states {len(labels)} labels, {positions.shape[1]} points and a rate of {rate:g}")
    return {"positions": positions, "labels": labels or np.zeros(0, str), "rate": rate, "unit": unit}


if __name__ == "__main__":
    sys.exit(serve(_points, ["ezc3d"]))
