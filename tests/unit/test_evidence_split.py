"""Differences of log evidence, split: they add up, and a hypothesis that wins without fitting better is visible as such."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import pytest

from bcid.inference.discrepancy import Evidence
from bcid.inference.hypotheses import Hypothesis, HypothesisOdds, log_prior
from bcid.search.answer.evidence_split import evidence_splits
from bcid.search.fitting.fitted_hypothesis import FittedHypothesis


def rival(names: tuple[str, ...], anchors: str, chi2: float, occam: float, forced: float = -9.0) -> FittedHypothesis:
    """With a volume of 7 for each patch."""
    volume = 7.0 * len(anchors)
    state = SimpleNamespace(anchors=frozenset(anchors), chi2=chi2, errors=SimpleNamespace(log_volume=volume))
    plain = -0.5 * chi2 - volume + occam
    return FittedHypothesis(names, cast("Any", SimpleNamespace(state=state)), Evidence(plain, plain + forced, 1.0), 20)


RIVALS = [rival((), "1", 100.0, 0.0), rival(("gravity",), "1", 99.0, -2.5), rival((), "12", 160.0, 0.0)]
ODDS = HypothesisOdds.of({h: log for one in RIVALS for h, log in one.logs.items()})


def test_evidence_splits_parts_add_up_to_the_difference() -> None:
    first = Hypothesis(frozenset("1"))
    found = evidence_splits(RIVALS, ODDS, first)
    logs = {h: log for one in RIVALS for h, log in one.logs.items()}
    assert [one.hypothesis for one in found][:2] == [first, Hypothesis(frozenset("1"), "gravity")]
    assert found[0].total == 0
    assert [one.total for one in found] == pytest.approx([logs[one.hypothesis] - logs[first] for one in found])
    heavy = found[1]
    assert (heavy.misfit, heavy.volume, heavy.occam) == pytest.approx((0.5, 0.0, -2.5))
    assert heavy.prior == pytest.approx(log_prior(1, False, 20))
    assert {one.hypothesis: one.discrepancy for one in found}[Hypothesis(frozenset("1"), "", True)] == -9.0
    assert heavy.row("12").effects == ("gravity",)
    # What is the same as another has no row, as springs without stiffness.
    others = HypothesisOdds({h: p for h, p in ODDS.probabilities.items() if h != heavy.hypothesis})
    assert heavy.hypothesis not in [one.hypothesis for one in evidence_splits(RIVALS, others, first)]
    # What was not compared with all steps has no parts.
    assert evidence_splits(RIVALS, ODDS, Hypothesis(frozenset("3"))) == []
