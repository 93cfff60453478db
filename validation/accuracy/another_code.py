"""What another code measures on two bodies in which everything is slightly wrong, told by `explain`.

./dev python -m validation.accuracy.another_code FOLDER [CASE...]

The bodies are those of `tests/data/lab2`, their scenes what an honest user would write. In truth a dimension is 2 to 3 % off,
borders of patches about 1 mm, Poisson's ratio 0.03, markers sit 0.35 mm (standard deviation, along the surface) from where the
scene has them, the gripper is reported 0.3 to 0.5 mm and 0.3 degrees off in each action, the camera is turned by 0.2 degrees;
noise 0.13 mm. The elements are those of `tetrahedra.py`. A row for each case: verdict, anchors with their probability, values
against the truth, error without and with what is named, CPU seconds. What is in FOLDER already is told again.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI
from scipy.spatial.transform import Rotation

from bcid import Scene
from bcid.base.progress import Silent
from bcid.base.run_folder import RunFolder
from bcid.base.units import percent
from bcid.forms.model import Model, check_physics
from bcid.forms.simulate import recorded
from bcid.measurement import Action
from bcid.scene.rotation import as_quaternion
from validation.accuracy.tetrahedra import Array, Body, Mesh
from validation.explained import run_explain
from validation.synthetic.amounts import adopted

SCENES = Path(__file__).parents[2] / "tests/data/lab2/scenes"
NOISE, MARKERS, CAMERA, TURN = 0.13, 0.35, 0.2, 0.3
SIZES = {"block": 4.0, "organ": 4.5}
AXES: Array = np.array([45.0, 22.0, 30.0])


@dataclass(frozen=True)
class Pull:
    """By how far (mm) and about what (degrees, a rotation vector) a grasp is moved, in so many steps."""

    grasp: str
    to: tuple[float, float, float]
    steps: int
    turn: tuple[float, float, float] = (0.0, 0.0, 0.0)


BLOCK = (Pull("G1", (6, 2, 0), 8), Pull("G2", (2, 1, 6), 8), Pull("G1", (1, -2, 6), 8), Pull("G2", (5, 3, -1), 7))
TURNED = (Pull("G1", (5, 4, 1), 7, (0, 10, 0)), Pull("G2", (-3, 2, 6), 8), Pull("G1", (2, 5, -5), 8))
ORGAN = (
    *(Pull("G1", (7, 3, 0), 8), Pull("G1", (2, 2, 8), 7), Pull("G1", (1, 8, -2), 8), Pull("G1", (5, -1, -6), 8)),
    Pull("G1", (4, 6, 3), 6, (12, 0, 0)),
)


@dataclass(frozen=True)
class Case:
    """What holds a body, what acts in it, and how it is pulled.

    Attributes:
        anchors: the patches.
        pulls: one for each action.
        hidden: what `tetrahedra.Body` has besides; "slip" is the part by which the gripper's grasp lags.
        effect: its name in the catalogue, and its numbers there.
    """

    anchors: str
    pulls: tuple[Pull, ...]
    hidden: Mapping[str, Any] = field(default_factory=dict)
    effect: tuple[str, Mapping[str, float]] = ("none", {})


CASES = {
    "block-gravity": Case("23", BLOCK, {"weight": 9.8e-6}, ("gravity", {"weight": 9800.0})),
    "block-fibres": Case("16", BLOCK, {"fibres": (6e-3, 30.0)}, ("fibres", {"k1": 6000.0, "angle": 30.0})),
    "block-none": Case("45", TURNED),
    "block-slip": Case("25", TURNED, {"slip": 0.25}, ("grasp_slip", {"lag": 0.25})),
    "block-inclusion": Case(
        "14",
        BLOCK,
        {"ball": (np.array([32.0, 8.0, 22.0]), 7.0, 6.0)},
        ("inclusion", {"ratio": 6.0, "cx": 0.032, "cy": 0.008, "cz": 0.022, "radius": 0.007}),
    ),
    "organ-none": Case("26", ORGAN),
    "organ-active": Case(
        "15", ORGAN, {"active": (1.2e-3, 20.0)}, ("active_stress", {"amplitude": 1200.0, "angle": 20.0})
    ),
    "organ-soft": Case("24", ORGAN, {"springs": {"patch_2": 6e-4}}, ("soft_anchor", {"stiffness": 6e5})),
}


@dataclass(frozen=True)
class Wrong:
    """By how much a scene is off: factors of the dimensions, borders (mm), and Poisson's ratio."""

    scale: Array
    borders: Array
    poisson: float

    @classmethod
    def all(cls) -> dict[str, Wrong]:
        """Of every case; drawn in this order."""
        rng, found = np.random.default_rng(5), {}
        for name in CASES:
            scale = np.ones(3)
            scale[int(rng.integers(3))] = 1 + rng.choice([-1, 1]) * rng.uniform(0.02, 0.03)
            poisson = 0.38 + float(rng.choice([-0.03, 0.03])) if name.startswith("block") else 0.39
            borders = rng.choice([-1, 1], 2) * rng.uniform(0.8, 1.2, 2)
            found[name] = cls(scale, borders, poisson)
            rng.integers(10**6)
        return found


