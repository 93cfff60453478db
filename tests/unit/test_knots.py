"""Steps of an action between which what changes smoothly is interpolated."""

from __future__ import annotations

import numpy as np
import pytest

from bcid.comparison.knots import Knots, spread
from bcid.scene.action import Action


def action(along: list[float], across: list[float] | None = None) -> Action:
    steps = np.arange(len(along))
    path = np.column_stack([along, across or np.zeros(len(along)), np.zeros(len(along))])
    return Action("1", 10 + steps, steps, "I", path, np.tile([1.0, 0.0, 0.0, 0.0], (len(along), 1)))


def test_a_straight_way_needs_its_ends_and_its_middle() -> None:
    assert list(Knots.of(action([0, 1, 2, 3, 4, 5, 6, 7, 8])).steps) == [0, 4, 8]
    assert list(Knots.of(action([0, 1, 2, 3, 4, 5, 6, 7, 8]), 1, 5).steps) == [1, 3, 5]


def test_where_it_turns_there_is_an_end() -> None:
    back = Knots.of(action([0, 1, 2, 3, 4, 3, 2, 1, 0]))
    assert list(back.ends) == [0, 4, 8]
    assert list(back.steps) == [0, 2, 4, 6, 8]
    corner = Knots.of(action([0, 1, 2, 3, 3, 3, 3], [0, 0, 0, 0, 1, 2, 3]))
    assert 3 in corner.ends


@pytest.mark.parametrize("steps", [1, 2, 3])
def test_short_actions_are_known_whole(steps: int) -> None:
    assert list(Knots.of(action(list(range(steps)))).steps) == list(range(steps))
    assert list(Knots.of(action(list(range(steps))), 1).steps)[-1] == steps - 1


def test_parabolas_on_each_stretch_are_exact() -> None:
    """With a kink where the way turns; nothing else is touched."""
    way = np.array([0, 1, 2, 3, 4, 3, 2, 1, 0], float)
    exact = np.full((30, 2), 7.0)
    exact[10:19] = np.column_stack([way**2, 3 * way - 0.5 * way**2])
    known = Knots.of(action(list(way)))
    values = exact.copy()
    hidden = np.setdiff1d(np.arange(9), known.steps)
    values[10 + hidden] = np.nan
    bent = known.fill(values)
    assert np.allclose(values, exact)
    # A parabola is a quarter of a step's square above its chord over two steps.
    assert bent == pytest.approx(np.sqrt((1.0**2 + 0.5**2) / 2), rel=0.01)


def test_after_the_last_step_that_is_known_nothing_changes() -> None:
    values = np.arange(30.0)[:, None].copy()
    Knots.of(action([0, 1, 2, 3, 4, 5, 6]), 0, 4).fill(values)
    assert list(values[10:17, 0]) == [10, 11, 12, 13, 14, 14, 14]


def test_steps_are_spread_evenly() -> None:
    assert list(spread(9, 2)) == [0, 4, 8]
    assert list(spread(1, 2)) == [0]
