"""What the fiducials of a case really do, and the measurement made of it.

The truth is computed with cubic elements on a mesh of its own and with every commanded step cut in two, so that a
diagnosis never meets the errors of its own discretisation.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bcid.base.errors import SolveError
from bcid.base.run_folder import write_whole
from bcid.base.shipped import shipped
from bcid.forms import effects
from bcid.forms.effects.effect import Effect
from bcid.forms.forward import Forward
from bcid.forms.gripper_force import ROWS, ForceScale
from bcid.forms.mesh import level_mesh
from bcid.forms.model import Model, Term, check_physics
from bcid.forms.simulate import recorded
from bcid.forms.solver.equilibrium import Settings
from bcid.forms.solver.status import Status
from bcid.forms.solver.trajectory import between, poses
from bcid.measurement import Action
from bcid.scene import Level, Scene
from validation.synthetic import outside
from validation.synthetic.case_scene import write_scene
from validation.synthetic.cases import Case, Hidden
from validation.synthetic.chance import generator
from validation.synthetic.drawing import CaseChoice, draw
from validation.synthetic.felt import Felt
from validation.synthetic.inexact import Inexact

Array = NDArray[np.float64]

ACCURACY = Settings(rtol=1e-6, halvings=3)
# A term is searched until its size is this near the target (relative), with so many trajectories at most.
NEAR, MOST = 0.1, 7
# Bounds are kept clear of: terms end at this part of the way to one.
CLEAR = 0.95
# An effect is not made larger than so many terms: beyond it would be rigid, and nothing more would be seen.
DOSES = 20.0
# Two meshes that differ by more, m, follow different branches: the body buckles, and its shape is a matter of chance.
BRANCHED = 4e-4
# A smaller effect is none, in units of noise: an obstacle that is not met.
INVISIBLE = 0.05
# Whether a patch is anchored is not asked for where that moves the fiducials by less, in units of noise.
ASKED = 1.0
# A case that cannot be solved, or hides nothing, is drawn anew so often.
ATTEMPTS = 6


def make(folder: Path, index: int, choice: CaseChoice) -> None:
    """Write `scene.toml`, `measurement/` and, apart from them, `truth.json` into the folder of a case; what is there stays.

    Raises:
        SolveError: none of the attempts could be solved.
    """
    if (folder / "measurement").is_dir():
        return
    reasons = []
    for attempt in range(ATTEMPTS):
        case = draw(choice, index, attempt)
        file = shipped(case.body.scene)
        scene = Scene.read(file, physics=check_physics)
        if case.conditions.nuisances:
            mesh = level_mesh(replace(scene, levels=(case.body.coarse,)), case.body.coarse)
            rng = generator(choice.seed, 7, index, attempt)
            case = replace(case, inexact=Inexact.draw(rng, scene, mesh, len(case.motions)))
        if case.conditions.forces:
            felt = Felt.draw(generator(choice.seed, 8, index, attempt), exact=not case.conditions.nuisances)
            case = replace(case, felt=felt)
        try:
            truth = compute(scene, case)
        except SolveError as error:
            reasons.append(str(error))
            continue
        rng = generator(choice.seed, 6, index, attempt)
        times = np.concatenate([action.clock for action in case.actions])
        seen = recorded(scene, case.actions, truth.positions, truth.noise, rng, times, f"hidden study, case {index}")
        if case.felt and truth.wrenches is not None:
            seen = case.felt.measured(seen, truth.wrenches, rng)
        write_whole(folder / "truth.json", json.dumps(truth.to_json(case), indent=1) + "\n")
        write_scene(folder, file, case.conditions, truth.noise)
        # What is known of the noise stands in the scene.
        replace(seen, noise_sigma=None).write(folder / "measurement")
        return
    raise SolveError(
        f"case {index} of seed {choice.seed} could not be made in {ATTEMPTS} attempts: {'; '.join(reasons)}"
    )


@dataclass(frozen=True)
class Truth:
    """What really happens in a case.

    Attributes:
        positions: noise-free (frames, fiducials, 3), m.
        terms: that act.
        sizes: theirs, in units of noise.
        noise: m.
        toggles: by how much it moves the fiducials (RMS, m) whether a patch is anchored; NaN where that cannot be computed.
        stated: the model of the scene.
        wrenches: force (N) and torque (N m) of the gripper, shape (frames, 6), where it feels them.
    """

    positions: Array
    terms: tuple[Term, ...]
    sizes: tuple[float, ...]
    noise: float
    toggles: Mapping[str, float]
    stated: Model
    wrenches: Array | None = None

    def to_json(self, case: Case) -> dict[str, Any]:
        """What the scoring needs to know, without any need of the catalogue."""
        pairs = zip(case.hidden, self.terms, self.sizes, strict=True)
        return {
            "index": case.index,
            "body": case.body.name,
            "conditions": asdict(case.conditions),
            "kind": case.kind,
            "anchored": list(case.anchors),
            "not_asked": [patch for patch, moved in self.toggles.items() if moved < ASKED * self.noise],
            "noise": self.noise,
            "stiffness": case.felt.stiffness if case.felt else None,
            "size": min(self.sizes, default=0.0),
            "effects": [self._effect(hidden, term, size) for hidden, term, size in pairs],
            "toggles": {patch: None if math.isnan(moved) else moved for patch, moved in self.toggles.items()},
            "case": case.to_json(),
        }

    def _effect(self, hidden: Hidden, term: Term, size: float) -> dict[str, Any]:
        parameters = {
            p.name: {
                "value": term.values[p.name],
                "unit": p.unit,
                # JSON has no infinity.
                "neutral": None if p.neutral is None or p.reciprocal else self.stated.neutral(p),
                "role": "amount" if p.neutral is not None else "shape",
                "reciprocal": p.reciprocal,
                "scale": p.scale,
                "period": p.period,
            }
            for p in term.effect.parameters
        }
        names = {"effect": hidden.effect, "outside": hidden.outside, "place": hidden.place}
        return names | {"target": hidden.target, "size": size, "parameters": parameters}


def compute(scene: Scene, case: Case, true: Level | None = None, coarse: Level | None = None) -> Truth:
    """Find the terms on the coarse level, then the positions and the sizes reached on the true one.

    Both levels must agree roughly; those of the body are taken where none are given.

    Raises:
        SolveError: a trajectory cannot be followed, the body buckles, or nothing could be seen of an effect or a patch.
    """
    true, coarse = true or case.body.true, coarse or case.body.coarse
    stated = scene
    for of_truth in (case.felt, case.inexact):
        scene = of_truth.scene(scene) if of_truth else scene
    plain, toggles = _plain(scene, case, coarse)
    case = replace(case, noise=visible(case, toggles))
    terms = tuple(_dose(scene, case, hidden, plain, coarse) for hidden in case.hidden)
    rough, positions = (true_positions(scene, case, level, terms) for level in (coarse, true))
    if rms(rough - positions) > BRANCHED:
        raise SolveError(f"two meshes differ by {rms(rough - positions) * 1e3:.2g} mm: the body buckles")
    sizes = []
    for k in range(len(terms)):
        others = true_positions(scene, case, true, terms[:k] + terms[k + 1 :])
        sizes.append(rms(positions - others) / case.noise)
    noise = quieter(case, sizes)
    sizes = [size * case.noise / noise for size in sizes]
    if sizes and min(sizes) < INVISIBLE:
        raise SolveError(f"a hidden effect moves the fiducials by no more than {INVISIBLE} of the noise")
    seen = case.inexact.seen(stated, positions) if case.inexact else positions
    felt = _wrenches(scene, case, true, terms) if case.felt else None
    return Truth(seen, terms, tuple(sizes), noise, toggles, Model.of(stated), felt)


def _plain(scene: Scene, case: Case, coarse: Level) -> tuple[Array, dict[str, float]]:
    """Positions of the plain body (frames, fiducials, 3), m, and by how much each patch moves them (RMS, m).

    Motions in which it passes an instability are refused: which way it buckles is a matter of chance.
    """
    forward = _forward(scene, case, coarse, ())
    try:
        plain = forward.predict(case.anchors, case.made)
        for t in plain.trajectories:
            if t.status is not Status.CONVERGED or t.halvings or t.factorisations > 4 + t.steps // 2:
                raise SolveError("the plain body passes an instability")
        toggled = {patch: set(case.anchors) ^ {patch} for patch in scene.patches}
        return plain.positions, {
            # Nothing would hold a body without its only anchor.
            patch: rms(forward.predict(sorted(others), case.made).positions - plain.positions) if others else math.nan
            for patch, others in toggled.items()
        }
    finally:
        forward.destroy()


def untold_patches(scene: Scene, case: Case) -> list[str]:
    """Patches that move the fiducials by less than the noise if they are toggled: nobody could tell whether they are anchored.

    None where the plain body passes an instability, and where nothing would hold it.
    """
    try:
        _, toggles = _plain(scene, case, case.body.coarse)
    except SolveError:
        return []
    return [patch for patch, moved in toggles.items() if moved < ASKED * case.noise]


def visible(case: Case, toggles: Mapping[str, float]) -> float:
    """The noise, m, lowered as far as the range of noises allows until it shows of every anchor that it is one.

    Raises:
        SolveError: an anchor cannot be seen.
    """
    moved = min((toggles[patch] for patch in case.anchors if not math.isnan(toggles[patch])), default=math.inf)
    if moved < ASKED * case.quietest:
        raise SolveError(f"one of the anchors moves the fiducials by no more than {moved * 1e3:.2g} mm")
    return min(case.noise, moved / ASKED)


def quieter(case: Case, sizes: Sequence[float]) -> float:
    """The noise, m, lowered where an effect at its bounds falls short of its target, as far as the range of noises allows."""
    reached = [size / hidden.target for size, hidden in zip(sizes, case.hidden, strict=True)]
    short = min([1.0, *reached])
    return case.noise if short > 1 - 2 * NEAR else max(case.quietest, case.noise * short)


def rms(shift: Array) -> float:
    """Root of the mean square over all coordinates and frames."""
    return float(np.sqrt(np.mean(shift**2)))


def halved(action: Action, first_extra: int) -> Action:
    """The action with every step cut in two; the frames between the commanded ones are numbered from `first_extra`."""
    path = poses(action)
    middles = [between(a, b, 0.5) for a, b in pairwise(path)]
    every = [pose for pair in zip(path[:-1], middles, strict=True) for pose in pair] + path[-1:]
    frames = np.empty(len(every), dtype=np.int64)
    frames[::2], frames[1::2] = action.frames, first_extra + np.arange(len(middles))
    steps, numbers = (np.repeat(one, 2)[: len(every)] for one in (action.steps, action.numbered))
    translation, rotation = np.array([p.translation for p in every]), np.array([p.rotation for p in every])
    times = np.array([p.time for p in every])
    made = replace(action, frames=frames, steps=steps, numbers=numbers)
    return replace(made, translation=translation, rotation=rotation, times=times)


def true_positions(scene: Scene, case: Case, level: Level, terms: Sequence[Term]) -> Array:
    """Noise-free positions in the commanded frames (frames, fiducials, 3), m."""
    return _shown(scene, case, level, terms, None)


def _wrenches(scene: Scene, case: Case, level: Level, terms: Sequence[Term]) -> Array:
    """Force (N) and torque (N m) of the gripper in the commanded frames (frames, 6)."""
    scale = ForceScale.of_body(scene)
    return scale.wrenches(_shown(scene, case, level, terms, scale)[:, -ROWS:])


def _shown(scene: Scene, case: Case, level: Level, terms: Sequence[Term], forces: ForceScale | None) -> Array:
    """What is predicted in the commanded frames (frames, rows, 3), m."""
    count = sum(len(action) for action in case.actions)
    actions, extra = [], count
    for action in case.made:
        actions.append(halved(action, extra))
        extra += len(action) - 1
    forward = _forward(scene, case, level, terms, forces)
    try:
        prediction = forward.predict(case.anchors, actions)
    finally:
        forward.destroy()
    if prediction.failure:
        raise SolveError(prediction.failure.reason)
    return prediction.positions[:count]


def _forward(
    scene: Scene, case: Case, level: Level, terms: Sequence[Term], forces: ForceScale | None = None
) -> Forward:
    model = Model.of(scene)
    for term in terms:
        model = model + term
    mesh = case.inexact.mesh(scene, level_mesh(scene, level)) if case.inexact else None
    return Forward(replace(scene, levels=(level,)), 0, model=model, settings=ACCURACY, mesh=mesh, forces=forces)


# -- terms
# ------------------------------------------------------------------------------------------------------------------


def _dose(scene: Scene, case: Case, hidden: Hidden, without: Array, coarse: Level) -> Term:
    model = Model.of(scene)
    most = largest(hidden, model)
    if all(p.switch for p in known(hidden.effect).amounts):
        return term_of(hidden, 1.0, model)
    forward = _forward(scene, case, coarse, (term_of(hidden, min(1.0, most), model),))

    def size(amount: float) -> float | None:
        forward.set_model(model + term_of(hidden, amount, model))
        found = forward.predict(case.anchors, case.made)
        return None if found.failure else rms(found.positions - without) / case.noise

    try:
        return term_of(hidden, search(size, hidden.target, most), model)
    finally:
        forward.destroy()


def known(name: str) -> Effect:
    """An effect of the catalogue or outside it."""
    return outside.EFFECTS[name] if name in outside.EFFECTS else effects.effect(name)


def term_of(hidden: Hidden, amount: float, model: Model) -> Term:
    """`amount` terms of a hidden effect; one term is the weights times the scales of its amounts."""
    effect = known(hidden.effect)
    values = {name: value for name, value in hidden.shapes.items() if name in {p.name for p in effect.shapes}}
    for p in effect.shapes:
        values.setdefault(p.name, p.default if p.default is not None else (*p.scan, p.scale)[0])
    for p in effect.amounts:
        part = amount * _weights(hidden, effect)[p.name]
        neutral = model.neutral(p)
        assert neutral is not None
        values[p.name] = p.scale / part if p.reciprocal else neutral + part * p.scale
    return Term(effect, values, place=hidden.place)


def _weights(hidden: Hidden, effect: Effect) -> Mapping[str, float]:
    """Weights of all amounts: those drawn, else one for the first."""
    names = [p.name for p in effect.amounts]
    drawn = {name: weight for name, weight in hidden.weights.items() if name in names} or {names[0]: 1.0}
    return {name: drawn.get(name, 0.0) for name in names}


def largest(hidden: Hidden, model: Model) -> float:
    """The largest amount that is asked of an effect: every parameter keeps clear of its bounds."""
    effect = known(hidden.effect)
    limits = [DOSES]
    for p in effect.amounts:
        weight, neutral = _weights(hidden, effect)[p.name], model.neutral(p)
        if weight and p.reciprocal and p.lower > 0:
            limits.append(p.scale / p.lower)
        elif weight and not p.reciprocal and neutral is not None:
            room = (p.upper - neutral) if weight > 0 else (neutral - p.lower)
            limits.append(CLEAR * room / (abs(weight) * p.scale))
    return min(limits)


def search(size: Callable[[float], float | None], target: float, most: float) -> float:
    """The amount, at most `most`, whose size is nearest to the target.

    The size grows with the amount, nearly in proportion; an amount without a size (it cannot be solved) is too large.

    Raises:
        SolveError: no amount could be solved.
    """
    amount = min(1.0, most)
    lower: tuple[float, float] = (0.0, 0.0)
    upper: tuple[float, float] | None = None
    best, miss = 0.0, math.inf
    for _ in range(MOST):
        found = size(amount)
        if found is not None and abs(math.log(max(found, 1e-9) / target)) < miss:
            best, miss = amount, abs(math.log(max(found, 1e-9) / target))
        if found is not None and (miss <= NEAR or (found < target and amount >= most)):
            break
        if found is not None and found < target:
            lower = (amount, found)
        else:
            upper = (amount, math.inf if found is None else found)
        amount = _next(lower, upper, target, most)
    if not math.isfinite(miss):
        raise SolveError("no term of the hidden effect could be solved")
    return best


def _next(lower: tuple[float, float], upper: tuple[float, float] | None, target: float, most: float) -> float:
    """The secant's amount in the logarithms where both ends have a size, kept inside the bracket; else a cautious one."""
    (a, s), b = lower, upper
    if b is None:
        return min(most, a * float(np.clip(target / s, 1.3, 10.0)) if s > 1e-6 else 2 * a)
    if a == 0.0:
        return b[0] * (float(np.clip(target / b[1], 0.02, 0.8)) if math.isfinite(b[1]) else 0.3)
    if s <= 1e-6 or not math.isfinite(b[1]):
        return (a + b[0]) / 2
    part = math.log(target / s) / math.log(b[1] / s)
    return float(a * (b[0] / a) ** np.clip(part, 0.1, 0.9))