def truly(name: str, mesh: Mesh, wrong: Wrong) -> Mesh:
    """The body as it is: borders lie elsewhere inside it, and then a dimension is another."""
    x = mesh.points.copy()
    if name.startswith("block"):
        inside = np.sin(np.pi * x[:, 2] / 40), np.sin(np.pi * x[:, 0] / 60)
        x[:, 2] += wrong.borders[0] * inside[0]
        x[:, 0] += wrong.borders[1] * inside[1]
    else:
        part = 1 - ((x / AXES) ** 2).sum(axis=1)
        x[:, 0] += wrong.borders[0] * part
        x[:, 2] += wrong.borders[1] * part
    return replace(mesh, points=x * wrong.scale)


def placed(name: str, rest: Array, wrong: Wrong, rng: np.random.Generator) -> Array:
    """Where the markers sit: on the surface, beside where the scene has them, mm."""
    found = rest.copy()
    for place in found:
        away = rng.normal(0, MARKERS, 3)
        if name.startswith("block"):
            away[1] = 0
        else:
            normal = place / (AXES * wrong.scale) ** 2
            normal /= np.linalg.norm(normal)
            away -= normal * (normal @ away)
        place += away
    if name.startswith("block"):
        found[:, 1] = 15 * wrong.scale[1]
    else:
        found /= np.sqrt(((found / (AXES * wrong.scale)) ** 2).sum(axis=1))[:, None]
    return found


def _unit(rng: np.random.Generator) -> Array:
    drawn = rng.normal(size=3)
    return np.asarray(drawn / np.linalg.norm(drawn))


