"""Which effect is missing? Every dormant effect ranked by what its signature explains of the residual, before any refit."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear
from scipy.stats import chi2, ncx2

from bcid.compare.fit import Coordinate, columns, coordinates
from bcid.compare.state import State
from bcid.errors import InputError
from bcid.forms import effects
from bcid.forms.effects.effect import Effect
from bcid.forms.model import Dose, Model
from bcid.forms.parameter import Parameter
from bcid.forms.sensitivity import Probe, Wanted

Array = NDArray[np.float64]
# Directions are scanned in steps of this size, in degrees, centres of inclusions at so many places, in radii of these sizes.
_DEGREES = 5.0
_PLACES = 120
_RADII = (0.1, 0.17, 0.28)
_SMOOTH = 0.1
# What two explanations leave different must exceed this (chi-square) for them to be told apart.
_TELLING = 9.0
# A refit of what the model has already must not gain more than this (chi-square, and part of it).
_OPTIMUM = 9.0, 0.02
# A name is believed at this probability of a chance, all tries counted.
SIGNIFICANT = 0.01


@dataclass(frozen=True)
class Variant:
    """An effect at a place, in a direction, from a time on, ... with its signature.

    Attributes:
        dose: the effect with its amounts neutral.
        amounts: coordinates of its amounts.
        signature: scaled, per unit of each, shape (n, p).
    """

    dose: Dose
    amounts: tuple[Coordinate, ...]
    signature: Array


@dataclass(frozen=True)
class Row:
    """What a dormant effect would explain.

    Attributes:
        effect: its name.
        dose: its best variant with the expected values.
        stderr: standard error of each amount, by parameter.
        score: expected fall of chi-square.
        freedom: number of amounts.
        p_value: that chance explains as much, all variants of all effects counted.
        expected_rms: RMS residual once it is added, m.
        power: probability that a notable amount of it would show in these data.
        identifiable: whether the data tell its amounts at all.
        confounded_with: effects that explain the same.
        explained: what it explains of the scaled residual, shape (n,).
        tried: variants tried.
    """

    effect: str
    dose: Dose
    stderr: dict[str, float]
    score: float
    freedom: int
    p_value: float
    expected_rms: float
    power: float
    identifiable: bool
    explained: Array
    tried: int
    confounded_with: tuple[str, ...] = ()


@dataclass(frozen=True)
class Ranking:
    """All dormant effects, the one that explains most first.

    Attributes:
        rows: the effects.
        excluded: effects that cannot act here, with the reason in words.
        tried: number of variants tried over all effects.
        cost: time of the signatures in units of a forward trajectory is told by the caller.
    """

    rows: tuple[Row, ...]
    excluded: dict[str, str] = field(default_factory=dict)
    tried: int = 0


def rank(state: State, more: Iterable[Effect] = (), only: Sequence[str] | None = None, strict: bool = True) -> Ranking:
    """Rank all effects that the model lacks; collective.

    Args:
        state: the model at its optimum.
        more: effects beyond the catalogue.
        only: names of the effects to look at; all by default.
        strict: refuse a model that is not at its optimum (what a refit of it could explain is projected out anyway).

    Raises:
        InputError: the model is not at its optimum: what a refit explains would be taken for a missing effect.
    """
    present = present_columns(state)
    if strict:
        check_optimum(state, present)
    candidates, excluded = dormant(state.model, state, more, only)
    variants = _variants(state, candidates)
    basis = _orthonormal(present)
    tried = max(sum(_effective(v) for v in variants.values()), 1)
    rows = [_row(state, name, found, basis, tried) for name, found in variants.items() if found]
    rows.sort(key=lambda row: (-(row.score - 2 * row.freedom), row.effect))
    return Ranking(tuple(_confusions(rows)), excluded, tried)


def dormant(
    model: Model, state: State, more: Iterable[Effect] = (), only: Sequence[str] | None = None
) -> tuple[list[tuple[Effect, str]], dict[str, str]]:
    """Effects and places that the model lacks, and those that cannot act in this scene and measurement, with the reason."""
    known = [effects.effect(name) for name in effects.names()] + list(more)
    found, excluded = [], {}
    measurement, scene = state.twin.measurement, state.twin.scene
    for effect in known:
        if only is not None and effect.name not in only:
            continue
        reason = effect.needs(scene, measurement) if effect.needs else ""
        if reason:
            excluded[effect.name] = reason
            continue
        own = [dose for dose in model.doses if dose.effect.name == effect.name]
        if not effect.places:
            if not own:
                found.append((effect, ""))
            elif effect.name in ("fibres", "inclusion", "active_stress"):
                continue
            continue
        taken = {dose.place for dose in own}
        if taken and ("" in effect.places(scene, state.anchors)):
            # What acts everywhere already includes its places.
            continue
        found += [(effect, place) for place in effect.places(scene, state.anchors) if place not in taken]
    return found, excluded


def present_columns(state: State) -> Array:
    """Scaled signatures of what the model has fitted already, shape (n, p); collective."""
    if not state.free:
        return np.zeros((len(state.twin.data), 0))
    chosen = coordinates(state.model, state.free)
    raw = columns(state.twin, state.model, state.anchors, state.reply, chosen)
    return state.errors.whiten(raw * np.array([c.scale for c in chosen]))


def check_optimum(state: State, present: Array) -> None:
    """Refuse a model whose fitted numbers a refit would change noticeably."""
    if present.shape[1] == 0:
        return
    numbers = state.model.constants()
    chosen = coordinates(state.model, state.free)
    inner = []
    for c in chosen:
        at, (lower, upper) = c.of(numbers[c.name]), c.bounds
        inner.append(min(at - lower, upper - at) > 1e-3 * c.scale)
    basis, scaled = _orthonormal(present[:, inner]), state.scaled
    gain = float(np.sum((basis.T @ scaled) ** 2))
    if gain > max(_OPTIMUM[0], _OPTIMUM[1] * float(scaled @ scaled)):
        raise InputError(
            f"the model {state.model.name} is not at its optimum: refitting {', '.join(state.free)} alone would lower "
            f"chi-square by {gain:.0f} of {scaled @ scaled:.0f}, and a missing effect would be taken for that; fit it first"
        )


# -- variants
# ------------------------------------------------------------------------------------------------------------------


def neutral_values(model: Model, effect: Effect) -> dict[str, float]:
    """Values at which an effect does nothing."""
    values = {}
    for p in effect.parameters:
        neutral = model.neutral(p)
        values[p.name] = neutral if neutral is not None else p.default if p.default is not None else p.typical
    return values


def _variants(state: State, candidates: Sequence[tuple[Effect, str]]) -> dict[str, list[Variant]]:
    """Every variant of every effect, with its signature; collective."""
    probes: list[Probe] = []
    stiff = []
    for effect, place in candidates:
        if _is_inclusion(effect):
            stiff.append(effect)
            continue
        values = neutral_values(state.model, effect)
        names = tuple(p.name for p in effect.amounts)
        scans = [p for p in effect.shapes if p.scan]
        for k, chosen in enumerate(itertools.product(*(p.scan for p in scans))):
            numbers = values | {p.name: float(v) for p, v in zip(scans, chosen, strict=True)}
            base = f"{effect.name}({place})" if place else effect.name
            # What remembers keeps a memory of its own for each time constant.
            label = f"{base}@{k}" if effect.memory else base
            probes.append(Probe(Dose(effect, numbers, label, place), names))
    found = state.twin.signatures(state.model, state.anchors, state.reply, Wanted(tuple(probes), {}, bool(stiff)))
    result: dict[str, list[Variant]] = {effect.name: [] for effect, _ in candidates}
    for (name, _), group in itertools.groupby(
        zip(probes, found.probes, strict=True), key=lambda pair: (pair[0].effect.name, pair[0].dose.place)
    ):
        result[name] += _scaled(state, _expanded(state, list(group)))
    for effect in stiff:
        assert found.stiffness is not None
        result[effect.name] = _inclusions(state, effect, found.stiffness)
    return result


def _is_inclusion(effect: Effect) -> bool:
    return {"cx", "cy", "cz", "radius"} <= {p.name for p in effect.shapes}


def _variant(state: State, dose: Dose, arrays: Sequence[Array], names: Sequence[str]) -> Variant:
    """A variant whose signature is not scaled yet."""
    raw = np.column_stack([state.twin.data.vector(array) for array in arrays])
    plain = Dose(dose.effect, dose.values, place=dose.place)
    return Variant(plain, tuple(amounts(plain, names)), np.nan_to_num(raw))


def _scaled(state: State, variants: Sequence[Variant]) -> list[Variant]:
    """Variants with scaled signatures, all at once."""
    if not variants:
        return []
    scaled = state.errors.whiten(np.hstack([v.signature for v in variants]))
    ends = np.cumsum([v.signature.shape[1] for v in variants])[:-1]
    return [replace(v, signature=part) for v, part in zip(variants, np.split(scaled, ends, axis=1), strict=True)]


def amounts(dose: Dose, names: Sequence[str]) -> list[Coordinate]:
    """Coordinates of amounts of an effect."""
    parameters = {p.name: p for p in dose.effect.parameters}
    return [_amount(dose, parameters[name]) for name in names]


def _amount(dose: Dose, p: Parameter) -> Coordinate:
    return Coordinate(dose.full(p.name), p, 1 / p.typical if p.reciprocal else p.typical)


def _expanded(state: State, group: Sequence[tuple[Probe, dict[str, Array]]]) -> list[Variant]:
    """From the probed directions to all directions, and from the first frame to every frame on which it may begin."""
    probe = group[0][0]
    effect = probe.effect
    angle = next((p for p in effect.shapes if p.period and p.harmonics is not None), None)
    if angle is not None:
        return _all_directions(state, group, angle)
    if any(p.name == "onset" for p in effect.shapes):
        return [v for pair in group for v in _all_onsets(state, *pair)]
    return [_variant(state, p.dose, [arrays[n] for n in p.wanted], p.wanted) for p, arrays in group]


def _all_directions(state: State, group: Sequence[tuple[Probe, dict[str, Array]]], angle: Parameter) -> list[Variant]:
    """Trigonometric interpolation in a direction: exact up to the declared harmonic."""
    assert angle.period is not None
    assert angle.harmonics is not None
    others: dict[tuple[float, ...], list[tuple[Probe, dict[str, Array]]]] = {}
    for pair in group:
        key = tuple(v for name, v in pair[0].dose.values.items() if name != angle.name)
        others.setdefault(key, []).append(pair)
    grid = np.arange(0.0, angle.period, _DEGREES)
    found = []
    for members in others.values():
        at = np.array([probe.dose.values[angle.name] for probe, _ in members])
        weights = _harmonics(grid, angle.period, angle.harmonics) @ np.linalg.pinv(
            _harmonics(at, angle.period, angle.harmonics)
        )
        probe = members[0][0]
        stacks = {name: np.array([arrays[name] for _, arrays in members]) for name in probe.wanted}
        for direction, weight in zip(grid, weights, strict=True):
            dose = probe.dose.with_values({angle.name: float(direction)})
            arrays = [np.tensordot(weight, stacks[name], axes=1) for name in probe.wanted]
            found.append(_variant(state, dose, arrays, probe.wanted))
    return found


def _harmonics(degrees: NDArray[np.floating], period: float, highest: int) -> Array:
    phase = 2 * math.pi * degrees / period
    return np.column_stack(
        [np.ones(len(degrees))] + [f(k * phase) for k in range(1, highest + 1) for f in (np.cos, np.sin)]
    )


def _all_onsets(state: State, probe: Probe, arrays: dict[str, Array]) -> list[Variant]:
    """The effect from each frame on."""
    frames = len(state.twin.data.mask)
    found = []
    for onset in range(frames):
        later = [np.where((np.arange(frames) >= onset)[:, None, None], arrays[n], 0.0) for n in probe.wanted]
        dose = probe.dose.with_values({"onset": float(onset)})
        found.append(_variant(state, dose, later, probe.wanted))
    return found


def _inclusions(state: State, effect: Effect, stiffness: NDArray[np.float32]) -> list[Variant]:
    """Round inclusions everywhere in the body, from the influence of every cell's stiffness."""
    forward = state.twin.forward(state.model)
    points, cells = forward.mesh.points, forward.mesh.cells
    original = np.asarray(forward.body.domain.topology.original_cell_index)[: stiffness.shape[-1]]
    middles = points[cells].mean(axis=1)[original]
    size = float(np.linalg.norm(np.ptp(points, axis=0)))
    columns = state.errors.whiten(stiffness[state.twin.data.mask].astype(float))
    found = []
    values = neutral_values(state.model, effect)
    amount = effect.amounts[0].name
    for centre in _spread(middles, _PLACES):
        for part in _RADII:
            radius = part * size
            beyond = (np.linalg.norm(middles - centre, axis=1) - radius) / (_SMOOTH * radius)
            inside = (1 - np.tanh(beyond / 2)) / 2
            x, y, z = (float(v) for v in centre)
            dose = Dose(effect, values | {"cx": x, "cy": y, "cz": z, "radius": radius})
            found.append(Variant(dose, tuple(amounts(dose, [amount])), (columns @ inside)[:, None]))
    return found


