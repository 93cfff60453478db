"""What is reported of the posterior after some pulls."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

from bcid.exploration.fitted_numbers import FittedNumbers
from bcid.inference.hypotheses import Hypothesis, effects, entropy, log_prior, normalised, patches
from bcid.inference.priors import PRIORS
from bcid.inference.stiffness import Stiffness
from bcid.measurement import Measurement


@dataclass(frozen=True)
class PosteriorSummary:
    """The posterior after some pulls.

    Attributes:
        probabilities: of every hypothesis, with or without a discrepancy, the most probable first.
        patches: probability that each patch is anchored.
        effects: probability of each effect, and of none ("").
        entropy: bits.
        rms: RMS residual of the likeliest hypothesis that was fitted, m; NaN before anything was seen.
        missed: the same in units of what noise, mesh, and what the scene may have slightly wrong explain.
        missing: probability that something unknown acts besides (see `bcid.inference.discrepancy`).
        error: RMS error of the mesh, as part of the motion.
        fitted: the hypotheses with an effect that were fitted, with their numbers.
        stiffness: how stiff the body is with the likeliest hypothesis, where forces are measured.
        seen: the pulls.
    """

    probabilities: dict[Hypothesis, float]
    patches: dict[str, float]
    effects: dict[str, float]
    entropy: float
    rms: float
    missed: float
    missing: float
    error: float
    fitted: dict[Hypothesis, FittedNumbers] = field(default_factory=dict)
    stiffness: Stiffness | None = None
    seen: tuple[Measurement, ...] = ()

    @classmethod
    def before(
        cls, sets: Sequence[frozenset[str]], names: Iterable[str], effects: Sequence[str], fine: bool
    ) -> PosteriorSummary:
        """Before any pull: all sets are as probable; `names` are those of the patches, `fine` whether there is a finer level."""
        even = {Hypothesis(anchors): 1.0 / len(sets) for anchors in sets}
        prior = prior_effects(effects)
        bits = math.log2(len(sets)) + entropy(prior.values())
        return cls(even, patches(even, names), prior, bits, math.nan, 0, 0, PRIORS.first_mesh_error if fine else 0.0)

    @property
    def best(self) -> Hypothesis:
        """The most probable hypothesis."""
        return next(iter(self.probabilities))

    @property
    def certainty(self) -> float:
        """Its probability."""
        return self.probabilities[self.best]


def prior_effects(names: Sequence[str]) -> dict[str, float]:
    """Prior probability of each effect, and of none ("")."""
    nothing = frozenset[str]()
    prior = {Hypothesis(nothing, name): log_prior(bool(name), False, len(names)) for name in ("", *names)}
    return effects(normalised(prior), names)
