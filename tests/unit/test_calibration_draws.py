"""Simulation-based calibration: how draws are judged, and what the table and the diagram say of them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bcid.inference.hypotheses import Hypothesis, HypothesisOdds
from validation import calibration


def draws(stated: float, right: float, count: int = 400) -> list[dict[str, Any]]:
    """Answers of which so many are right, with ranks that are uniform where that is as stated."""
    rng = np.random.default_rng(1)
    made = [[stated, bool(rng.random() < right)] for _ in range(count)]
    ranks = rng.random(count) ** (1.0 if stated == right else 3.0)
    return [{"verdict": one, "anchors": one, "rank": float(rank)} for one, rank in zip(made, ranks, strict=True)]


def test_calibration_error_is_the_distance_of_stated_and_right() -> None:
    pairs = [(0.95, True)] * 7 + [(0.95, False)] * 3 + [(0.55, True)] * 5 + [(0.55, False)] * 5
    assert calibration.reliability(pairs) == [(pytest.approx(0.55), 0.5, 10), (pytest.approx(0.95), 0.7, 10)]
    assert calibration.calibration_error(pairs) == pytest.approx((0.05 + 0.25) / 2)


@pytest.mark.parametrize("right", [0.8, 0.5])
def test_table_shows_answers_that_are_stated_as_too_probable(right: float) -> None:
    text = calibration.table({10.0: draws(0.8, right)}).text()
    cells = text.splitlines()[-1].split()
    assert cells[:2] == ["10", "400"]
    assert (float(cells[3]) < 0.05) == (right == 0.8)
    assert (float(cells[6]) > 0.01) == (right == 0.8)


def test_judged_rank_is_uniform_within_the_probability_of_the_truth() -> None:
    one, other = Hypothesis(frozenset("1")), Hypothesis(frozenset("12"), "gravity")
    odds = HypothesisOdds({one: 0.7, other: 0.3})
    found = calibration.judged(other, odds, 0.5)
    assert found == {"verdict": [0.7, False], "anchors": [0.7, False], "rank": pytest.approx(0.85)}
    assert calibration.judged(one, odds, 0.5)["rank"] == pytest.approx(0.35)


def test_picture_is_written(tmp_path: Path) -> None:
    found = {3.0: draws(0.8, 0.8), 10.0: draws(0.4, 0.5)}
    assert calibration.picture(found, tmp_path / "made.png").stat().st_size > 10_000
