"""What is believed after some pulls, in numbers."""

from __future__ import annotations

from dataclasses import dataclass, field

from bcid.exploration.rival_effects import Fitted
from bcid.inference.hypotheses import Hypothesis
from bcid.inference.stiffness import Stiffness


@dataclass(frozen=True)
class PosteriorSummary:
    """What is believed after some pulls.

    Attributes:
        probabilities: of every hypothesis looked at, the likeliest first.
        patches: probability that each patch is anchored.
        effects: probability of each rival effect, and of none ("").
        entropy: bits.
        rms: RMS residual of the likeliest hypothesis, m; NaN before anything was seen.
        missed: the same in units of what noise, mesh, and what the scene may have slightly wrong explain.
        missing: probability that something is missing in the model besides (see `bcid.inference.discrepancy`).
        error: RMS error of the mesh at the end of a pull, as part of its motion.
        fitted: the hypotheses with an effect, with their numbers.
        stiffness: how stiff the body is with the likeliest set, where forces are measured.
    """

    probabilities: dict[Hypothesis, float]
    patches: dict[str, float]
    effects: dict[str, float]
    entropy: float
    rms: float
    missed: float
    missing: float
    error: float
    fitted: dict[Hypothesis, Fitted] = field(default_factory=dict)
    stiffness: Stiffness | None = None

    @property
    def best(self) -> Hypothesis:
        """The likeliest hypothesis."""
        return next(iter(self.probabilities))

    @property
    def certainty(self) -> float:
        """Its probability."""
        return self.probabilities[self.best]
