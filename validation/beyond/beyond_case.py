"""One case: a law or a term of the truth is drawn, and the body is pulled; a term is proposed from scene and measurement alone."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from bcid.base.errors import SolveError
from bcid.base.run_folder import write_whole
from bcid.base.shipped import shipped
from bcid.base.text_file import read_json
from bcid.forms.mesh import BodyMesh, level_mesh
from bcid.forms.mesh.closest import closest_on_triangles
from bcid.forms.model import Model, Term, check_physics
from bcid.forms.simulate import recorded
from bcid.inference.continuation import truncate_to_converged
from bcid.measurement import Measurement
from bcid.scene import Scene
from validation.beyond.compared_energy import energy_apart
from validation.beyond.mesh_floor import BeyondMesh, MeshFloor
from validation.beyond.true_laws import LAWS, true_scene
from validation.beyond.true_terms import TERMS
from validation.synthetic import truth
from validation.synthetic.case_scene import FILE, write_scene
from validation.synthetic.cases import Case
from validation.synthetic.chance import Rng, generator, log_uniform
from validation.synthetic.conditions import Conditions
from validation.synthetic.drawing import CaseChoice, draw

if TYPE_CHECKING:
    from bcid.predict.predictor import Predictor

Array = NDArray[np.float64]
# Of the noise, m; sizes of a term of the truth in units of it; radius of its patch relative to the body.
NOISE, SIZES, RADII = 2e-4, (4.0, 12.0), (0.06, 0.11)
# How much farther than others bodies are pulled for a law, attempt by attempt.
FARTHER = (1.8, 1.5, 1.2)
# Five pulls, so many laws and terms, and now and then nothing.
PULLS = 5
KINDS = (*LAWS, *TERMS, "none")
_ATTEMPTS = 18
# A patch of skin lies so far from grips and anchors at least, relative to the body.
_AWAY = 0.12


@dataclass(frozen=True)
class Made:
    """The truth of a case.

    Attributes:
        positions: noise-free, (frames, fiducials, 3), m.
        scene: with the true law.
        term: of the truth, or None.
        size: how far it moves the fiducials, RMS, in units of noise.
    """

    positions: Array
    scene: Scene
    term: Term | None
    size: float


def maker(job: Mapping[str, Any]) -> Callable[[Mapping[str, Any]], dict[str, Any]]:
    """The function that makes a case, for `validation.engine.dispatch`; `job` holds `cases`, `seed` and `bodies`."""

    def case(task: Mapping[str, Any]) -> dict[str, Any]:
        folder = Path(job["cases"]) / f"{task['index']:04d}"
        make(folder, task["index"], job["seed"], tuple(job["bodies"]))
        began = time.process_time()
        found = proposed(folder)
        return {"truth": read_json(folder / "truth.json"), "found": found, "cpu_seconds": time.process_time() - began}

    return case


def kind_of(index: int) -> str:
    """Kinds take turns."""
    return KINDS[index % len(KINDS)]


def make(folder: Path, index: int, seed: int, bodies: tuple[str, ...]) -> None:
    """Write scene and measurement of a case, and apart from them its truth; what is there stays.

    A truth that the working mesh does not show is drawn again: whatever is proposed for it, that mesh would be measured.

    Raises:
        SolveError: no attempt could be solved, and be followed on the working mesh.
    """
    if (folder / "measurement").is_dir():
        return
    kind, reasons, refused = kind_of(index), [], list[str]()
    body = bodies[index // len(KINDS) % len(bodies)]
    for attempt in range(_ATTEMPTS):
        case = _drawn(index, attempt, seed, body)
        scene = Scene.read(shipped(case.body.scene), physics=check_physics)
        rng = generator(seed, 21, index, attempt)
        try:
            made = _made(kind, case, scene, rng)
            seen = _seen(case, scene, made, rng)
            true = replace(made.scene, noise_sigma=NOISE)
            floor = MeshFloor.of(true, seen, frozenset(case.anchors), made.term)
        except SolveError as error:
            reasons.append(str(error))
            refused += [str(error)] if isinstance(error, BeyondMesh) else []
            continue
        known = _told(kind, case, made) | {"not_asked": truth.untold_patches(scene, case), "refused": refused}
        known |= {"floor": floor.held_out, "floor_rms": floor.rms}
        write_whole(folder / "truth.json", json.dumps(known, indent=1) + "\n")
        write_scene(folder, shipped(case.body.scene), case.conditions, NOISE)
        replace(seen, noise_sigma=None).write(folder / "measurement")
        return
    raise SolveError(f"case {index} of seed {seed} could not be made in {_ATTEMPTS} attempts: {'; '.join(reasons)}")


def _drawn(index: int, attempt: int, seed: int, body: str) -> Case:
    """Anchors and pulls as in the hidden study."""
    case = draw(CaseChoice(seed, bodies=(body,), conditions="exact"), index, attempt)
    motions = (*case.motions, *case.motions)[:PULLS]
    if kind_of(index) in LAWS:
        # Laws of the same stiffness at small strain differ where strains are large.
        motions = tuple(replace(m, amplitude=FARTHER[attempt % len(FARTHER)] * m.amplitude) for m in motions)
    return replace(case, kind="none", hidden=(), motions=motions, noise=NOISE, conditions=Conditions())


def _made(kind: str, case: Case, scene: Scene, rng: Rng) -> Made:
    true, coarse = case.body.true, case.body.coarse
    if kind in LAWS:
        return _with_law(case, scene, true_scene(kind, rng, scene))
    plain = truth.true_positions(scene, case, true, ())
    if kind == "none":
        return Made(plain, scene, None, 0.0)
    term = _term(kind, case, scene, rng, truth.true_positions(scene, case, coarse, ()))
    found = truth.true_positions(scene, case, true, (term,))
    return Made(found, scene, term, truth.rms(found - plain) / NOISE)


def _with_law(case: Case, scene: Scene, other: Scene) -> Made:
    """Of another law than the scene's; tried with coarse elements first, which tell sooner that it cannot be followed."""
    truth.true_positions(other, case, case.body.coarse, ())
    found = truth.true_positions(other, case, case.body.true, ())
    return Made(found, other, None, truth.rms(found - truth.true_positions(scene, case, case.body.true, ())) / NOISE)


