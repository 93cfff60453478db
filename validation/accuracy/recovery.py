"""Is an effect found again? Each is hidden in the slab of the hidden study, seen with a noise of 0.3 mm, and looked for blindly.

./dev python -m validation.accuracy.recovery FOLDER [EFFECT...]

The truth has cubic elements on a mesh of its own, steps half as long, and anchors 3 and 4; four pulls, two of them there and back.
A row for each: verdict and its probability, anchors, values against the truth, the error without and with the effect, CPU seconds.
What is in FOLDER already is told again.
"""

from __future__ import annotations

import json
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from bcid import Scene
from bcid.base.progress import Silent
from bcid.base.run_folder import RunFolder, write_whole
from bcid.base.shipped import shipped
from bcid.forms import effects
from bcid.forms.model import check_physics
from bcid.forms.simulate import recorded
from bcid.search.answer.compare_runs import run_explain
from validation.synthetic.amounts import adopted
from validation.synthetic.bodies import SLAB
from validation.synthetic.case_scene import write_scene
from validation.synthetic.cases import Case, Hidden, Motion
from validation.synthetic.conditions import CONDITIONS
from validation.synthetic.felt import Felt
from validation.synthetic.truth import compute

ANCHORS, NOISE, SIZE = ("3", "4"), 3e-4, 4.0
# The gripper leads what it holds back: a set of the material shows no more than so.
SIZES = {"permanent_set": 1.2, "softening": 0.15}
# What moves it hardly at all is told by the gripper's forces, with a noise of 1 % of the largest.
FELT = {"softening": Felt(1.0)}
MOTIONS = (
    Motion("II", "x", (1.0, 0.0, 0.0), 0.014, 8, back=True, seconds=2.0),
    Motion("II", "up", (0.0, 1.0, 0.0), 0.014, 6, seconds=2.0),
    Motion("III", "x and -z", (0.8, 0.0, -0.6), 0.012, 8, back=True, seconds=2.0),
    Motion("I", "x and up", (0.8, 0.6, 0.0), 0.012, 6, seconds=2.0),
)
# Where, in which direction and how fast: of those that have a place in the slab.
SHAPES: dict[str, dict[str, float]] = {
    "permanent_set": {"yield_strain": 0.06},
    "swelling": {},
    # Above the slab, 5 mm from its top.
    "obstacle": {"cx": 0.065, "cy": 0.045, "cz": 0.05, "radius": 0.03},
    # In the middle of the second pull.
    "release": {"onset": 12.0},
    "layer": {},
    "tether": {"angle": 30.0},
    "softening": {"strain": 0.1},
    "grasp_compliance": {},
}
# A slab that swells buckles between anchors and gripper: it dries.
WEIGHTS: dict[str, dict[str, float]] = {"swelling": {"rate": -1.0}}
PLACES = {"release": "4", "tether": "7"}


def made(folder: Path, name: str) -> dict[str, Any]:
    """Write scene, measurement and truth of an effect; the truth."""
    if not (folder / "truth.json").is_file():
        hidden = Hidden(name, SIZES.get(name, SIZE), WEIGHTS.get(name, {}), SHAPES.get(name, {}), PLACES.get(name, ""))
        exact = next(iter(CONDITIONS["exact"]))
        felt, rng = FELT.get(name), np.random.default_rng(1)
        case = Case(0, 0, 0, SLAB, exact, "one", ANCHORS, MOTIONS, NOISE, (hidden,), felt=felt)
        file = shipped(SLAB.scene)
        scene = Scene.read(file, physics=check_physics)
        truth = compute(scene, case)
        times = np.concatenate([action.clock for action in case.actions])
        seen = recorded(scene, case.actions, truth.positions, NOISE, rng, times, name)
        if felt and truth.wrenches is not None:
            seen = felt.measured(seen, truth.wrenches, rng)
        write_scene(folder, file, exact, NOISE)
        replace(seen, noise_sigma=None).write(folder / "measurement")
        write_whole(folder / "truth.json", json.dumps(truth.to_json(case), indent=1) + "\n")
    found: dict[str, object] = json.loads((folder / "truth.json").read_text())["effects"][0]
    return found


def told(folder: Path, name: str) -> str:
    """Find an effect again; a row of the table."""
    truth, run, seconds = made(folder, name), folder / "diagnosis", time.process_time()
    if not (run / "diagnosis.json").is_file():
        run_explain(folder / "scene.toml", folder / "measurement", run, None, MPI.COMM_SELF, Silent(), overwrite=True)
    seconds = time.process_time() - seconds
    diagnosis = RunFolder.open(run).read_json("diagnosis.json")
    entry = adopted(diagnosis, name)
    values = [f"place {entry.get('place', '')} ({truth['place']})"] if entry and truth["place"] else []
    found = entry["parameters"] if entry else {}
    for key, here in found.items():
        p = truth["parameters"][key]
        value, error = (here["value"], here["stderr"]) if isinstance(here, dict) else (here, None)
        values.append(f"{key} {value:.3g}" + (f" ± {error:.2g}" if error is not None else "") + f" ({p['value']:.3g})")
    errors = [rung["rms"] for rung in diagnosis["ladder"]]
    return " | ".join(
        [
            name,
            f"{diagnosis['verdict']}, {100 * diagnosis['verdict_probability']:.1f} %",
            " ".join(diagnosis["anchored"]),
            ", ".join(values),
            f"{errors[0]:.3f} → {errors[-1]:.3f} mm",
            f"{seconds:.0f} s",
        ]
    )


def main(folder: Path, names: list[str]) -> None:
    """Print the table."""
    for name in names or [n for n in effects.names() if n in SHAPES]:
        one = folder / name
        one.mkdir(parents=True, exist_ok=True)
        print(f"| {told(one, name)} |", flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2:])
