"""Criteria that decide, each with its source, and the thresholds of verdicts."""

from __future__ import annotations

import math


def bic(deviance: float, values: int, fitted: int) -> float:
    """Bayesian information criterion: deviance + fitted * ln(values).

    Schwarz, Ann. Statist. 6 (1978) 461-464. Of two models the one with the smaller value is preferred; the difference is
    twice the logarithm of the odds, for many values.

    Args:
        deviance: minus twice the logarithm of the likelihood; what all models have in common may be left out of it.
        values: number of measured values.
        fitted: number of fitted numbers.
    """
    return deviance + fitted * math.log(values)


# What chance alone does less often than this is a surprise: false alarms of tests of many numbers together (Bonferroni).
SURPRISE = 0.01
# A set that could not be followed to the end is told when it is at least this probable on the frames before.
MAY_BE = 0.01
# How often the forward model cannot follow the true set to the end: what a set that fails has for it before the measurement.
FAILS_FOR_THE_TRUE = 0.01
# What is at least this probable is told as certain, and what is less as open.
CERTAIN = 0.95
# A residual that is so many times the noise is not explained by it, where it cannot be asked whether something is missing.
FAR = 2.0
