"""Which effect is missing? Every dormant effect ranked by what its sensitivity explains of the residual, before any refit."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear
from scipy.special import logsumexp

from bcid.base.errors import InputError, SolveError
from bcid.base.tails import chi2_limit, chi2_tail, shifted_chi2_tail
from bcid.forms import effects
from bcid.forms.course import constant
from bcid.forms.effects.effect import Effect
from bcid.forms.model import Term
from bcid.inference.evidence import LARGER, log_gains
from bcid.inference.thresholds import THRESHOLDS
from bcid.search.fitting.fit import columns, coordinates
from bcid.search.fitting.parameter_priors import log_share, log_variants, one_sided, visible
from bcid.search.fitting.state import State
from bcid.search.fitting.variants import Variant, all_variants

Array = NDArray[np.float64]
# A refit of what the model has already must not gain more than this (chi-square, and part of it).
_OPTIMUM = 9.0, 0.02
# Scans of more variants count each of them as a try.
_MANY = 60


@dataclass(frozen=True)
class Row:
    """What a dormant effect would explain.

    Attributes:
        effect: its name.
        term: its best variant with the expected values.
        stderr: standard error of each amount, by parameter.
        score: expected fall of chi-square.
        dof: number of amounts.
        p_value: that chance explains as much, all variants of all effects counted.
        expected_rms: RMS residual once it is added, m.
        power: probability that a notable amount of it would show in these data.
        identifiable: whether the data tell its amounts at all.
        confounded_with: effects that explain the same.
        explained: what it explains of the scaled residual, shape (n,).
        tried: variants tried.
        gain: logarithm of how much likelier the effect makes the data, all variants and amounts counted; minus infinity where
            these data cannot show it.
    """

    effect: str
    term: Term
    stderr: dict[str, float]
    score: float
    dof: int
    p_value: float
    expected_rms: float
    power: float
    identifiable: bool
    explained: Array
    tried: int
    gain: float
    confounded_with: tuple[str, ...] = ()


@dataclass(frozen=True)
class Ranking:
    """All dormant effects, the likeliest first.

    Attributes:
        rows: the effects.
        excluded: effects that cannot act here, with the reason in words.
        tried: number of variants tried over all effects.
        variants: of every effect.
    """

    rows: tuple[Row, ...]
    excluded: dict[str, str] = field(default_factory=dict)
    tried: int = 0
    variants: dict[str, list[Variant]] = field(default_factory=dict)


def rank(
    state: State,
    known: Sequence[Effect] | None = None,
    strict: bool = True,
    place: str | None = None,
    like: Ranking | None = None,
) -> Ranking:
    """Rank the effects that the model lacks; collective.

    Args:
        state: the model at its optimum.
        known: the effects to look at; the whole catalogue by default.
        place: where the effects act; everywhere they can by default.
        strict: refuse a model that is not at its optimum (what a refit of it could explain is projected out anyway).
        like: of a set near by with the same errors, whose sensitivities serve.

    Raises:
        InputError: the model is not at its optimum: what a refit explains would be taken for a missing effect.
    """
    present = present_columns(state)
    if strict:
        check_optimum(state, present)
    candidates, excluded = dormant(state, effects.catalogue() if known is None else known)
    candidates = [(effect, at) for effect, at in candidates if place is None or at == place]
    variants = _evaluated(state, candidates, excluded) if like is None else _of_candidates(like, candidates)
    basis = orthonormal(present)
    tried = max(sum(_effective(v) for v in variants.values()), 1)
    rows = [best_row(state, name, found, basis, tried) for name, found in variants.items() if found]
    rows.sort(key=lambda row: (-row.gain, -row.score, row.effect))
    return Ranking(tuple(_confusions(rows)), excluded, tried, variants)


def _evaluated(
    state: State, candidates: Sequence[tuple[Effect, str]], excluded: dict[str, str]
) -> dict[str, list[Variant]]:
    """Variants of all effects; where their sensitivities fail together, of each by itself, and why one is `excluded`."""
    with suppress(SolveError):
        return all_variants(state, candidates)
    found: dict[str, list[Variant]] = {}
    for name in dict.fromkeys(effect.name for effect, _ in candidates):
        try:
            found |= all_variants(state, [(effect, at) for effect, at in candidates if effect.name == name])
        except SolveError as error:
            excluded[name] = str(error)
    return found


def _of_candidates(like: Ranking, candidates: Sequence[tuple[Effect, str]]) -> dict[str, list[Variant]]:
    """Those variants that may act here too."""
    known = {(effect.name, place) for effect, place in candidates}
    found = {effect.name: list[Variant]() for effect, _ in candidates}
    for name, variants in like.variants.items():
        if name in found:
            found[name] = [v for v in variants if (name, v.term.place) in known]
    return found


def dormant(state: State, known: Iterable[Effect]) -> tuple[list[tuple[Effect, str]], dict[str, str]]:
    """Effects and places that the model lacks, and those that cannot act in this scene and measurement, with the reason."""
    found, excluded = [], {}
    measurement, scene = state.predictor.measurement, state.predictor.scene
    for effect in known:
        reason = effect.not_applicable(scene, measurement)
        if reason:
            excluded[effect.name] = reason
            continue
        taken = {term.place for term in state.model.terms if constant(term.effect).name == effect.name}
        places = effect.places(scene, state.anchors) if effect.places else [""]
        # What can act everywhere is not looked for once more at a place.
        if not (taken and "" in places):
            found += [(effect, place) for place in places if place not in taken]
    return found, excluded


def present_columns(state: State) -> Array:
    """Scaled sensitivities of what the model has fitted already, shape (n, p); collective."""
    if not state.free:
        return np.zeros((len(state.predictor.data), 0))
    chosen = coordinates(state.model, state.free)
    raw = columns(state.predictor, state.model, state.anchors, state.prediction, chosen)
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
    basis, scaled = orthonormal(present[:, inner]), state.scaled
    gain = float(np.sum((basis.T @ scaled) ** 2))
    if gain > max(_OPTIMUM[0], _OPTIMUM[1] * float(scaled @ scaled)):
        raise InputError(
            f"the model {state.model.name} is not at its optimum: refitting {', '.join(state.free)} alone would lower "
            f"chi-square by {gain:.0f} of {scaled @ scaled:.0f}, and a missing effect would be taken for that; fit it first"
        )


# -- scores
# --------------------------------------------------------------------------------------------------------------------


def orthonormal(columns: Array) -> Array:
    """Orthonormal basis of the columns."""
    if columns.shape[1] == 0:
        return columns
    basis, sizes, _ = np.linalg.svd(columns, full_matrices=False)
    return np.asarray(basis[:, sizes > 1e-8 * max(sizes.max(initial=0.0), 1e-300)])


def _effective(variants: Sequence[Variant]) -> int:
    """How many independent tries a scan is worth: the dimension of what its sensitivities span."""
    if len(variants) < 2:
        return len(variants)
    # An upper limit, where so many sensitivities are not worth a decomposition.
    if len(variants) > _MANY:
        return len(variants)
    stacked = np.column_stack([v.sensitivity for v in variants])
    sizes = np.linalg.svd(stacked, compute_uv=False)
    return max(1, int((sizes > 0.05 * sizes[0]).sum() / variants[0].sensitivity.shape[1])) if sizes[0] > 0 else 1


def best_row(state: State, name: str, variants: Sequence[Variant], basis: Array, tried: int) -> Row:
    """An effect with its best variant, of those that are given.

    Args:
        state: the model.
        name: of the effect.
        variants: ways in which it may act.
        basis: of what the model has fitted already, orthonormal, shape (n, p).
        tried: how many tries all effects together are worth.
    """
    residual = state.scaled
    residual = residual - basis @ (basis.T @ residual)
    stacked = _projected(np.hstack([v.sensitivity for v in variants]), basis)
    gains = _gains(state, variants, stacked, residual)
    evidence = float(logsumexp(gains)) + log_variants(len(variants))
    at = int(np.argmax(gains)) if np.isfinite(gains).any() else 0
    width = len(variants[0].amounts)
    best, left = variants[at], stacked[:, at * width : (at + 1) * width]
    step, gain = _bounded(best, left, residual)
    values = dict(best.term.values)
    for c, move in zip(best.amounts, step, strict=True):
        p, start = c.parameter, 0.0 if c.parameter.reciprocal else values[c.parameter.name]
        moved = start + float(move)
        values[p.name] = float(np.clip(c.value(moved), p.lower, p.upper)) if moved or not p.reciprocal else math.inf
    scale = np.array([c.scale for c in best.amounts])
    information = (left * scale).T @ (left * scale)
    whole = (best.sensitivity * scale).T @ (best.sensitivity * scale)
    sizes = np.linalg.eigvalsh(information)
    identifiable = bool(sizes.min() > max(1e-9 * np.trace(whole), 1.0 / 9))
    covariance = np.linalg.pinv(information) * np.outer(scale, scale)
    errors = {}
    for c, v in zip(best.amounts, np.diag(covariance), strict=True):
        value = values[c.parameter.name]
        factor = value**2 if c.parameter.reciprocal and math.isfinite(value) else 1.0
        # Of numbers that cannot be told apart round-off leaves a variance that is none.
        errors[c.parameter.name] = float(np.sqrt(v)) * factor if v >= 0 else math.inf
    dof = len(best.amounts)
    limit = chi2_limit(THRESHOLDS.surprise / tried, dof)
    power = shifted_chi2_tail(limit, dof, max(float(np.trace(information)) / dof, 1e-12))
    explained = left @ step
    after = state.residual - state.errors.unwhiten(explained)
    return Row(
        name,
        Term(best.term.effect, values, place=best.term.place),
        errors,
        gain,
        dof,
        min(1.0, chi2_tail(gain, dof) * tried),
        state.predictor.data.rms(after),
        power if math.isfinite(power) else 1.0,
        identifiable,
        explained,
        len(variants),
        evidence,
    )


def _gains(state: State, variants: Sequence[Variant], stacked: Array, residual: Array) -> Array:
    """How much likelier each variant makes the data, as logarithms; `stacked` are their sensitivities, one after the other."""
    amounts = variants[0].amounts
    columns = stacked.reshape(len(stacked), len(variants), len(amounts))
    scale = np.array([c.scale for c in amounts])
    shown = np.sqrt(np.mean(np.sum((columns * scale) ** 2, axis=0), axis=1))
    factors = None if state.predictor.data.stated else LARGER
    found = np.full(len(variants), -np.inf)
    # Variants that show as much of their amounts are judged together.
    counts = np.array([len(visible(float(one))) for one in shown])
    for count in np.unique(counts[counts > 0]):
        some = np.flatnonzero(counts == count)
        widths = visible(float(shown[some].min()))[:, None] * scale
        logs = log_gains(residual, columns[:, some], widths, one_sided(amounts), factors)
        found[some] = logs + log_share(len(widths))
    return found


def _projected(sensitivity: Array, basis: Array) -> Array:
    return sensitivity - basis @ (basis.T @ sensitivity) if basis.shape[1] else sensitivity


def _bounded(variant: Variant, left: Array, residual: Array) -> tuple[Array, float]:
    """Best amounts within their bounds, as steps from the neutral values, and the fall of chi-square."""
    lower, upper = [], []
    for c in variant.amounts:
        low, high = c.bounds
        start = 0.0 if c.parameter.reciprocal else variant.term.values[c.parameter.name]
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
            if other.effect == row.effect or size <= 0 or row.score <= THRESHOLDS.detection**2:
                continue
            along = float(row.explained @ other.explained) / size
            apart = row.explained - along * other.explained
            if other.score > row.score - THRESHOLDS.detection**2 and float(apart @ apart) < THRESHOLDS.detection**2:
                same.append(other.effect)
        result.append(replace(row, confounded_with=tuple(same)))
    return result
