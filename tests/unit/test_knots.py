"""Steps of an action between which what changes smoothly is interpolated."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from bcid.inference.knots import Knots, knots_of
from bcid.measurement.compared import spread
from bcid.scene.action import Action
from bcid.scene.rotation import from_vector


def action(along: list[float], across: list[float] | None = None) -> Action:
    steps = np.arange(len(along))
    path = np.column_stack([along, across or np.zeros(len(along)), np.zeros(len(along))])
    return Action("1", 10 + steps, steps, "I", path, np.tile([1.0, 0.0, 0.0, 0.0], (len(along), 1)))


def test_on_a_straight_way_three_are_enough() -> None:
    assert list(Knots.of(action([0, 1, 2, 3, 4, 5, 6, 7, 8])).steps) == [0, 4, 8]
    assert list(Knots.of(action([0, 1, 2, 3, 4, 5, 6, 7, 8]), 1, 5).steps) == [1, 3, 5]


def test_the_way_back_is_known_from_the_way_there() -> None:
    back = Knots.of(action([0, 1, 2, 3, 4, 3, 2, 1, 0]))
    values = np.arange(30.0)[:, None].copy()
    back.fill(values)
    assert len(back.steps) == 3
    assert np.allclose(values[10:15], values[18:13:-1], atol=1e-6)


def test_what_is_a_matter_of_time_is_not_the_same_on_the_way_back() -> None:
    there = action([0, 1, 2, 3, 4, 3, 2, 1, 0])
    values = np.zeros((30, 1))
    values[10:19, 0] = np.arange(9.0) * (4 - np.abs(np.arange(9.0) - 4))
    exact = values.copy()
    known = Knots.of(there, timed=True)
    values[10 + np.setdiff1d(np.arange(9), known.steps)] = np.nan
    known.fill(values)
    assert np.allclose(values, exact, atol=0.2)


def test_what_depends_on_the_direction_is_known_on_both_sides_of_a_turn() -> None:
    there = action([0, 1, 2, 3, 4, 5, 6, 5, 4, 3, 2])
    plain: Any = SimpleNamespace(terms=())
    known = knots_of(plain, [there], np.ones(21, dtype=bool), directed=True)
    assert known is not None
    assert [(one.steps[0], one.steps[-1]) for one in known] == [(1, 6), (7, 10)]
    values = np.full((21, 1), np.nan)
    for one, sign in zip(known, (1.0, -1.0), strict=True):
        values[10 + one.steps] = sign
    for one in known:
        one.fill(values)
    assert np.allclose(values[11:, 0], [1.0] * 6 + [-1.0] * 4, atol=0.01)


def test_what_bends_needs_more() -> None:
    angle = np.linspace(0, np.pi, 21)
    around = Knots.of(action(list(np.cos(angle)), list(np.sin(angle))))
    assert 5 <= len(around.steps) <= 9


def test_what_the_gripper_is_measured_to_shake_needs_no_more() -> None:
    straight = action([0, 1, 2, 3, 4, 5, 6, 7, 8])
    shaken = np.random.default_rng(1).normal(0, np.radians(0.02), (9, 3))
    turned = replace(straight, rotation=from_vector(np.degrees(shaken)))
    assert len(Knots.of(turned).steps) <= 4


@pytest.mark.parametrize("steps", [1, 2, 3])
def test_short_actions_are_known_whole(steps: int) -> None:
    assert list(Knots.of(action(list(range(steps)))).steps) == list(range(steps))
    assert list(Knots.of(action(list(range(steps))), 1).steps)[-1] == steps - 1


def test_parabolas_are_exact_wherever_the_way_turns() -> None:
    """To the nugget and what the process makes of it; nothing else is touched."""
    along = np.array([0, 1, 2, 3, 4, 4, 4, 4, 4, 3, 2], float)
    across = np.array([0, 0, 0, 0, 0, 1, 2, 3, 4, 4, 4], float)
    exact = np.full((30, 2), 7.0)
    exact[10:21] = np.column_stack([along**2 - across, 3 * along * across])
    known = Knots.of(action(list(along), list(across)))
    values = exact.copy()
    hidden = np.setdiff1d(np.arange(len(along)), known.steps)
    assert len(hidden) >= 2
    values[10 + hidden] = np.nan
    bent = known.fill(values)
    assert np.allclose(values, exact, atol=0.01 * np.ptp(exact[10:21]))
    assert bent < 0.02 * np.ptp(exact[10:21])


def test_a_jump_is_told() -> None:
    known = Knots.of(action(list(range(21))))
    values = np.zeros((40, 1))
    values[20:] = 1.0
    assert known.fill(values) > 0.03


def test_after_the_last_step_that_is_known_nothing_changes() -> None:
    values = np.arange(30.0)[:, None].copy()
    Knots.of(action([0, 1, 2, 3, 4, 5, 6]), 0, 4).fill(values)
    assert values[10:17, 0] == pytest.approx([10, 11, 12, 13, 14, 14, 14], abs=0.01)


def test_steps_are_spread_evenly() -> None:
    assert list(spread(9, 2)) == [0, 4, 8]
    assert list(spread(1, 2)) == [0]
