"""The numbers of the report: from where on something is said. No evidence depends on them."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Thresholds:
    """From where on something is said, by convention.

    Attributes:
        surprise: what chance alone does less often is a surprise: false alarms of tests of many numbers together (Bonferroni).
            What is as improbable is not reported.
        false_alarms: adequate models that may be called inadequate, as a part of all.
        credible: probability from which on an answer is certain, and of all intervals.
        residual: a residual of so many times the noise is not explained by it, where it is not asked whether something is missing.
        effect: what moves the markers by less than this part of the noise (RMS) is not looked for: nothing is said of it.
        detection: an amount is seen where its standard deviation before the data is so many times that after, and significant where
            it is so many standard errors from nothing.
        explained: a model may be named although something is missing besides when it explains this part of what its errors leave.
        outlier: how often a marker is an outlier.
    """

    surprise: float = 0.01
    false_alarms: float = 0.05
    credible: float = 0.95
    residual: float = 2.0
    effect: float = 0.5
    detection: float = 3.0
    explained: float = 0.95
    outlier: float = 0.01

    @property
    def odds(self) -> float:
        """Odds from which on one of two is certain."""
        return self.credible / (1 - self.credible)


THRESHOLDS = Thresholds()
