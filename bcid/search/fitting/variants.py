"""Every way in which a dormant effect may act: places, directions, first frames, inclusions; each with its sensitivity."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bcid.forms.effects.effect import Effect
from bcid.forms.force_bumps import farthest_point_sample
from bcid.forms.model import Model, Term
from bcid.forms.parameter import Parameter
from bcid.forms.probes import Probe, SensitivityRequest
from bcid.inference.priors import PRIORS
from bcid.search.fitting.ahead import obstacle_candidates
from bcid.search.fitting.fit import Coordinate
from bcid.search.fitting.parameter_priors import visible
from bcid.search.fitting.state import State

Array = NDArray[np.float64]
# Directions are scanned in steps of this size, in degrees, centres of inclusions at so many places, in radii of these sizes.
_DEGREES = 5.0
# Periods are tried in steps of so many cycles per measurement, with every fourth of the directions.
_CYCLE, _COARSER = 0.15, 4
_PLACES = 120
_RADII = (0.1, 0.17, 0.28)
# Times that are off are tried in so many notable ones, in either direction.
_LAGS = (1.0, 3.0, 6.0, 10.0, 15.0, 20.0, 30.0)


@dataclass(frozen=True)
class Variant:
    """An effect at a place, in a direction, from a time on, ... with its sensitivity.

    Attributes:
        term: the effect with its amounts neutral.
        amounts: coordinates of its amounts.
        sensitivity: scaled, per unit of each, shape (n, p).
    """

    term: Term
    amounts: tuple[Coordinate, ...]
    sensitivity: Array


def neutral_values(model: Model, effect: Effect) -> dict[str, float]:
    """Values at which an effect does nothing."""
    values = {}
    for p in effect.parameters:
        neutral = model.neutral(p)
        values[p.name] = neutral if neutral is not None else p.default if p.default is not None else p.scale
    return values


def all_variants(state: State, candidates: Sequence[tuple[Effect, str]]) -> dict[str, list[Variant]]:
    """Every variant of every effect, with its sensitivity; collective."""
    probes: list[Probe] = []
    stiff, loose = [], []
    for effect, place in candidates:
        if effect.around:
            stiff.append(effect)
            continue
        if effect.held or effect.retimed:
            loose.append((effect, place))
            continue
        values = neutral_values(state.model, effect)
        names = tuple(p.name for p in effect.amounts)
        for k, chosen in enumerate(_tried(state, effect)):
            numbers = values | chosen
            base = f"{effect.name}({place})" if place else effect.name
            # What remembers keeps a memory of its own for each time constant.
            label = f"{base}@{k}" if effect.memory else base
            probes.append(Probe(Term(effect, numbers, label, place), names))
    found = state.predictor.sensitivities(
        state.model, state.anchors, state.prediction, SensitivityRequest(tuple(probes), (), bool(stiff))
    )
    result: dict[str, list[Variant]] = {effect.name: [] for effect, _ in candidates}
    for (name, _), group in itertools.groupby(
        zip(probes, found.probes, strict=True), key=lambda pair: (pair[0].effect.name, pair[0].term.place)
    ):
        result[name] += _scaled(state, _expanded(state, list(group)))
    for effect in stiff:
        assert found.stiffness is not None
        result[effect.name] = _inclusions(state, effect, found.stiffness)
    for name, variants in result.items():
        result[name] = variants + [v for one in variants for v in _large(state, one)]
    for effect, place in loose:
        result[effect.name] += _let_go(state, effect, place) if effect.held else _at_other_times(state, effect)
    return result


def _large(state: State, small: Variant) -> list[Variant]:
    """What large amounts of an effect do by their size, where the slope of small ones shows nothing and large ones are tried."""
    found = list[Variant]()
    for column, c in zip(small.sensitivity.T, small.amounts, strict=True):
        if not c.parameter.scan or len(visible(float(np.linalg.norm(column)) * c.scale)):
            continue
        for value in c.parameter.scan:
            term = small.term.with_values({c.parameter.name: value})
            far = state.predictor.predict(state.model + term, state.anchors)
            if not far.failure:
                off = value - small.term.values[c.parameter.name]
                moved = np.asarray((far.positions - state.prediction.positions) / off)
                found.append(_variant(state, small.term, [moved], [c.parameter.name]))
    return _scaled(state, found)


def _at_other_times(state: State, effect: Effect) -> list[Variant]:
    """What is seen was predicted for other times: how far the fiducials are elsewhere then, by the part that is off.

    A motion that turns or ends meanwhile is not linear in its time.
    """
    (amount,) = effect.amounts
    term = Term(effect, neutral_values(state.model, effect))
    offs = [side * many * amount.scale for many in _LAGS for side in (1.0, -1.0)]
    found = [_variant(state, term, [np.asarray(_meanwhile(state, term, off) / off)], [amount.name]) for off in offs]
    return _scaled(state, found)


def _meanwhile(state: State, term: Term, off: float) -> Array:
    """By how much the fiducials are elsewhere when times are so far off (s), (frames, fiducials, 3), m."""
    moved, retimed = np.zeros_like(state.predicted), term.effect.retimed
    assert retimed is not None
    (amount,) = term.effect.amounts
    for action in state.predictor.actions:
        shown = state.predicted[action.frames]
        times = retimed(action.clock, {amount.name: off})
        moved[action.frames] = np.apply_along_axis(_at, 0, shown, times, action.clock) - shown
    return moved


def _at(path: Array, times: Array, clock: Array) -> Array:
    """A path that is known at the times of a clock at others, straight in between."""
    return np.interp(times, clock, path)


def _let_go(state: State, effect: Effect, place: str) -> list[Variant]:
    """A patch that is not held from each frame on: what is seen then is what the other anchors show."""
    moved = _without(state, state.anchors - {place})
    (amount,) = (p.name for p in effect.amounts)
    (onset,) = (p.name for p in effect.shapes)
    probe = Probe(Term(effect, neutral_values(state.model, effect), place=place), (amount,))
    return _scaled(state, _all_onsets(state, probe, {amount: moved}, onset))


def _without(state: State, others: frozenset[str]) -> Array:
    """By how much the fiducials are elsewhere with other anchors, exactly in all steps: a tangent may show another onset."""
    if not state.predictor.thin:
        found = state.predictor.predict(state.model, others)
        if not found.failure:
            return found.positions - state.prediction.positions
    (moved,) = state.predictor.moves(state.model, state.anchors, state.prediction, [others])
    return moved


def _tried(state: State, effect: Effect) -> list[dict[str, float]]:
    """Values of the shapes of an effect that are tried."""
    if effect.ahead:
        return obstacle_candidates(state)
    scans = [p for p in effect.shapes if p.scan]
    return [
        {p.name: float(v) for p, v in zip(scans, chosen, strict=True)}
        for chosen in itertools.product(*(p.scan for p in scans))
    ]


def _variant(state: State, term: Term, arrays: Sequence[Array], names: Sequence[str]) -> Variant:
    """A variant whose sensitivity is not scaled yet."""
    raw = np.column_stack([state.predictor.data.vector(array) for array in arrays])
    plain = Term(term.effect, term.values, place=term.place)
    return Variant(plain, tuple(amounts(plain, names)), np.nan_to_num(raw))


def _scaled(state: State, variants: Sequence[Variant]) -> list[Variant]:
    """Variants with scaled sensitivities, all at once."""
    if not variants:
        return []
    scaled = state.errors.whiten(np.hstack([v.sensitivity for v in variants]))
    ends = np.cumsum([v.sensitivity.shape[1] for v in variants])[:-1]
    return [replace(v, sensitivity=part) for v, part in zip(variants, np.split(scaled, ends, axis=1), strict=True)]


def amounts(term: Term, names: Sequence[str]) -> list[Coordinate]:
    """Coordinates of amounts of an effect."""
    parameters = {p.name: p for p in term.effect.parameters}
    return [Coordinate.of_parameter(term.full(name), parameters[name]) for name in names]


def _expanded(state: State, group: Sequence[tuple[Probe, dict[str, Array]]]) -> list[Variant]:
    """From the probed directions to all directions, and from the first frame to every frame on which it may begin."""
    probe = group[0][0]
    effect = probe.effect
    angle = next((p for p in effect.shapes if p.period and p.harmonics is not None), None)
    variants = _all_directions(state, group, angle) if angle is not None else []
    period = next((p for p in effect.shapes if p.off is not None), None)
    if period is not None and effect.acting:
        variants += [v for one in variants[::_COARSER] for v in _all_periods(state, one, period)]
    if variants:
        return variants
    onset = next((p.name for p in effect.shapes if p.onset), None)
    if onset is not None:
        return [v for pair in group for v in _all_onsets(state, *pair, onset)]
    return [_variant(state, p.term, [arrays[n] for n in p.wanted], p.wanted) for p, arrays in group]


def _all_directions(state: State, group: Sequence[tuple[Probe, dict[str, Array]]], angle: Parameter) -> list[Variant]:
    """Trigonometric interpolation in a direction: exact up to the declared harmonic."""
    assert angle.period is not None
    assert angle.harmonics is not None
    others: dict[tuple[float, ...], list[tuple[Probe, dict[str, Array]]]] = {}
    for pair in group:
        key = tuple(v for name, v in pair[0].term.values.items() if name != angle.name)
        others.setdefault(key, []).append(pair)
    grid = np.arange(0.0, angle.period, _DEGREES)
    found = []
    for members in others.values():
        at = np.array([probe.term.values[angle.name] for probe, _ in members])
        weights = _harmonics(grid, angle.period, angle.harmonics) @ np.linalg.pinv(
            _harmonics(at, angle.period, angle.harmonics)
        )
        probe = members[0][0]
        stacks = {name: np.array([arrays[name] for _, arrays in members]) for name in probe.wanted}
        for direction, weight in zip(grid, weights, strict=True):
            term = probe.term.with_values({angle.name: float(direction)})
            arrays = [np.tensordot(weight, stacks[name], axes=1) for name in probe.wanted]
            found.append(_variant(state, term, arrays, probe.wanted))
    return found


def _all_periods(state: State, steady: Variant, period: Parameter) -> list[Variant]:
    """An effect that comes and goes: the part of its amounts that acts, times what it does when it is steady."""
    effect, data = steady.term.effect, state.predictor.data
    times, frames = np.unique(state.predictor.times, return_inverse=True)
    found = []
    # Two frequencies are told apart when they are out of step at the end.
    for cycles in np.arange(*PRIORS.cycles, _CYCLE) if np.ptp(times) > 0 else ():
        term = steady.term.with_values({period.name: float(times.max() / cycles)})
        share = np.array(
            [[effect.slopes(p.name, float(t), term.values).get(p.name, 0.0) for p in effect.amounts] for t in times]
        )
        found.append(replace(steady, term=term, sensitivity=steady.sensitivity * share[frames[data.frame]]))
    return found


def _harmonics(degrees: NDArray[np.floating], period: float, highest: int) -> Array:
    phase = 2 * math.pi * degrees / period
    return np.column_stack(
        [np.ones(len(degrees))] + [f(k * phase) for k in range(1, highest + 1) for f in (np.cos, np.sin)]
    )


def _all_onsets(state: State, probe: Probe, arrays: dict[str, Array], name: str) -> list[Variant]:
    """The effect from each frame on."""
    frames = len(state.predictor.data.mask)
    found = []
    for first in range(frames):
        later = [np.where((np.arange(frames) >= first)[:, None, None], arrays[n], 0.0) for n in probe.wanted]
        term = probe.term.with_values({name: float(state.predictor.numbers[first])})
        found.append(_variant(state, term, later, probe.wanted))
    return found


def _inclusions(state: State, effect: Effect, stiffness: NDArray[np.float32]) -> list[Variant]:
    """Round inclusions everywhere in the body, from the influence of every cell's stiffness."""
    forward = state.predictor.forward(state.model)
    points, cells = forward.mesh.points, forward.mesh.cells
    original = np.asarray(forward.body.domain.topology.original_cell_index)[: stiffness.shape[-1]]
    middles = points[cells].mean(axis=1)[original]
    size = float(np.linalg.norm(np.ptp(points, axis=0)))
    assert effect.around is not None
    values = neutral_values(state.model, effect)
    amount = effect.amounts[0].name
    terms = []
    for centre in farthest_point_sample(middles, _PLACES):
        for part in _RADII:
            place = dict(zip(("cx", "cy", "cz"), map(float, centre), strict=True)) | {"radius": part * size}
            terms.append(Term(effect, values | place))
    inside = np.column_stack([effect.around(middles, term.values) for term in terms])
    # The places first: there are fewer of them than cells.
    moved = state.predictor.data.vector(np.tensordot(stiffness, inside.astype(np.float32), axes=1)).astype(float)
    columns = state.errors.whiten(moved)
    return [
        Variant(term, tuple(amounts(term, [amount])), column[:, None])
        for term, column in zip(terms, columns.T, strict=True)
    ]
