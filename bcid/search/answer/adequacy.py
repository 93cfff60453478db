"""Adequate? Whether noise and the error of the mesh explain what a model leaves of the measurement."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bcid.base.tails import chi2_tail, normal_tail
from bcid.inference.thresholds import THRESHOLDS
from bcid.results.diagnosis_record import BREAKING, Finding
from bcid.search.fitting.state import State

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Adequacy:
    """The verdict on a model.

    Attributes:
        adequate: whether the residual is what noise and mesh leave.
        p_value: of the verdict; below `Thresholds.false_alarms` the model is not adequate.
        findings: the single tests.
        stated: whether the noise is stated, and not only estimated from the residual that is judged.
    """

    adequate: bool
    p_value: float
    findings: tuple[Finding, ...]
    stated: bool = True

    @property
    def told(self) -> bool | None:
        """Whether the model is adequate; None where that cannot be told: the noise was estimated from what is judged by it."""
        return None if self.adequate and not self.stated else self.adequate


def judge(state: State) -> Adequacy:
    """Test the residual of a model. Three tests decide, together with a false-alarm rate of at most `Thresholds.false_alarms`:
    its size, its slow part along each trajectory, and its part common to all actions of a fiducial (bias).
    """
    findings = [_size(state), _slow(state), _bias(state), *_describing(state)]
    findings += [Finding("left out", 1.0, text) for text in state.predictor.left_out]
    deciding = [f.p_value for f in findings if f.decides]
    p = min(1.0, len(deciding) * min(deciding))
    return Adequacy(p >= THRESHOLDS.false_alarms, p, tuple(findings), state.predictor.data.stated)


def _size(state: State) -> Finding:
    scaled, dof = state.scaled, max(len(state.scaled) - len(state.free), 1)
    p = chi2_tail(float(scaled @ scaled), dof)
    ratio = float(np.sqrt(scaled @ scaled / dof))
    return Finding("size", p, f"the residual is {ratio:.2f} times what noise and mesh explain", True)


def _projected(state: State, groups: NDArray[np.int64], shapes: Array) -> tuple[float, int]:
    """Chi-square of the scaled residual along shapes (n, m), separately in each group, and its degrees of dof."""
    scaled = state.scaled
    total, dof = 0.0, 0
    order = np.argsort(groups, kind="stable")
    for members in np.split(order, np.flatnonzero(np.diff(groups[order])) + 1):
        basis, sizes, _ = np.linalg.svd(shapes[members], full_matrices=False)
        basis = basis[:, sizes > 1e-9 * max(sizes.max(initial=0.0), 1e-300)]
        part = basis.T @ scaled[members]
        total, dof = total + float(part @ part), dof + basis.shape[1]
    return total, dof


def _slow(state: State) -> Finding:
    """A constant and a slope along the steps of every trajectory."""
    data = state.predictor.data
    shapes = np.column_stack([np.ones(len(data)), data.step - np.mean(data.step)])
    total, dof = _projected(state, data.trajectory, shapes)
    dof = max(dof - len(state.free), 1)
    p = chi2_tail(total, dof)
    return Finding("slow", p, f"its slow part is {np.sqrt(total / dof):.2f} times that of noise", True)


def _bias(state: State) -> Finding:
    """A constant of every fiducial and axis over all actions, and one that grows with the way the fiducial has gone."""
    data = state.predictor.data
    way = np.linalg.norm(state.predicted - data.rest, axis=2)[data.frame, data.fiducial]
    shapes = np.column_stack([np.ones(len(data)), way / max(float(way.max()), 1e-12)])
    total, dof = _projected(state, data.fiducial * 3 + data.axis, shapes)
    dof = max(dof - len(state.free), 1)
    p = chi2_tail(total, dof)
    return Finding(
        "bias", p, f"what a fiducial misses in all actions is {np.sqrt(total / dof):.2f} times that of noise", True
    )


def _describing(state: State) -> list[Finding]:
    """What the residual looks like: it does not decide, but tells where to look."""
    data, scaled = state.predictor.data, state.scaled
    found = []
    order = np.lexsort((data.step, data.trajectory))
    pairs = np.diff(data.trajectory[order]) == 0
    products = (scaled[order][1:] * scaled[order][:-1])[pairs]
    if len(products):
        along = float(products.mean() / np.mean(scaled**2))
        p = normal_tail(along * math.sqrt(len(products)))
        found.append(Finding("correlation along time", p, f"neighbouring steps correlate by {along:.2f}"))
    rest = data.step == 0
    if rest.any():
        value = float(np.sum(scaled[rest] ** 2))
        p = chi2_tail(value, int(rest.sum()))
        found.append(Finding("error at rest", p, f"at step 0 it is {np.sqrt(value / rest.sum()):.2f} times noise"))
    way = np.linalg.norm(state.predicted - data.rest, axis=2)[data.frame, data.fiducial]
    if np.ptp(way) > 0:
        grows = float(np.corrcoef(way, scaled**2)[0, 1])
        p = normal_tail(grows * math.sqrt(len(data)))
        found.append(Finding("growth with amplitude", p, f"its square correlates with the way by {grows:.2f}"))
    found += _hysteresis(state)
    broken = breaking(state)
    return [*found, broken] if broken is not None else found


def breaking(state: State) -> Finding | None:
    """The frame from which on the residual is larger than before, where there is one and what is before fits.

    The likeliest place of a change of the residual's variance in time: twice the logarithm of the likelihood ratio against no
    change, compared with chi-square for each place that was tried.
    """
    data, scaled = state.predictor.data, state.scaled
    frames = np.unique(data.frame)
    squares = np.array([float(np.sum(scaled[data.frame == frame] ** 2)) for frame in frames])
    counts = np.array([int(np.sum(data.frame == frame)) for frame in frames])
    if len(frames) < 3:
        return None
    before, after = np.cumsum(squares)[:-1], np.cumsum(squares[::-1])[::-1][1:]
    few, many = np.cumsum(counts)[:-1], np.cumsum(counts[::-1])[::-1][1:]
    means = np.maximum([before / few, after / many], 1e-12)
    ratio = counts.sum() * np.log(squares.sum() / counts.sum()) - few * np.log(means[0]) - many * np.log(means[1])
    at = int(np.argmax(np.where(means[1] > means[0], ratio, -np.inf)))
    p = min(1.0, len(frames) * chi2_tail(ratio[at], 1))
    fits = chi2_tail(before[at], few[at]) >= THRESHOLDS.false_alarms
    fails = chi2_tail(after[at], many[at]) < THRESHOLDS.surprise
    if not (fits and fails and p < THRESHOLDS.surprise):
        return None
    row = int(np.flatnonzero(data.frame == frames[at + 1])[0])
    where = f"step {data.step[row]} of action {data.actions[data.action[row]]}"
    text = (
        f"from {where} on it is {np.sqrt(means[1][at]):.2f} times what noise and mesh explain, before that "
        f"{np.sqrt(means[0][at]):.2f} times"
    )
    return Finding(BREAKING, p, text)


def _hysteresis(state: State) -> list[Finding]:
    """Residuals at the same pose of the gripper, on the way there and on the way back."""
    data, scaled = state.predictor.data, state.scaled
    table = data.spread(scaled)
    differences = []
    for action in state.predictor.actions:
        for i in range(len(action)):
            for j in range(i + 2, len(action)):
                near = np.allclose(action.translation[i], action.translation[j], atol=1e-6) and np.allclose(
                    action.rotation[i], action.rotation[j], atol=1e-6
                )
                if near and not np.allclose(action.translation[i], action.translation[i + 1], atol=1e-6):
                    differences.append((table[action.frames[j]] - table[action.frames[i]]) / np.sqrt(2))
    values = np.array(differences).ravel()
    values = values[np.isfinite(values)]
    if not len(values):
        return []
    total = float(values @ values)
    p = chi2_tail(total, len(values))
    text = f"there and back at the same pose differ by {np.sqrt(total / len(values)):.2f} times noise"
    return [Finding("hysteresis", p, text)]


def groups(state: State) -> dict[str, dict[str, float]]:
    """RMS residual in units of noise by action, step, fiducial and axis."""
    data = state.predictor.data
    ratio = state.residual / state.errors.sigma

    def by(labels: NDArray[np.int64], names: dict[int, str]) -> dict[str, float]:
        return {
            names.get(int(v), str(int(v))): float(np.sqrt(np.mean(ratio[labels == v] ** 2))) for v in np.unique(labels)
        }

    return {
        "action": by(data.action, dict(enumerate(data.actions))),
        "step": by(data.step, {}),
        "fiducial": by(data.fiducial, dict(enumerate(data.names))),
        "axis": by(np.where(data.along, 3, data.axis), dict(enumerate((*"xyz", "normal")))),
    }
