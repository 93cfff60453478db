"""Part of B2: mutated C3D files, through the mapping file that names them."""

from __future__ import annotations

import tempfile
from collections import Counter
from pathlib import Path

import numpy as np

from bcid import Measurement
from validation.reliability import Reached
from validation.reliability.inputs import refusal

_MAPPING = """format = "bcid-mapping/1"
file = "some.c3d"
length_unit = "mm"
time_unit = "s"
force_unit = "N"
[fiducials]
a = "A"
b = "B"
"""


def good_file(path: Path) -> bytes:
    """Two points in twenty frames."""
    import ezc3d

    content = ezc3d.c3d()
    content["parameters"]["POINT"]["RATE"]["value"] = [100.0]
    content["parameters"]["POINT"]["LABELS"]["value"] = ["A", "B"]
    content["parameters"]["POINT"]["UNITS"]["value"] = ["mm"]
    points = np.ones((4, 2, 20))
    points[:3] = np.random.default_rng(0).random((3, 2, 20))
    content["data"]["points"] = points
    content.write(str(path))
    return path.read_bytes()


def mutated(good: bytes, rng: np.random.Generator) -> bytes:
    """With a few bytes changed, mostly in the header and the parameters, or cut short."""
    if rng.random() < 0.2:
        return good[: rng.integers(len(good))]
    bad = bytearray(good)
    reach = (64, 1024, len(good))[rng.integers(3)]
    for place in rng.integers(min(reach, len(good)), size=rng.integers(1, 9)):
        bad[place] = (0, 255, 127, 128, int(rng.integers(256)))[rng.integers(5)]
    return bytes(bad)


def damage(count: int = 300, seed: int = 0) -> Reached:
    """C3D: each is refused in words, or read as a measurement that is sound."""
    rng = np.random.default_rng(seed)
    ends: Counter[str] = Counter()
    misses = []
    with tempfile.TemporaryDirectory(prefix="bcid-") as name:
        path = Path(name) / "some.c3d"
        good = good_file(path)
        mapping = path.with_name("mapping.toml")
        mapping.write_text(_MAPPING, encoding="utf-8")
        Measurement.read(mapping)
        for number in range(count):
            path.write_bytes(mutated(good, rng))
            try:
                said = refusal(lambda: Measurement.read(mapping))
            except Exception as error:
                misses.append(f"case {number} of seed {seed}: {error!r}")
                continue
            died = said is not None and "the reader died" in said
            ends["ezc3d died" if died else "refused" if said else "read"] += 1
            if said is not None and "some.c3d" not in said and "mapping.toml" not in said:
                misses.append(f"case {number} of seed {seed}: {said[:200]}")
    text = ", ".join(f"{what} {times}" for what, times in sorted(ends.items()))
    return Reached("mutated C3D files: no death of bcid, one message", text, not misses, tuple(misses))
