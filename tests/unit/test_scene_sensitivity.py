"""The answer with inputs of the scene that are off: as if they were known, from the columns of the covariance alone."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from weighed_sets import POISSON, Sets, force

from bcid.forms.model import Term
from bcid.inference.discrepancy import Evidence
from bcid.inference.error_covariance import ErrorCovariance
from bcid.inference.hypotheses import Hypothesis, HypothesisOdds
from bcid.inference.mesh_error import MeshError
from bcid.inference.priors import PRIORS
from bcid.search.answer.next_steps import leading
from bcid.search.answer.scene_sensitivity import noise_error, reported_as, scene_sensitivity
from bcid.search.fitting.fitted_hypothesis import FittedHypothesis


def test_fitted_without_a_known_input_has_the_evidence_that_was_reported() -> None:
    for one in Sets.of().fitted:
        assert {h: float(v[0]) for h, v in one.logs().items()} == pytest.approx(one.rival.logs)
        # An input that a hypothesis does not have tells nothing of it.
        alone = replace(one, inputs={})
        assert alone.logs(POISSON, np.array([2.0])) == one.logs()


def test_fitted_with_a_known_input_is_that_of_errors_without_it() -> None:
    """With errors made anew, in which the column is not, and forces in their units."""
    sets = Sets.of()
    errors = ErrorCovariance(sets.data, sets.data.sigma, MeshError.unknown(sets.data.mask.shape))
    for one in sets.fitted:
        state = one.rival.judged
        found = one.logs(POISSON, np.array([-2.0, 2.0]))
        for k, value in enumerate((-2.0, 2.0)):
            plain = Evidence.of(errors, state.residual - value * sets.column, [force(errors)]).plain
            assert next(iter(found.values()))[k] == pytest.approx(plain)


def test_scene_sensitivity_names_the_input_on_which_the_answer_depends() -> None:
    sets = Sets.of()
    found = sets.explanation
    rows = scene_sensitivity(found, sets.fitted)
    assert found.odds.best.anchors == frozenset("2")
    answers = {(row.input.name, row.offset): (set(row.answer.anchors), row.depends) for row in rows}
    assert answers["poisson", 2.0] == ({"1"}, True)
    assert answers["poisson", -2.0][0] == {"2"}
    assert not answers["noise", 2.0][1]
    assert not answers["noise", -2.0][1]
    shown = {(row.label, row.shift): row.anchored for row in (one.row("12") for one in rows)}
    assert shown["Poisson's ratio", "+0.06"] == ("1",)
    assert rows[0].row("12").anchored in (("1",), ("2",))
    assert noise_error(found) == PRIORS.noise_error
    assert scene_sensitivity(found, []) == []


def test_springs_without_stiffness_count_as_the_set_without_the_patch() -> None:
    """As they do in the reported probabilities: what they have adds to that set."""
    sets = Sets.of()
    free, other = sets.fitted[0], sets.fitted[1]
    soft = replace(other, reported=free.reported)
    rows = scene_sensitivity(sets.explanation, [free, soft])
    assert {row.answer.anchors for row in rows} == {frozenset("1")}
    assert all(row.answer.held_by == pytest.approx(1.0) for row in rows)
    assert leading([free, soft])[1] == pytest.approx([1.0])
    spring = Term("soft_anchor", {"stiffness": 5e4}, place="2")
    state = SimpleNamespace(anchors=frozenset("12"), model=SimpleNamespace(terms=(spring,)))
    rival = FittedHypothesis(("soft_anchor",), cast("Any", SimpleNamespace(state=state)), Evidence(0.0, -1.0, 1.0), 20)
    odds = HypothesisOdds({Hypothesis(frozenset("1")): 1.0})
    assert reported_as(rival, odds) == Hypothesis(frozenset("1"))
    assert reported_as(rival, HypothesisOdds({rival.hypothesis: 1.0})) == rival.hypothesis
    assert reported_as(rival, HypothesisOdds({})) is None
