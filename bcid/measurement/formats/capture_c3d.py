"""C3D recordings: their points, read by ezc3d in a process of its own. Analog channels and force plates are not read."""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from bcid.base.confined import serve
from bcid.measurement.formats.foreign import Foreign, How, fetched, needed, whole


def read(path: Path, _how: How) -> Foreign:
    """The points of a C3D file."""
    data = fetched("bcid.measurement.formats.capture_c3d", path, "C3D file")
    positions, labels = data["positions"], [str(label) for label in data["labels"]]
    count = positions.shape[1]
    points = {label: whole(positions[:, i].T) for i, label in enumerate(labels[:count])}
    times = np.arange(positions.shape[2]) / float(data["rate"])
    return Foreign("C3D", times, points, unit=str(data["unit"]), empty=tuple(labels[count:]))


def _points(source: Path, _arguments: Sequence[str]) -> dict[str, Any]:
    """Positions (3, points, frames), not finite where a point was not seen; labels; frames per second; unit, "" if not stated."""
    try:
        import ezc3d
    except ImportError:
        raise needed("ezc3d") from None
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
