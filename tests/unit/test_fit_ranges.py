"""Ranges and scales of the numbers that are fitted: what a formulation supports, and steps from zero."""

from __future__ import annotations

import pytest

from bcid.forms import materials
from bcid.forms.model import Model
from bcid.search.answer.explanation import verdict_of
from bcid.search.fitting.fit import coordinates

NEO = {"young": 15e3, "poisson": 0.42}


@pytest.mark.parametrize("poisson", [0.35, 0.42, 0.45, 0.499])
@pytest.mark.parametrize("asked", [0.5, 0.7, -1.0, -5.0])
def test_poisson_displacement_formulation_stays_in_its_range(poisson: float, asked: float) -> None:
    model = Model(materials.law("neo_hooke"), NEO | {"poisson": poisson})
    (number,) = coordinates(model, ["poisson"])
    moved = model.with_values({"poisson": number.allowed(asked)})
    assert -1 < moved.values["poisson"] <= max(0.495, poisson)


@pytest.mark.parametrize("asked", [0.6, 0.0, -0.3])
def test_poisson_mixed_formulation_stays_in_its_range(asked: float) -> None:
    model = Model(materials.law("neo_hooke"), NEO | {"poisson": 0.499}, "mixed")
    (number,) = coordinates(model, ["poisson"])
    moved = model.with_values({"poisson": number.allowed(asked)})
    assert 0 < moved.values["poisson"] <= 0.5


def test_constant_that_starts_at_zero_has_the_scale_of_the_stiffness() -> None:
    model = Model(materials.law("mooney_rivlin"), {"c10": 25e3, "c01": 0.0, "poisson": 0.45})
    first, second = coordinates(model, ["c10", "c01"])
    assert second.scale == pytest.approx(first.scale)
    assert second.scale == pytest.approx(model.law.shear(model.values) / 3)


def test_pure_numbers_have_the_scale_that_they_declare() -> None:
    model = Model(materials.law("neo_hooke"), NEO | {"poisson": 0.0})
    (number,) = coordinates(model, ["poisson"])
    assert number.scale == pytest.approx(0.1)


@pytest.mark.parametrize(
    ("effects", "unknown", "nearly", "adequate", "verdict"),
    [
        ((), False, False, True, "none"),
        ((), False, False, False, "unknown"),
        ((), True, False, True, "unknown"),
        (("gravity",), False, True, False, "gravity"),
        (("gravity",), True, True, False, "gravity"),
        (("gravity",), True, False, False, "unknown"),
        (("gravity", "fibres"), False, True, True, "gravity+fibres"),
    ],
)
def test_verdict_none_only_where_the_data_do_not_refute_it(
    effects: tuple[str, ...], unknown: bool, nearly: bool, adequate: bool, verdict: str
) -> None:
    assert verdict_of(effects, unknown, nearly, adequate) == verdict