def _term(kind: str, case: Case, scene: Scene, rng: Rng, plain: Array) -> Term:
    """A term of the truth of a size that is drawn."""
    known = TERMS[kind]
    mesh = level_mesh(scene, case.body.coarse)
    centre = _place(scene, case, mesh, rng)
    shapes = dict(zip(("cx", "cy", "cz"), map(float, centre), strict=True))
    shapes["radius"] = mesh.size * float(rng.uniform(*RADII))
    names = [p.name for p in known.effect.amounts]
    weights = rng.normal(size=len(names)) if len(names) > 1 else np.array([rng.choice(known.signs)])
    weights /= np.linalg.norm(weights)
    target = log_uniform(rng, *SIZES)

    def term(amount: float) -> Term:
        values = {p.name: float(amount * w * p.scale) for p, w in zip(known.effect.amounts, weights, strict=True)}
        return Term(known.effect, shapes | values)

    def size(amount: float) -> float | None:
        try:
            return truth.rms(truth.true_positions(scene, case, case.body.coarse, (term(amount),)) - plain) / NOISE
        except SolveError:
            return None

    amount = truth.search(size, target, truth.DOSES)
    if (reached := size(amount)) is None or reached < SIZES[0] / 2:
        raise SolveError(f"a {kind} moves the fiducials by no more than {reached or 0:.2g} noises")
    return term(amount)


def _place(scene: Scene, case: Case, mesh: BodyMesh, rng: Rng) -> Array:
    """A place on the skin away from anchors and grips."""
    points, middles = mesh.points, mesh.points[mesh.boundary].mean(axis=1)
    kept = [scene.patches[name] for name in case.anchors] + [scene.grasps[m.grasp].region for m in case.motions]
    held = points[np.unique(np.concatenate([mesh.select(region, "held").ravel() for region in kept]))]
    away = np.linalg.norm(middles[:, None] - held[None], axis=2).min(axis=1)
    usable = np.flatnonzero(away > _AWAY * mesh.size)
    if not len(usable):
        raise SolveError("no place is away from what is held")
    return np.asarray(middles[rng.choice(usable)])


def _seen(case: Case, scene: Scene, made: Made, rng: Rng) -> Measurement:
    """The measurement, with noise."""
    times = np.concatenate([action.clock for action in case.actions])
    name = f"beyond the catalogue, case {case.index}"
    return recorded(scene, case.actions, made.positions, NOISE, rng, times, name)


def _told(kind: str, case: Case, made: Made) -> dict[str, Any]:
    """What is true."""
    return {
        "index": case.index, "kind": kind, "body": case.body.name, "anchored": list(case.anchors), "size": made.size,
        "law": {"name": made.scene.material.law, "values": dict(made.scene.material.values)},
        "term": None if made.term is None else dict(made.term.values),
    }  # fmt: skip


def proposed(folder: Path) -> dict[str, Any]:
    """What is proposed, given scene and measurement alone, as far as that can be followed; then compared with the truth."""
    scene = Scene.read(folder / FILE, physics=check_physics)
    measurement = Measurement.read(folder / "measurement")
    known = read_json(folder / "truth.json")
    return truncate_to_converged(measurement, lambda seen: _proposed(scene, seen, known))


def _proposed(scene: Scene, measurement: Measurement, known: Mapping[str, Any]) -> dict[str, Any]:
    from mpi4py import MPI

    from bcid.grammar.propose import propose
    from bcid.predict.predictor import Predictor

    predictor = Predictor(scene, measurement, MPI.COMM_SELF)
    try:
        found = propose(predictor, Model.of(scene))
        last = found.explanation.last
        told: dict[str, Any] = {
            "verdict": found.explanation.verdict,
            "complete": found.complete,
            "anchored": sorted(last.state.anchors),
            "held_by": found.explanation.held_by,
            "probability": found.explanation.probability,
            "rms": last.state.rms,
            "held_out": last.held_out,
            "verdicts": dict(list(found.explanation.odds.verdicts.items())[:8]),
            "terms": [
                {
                    "family": entry.family.name,
                    "kind": entry.family.kind,
                    "place": term.place,
                    "values": dict(term.values),
                    "apart": None if known["term"] is None else _apart(predictor, term, known["term"]),
                }
                for term, entry in zip(found.terms, found.path, strict=True)
            ],
        }
        if known["kind"] in LAWS:
            told["energy_apart"] = energy_apart(predictor, last.fitted, known["law"])
        return told
    finally:
        predictor.destroy()


def _apart(predictor: Predictor, term: Term, truth: Mapping[str, float]) -> float | None:
    """Distance of where a term acts from the middle of the true one, m; None where it acts on all of the body or its skin."""
    middle = np.array([truth[f"c{axis}"] for axis in "xyz"])
    if "cx" in term.values:
        return float(np.linalg.norm([term.values[f"c{axis}"] for axis in "xyz"] - middle))
    region = predictor.scene.patches.get(term.place)
    if region is None:
        return None
    mesh = level_mesh(predictor.scene, predictor.scene.levels[predictor.level])
    triangles = mesh.points[mesh.select(region, f"patch {term.place}")]
    return float(np.linalg.norm(closest_on_triangles(triangles, middle) - middle, axis=1).min())
