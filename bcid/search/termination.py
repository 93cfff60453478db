"""When enough seeds have been climbed from."""

from __future__ import annotations

from dataclasses import dataclass

from bcid.inference.outcome import Outcome
from bcid.search.evaluator import Evaluator


@dataclass(frozen=True)
class Termination:
    """Three conditions, looked at after every group of seeds; the first that holds ends the stage.

    Attributes:
        fit: the best RMS residual is at most `fit` times the noise: nothing better can be asked for.
        patience: this many seeds in a row led to nothing better than what was known.
        budget: forward trajectories (whole-trajectory equivalents) computed on this level.
    """

    fit: float = 1.05
    patience: int = 12
    budget: float = 10_000.0

    def reached(self, evaluator: Evaluator, level: int, best: Outcome, seeds_since_better: int) -> str | None:
        """The condition that holds, in words, or None."""
        noise = evaluator.misfit.noise
        if noise is not None and best.rms <= self.fit * noise:
            return f"the residual is the noise ({best.rms * 1e3:.3g} mm, noise {noise * 1e3:.3g} mm)"
        if seeds_since_better >= self.patience:
            return f"{seeds_since_better} seeds in a row led to nothing better"
        if evaluator.evaluations().get(level, 0.0) >= self.budget:
            return f"the budget of {self.budget:g} trajectories is used"
        return None
