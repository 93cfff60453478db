"""The answer with inputs of the scene that are off: as if they were known, from the columns of the covariance alone."""

from __future__ import annotations

import numpy as np
import pytest
from weighed_sets import POISSON, Sets, force

from bcid.comparison.answer_text import sensitivity
from bcid.comparison.scene_sensitivity import WeighedHypothesis, noise_error, scene_sensitivity
from bcid.inference.likelihood import Errors
from bcid.inference.mesh_error import MeshError
from bcid.inference.priors import PRIORS
from bcid.inference.unknown_force import Evidence


def test_fitted_without_a_known_input_has_the_evidence_that_was_reported() -> None:
    for one in Sets.of().fitted:
        assert {h: float(v[0]) for h, v in one.logs().items()} == pytest.approx(one.rival.logs)
        # An input that a hypothesis does not have tells nothing of it.
        alone = WeighedHypothesis(one.rival, one.numbers, {})
        assert alone.logs(POISSON, np.array([2.0])) == one.logs()


def test_fitted_with_a_known_input_is_that_of_errors_without_it() -> None:
    """With errors made anew, in which the column is not, and forces in their units."""
    sets = Sets.of()
    errors = Errors(sets.data, sets.data.sigma, MeshError.unknown(sets.data.mask.shape))
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
    text = "\n".join(sensitivity(rows, "12"))
    assert "Poisson's ratio +0.06: nothing missing" in text
    assert "anchored {1}" in text
    same = sensitivity([row for row in rows if not row.depends], "12")
    assert same[0] == "The answer is the same for noise at ±2 standard deviations."
    assert rows[0].to_json("12")["anchored"] in (["1"], ["2"])
    assert noise_error(found) == PRIORS.noise_error
    assert scene_sensitivity(found, []) == []
