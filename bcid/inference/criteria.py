"""Criteria that weigh how well a model fits against how many numbers were fitted."""

from __future__ import annotations

import math


def bic(chi2: float, values: int, fitted: int) -> float:
    """Bayesian information criterion for known noise: chi-square + fitted * ln(values).

    Schwarz, Ann. Statist. 6 (1978) 461-464. Of two models the one with the smaller value is preferred; the difference is
    twice the logarithm of the odds, for many values.

    Args:
        chi2: sum of squared residuals in units of their standard deviations.
        values: number of measured values.
        fitted: number of fitted numbers.
    """
    return chi2 + fitted * math.log(values)


# What chance alone does less often than this is a surprise: false alarms of tests of many numbers together (Bonferroni).
SURPRISE = 0.01
