"""What is believed most is fitted, and so is the same without each of its effects: an effect is believed against that."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import pytest

from bcid.comparison.compared import Compared
from bcid.comparison.explanation import Explanation
from bcid.comparison.rivals import Rival
from bcid.inference.hypotheses import Hypothesis, HypothesisOdds
from bcid.inference.unknown_force import Evidence


def rival(names: tuple[str, ...], anchors: str, evidence: float) -> Rival:
    """A hypothesis that was compared with all steps, with so much evidence and no error of the mesh."""
    errors = SimpleNamespace(mesh=SimpleNamespace(rms=0.0))
    state = SimpleNamespace(anchors=frozenset(anchors), noise=1.0, errors=errors)
    return Rival(names, cast("Any", SimpleNamespace(state=state)), Evidence(evidence, evidence - 50, 1.0), 20)


def less(anchors: str, effect: str = "") -> Hypothesis:
    return Hypothesis(frozenset(anchors), effect)


@pytest.mark.parametrize(
    ("full", "wanted"),
    [
        ([rival(("gravity",), "1", 100), rival((), "2", 80)], less("1")),
        ([rival(("gravity",), "1", 100), rival((), "1", 80)], None),
        ([rival(("gravity", "fibres"), "1", 100), rival((), "1", 80)], less("1", "gravity")),
        ([rival(("gravity", "fibres"), "1", 100), rival(("gravity",), "1", 80)], less("1", "fibres")),
        ([rival((), "1", 100), rival(("gravity",), "2", 80)], None),
    ],
)
def test_an_effect_is_weighed_against_the_same_anchors_without_it(full: list[Rival], wanted: Hypothesis | None) -> None:
    assert Compared(own=full, full=full).unopposed() == wanted


@pytest.mark.parametrize(("misses", "least"), [([-400.0, -350.0, -700.0], 0.8), ([-300.0], 2 / 3), ([], 1.0)])
def test_sets_that_were_not_fitted_are_no_likelier_together_than_that_one_more_wins(
    misses: list[float], least: float
) -> None:
    """However many there are, where those that were shown to be likelier have lost."""
    full = [rival((), "1", 100), rival((), "2", -300)]
    others = {frozenset(f"3{name}"): -20.0 for name in "456789abcdefghijklmnopqrstuvwxyz" * (1 if misses else 0)}
    compared = Compared(own=full, full=full, about=full[0], shown=others, misses=misses)
    assert compared.odds.held_by(frozenset("1")) == pytest.approx(least, abs=1e-6)
    # Where another set than that whose tangent was asked is the best, nothing was lost to it.
    elsewhere = replace(compared, about=full[1])
    assert elsewhere.odds.held_by(frozenset("1")) > 0.999


def test_of_an_effect_it_is_told_how_probable_it_is_whatever_else_acts() -> None:
    names = {"gravity": 0.6, "gravity+fibres": 0.3, "": 0.1}
    odds = HypothesisOdds.of({less("1", name): math.log(share) for name, share in names.items()})
    nothing: Any = None
    found = Explanation("gravity", odds, (), nothing, (), nothing, {}, 0.0)
    assert found.probability == pytest.approx(0.9)
    assert found.ambiguous == ("gravity+fibres", "none")
    assert Explanation("none", odds, (), nothing, (), nothing, {}, 0.0).probability == pytest.approx(0.1)


def test_what_cannot_be_followed_is_not_asked_for_again() -> None:
    full = [rival(("gravity",), "1", 100), rival((), "2", 80)]
    compared = Compared(own=full, full=full)
    compared.refuse(less("1"))
    assert compared.unopposed() is None
