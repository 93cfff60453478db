"""Courses in time: an effect whose amounts change as it acts, straight from knot to knot or in steps."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bcid.base.errors import InputError
from bcid.forms.effects.effect import BodyEffect, Effect

Array = NDArray[np.float64]


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
    # Where a course of an inclusion may be is tried by its constant amounts.
    return replace(found, around=None) if isinstance(found, BodyEffect) else found


def course_of(effect: Effect) -> Course | None:
    """The course that an effect's amounts follow; None where they follow none."""
    return effect.acting if isinstance(effect.acting, Course) else None


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
