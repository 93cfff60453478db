"""Tails of distributions, against SciPy's."""

from __future__ import annotations

import pytest
from scipy.stats import chi2, ncx2, norm

from bcid.base import tails

SUMS = (0.1, 1.0, 10.0, 100.0, 2500.0)


@pytest.mark.parametrize("value", [-3.0, 0.0, 1.96, 8.0, 30.0])
def test_normal(value: float) -> None:
    assert tails.normal_tail(value) == pytest.approx(norm.sf(value), rel=1e-10)
    assert tails.normal_quantile(norm.cdf(min(value, 3.0))) == pytest.approx(min(value, 3.0), abs=1e-9)


@pytest.mark.parametrize("dof", [1, 3, 50, 2000])
def test_chi_square(dof: int) -> None:
    for value in SUMS:
        assert tails.chi2_tail(value, dof) == pytest.approx(chi2.sf(value, dof), rel=1e-9, abs=1e-300)
    for probability in (1e-9, 1e-3, 0.5):
        limit = tails.chi2_limit(probability, dof)
        assert limit == pytest.approx(chi2.isf(probability, dof), rel=1e-9)
        for squares in (1e-9, 1.0, 100.0, 1e5):
            found = tails.shifted_chi2_tail(limit, dof, squares)
            assert found == pytest.approx(ncx2.sf(limit, dof, squares), abs=1e-9)
