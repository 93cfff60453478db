"""Simulation-based calibration: data drawn from prior and linearised model, and the posterior that is computed of them.

The model is linearised once about a golden case: movements by all sets, sensitivities of effects, columns of the discrepancies.
Hypotheses and amounts are drawn from the prior and data from equation (1) of the theory. The functions that explain a measurement
compute the posterior (Talts et al., arXiv:1804.06788, 2018). The rank of the true hypothesis is then uniform, and of the answers
with probability p a part p is right. The noise is raised by a factor, so that hypotheses can be confused.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from bcid.base.progress import Progress
from bcid.base.run_folder import write_whole
from bcid.forms import effects
from bcid.forms.model import Model
from bcid.inference.discrepancy import Evidence
from bcid.inference.error_covariance import ErrorCovariance
from bcid.inference.evidence import LowRankDiscrepancy, log_gains
from bcid.inference.hypotheses import Hypothesis, HypothesisOdds, log_prior
from bcid.inference.priors import PRIORS
from bcid.search.fitting.parameter_priors import log_share, log_variants, one_sided, visible
from bcid.search.fitting.ranking import rank
from bcid.search.fitting.state import State
from bcid.search.fitting.variants import Variant
from validation.golden.cases import MEASUREMENT, SCENE, prepare
from validation.text_table import TextTable

Array = NDArray[np.float64]
Json = Mapping[str, Any]
CASE, SEED = "hidden-223-4", 60
# Factors of the noise; sets of anchors and effects that compete.
NOISES = (3.0, 10.0, 30.0)
SETS = 12
EFFECTS = ("gravity", "swelling", "fibres", "active_stress", "viscosity", "permanent_set")
BINS = np.linspace(0.0, 1.0, 11)


@dataclass(frozen=True)
class LinearModel:
    """A linearised family of hypotheses.

    Attributes:
        state: the hypothesis about which it is linear; its errors are those of the data.
        shifts: what each set adds to the values, in units of their errors, shape (n,).
        variants: of each effect, the ways in which it may act.
        known: how many effects may act.
    """

    state: State
    shifts: Mapping[frozenset[str], Array]
    variants: Mapping[str, Sequence[Variant]]
    known: int

    @classmethod
    def of(cls, state: State, noise: float) -> LinearModel:
        """About a hypothesis, with so many times its noise; collective."""
        errors = state.errors
        state = replace(state, errors=ErrorCovariance(errors.data, noise * errors.sigma, errors.mesh, errors.nuisances))
        patches = list(state.predictor.scene.patches)
        near = [state.anchors ^ {patch} for patch in patches]
        near += [state.anchors ^ {one, other} for one, other in pairwise(patches)]
        sets = [state.anchors, *near][:SETS]
        moves = state.predictor.moves(state.model, state.anchors, state.prediction, sets)
        shifts = {
            s: state.errors.whiten(state.predictor.data.vector(moved)) for s, moved in zip(sets, moves, strict=True)
        }
        found = rank(state, effects.catalogue(EFFECTS), strict=False).variants
        return cls(state, shifts, {name: some for name, some in found.items() if some}, len(EFFECTS))

    @cached_property
    def grouped(self) -> dict[str, list[_Alike]]:
        """Effects that the data could show, with their variants."""
        found = {name: _Alike.grouped(variants) for name, variants in self.variants.items()}
        return {name: groups for name, groups in found.items() if groups}

    def draw(self, rng: np.random.Generator) -> tuple[Hypothesis, Array]:
        """A hypothesis and data, in units of their errors, shape (n,), from the joint prior."""
        anchors = list(self.shifts)[rng.integers(len(self.shifts))]
        ways: list[tuple[Hypothesis, Variant | None, Array]] = [
            (Hypothesis(anchors), None, np.zeros(0)),
            (Hypothesis(anchors, unknown=True), None, np.zeros(0)),
        ]
        logs = [0.0, log_prior(0, True, self.known)]
        for name, variants in self.variants.items():
            for one in variants:
                for width in _widths(one):
                    ways.append((Hypothesis(anchors, name), one, width))
                    logs.append(log_prior(1, False, self.known) + log_variants(len(variants)) + log_share(1))
        h, variant, width = ways[rng.choice(len(ways), p=np.exp(logs - logsumexp(logs)))]
        data = rng.normal(size=len(self.shifts[anchors]))
        if h.unknown:
            data = self._disturbed(data, rng)
        if variant is not None:
            amounts = width * rng.normal(size=len(width))
            amounts = np.where(one_sided(variant.amounts), np.abs(amounts), amounts)
            data = data + variant.sensitivity @ amounts
        return h, data + self.shifts[anchors]

    def _disturbed(self, noise: Array, rng: np.random.Generator) -> Array:
        """Noise with a discrepancy of a few steps: a smooth force or growth, or a misfit in observation space."""
        forced = rng.random() * (PRIORS.force + PRIORS.response) < PRIORS.force
        kinds: Sequence[LowRankDiscrepancy] = self.state.forces if forced else self.state.errors.misfits
        one = kinds[rng.integers(len(kinds))]
        k = int(rng.integers(len(one.sizes)))
        larger = 1.0 if one.inflation is None else one.inflation[k]
        moved = one.basis @ (np.sqrt(one.squares) * one.sizes[k] * rng.normal(size=len(one.squares)))
        return np.asarray(larger * noise + moved)

    def posterior(self, data: Array) -> HypothesisOdds:
        """Of all hypotheses, given data in units of their errors, shape (n,)."""
        errors, logs = self.state.errors, dict[Hypothesis, float]()
        for anchors, shift in self.shifts.items():
            residual = data - shift
            evidence = Evidence.of(errors, errors.unwhiten(residual), self.state.forces)
            logs[Hypothesis(anchors)] = evidence.plain
            logs[Hypothesis(anchors, unknown=True)] = evidence.forced + log_prior(0, True, self.known)
            for name, groups in self.grouped.items():
                gain = float(logsumexp(np.concatenate([some.logs(residual) for some in groups])))
                among = log_variants(len(self.variants[name])) + log_prior(1, False, self.known)
                logs[Hypothesis(anchors, name)] = evidence.plain + gain + among
        return HypothesisOdds.of(logs)


def _widths(variant: Variant) -> list[Array]:
    """Standard deviations of the amounts of an effect that the data could show, one row each."""
    scale = np.array([c.scale for c in variant.amounts])
    shown = float(np.sqrt(np.mean(np.sum((variant.sensitivity * scale) ** 2, axis=0))))
    return [size * scale for size in visible(shown)]


@dataclass(frozen=True)
class _Alike:
    """Variants of an effect that have the same visible amounts, whose sensitivities (n, variants, amounts) are used together."""

    sensitivities: Array
    widths: Array
    positive: NDArray[np.bool_]

    @classmethod
    def grouped(cls, variants: Sequence[Variant]) -> list[_Alike]:
        """Those of an effect that the data could show at all."""
        groups: dict[int, list[Variant]] = {}
        for one in variants:
            groups.setdefault(len(_widths(one)), []).append(one)
        return [
            cls(np.stack([v.sensitivity for v in some], axis=1), np.array(_widths(some[0])), one_sided(some[0].amounts))
            for count, some in groups.items()
            if count
        ]

    def logs(self, residual: Array) -> Array:
        """How much more probable each makes a residual (n,), as logarithms, shape (variants,)."""
        return log_gains(residual, self.sensitivities, self.widths, self.positive) + log_share(len(self.widths))


def run(folder: Path, draws: int, progress: Progress) -> None:
    """Draw and infer, with each noise; a file of a noise that is complete is kept."""
    missing = [noise for noise in NOISES if not _file(folder, noise).is_file()]
    if not missing:
        return
    prepare(CASE, folder / "case")
    state = _state(folder / "case")
    for noise in missing:
        model, rng, found = LinearModel.of(state, noise), np.random.default_rng([SEED, int(10 * noise)]), []
        for number in range(draws):
            progress.step(f"draws with {noise:g} times the noise", number, draws)
            truth, data = model.draw(rng)
            found.append(judged(truth, model.posterior(data), float(rng.random())))
        write_whole(_file(folder, noise), json.dumps(found) + "\n")
    state.predictor.destroy()


def _state(folder: Path) -> State:
    """The case in a few steps, with the set that is likeliest there."""
    from mpi4py import MPI

    from bcid.measurement import Measurement
    from bcid.predict.predictor import Predictor
    from bcid.scene import Scene
    from bcid.search.fitting.state import in_few_steps
    from bcid.search.searched import first_sets

    scene = Scene.read(folder / SCENE)
    predictor = Predictor(scene, Measurement.read(folder / MEASUREMENT), MPI.COMM_SELF)
    model = Model.of(scene)
    return in_few_steps(State.of(predictor, model, first_sets(predictor, model)[0]))


def judged(truth: Hypothesis, odds: HypothesisOdds, between: float) -> dict[str, Any]:
    """Probabilities of the reported verdict and set, whether each is right, and the rank of the true hypothesis, in 0 to 1."""
    p, verdicts = odds.probabilities, odds.verdicts
    verdict = next(iter(verdicts))
    sets = {s: odds.held_by(s) for s in {h.anchors for h in p}}
    anchors = max(sets, key=lambda s: (sets[s], sorted(s)))
    before = math.fsum(p[h] for h in p if h.order < truth.order)
    return {
        "verdict": [verdicts[verdict], verdict == truth.verdict],
        "anchors": [sets[anchors], anchors == truth.anchors],
        "rank": before + between * p.get(truth, 0.0),
    }


def read(folder: Path) -> dict[float, list[dict[str, Any]]]:
    """Judged draws so far, by the factor of the noise."""
    return {n: json.loads(_file(folder, n).read_text(encoding="utf-8")) for n in NOISES if _file(folder, n).is_file()}


def reliability(pairs: Sequence[tuple[float, bool]]) -> list[tuple[float, float, int]]:
    """Mean probability, part that is right, and count, of the answers in each bin that has some."""
    place = np.clip(np.digitize([p for p, _ in pairs], BINS) - 1, 0, len(BINS) - 2)
    binned = [[pair for at, pair in zip(place, pairs, strict=True) if at == k] for k in range(len(BINS) - 1)]
    return [(float(np.mean([p for p, _ in b])), float(np.mean([right for _, right in b])), len(b)) for b in binned if b]


def calibration_error(pairs: Sequence[tuple[float, bool]]) -> float:
    """Expected difference of the stated probability and the part that is right (Naeini et al., AAAI 2015)."""
    return sum(count * abs(p - right) for p, right, count in reliability(pairs)) / len(pairs)


def table(found: Mapping[float, Sequence[Json]]) -> TextTable:
    """Calibration errors of verdict and anchors, and the test of the ranks, for each noise."""
    from scipy.stats import kstest

    rows = []
    for noise, draws in found.items():
        row = [f"{noise:g}", str(len(draws))]
        for what in ("verdict", "anchors"):
            pairs = [(one[what][0], one[what][1]) for one in draws]
            row += [f"{np.mean([right for _, right in pairs]):.0%}", f"{calibration_error(pairs):.3f}"]
        rows.append((*row, f"{kstest([one['rank'] for one in draws], 'uniform').pvalue:.2g}"))
    head = ("noise", "draws", "verdict right", "error", "anchors right", "error", "p of the ranks")
    return TextTable("Simulation-based calibration of the linearised model", head, tuple(rows))


def picture(found: Mapping[float, Sequence[Json]], target: Path) -> Path:
    """Reliability diagram of verdicts and anchors, over all noises, with binomial bands of 95 %; written as PNG."""
    import matplotlib

    matplotlib.use("agg")
    from matplotlib import pyplot
    from scipy.stats import binom

    from bcid.report.figure import DARK, GREY, save

    figure, axes = pyplot.subplots(1, 2, figsize=(8.4, 4.2), sharey=True, layout="constrained")
    for ax, what in zip(axes, ("verdict", "anchors"), strict=True):
        bins = reliability([(one[what][0], one[what][1]) for draws in found.values() for one in draws])
        mean, right, count = (np.array(values) for values in zip(*bins, strict=True))
        low, high = (binom.ppf(q, count, mean) / count for q in (0.025, 0.975))
        ax.plot([0, 1], [0, 1], color=GREY, linewidth=0.8)
        ax.fill_between(mean, low, high, color=GREY, alpha=0.2, linewidth=0, label="chance, 95 %")
        ax.plot(mean, right, "o-", color=DARK, label="answers (synthetic)")
        for p, part, n in bins:
            ax.annotate(str(n), (p, part), (4, -11), textcoords="offset points", fontsize=8, color=GREY)
        ax.set(xlabel=f"stated probability of the {what}", xlim=(0, 1.02), ylim=(0, 1.02), aspect="equal")
    axes[0].set_ylabel("part that is right")
    axes[0].legend(loc="upper left", frameon=False)
    try:
        return save(figure, target)
    finally:
        pyplot.close(figure)


def _file(folder: Path, noise: float) -> Path:
    return folder / f"draws-{noise:g}.json"
