"""What a dense field costs: CPU seconds and memory of identify and explain by the number of points, each in a process of its own.

./dev python -m validation.bench.dense                          (16 to 10,000 points in 22 frames; some minutes)
./dev python -m validation.bench.dense --points 10000 --steps 24   (50 frames)

The points lie anywhere on the top of the slab, each seen with a noise of 0.2 mm; {3 4} are anchored and nothing is hidden.
"""

from __future__ import annotations

import argparse
import json
import math
import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import bcid
from bcid import Measurement, Scene
from bcid.measurement.compared import pooled
from bcid.scene.motions import actions

SCENE = Path(__file__).resolve().parents[1] / "examples/scenes/slab_explain.toml"
NOISE, MEBIBYTE = 2e-4, 1024.0


def field(points: int, scene: Scene) -> Scene:
    """The scene with so many points on the top of the slab."""
    rng = np.random.default_rng(0)
    places = np.column_stack([rng.uniform(1, 75, points), np.full(points, 10.0), rng.uniform(1, 99, points)]) * 1e-3
    return replace(scene, fiducials={f"p{k}": (float(x), float(y), float(z)) for k, (x, y, z) in enumerate(places)})


def measured(scene: Scene, steps: int, folder: Path) -> None:
    """Write what two pulls show of the points."""
    part = np.linspace(0, 1, steps + 1)[:, None]
    ways = [(part * np.array(way), np.tile([1.0, 0, 0, 0], (steps + 1, 1))) for way in ((0.012, 0, 0), (0, 0.01, 0))]
    made = bcid.simulate(scene, "34", actions(ways, "II"), level=1, noise=NOISE)
    made.to_netcdf(folder / "measurement.nc")


def timed(command: str, points: int, folder: Path) -> dict[str, Any]:
    """CPU seconds and memory of a command, in this process; of "read" those that come before any of them."""
    scene = field(points, Scene.read(SCENE))
    measurement = Measurement.from_netcdf(folder / "measurement.nc")
    began = time.process_time()
    if command == "read":
        pooled(scene, measurement)
        told = ""
    else:
        found = getattr(bcid, command)(scene, measurement)
        told = "{" + " ".join(found.anchored) + "}" + (f", {found.verdict}" if command == "explain" else "")
    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / MEBIBYTE
    return {"seconds": time.process_time() - began, "memory": most, "told": told}


def main() -> None:
    """Measure each number of points, or one command in a child process."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--points", type=int, nargs="+", default=[16, 100, 1000, 10_000])
    parser.add_argument("--steps", type=int, default=10)
    parser.add_argument(
        "--commands", nargs="+", default=["identify", "explain"], choices=["read", "identify", "explain"]
    )
    parser.add_argument("--child", nargs=3, metavar=("COMMAND", "POINTS", "FOLDER"), help=argparse.SUPPRESS)
    chosen = parser.parse_args()
    if chosen.child:
        command, points, place = chosen.child
        print(json.dumps(timed(command, int(points), Path(place))))
        return
    print(f"{2 * (chosen.steps + 1)} frames\n{'points':>7}{'command':>10}{'CPU s':>8}{'MB':>7}  answer")
    took: dict[str, list[tuple[int, float]]] = {command: [] for command in chosen.commands}
    for points in chosen.points:
        with tempfile.TemporaryDirectory() as folder:
            measured(field(points, Scene.read(SCENE)), chosen.steps, Path(folder))
            for command in chosen.commands:
                child = [sys.executable, __file__, "--child", command, str(points), folder]
                output = subprocess.run(child, check=True, capture_output=True, text=True).stdout
                found = json.loads(output.splitlines()[-1])
                took[command].append((points, found["seconds"]))
                numbers = f"{found['seconds']:>8.1f}{found['memory']:>7.0f}"
                print(f"{points:>7}{command:>10}{numbers}  {found['told']}", flush=True)
    for command, pairs in took.items():
        if len(pairs) > 1:
            (few, short), (many, long) = pairs[0], pairs[-1]
            print(f"{command}: time grows with points^{math.log(long / short) / math.log(many / few):.2f}")


if __name__ == "__main__":
    main()
