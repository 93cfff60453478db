"""Refinement in two rounds, and of halves that leave no trace."""

from unit.test_refine import NOISE, refine, seen


def test_a_quarter_is_found_in_two_rounds() -> None:
    fine = refine(seen("7.2.1", cuts=("7", "7.2")), 2)
    assert fine.found.anchored == ("7.2.1",)
    assert fine.found.probability > 0.95
    assert fine.found.rms < 1.05 * NOISE
    assert fine.refined == {"7": ("7.1", "7.2"), "7.2": ("7.2.1", "7.2.2")}


def test_halves_that_cannot_be_told_apart_are_merged() -> None:
    """Behind the anchored edge 3 hardly anything moves: whether all of 8 is anchored there or only a half leaves no trace."""
    fine = refine(seen("3", "8.2", cuts=("8",)), 1)
    assert fine.refined == {}
    assert fine.found.anchored == ("3", "8")
    assert fine.found.rms < 1.05 * NOISE
