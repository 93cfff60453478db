"""C3D recordings, read by ezc3d in a process of its own: a damaged file may make it die, hang, or ask for any amount of memory.

``python -m bcid.c3d FILE OUT.npz`` is that process: it prints one line and exits with 1 when the file cannot be used.
"""

from __future__ import annotations

import math
import os
import resource
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bcid.errors import InputError
from bcid.scratch import require, temporary_folder

# Time of the reader, s, and how much more a byte of the file may take.
_SECONDS = 30.0
_SECONDS_PER_BYTE = 1e-6
# Address space of the reader, bytes, and how much more a byte of the file may take.
_SPACE = 2_000_000_000
_PER_BYTE = 100


@dataclass(frozen=True)
class Points:
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


def read_points(path: Path) -> Points:
    """Read the points of a C3D file.

    Raises:
        InputError: the file is damaged, or ezc3d is missing.
    """
    limit = _SECONDS + _SECONDS_PER_BYTE * path.stat().st_size
    with temporary_folder("bcid-c3d-") as folder:
        out = folder / "points.npz"
        root = str(Path(__file__).resolve().parents[1])
        environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, [root, os.environ.get("PYTHONPATH")]))}
        command = [sys.executable, "-m", "bcid.c3d", str(path.resolve()), str(out)]
        try:
            child = subprocess.run(command, env=environment, capture_output=True, timeout=limit, check=False)
        except subprocess.TimeoutExpired:
            raise InputError(f"{path}: is not a readable C3D file: reading took more than {limit:.0f} s") from None
        if child.returncode != 0 or not out.exists():
            require()
            said = (child.stdout + child.stderr).decode("utf-8", "replace").strip().splitlines()
            reason = said[-1][:300] if said else f"the reader died with code {child.returncode}"
            raise InputError(f"{path}: is not a readable C3D file: {reason}")
        with np.load(out, allow_pickle=False) as data:
            return Points(data["positions"], [str(x) for x in data["labels"]], float(data["rate"]), str(data["unit"]))


def main() -> int:
    """Read the arguments, write the arrays."""
    source, out = Path(sys.argv[1]), sys.argv[2]
    most = _SPACE + _PER_BYTE * source.stat().st_size
    resource.setrlimit(resource.RLIMIT_AS, (most, resource.getrlimit(resource.RLIMIT_AS)[1]))
    try:
        import ezc3d
    except ImportError:
        print("reading C3D needs the package ezc3d; install bcid[mocap]")
        return 1
    try:
        content = ezc3d.c3d(str(source))
        about = content["parameters"]["POINT"]
        labels = [str(label) for label in about["LABELS"]["value"]]
        rate = float(about["RATE"]["value"][0])
        unit = next((str(unit) for unit in about.get("UNITS", {}).get("value", [])), "")
        positions = np.asarray(content["data"]["points"], dtype=float)[:3]
        if positions.ndim != 3 or len(labels) < positions.shape[1] or not (math.isfinite(rate) and rate > 0):
            raise ValueError(f"it states {len(labels)} labels, {positions.shape[1]} points and a rate of {rate:g}")
    except Exception as error:
        print(str(error).strip().replace("\n", " ") or type(error).__name__)
        return 1
    np.savez(out, positions=positions, labels=labels or np.zeros(0, str), rate=rate, unit=unit)
    return 0


if __name__ == "__main__":
    sys.exit(main())
