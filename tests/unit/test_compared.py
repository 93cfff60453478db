"""What is believed most is fitted, and so is the same without each of its effects: an effect is believed against that."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import pytest

from bcid.comparison.compared import Compared
from bcid.comparison.rivals import Rival
from bcid.inference.hypotheses import Hypothesis
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


def test_what_cannot_be_followed_is_not_asked_for_again() -> None:
    full = [rival(("gravity",), "1", 100), rival((), "2", 80)]
    compared = Compared(own=full, full=full)
    compared.refuse(less("1"))
    assert compared.unopposed() is None