def measured(folder: Path, name: str, scene: Scene) -> None:
    """Compute what is seen, and write it."""
    case, wrong = CASES[name], Wrong.all()[name]
    kind = name.split("-")[0]
    mesh = truly(name, Mesh.of(SCENES / f"{kind}.geo", SIZES[kind]), wrong)
    hidden = {key: value for key, value in case.hidden.items() if key != "slip"}
    body = Body(mesh, Model.of(scene).constants()["young"] * 1e-6, wrong.poisson, **hidden)
    rng = np.random.default_rng(list(CASES).index(name))
    rest = scene.rest * 1e3
    looked_at = body.seen(placed(name, rest, wrong, rng))
    places = np.array([values @ mesh.points[nodes] for nodes, values in looked_at])
    middle = rest.mean(axis=0)
    camera = Rotation.from_rotvec(np.radians(CAMERA) * _unit(rng))
    firm = [mesh.faces[f"patch_{p}"] for p in case.anchors if f"patch_{p}" not in body.springs]
    anchored = np.unique(np.concatenate([faces.ravel() for faces in firm]))
    actions, seen, first = list[Action](), list[Array](), 0
    for number, pull in enumerate(case.pulls, 1):
        shift, turn = rng.uniform(0.3, 0.5) * _unit(rng), np.radians(TURN) * _unit(rng)
        gripped = np.unique(mesh.faces[f"grasp_{pull.grasp[1]}"])
        fixed = np.setdiff1d(anchored, gripped)
        nodes = np.concatenate([fixed, gripped])
        held = (3 * nodes[:, None] + np.arange(3)).ravel()
        centre = np.array(scene.grasps[pull.grasp].centre) * 1e3
        u: Array = np.zeros(body.count)
        share = 0.0
        turns, shifts = [], []
        for step in range(pull.steps + 1):
            part = step / pull.steps
            done = part * (1 - case.hidden.get("slip", 0.0))
            rotation = Rotation.from_rotvec(np.radians(pull.turn) * done)
            goal = np.zeros((len(nodes), 3))
            from_centre = mesh.points[gripped] - centre
            goal[len(fixed) :] = rotation.apply(from_centre) - from_centre + done * np.array(pull.to)
            u, share = body.equilibrium(u, held, goal.ravel(), (share, 1.0)), 1.0
            moved = np.array([values @ u.reshape(-1, 3)[cells] for cells, values in looked_at])
            seen.append(camera.apply(places + moved - middle) + middle + rng.normal(0, NOISE, places.shape))
            reported = Rotation.from_rotvec(turn * (step > 0)) * Rotation.from_rotvec(np.radians(pull.turn) * part)
            turns.append(as_quaternion(reported))
            shifts.append((part * np.array(pull.to) + shift * (step > 0)) * 1e-3)
        steps = np.arange(pull.steps + 1)
        actions.append(Action(str(number), first + steps, steps, pull.grasp, np.array(shifts), np.array(turns)))
        first += len(steps)
    rng = np.random.default_rng(0)
    made = recorded(scene, actions, np.array(seen) * 1e-3, 0.0, rng, description=name)
    replace(made, noise_sigma=NOISE * 1e-3).write(folder)


def told(folder: Path, name: str) -> str:
    """Explain a case; a row of the table."""
    file = SCENES / f"{name.split('-')[0]}.toml"
    scene, case = Scene.read(file, physics=check_physics), CASES[name]
    if not (folder / "measurement").exists():
        measured(folder / "measurement", name, scene)
    run, seconds = folder / "diagnosis", time.process_time()
    if not (run / "diagnosis.json").is_file():
        run_explain(file, folder / "measurement", run, None, MPI.COMM_SELF, Silent(), overwrite=True)
    seconds = time.process_time() - seconds
    diagnosis = RunFolder.open(run).read_json("diagnosis.json")
    effect, truth = case.effect
    values = []
    named = adopted(diagnosis, effect)
    for key, value in truth.items() if named else ():
        here = named["parameters"][key] if named else None
        amount, error = (here["value"], here["stderr"]) if isinstance(here, dict) else (here, None)
        values.append(f"{key} {amount:.4g}" + (f" ± {error:.2g}" if error is not None else "") + f" ({value:.4g})")
    errors = [rung["rms"] for rung in diagnosis["model_sequence"]]
    return " | ".join(
        [
            f"{name.split('-')[0]}, {' '.join(case.anchors)}, {effect}",
            f"{diagnosis['verdict']}, {percent(diagnosis['verdict_probability'])}",
            f"{' '.join(diagnosis['anchored'])}, {percent(diagnosis['anchors_probability'])}",
            ", ".join(values),
            f"{errors[0]:.3f} → {errors[-1]:.3f} mm",
            f"{seconds:.0f} s",
        ]
    )


def main(folder: Path, names: list[str]) -> None:
    """Print the table."""
    for name in names or CASES:
        (folder / name).mkdir(parents=True, exist_ok=True)
        print(f"| {told(folder / name, name)} |", flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2:])
