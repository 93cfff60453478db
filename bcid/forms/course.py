"""Courses in time: an effect whose amounts change as it acts, straight from knot to knot or in steps."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bcid.base.errors import InputError
from bcid.base.units import quantity
from bcid.forms.effects.effect import BodyEffect, Effect, GripEffect

Array = NDArray[np.float64]
# Words with which a user asks for a course, and whether it is stepwise.
COURSES = {"course": False, "stepwise": True}


@dataclass(frozen=True)
class Course:
    """The values of an effect's parameters that act at a time, where each amount has a value at every knot.

    Between two knots an amount goes straight from one value to the next, or keeps the one of the earlier knot; before the first
    knot and after the last it stays.

    Attributes:
        effect: the same effect with constant amounts.
        times: of the knots, rising, s.
        stepwise: whether the amounts jump at the knots, and are constant between them.
    """

    effect: Effect
    times: tuple[float, ...]
    stepwise: bool = False

    def __call__(self, time: float, values: Mapping[str, float]) -> dict[str, float]:
        """Values of the parameters of `effect` at a time, s, from those of the course."""
        weights = self.weights(time)[0]
        found = {p.name: values[p.name] if p.off is None else p.off for p in self.effect.shapes}
        for p in self.effect.amounts:
            found[p.name] = float(weights @ [values[name] for name in self.names(p.name)])
        return found

    def names(self, amount: str) -> tuple[str, ...]:
        """Parameters that are the values of an amount at the knots."""
        return tuple(f"{amount}_{number + 1}" for number in range(len(self.times)))

    def weights(self, times: ArrayLike) -> Array:
        """How much of the value at each knot acts at given times, s, shape (times, knots): every row adds up to one."""
        at = np.atleast_1d(np.asarray(times, dtype=float))
        if self.stepwise:
            last = np.clip(np.searchsorted(self.times, at, side="right") - 1, 0, None)
            return np.eye(len(self.times))[last]
        return np.column_stack([np.interp(at, self.times, hat) for hat in np.eye(len(self.times))])


def in_time(effect: Effect, times: Iterable[float], stepwise: bool = False) -> Effect:
    """The same effect with amounts that follow a course: for each of them a value at every knot, as ``amplitude_1``.

    Shapes are those of the effect, but for one that may stand for none (a period), which does. The effect may be one of the body,
    the grip or the picture; its `acting` is the `Course`. Two courses of the same effect and knots are equal.

    Args:
        effect: with constant amounts.
        times: of the knots, rising, in the time of the measurement's actions, s.
        stepwise: whether the amounts jump at the knots, and are constant between them.

    Raises:
        InputError: its amounts cannot follow a course, or the times do not rise.
    """
    knots = tuple(map(float, times))
    problem = _refused(effect) or _not_rising(knots)
    if problem:
        raise InputError(f"{effect.name}: {problem}")
    course = Course(effect, knots, stepwise)
    values = [
        replace(p, name=name, about=f"{p.about}, at {at:.6g} s")
        for p in effect.amounts
        for name, at in zip(course.names(p.name), knots, strict=True)
    ]
    shapes = [p for p in effect.shapes if p.off is None]
    about = f"{effect.about}, by amounts that change with time"
    found = replace(effect, name=f"{effect.name}_in_time", parameters=(*values, *shapes), about=about, acting=course)
    # Where a course of an inclusion may be, and how late a clock, is tried by constant amounts.
    if isinstance(found, BodyEffect):
        return replace(found, around=None)
    return replace(found, retimed=None) if isinstance(found, GripEffect) else found


def course_of(effect: Effect) -> Course | None:
    """The course that an effect's amounts follow; None where they follow none."""
    return effect.acting if isinstance(effect.acting, Course) else None


def constant(effect: Effect) -> Effect:
    """The effect with constant amounts that one in time is made of; an effect that follows no course itself."""
    course = course_of(effect)
    return effect if course is None else course.effect


def of_table(effect: Effect, table: Mapping[str, Any]) -> tuple[Effect, dict[str, Any]]:
    """An effect of a scene with its values as written, in time where its table has the times of a course.

    A list of values belongs to the times one by one; a single value of an amount holds at all of them.

    Raises:
        InputError: the times, or the number of values, cannot be used.
    """
    asked = [word for word in COURSES if word in table]
    lists = [p.name for p in effect.amounts if isinstance(table.get(p.name), list)]
    if not asked and lists:
        raise InputError(f'{lists[0]} is a list: add the times of its values, as course = ["0 s", "10 s"]')
    if not asked:
        return effect, dict(table)
    if len(asked) > 1:
        raise InputError("course and stepwise exclude each other: give the times to one of them")
    moving = in_time(effect, _times(asked[0], table[asked[0]]), COURSES[asked[0]])
    course = course_of(moving)
    assert course is not None
    found = {name: value for name, value in table.items() if name not in asked}
    for p in effect.amounts:
        if p.name in found:
            found |= zip(course.names(p.name), _each(p.name, found.pop(p.name), len(course.times)), strict=True)
        elif not set(course.names(p.name)) & set(found):
            raise InputError(
                f"{p.name} is missing: give {len(course.times)} values, one for each time, or a single one"
            )
    return moving, found


def _times(word: str, written: object) -> list[float]:
    if not isinstance(written, list):
        raise InputError(f'{word} = {written!r}: expected a list of times, as ["0 s", "10 s"]')
    try:
        return [quantity(time, "s") for time in written]
    except InputError as error:
        raise InputError(f"{word}: {error}") from None


def _each(name: str, written: object, count: int) -> Sequence[object]:
    """The written value of an amount at every knot."""
    if not isinstance(written, list):
        return [written] * count
    if len(written) != count:
        raise InputError(f"{name}: found {len(written)} values for {count} times; give one for each")
    return written


def _refused(effect: Effect) -> str:
    """Why the amounts of an effect cannot follow a course, in words; "" where they can."""
    onsets = [p.name for p in effect.shapes if p.onset]
    springs = [p.name for p in effect.amounts if p.reciprocal]
    if course_of(effect):
        return "its amounts follow a course already"
    if effect.memory or effect.uses_past:
        return "it remembers earlier steps: its amounts must be constant in time"
    if onsets:
        return f"it begins at a frame of its own ({', '.join(onsets)}): its amounts must be constant after that"
    if springs:
        return f"nothing is left of it only where {', '.join(springs)} is infinite: no course leads from there"
    if effect.acting and not any(p.off is not None for p in effect.shapes):
        return "its amounts change with time already, in a way of their own"
    return "" if effect.amounts else "it has no amounts"


def _not_rising(times: tuple[float, ...]) -> str:
    told = ", ".join(f"{time:g}" for time in times)
    if len(times) < 2:
        return f"a course needs at least two knots, found {len(times)}"
    if not np.isfinite(times).all() or (np.diff(times) <= 0).any():
        return f"the times of a course must rise from knot to knot, found {told} s"
    return ""