def _spread(points: Array, count: int) -> Array:
    """Points far from each other: each the farthest from those before it."""
    chosen = [int(np.argmin(np.linalg.norm(points - points.mean(axis=0), axis=1)))]
    distance = np.linalg.norm(points - points[chosen[0]], axis=1)
    while len(chosen) < min(count, len(points)):
        chosen.append(int(distance.argmax()))
        distance = np.minimum(distance, np.linalg.norm(points - points[chosen[-1]], axis=1))
    return np.asarray(points[chosen])


# -- scores
# --------------------------------------------------------------------------------------------------------------------


def _orthonormal(columns: Array) -> Array:
    """Orthonormal basis of the columns."""
    if columns.shape[1] == 0:
        return columns
    basis, sizes, _ = np.linalg.svd(columns, full_matrices=False)
    return np.asarray(basis[:, sizes > 1e-8 * max(sizes.max(initial=0.0), 1e-300)])


def _effective(variants: Sequence[Variant]) -> int:
    """How many independent tries a scan is worth: the dimension of what its signatures span."""
    if len(variants) < 2:
        return len(variants)
    if len(variants) > 60:
        return len(variants)
    stacked = np.column_stack([v.signature for v in variants])
    sizes = np.linalg.svd(stacked, compute_uv=False)
    return max(1, int((sizes > 0.05 * sizes[0]).sum() / variants[0].signature.shape[1])) if sizes[0] > 0 else 1


