"""What to do next: what would most help to tell which anchors hold the body and which effects act, in bits of expected information.

A number of the scene and a repeat of the pulls are evaluated with all columns of equation (1). A pull, a force sensor and further
markers are not: how much of what separates hypotheses these columns would cover is taken to be as in the measured pulls.
What needs many solves is left out: other postures, and a search for the best pull.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from bcid.base.collective import overlaid
from bcid.inference.hypotheses import Hypothesis, entropy
from bcid.inference.information import information
from bcid.inference.nuisance_text import amount
from bcid.inference.priors import PRIORS
from bcid.results.diagnosis_record import NextStep, SeparatingPull
from bcid.results.words import pull_text
from bcid.search.answer.explanation import Explanation
from bcid.search.answer.scene_sensitivity import SceneInput, WeighedHypothesis
from bcid.search.fitting.state import State
from bcid.search.settings import SETTINGS

Array = NDArray[np.float64]
# Draws of a measurement, and their seed.
_SAMPLES, _SEED = 2000, 1
# Nodes of a coarse grid over a number of the scene, and about its mean under each hypothesis, in standard deviations.
_COARSE: Array = np.linspace(-6.0, 6.0, 49, dtype=float)
_FINE: Array = np.linspace(-5.0, 5.0, 41, dtype=float)
# Places on the surface that are compared, and the most markers to add.
_PLACES, _MARKERS = 200, 3


@dataclass(frozen=True)
class NextSteps:
    """What is open, and what would tell.

    Attributes:
        open: entropy of anchors and effects, bits.
        steps: the most informative first; none where nothing helps.
    """

    open: float
    steps: tuple[NextStep, ...]


@dataclass(frozen=True)
class BodyPrediction:
    """What a hypothesis predicts besides the markers.

    Attributes:
        displacement: of the nodes of the mesh, shape (frames, nodes, 3), m.
        wrench: force and torque of the gripper, shape (frames, 6), N and N m.
    """

    displacement: Array
    wrench: Array


def next_steps(
    found: Explanation, fitted: Sequence[WeighedHypothesis], pulls: Sequence[SeparatingPull] = ()
) -> NextSteps | None:
    """The ranked list; None where the answer is certain. Collective.

    Args:
        found: the explanation.
        fitted: its hypotheses that were fitted to all steps.
        pulls: that separate the last model from the next best, the most telling first.
    """
    if not found.open or not fitted:
        return None
    kept, p = leading(fitted)
    steps, left = [], entropy(p) + 0.0
    if len(kept) > 1:
        inputs = dict.fromkeys(one for each in kept for one in each.inputs)
        steps += [_number(one, kept, p) for one in inputs]
        steps.append(NextStep(kind="repeat", text="make the same pulls once more", expected_bits=repeated(kept, p)))
        steps += predicted(found, kept, p, pulls)
    useful = [
        replace(s, expected_bits=min(s.expected_bits, left)) for s in steps if s.expected_bits >= SETTINGS.helping
    ]
    return NextSteps(left, tuple(sorted(useful, key=lambda step: -step.expected_bits)))


def leading(fitted: Sequence[WeighedHypothesis]) -> tuple[list[WeighedHypothesis], Array]:
    """Anchors and effects that count, each by the likeliest fit, and their probabilities (hypotheses,), which sum to one.

    Whether or not something unknown acts besides.
    """
    logs = np.array([logsumexp([v[0] for v in one.logs().values()]) for one in fitted])
    shares = np.exp(logs - logsumexp(logs))
    best: dict[Hypothesis, int] = {}
    total: dict[Hypothesis, float] = {}
    for k in np.argsort(-shares, kind="stable"):
        best.setdefault(fitted[k].reported, int(k))
        total[fitted[k].reported] = total.get(fitted[k].reported, 0.0) + float(shares[k])
    kept = [h for h in best if total[h] > SETTINGS.counting]
    p = np.array([total[h] for h in kept])
    return [fitted[best[h]] for h in kept], np.asarray(p / p.sum())


# -- with all columns
# --------------------------------------------------------------------------------------------------------------


def _number(one: SceneInput, fitted: Sequence[WeighedHypothesis], p: Array) -> NextStep:
    text = f"measure: {one.label} (now known to {amount(one.name, one.stddev)})"
    return NextStep(kind="number", text=text, expected_bits=number_information(one, fitted, p))


def number_information(one: SceneInput, fitted: Sequence[WeighedHypothesis], p: Array) -> float:
    """Bits that an input of the scene is expected to tell where it is measured exactly.

    Given the data it has under each hypothesis the density p(v | d, h) = N(v; 0, 1) Z_h(v) / Z_h, which is integrated on a grid.

    Args:
        one: the input.
        fitted: the hypotheses.
        p: their probabilities, shape (hypotheses,).
    """
    logs = _densities(one, fitted, _COARSE)
    fine = [np.asarray(mean + sd * _FINE) for mean, sd in map(_about, logs)]
    nodes: Array = np.unique(np.concatenate([_COARSE, *fine]))
    weights = np.gradient(nodes)
    logs = _densities(one, fitted, nodes) + np.log(weights)
    shares = np.exp(logs - logsumexp(logs, axis=1, keepdims=True))
    mixture = p @ shares
    with np.errstate(divide="ignore", invalid="ignore"):
        gains = np.where(shares > 0, shares * np.log2(shares / mixture), 0.0)
    return max(float(p @ gains.sum(axis=1)), 0.0)


def _densities(one: SceneInput, fitted: Sequence[WeighedHypothesis], nodes: Array) -> Array:
    """Logarithms of the density of an input under each hypothesis, up to a constant of each: shape (hypotheses, nodes)."""
    each = [logsumexp(list(h.logs(one, nodes).values()), axis=0) for h in fitted]
    return np.array(each) - 0.5 * nodes**2


def _about(logs: Array) -> tuple[float, float]:
    """Mean and standard deviation of a density on the coarse grid, from a parabola through its three largest nodes."""
    k = int(np.clip(np.argmax(logs), 1, len(logs) - 2))
    step = _COARSE[1] - _COARSE[0]
    slope, bend = (logs[k + 1] - logs[k - 1]) / 2, logs[k + 1] - 2 * logs[k] + logs[k - 1]
    bend = min(bend, -(step**2))
    return float(_COARSE[k] - step * slope / bend), float(step / math.sqrt(-bend))


def repeated(fitted: Sequence[WeighedHypothesis], p: Array) -> float:
    """Bits that the same pulls are expected to tell once more, with fresh noise and all else as it is.

    Given the data d a repeat is d - S C^-1 r with covariance 2 S - S C^-1 S, for noise S, covariance C and residual r. It is
    compared along the differences of these means, and those as the inverse covariance sees them.
    """
    each = [_Repeat(one) for one in fitted]
    means = np.array([one.mean for one in each])
    apart = (means - means[0])[1:]
    basis = np.linalg.svd(np.vstack([apart, *(one.seen(apart.T).T for one in each)]).T, full_matrices=False)
    along = basis[0][:, basis[1] > 1e-9 * max(float(basis[1][0]), 1e-300)]
    if not along.size:
        return 0.0
    loose = [_root(np.eye(along.shape[1]) - along.T @ one.seen(along)) for one in each]
    return information(means @ along, p, _SAMPLES, _SEED, loose).bits


def _root(square: Array) -> Array:
    """Rows with this product, none of it negative."""
    values, vectors = np.linalg.eigh((square + square.T) / 2)
    return np.asarray((vectors * np.sqrt(np.maximum(values, 0.0))).T)


class _Repeat:
    """A repeat of the measurement under a hypothesis, in units of the noise.

    Its fitted numbers have the middle one of the widths that they may have; a discrepancy that is likelier than none is a part of
    the covariance.

    Attributes:
        mean: minus what is expected of it beyond the data, shape (n,).
    """

    def __init__(self, one: WeighedHypothesis) -> None:
        state, numbers = one.rival.judged, one.numbers
        self.errors, width = state.errors, numbers.widths[len(numbers.widths) // 2]
        columns = [numbers.columns * width]
        if not one.rival.complete:
            unknown = state.unknown.likeliest(state.predictor.data, one.rival.evidence)
            columns.append(self.errors.whiten(unknown))
        self.whitened = np.hstack(columns)
        self.inverse = np.linalg.inv(np.eye(self.whitened.shape[1]) + self.whitened.T @ self.whitened)
        scaled = state.scaled + numbers.columns @ numbers.apart
        self.mean = -self._weighed(scaled)

    def _weighed(self, scaled: Array) -> Array:
        """Of what is whitened, (n,) or (n, m), the product with the noise and the inverse of the covariance."""
        return self.errors.weighed(scaled - self.whitened @ (self.inverse @ (self.whitened.T @ scaled)))

    def seen(self, values: Array) -> Array:
        """S^1/2 C^-1 S^1/2 times columns (n, m)."""
        return self._weighed(self.errors.whiten(values * self.errors.sigma[:, None]))


# -- with what the columns cover in the measured pulls
# --------------------------------------------------------------------------------------------------------------


def uncovered(fitted: Sequence[WeighedHypothesis], p: Array) -> float:
    """Which part of what separates hypotheses in the measured pulls, in units of the noise, other errors do not cover (0 to 1)."""
    first = fitted[int(np.argmax(p))].rival.judged
    shown = np.array([first.predictor.data.vector(one.rival.judged.predicted) for one in fitted])
    apart = (shown - p @ shown).T * np.sqrt(p)
    whole = float(np.sum((apart / first.errors.sigma[:, None]) ** 2))
    return math.sqrt(float(np.sum(first.errors.whiten(apart) ** 2)) / whole) if whole > 0 else 0.0


def predicted(
    found: Explanation, fitted: Sequence[WeighedHypothesis], p: Array, pulls: Sequence[SeparatingPull]
) -> list[NextStep]:
    """A pull, a force sensor and further markers; collective."""
    part = uncovered(fitted, p)
    steps = _pull(found, fitted, p, part, pulls)
    fields = [_field(one) for one in fitted]
    state = fitted[int(np.argmax(p))].rival.judged
    if state.predictor.data.forces is None and any(action.grasp for action in state.predictor.actions):
        wrenches = [field.wrench[:, :3] for field in fields]
        bits = force_information(np.array(wrenches), p, part, _stiffness(fitted))
        steps.append(NextStep(kind="force", text="measure the gripper's force", expected_bits=bits))
    return steps + _markers(fitted, p, part, fields)


def _pull(
    found: Explanation, fitted: Sequence[WeighedHypothesis], p: Array, part: float, pulls: Sequence[SeparatingPull]
) -> list[NextStep]:
    """The first of some pulls that separate the last model from the next best: others count as that which they resemble less."""
    last = next((r.hypothesis for r in found.rivals if r.fitted.state is found.last.state), None)
    own = [k for k, one in enumerate(fitted) if one.reported == last]
    others = [k for k in range(len(fitted)) if k not in own]
    if not (pulls and own and others):
        return []
    both = np.array([p[own[0]], p[others].max()])
    apart = np.array([[0.0], [part * pulls[0].sigmas]])
    bits = float(both.sum()) * information(apart, both / both.sum(), _SAMPLES, _SEED).bits
    return [NextStep(kind="pull", text=f"pull {pull_text(pulls[0])}", expected_bits=bits)]


def _field(one: WeighedHypothesis) -> BodyPrediction:
    """What a hypothesis predicts of the whole body, from the states of its prediction; collective."""
    state = one.rival.fitted.state
    predictor, forward = state.predictor, state.predictor.forward(state.model)
    frames = len(predictor.data.mask)
    displacement = np.full((frames, len(forward.mesh.points), 3), np.nan)
    wrench = np.full((frames, 6), np.nan)
    for action in predictor.actions:
        part = state.prediction.parts.get(action.name)
        if part is not None and part.states is not None:
            detailed = forward.detail(state.anchors, [action], part)
            assert detailed.displacement is not None
            assert detailed.wrench is not None
            displacement[action.frames] = detailed.displacement[action.frames]
            wrench[action.frames] = detailed.wrench[action.frames]
    both = (overlaid(predictor.comm.allgather(values)) for values in (displacement, wrench))
    return BodyPrediction(*both)


def _stiffness(fitted: Sequence[WeighedHypothesis]) -> float:
    """Relative standard deviation of the stiffness of the body."""
    scene = fitted[0].rival.fitted.state.predictor.scene
    return float(scene.uncertainty.of(1.0).stiffness or 0.0)


def force_information(forces: Array, p: Array, part: float, stiffness: float) -> float:
    """Bits that the gripper's force is expected to tell.

    Args:
        forces: that hypotheses predict, shape (hypotheses, frames, 3), N; NaN in frames that are not predicted.
        p: probabilities of the hypotheses.
        part: of what separates them that other errors do not cover.
        stiffness: relative standard deviation of all forces together.
    """
    shown: Array = np.nan_to_num(forces).reshape(len(forces), -1)
    noise = PRIORS.force_sensor * float(np.abs(shown).max(initial=0.0))
    if noise <= 0:
        return 0.0
    shown = np.asarray(shown / noise)
    # All forces are larger by one factor: that may make hypotheses alike, however much else is known.
    return information(part * shown, p, _SAMPLES, _SEED, [part * stiffness * row[None] for row in shown]).bits


def _markers(
    fitted: Sequence[WeighedHypothesis], p: Array, part: float, fields: Sequence[BodyPrediction]
) -> list[NextStep]:
    """The best place for one marker more, and the best for three, one after the other."""
    state = fitted[int(np.argmax(p))].rival.judged
    nodes = _free_surface(state)
    points = state.predictor.forward(state.model).mesh.points
    if not len(nodes) or any(len(field.displacement[0]) != len(points) for field in fields):
        return []
    shown = np.array([np.nan_to_num(field.displacement[:, nodes]) for field in fields]) * (part / state.noise)
    chosen, bits = best_places(np.moveaxis(shown, 2, 1).reshape(len(fields), len(nodes), -1), p)
    places = [tuple(float(v) for v in points[nodes[k]]) for k in chosen]
    texts = [f"({' '.join(f'{round(1e3 * v)}' for v in place)}) mm" for place in places]
    kept = [1, _MARKERS] if len(places) == _MARKERS else [1]
    return [
        NextStep(
            kind="markers",
            text=f"{'a marker' if n == 1 else 'markers'} at {', '.join(texts[:n])}",
            expected_bits=bits[n - 1],
            positions=tuple(places[:n]),
        )
        for n in kept
    ]


def best_places(shown: Array, p: Array) -> tuple[list[int], list[float]]:
    """Places that tell most, chosen one after the other, and the bits that they tell together.

    Args:
        shown: that hypotheses predict at places, in units of the noise, shape (hypotheses, places, values).
        p: probabilities of the hypotheses.
    """
    chosen: list[int] = []
    bits: list[float] = []
    for _ in range(min(_MARKERS, shown.shape[1])):
        rest = [k for k in range(shown.shape[1]) if k not in chosen]
        gains = [information(shown[:, [*chosen, k]].reshape(len(p), -1), p, _SAMPLES // 4, _SEED).bits for k in rest]
        chosen.append(rest[int(np.argmax(gains))])
        bits.append(max(gains))
    return chosen, bits


def _free_surface(state: State) -> NDArray[np.int64]:
    """Nodes of the surface where a marker can sit, spread over it: not on a patch or a grasp."""
    predictor = state.predictor
    mesh, scene = predictor.forward(state.model).mesh, predictor.scene
    taken = [mesh.select(region, f"patch {name}") for name, region in scene.patches.items()]
    taken += [mesh.select(grasp.region, f"grasp {name}") for name, grasp in scene.grasps.items()]
    covered = np.concatenate([np.unique(part) for part in taken])
    nodes = np.setdiff1d(np.unique(mesh.boundary), covered)
    return nodes if len(nodes) <= _PLACES else nodes[np.linspace(0, len(nodes) - 1, _PLACES).astype(int)]
