"""Units at the border."""

import math

import numpy as np
import pytest

from bcid.base.errors import InputError
from bcid.base.units import (
    falls,
    for_people,
    p_value,
    parse_unit,
    percent,
    quantities,
    quantity,
    show,
    significance,
    uncertain,
    unit_factor,
)


@pytest.mark.parametrize(
    ("text", "like", "value"),
    [
        ("15 kPa", "Pa", 15e3),
        ("15kPa", "Pa", 15e3),
        ("-3.5e-1 mm", "m", -0.35e-3),
        ("1 N/mm^2", "Pa", 1e6),
        ("9.81 kN/m^3", "N/m^3", 9810.0),
        ("1 g", "kg", 1e-3),
        ("2 N*mm", "N*m", 2e-3),
        (".5 rad", "deg", 0.5 * 180 / math.pi),
        ("30 %", "1", 0.3),
        ("3 kPa/mm", "Pa/m", 3e6),
        ("1 m²", "m^2", 1.0),
    ],
)
def test_quantities_become_si(text: str, like: str, value: float) -> None:
    assert quantity(text, like) == pytest.approx(value, rel=1e-14)


def test_vectors_share_one_unit() -> None:
    assert quantities("15 10 12.5 mm", "m", 3) == pytest.approx([0.015, 0.010, 0.0125])
    assert quantities("15, 10, 12.5 mm", "m", 3) == pytest.approx([0.015, 0.010, 0.0125])


@pytest.mark.parametrize(
    ("value", "said"),
    [
        (15, "has no unit"),
        (True, "has no unit"),
        ("15", "has no unit"),
        ("kPa", "is not a quantity"),
        ("", "is not a quantity"),
        ("15 furlong", "is not known"),
        ("15 N", "expected a unit like 'Pa'"),
        ("15 kPa 3", "is not known"),
        ("1 2 kPa", "has 2 number"),
        ("nan kPa", "is not a quantity"),
        ("1e999 kPa", "is not finite"),
        ("1 kPa^x", "is not known"),
        (None, "has no unit"),
    ],
)
def test_nonsense_is_refused_in_words(value: object, said: str) -> None:
    with pytest.raises(InputError, match=said):
        quantity(value, "Pa")


def test_factor_needs_the_right_dimension() -> None:
    assert unit_factor("mm", "m") == 1e-3
    with pytest.raises(InputError, match="cannot be used here"):
        unit_factor("s", "m")
    assert parse_unit("N") == (1.0, (1, 1, -2, 0))
    assert show(15e3, "kPa") == "15 kPa"


def test_p_values_are_shown_as_people_read_them() -> None:
    assert [p_value(p) for p in (4.2e-217, 0.0, 0.00012, 0.034, 1.0)] == [
        "p < 0.0001",
        "p < 0.0001",
        "p = 0.00012",
        "p = 0.034",
        "p = 1",
    ]
    assert p_value(float("nan")) == "p = not known"
    assert significance(float("inf")) == ""


@pytest.mark.parametrize(
    ("probability", "text"),
    [
        (0.9723, "97 %"),
        (0.5, "50 %"),
        (0.0247, "2 %"),
        (0.99, "99 %"),
        (0.9962, "99.6 %"),
        (0.0072, "0.7 %"),
        (0.9994, "99.94 %"),
        (0.0004, "0.04 %"),
        (0.99995, "> 99.99 %"),
        (0.0, "< 0.01 %"),
    ],
)
def test_probabilities_have_digits_only_near_certainty(probability: float, text: str) -> None:
    assert percent(probability) == percent(np.float64(probability)) == text


def test_lengths_are_shown_in_mm() -> None:
    assert for_people(0.0012, 1e-4, "m") == pytest.approx((1.2, 0.1, "mm"))
    assert for_people(5.0, None, "kPa") == (5.0, None, "kPa")
    assert for_people(2e-3, None, "m")[1] is None


def test_a_number_is_told_with_its_error_and_unit() -> None:
    assert uncertain(1257.62, 9.41, "N") == "1257.6 ± 9.4 N"
    assert uncertain(3668369, 1344017, "Pa/m") == "3700000 ± 1300000 Pa/m"
    assert uncertain(10355.4, 344, "N/m^3") == "10360 ± 340 N/m^3"
    assert uncertain(-2.7, 3.1, "deg") == "−2.7 ± 3.1 deg"
    assert uncertain(0.5) == "0.5"
    assert uncertain(math.inf, 1.0, "Pa/m") == "infinite Pa/m"


def test_of_a_number_of_which_nothing_is_known_no_error_is_told() -> None:
    assert uncertain(14198.0, 1e100, "Pa") == "cannot be told"


def test_an_error_that_noise_could_hide_hardly_falls() -> None:
    assert falls(1.42, 0.205, 0.2, "mm") == "falls from 1.42 to 0.205 mm"
    assert falls(0.518, 0.516, 0.1, "mm") == "hardly falls, from 0.518 to 0.516 mm"
    assert falls(0.384, 0.398, 0.1, "mm") == "hardly falls, from 0.384 to 0.398 mm"