def _row(state: State, name: str, variants: Sequence[Variant], basis: Array, tried: int) -> Row:
    """The best variant of an effect."""
    residual = state.scaled
    residual = residual - basis @ (basis.T @ residual)
    best, most = variants[0], -1.0
    for variant in variants:
        gain = _free_gain(_projected(variant.signature, basis), residual)
        if gain > most:
            step, gain = _bounded(variant, _projected(variant.signature, basis), residual)
            if gain > most:
                best, most = variant, gain
    left = _projected(best.signature, basis)
    step, gain = _bounded(best, left, residual)
    values = dict(best.dose.values)
    for c, move in zip(best.amounts, step, strict=True):
        start = 0.0 if c.parameter.reciprocal else values[c.parameter.name]
        moved = start + float(move)
        values[c.parameter.name] = c.value(moved) if moved or not c.parameter.reciprocal else math.inf
    scale = np.array([c.scale for c in best.amounts])
    information = (left * scale).T @ (left * scale)
    whole = (best.signature * scale).T @ (best.signature * scale)
    sizes = np.linalg.eigvalsh(information)
    identifiable = bool(sizes.min() > max(1e-9 * np.trace(whole), 1.0 / 9))
    covariance = np.linalg.pinv(information) * np.outer(scale, scale)
    errors = {}
    for c, v in zip(best.amounts, np.diag(covariance), strict=True):
        value = values[c.parameter.name]
        factor = value**2 if c.parameter.reciprocal and math.isfinite(value) else 1.0
        errors[c.parameter.name] = float(np.sqrt(v)) * factor
    freedom = len(best.amounts)
    limit = float(chi2.isf(SIGNIFICANT / tried, freedom))
    power = float(ncx2.sf(limit, freedom, max(float(np.trace(information)) / freedom, 1e-12)))
    explained = left @ step
    after = state.residual - np.asarray(_unwhitened(state, best, step, basis))
    return Row(
        name,
        Dose(best.dose.effect, values, place=best.dose.place),
        errors,
        gain,
        freedom,
        min(1.0, float(chi2.sf(gain, freedom)) * tried),
        float(np.sqrt(np.mean(after**2))),
        power if math.isfinite(power) else 1.0,
        identifiable,
        explained,
        len(variants),
    )


