"""B3: bit flips and truncations of the files of a finished run folder."""

from __future__ import annotations

import json
import shutil
import tempfile
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from bcid.base.errors import InputError
from bcid.base.run_folder import RunFolder
from validation.reliability import Reached

_INPUTS = {"scene": "a", "measurement": "b", "options": {"seeds": 4}}


def finished(folder: Path, seed: int = 0) -> Path:
    """A run folder with files of every kind that a command reads again, and with numbers in all of them."""
    rng = np.random.default_rng(seed)
    run = RunFolder.start(folder, "identify", _INPUTS)
    run.write_json("identification.json", {"anchored": ["1", "2"], "probability": 0.98, "rms": rng.random()})
    data = xr.Dataset(
        {"measured": (("frame", "axis"), rng.random((20, 3)))},
        {"axis": ["x", "y", "z"], "time": ("frame", np.arange(20.0))},
    )
    run.write_dataset("prediction.nc", data)
    run.write_dataset("body.nc", data)
    run.finish({"anchored": ["1", "2"], "rms": rng.random()})
    return folder


def content(folder: Path) -> dict[str, Any]:
    """All that commands read of the folder; what is damaged is an `InputError`."""
    run = RunFolder.open(folder)
    found: dict[str, Any] = {"record": run.record, "identification": run.read_json("identification.json")}
    for name in ("prediction.nc", "body.nc"):
        found[name] = run.read_dataset(name).to_dict()
    return found


def damaged(good: bytes, rng: np.random.Generator) -> bytes:
    """With one to three bits turned, or cut short."""
    if rng.random() < 0.3:
        return good[: rng.integers(len(good))]
    bad = bytearray(good)
    for place in rng.integers(len(good), size=rng.integers(1, 4)):
        bad[place] ^= 1 << int(rng.integers(8))
    return bytes(bad)


def damage(count: int = 2000, seed: int = 0, read: Callable[[Path], Any] = content) -> Reached:
    """B3: damage one file at a time, and read all."""
    rng = np.random.default_rng(seed)
    ends: Counter[str] = Counter()
    misses = []
    with tempfile.TemporaryDirectory(prefix="bcid-") as name:
        folder = finished(Path(name) / "run")
        right = json.dumps(read(folder), default=str)
        files = sorted(f for f in folder.rglob("*") if f.is_file() and f.name != ".lock")
        for number in range(count):
            file = files[number % len(files)]
            good = file.read_bytes()
            bad = damaged(good, rng)
            file.write_bytes(bad)
            try:
                same = json.dumps(read(folder), default=str) == right
                ends["read right" if same else "another number"] += 1
                if not same:
                    misses.append(f"{file.name}: read as something else (case {number})")
            except InputError as error:
                ends["detected"] += 1
                if file.name not in str(error):
                    misses.append(f"{file.name}: not named: {error}")
            except Exception as error:
                misses.append(f"{file.name}: {error!r} (case {number})")
            file.write_bytes(good)
        shutil.rmtree(folder)
    text = ", ".join(f"{what} {times}" for what, times in sorted(ends.items()))
    return Reached("2,000 bit flips and truncations: detected or read right", text, not misses, tuple(misses))
