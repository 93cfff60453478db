"""Fitting from two starting points, so that a local minimum is seen to be one."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress

import numpy as np

from bcid.base.errors import InputError, SolveError
from bcid.base.units import WIDE
from bcid.comparison.fit import Fit, fit
from bcid.comparison.state import State

# Chi-squares that differ by less are equal: the data prefer neither by more than a factor of 1.6.
_EQUAL = 1.0


def fit_twice(start: State, names: Sequence[str]) -> tuple[Fit, str]:
    """A fit of numbers of a model, of which constants of the law are begun at a second point as well; collective.

    The second point lies a notable change away from where the first fit ended, in another direction for each constant in turn.

    Args:
        start: where to begin.
        names: full names of the numbers.

    Returns:
        The better of both, and a warning where they end in different minima, else "".

    Raises:
        InputError, SolveError: as `bcid.comparison.fit.fit`, of the first.
    """
    first = fit(start, names)
    second = _again(first, names)
    if second is None:
        return first, ""
    best, other = (second, first) if second.state.chi2 < first.state.chi2 - _EQUAL else (first, second)
    apart = {name for name, value in best.values.items() if _differ(best, other, name, value)}
    if not apart:
        return best, ""
    worse = other.state.chi2 - best.state.chi2
    ends = ", ".join(f"{name} = {other.values[name]:.4g}" for name in best.values if name in apart)
    fits = "fits as well" if worse < _EQUAL else f"is worse by {worse:.3g} in chi-square"
    return best, f"another starting point ends in a minimum at {ends}, which {fits}"


def _again(first: Fit, names: Sequence[str]) -> Fit | None:
    """The fit from the second starting point; None without constants of the law, and where it cannot be followed."""
    law = [c for c in first.coordinates if c.name in first.state.model.values]
    moved = {}
    for number, c in enumerate(law):
        lower, upper = c.bounds
        at = c.of(first.values[c.name])
        step = c.scale if number % 2 == 0 else -c.scale
        step = step if lower < at + step < upper else -step
        moved[c.name] = c.allowed(float(np.clip(at + step, lower, upper)))
    if not moved:
        return None
    with suppress(InputError, SolveError):
        state = first.state
        begun = State.of(
            state.predictor, state.model.with_values(moved), state.anchors, state.errors.mesh, tuple(names)
        )
        return fit(begun, names)
    return None


def _differ(one: Fit, other: Fit, name: str, value: float) -> bool:
    """Whether two fits have values of a number whose 95 % intervals do not meet."""
    return abs(value - other.values[name]) > WIDE * (one.stderr[name] + other.stderr[name])