def _unwhitened(state: State, variant: Variant, step: Array, basis: Array) -> Array:
    """What the effect changes of the prediction, m, as far as the scaling of the errors can be undone."""
    errors = state.errors
    scaled = _projected(variant.signature, basis) @ step
    if len(errors._shrink):
        grow = errors._shrink / (1 - errors._shrink)
        scaled = scaled + errors._basis @ (grow * (errors._basis.T @ scaled))
    return np.asarray(scaled * errors.sigma)


def _projected(signature: Array, basis: Array) -> Array:
    return signature - basis @ (basis.T @ signature) if basis.shape[1] else signature


def _free_gain(left: Array, residual: Array) -> float:
    """Fall of chi-square without bounds: an upper limit of that with bounds."""
    right = left.T @ residual
    solution = np.linalg.lstsq(left.T @ left, right, rcond=1e-10)[0]
    return float(right @ solution)


def _bounded(variant: Variant, left: Array, residual: Array) -> tuple[Array, float]:
    """Best amounts within their bounds, as steps from the neutral values, and the fall of chi-square."""
    lower, upper = [], []
    for c in variant.amounts:
        low, high = c.bounds
        start = 0.0 if c.parameter.reciprocal else variant.dose.values[c.parameter.name]
        lower.append(min((0.0 if c.parameter.reciprocal else low) - start, -1e-300))
        upper.append(max(high - start, 1e-300))
    scale = np.array([c.scale for c in variant.amounts])
    sizes = np.linalg.norm(left * scale, axis=0)
    if not sizes.max(initial=0.0) > 1e-9:
        return np.zeros(len(scale)), 0.0
    # The normal equations, as a square system of their own, are as good and much smaller.
    q, r = np.linalg.qr(left * scale)
    found = lsq_linear(r, q.T @ residual, bounds=(np.array(lower) / scale, np.array(upper) / scale), tol=1e-12)
    step = found.x * scale
    after = residual - left @ step
    return step, float(residual @ residual - after @ after)


def _confusions(rows: Sequence[Row]) -> list[Row]:
    """Note which effects explain the same: what is different of their explanations is within the errors."""
    result = []
    for row in rows:
        same = []
        for other in rows:
            size = float(other.explained @ other.explained)
            if other.effect == row.effect or size <= 0 or row.score <= _TELLING:
                continue
            along = float(row.explained @ other.explained) / size
            apart = row.explained - along * other.explained
            if other.score > row.score - _TELLING and float(apart @ apart) < _TELLING:
                same.append(other.effect)
        result.append(replace(row, confounded_with=tuple(same)))
    return result
