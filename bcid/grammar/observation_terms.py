"""Families of terms of the picture: axes with scales of their own, or not at right angles; a scale that changes over it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bcid.forms.model import Term
from bcid.forms.parameter import Amount
from bcid.grammar.family import OBSERVATION, Family
from bcid.search.fitting.state import State
from bcid.search.fitting.variants import Variant, amounts

Array = NDArray[np.float64]
# A picture is told by this many fiducials at least.
_FEWEST = 4
_PAIRS = ("xx", "yy", "zz", "xy", "xz", "yz")


def observation_terms() -> list[Family]:
    """All families; `code` of one is by how much fiducials are shifted that are `away` from their middle at rest, in NumPy."""
    matrix = ", ".join("[" + ", ".join(f"c['s{min(i, j)}{max(i, j)}']" for j in "xyz") + "]" for i in "xyz")
    sheared = Family(
        "camera_shear", OBSERVATION, "the picture has a scale of its own along each axis, or axes that are not at right angles",
        "seen is x + S (x - m), S symmetric, m the middle of the fiducials at rest", f"return away @ np.array([{matrix}])",
        tuple(Amount(f"s{pair}", "1", _about(pair), lower=-0.5, upper=0.5, neutral=0.0, scale=0.02) for pair in _PAIRS), (),
    )  # fmt: skip
    uneven = Family(
        "camera_perspective", OBSERVATION, "the scale of the picture changes evenly over it",
        "seen is x + (g . (x - m)/size) (x - m), m the middle of the fiducials at rest, size how far these are apart",
        "g = np.array([c['gx'], c['gy'], c['gz']])\nreturn (away @ g / size)[:, None] * away",
        tuple(
            Amount(f"g{axis}", "1", f"change of the scale along {axis}", lower=-1.0, upper=1.0, neutral=0.0, scale=0.04)
            for axis in "xyz"
        ), (),
    )  # fmt: skip
    bulging = Family(
        "camera_distortion", OBSERVATION, "the scale of the picture changes with the square of the distance from its middle",
        "seen is x + k |x - m|^2/size^2 (x - m), m the middle of the fiducials at rest, size how far these are apart",
        "return c['k'] * (np.sum(away**2, axis=1) / size**2)[:, None] * away",
        (Amount("k", "1", "change of the scale at that distance", lower=-1.0, upper=1.0, neutral=0.0, scale=0.1),), (),
    )  # fmt: skip
    return [sheared, uneven, bulging]


def _about(pair: str) -> str:
    return (
        f"change of scale along {pair[0]}"
        if pair[0] == pair[1]
        else f"half the lack of a right angle of {pair[0]} and {pair[1]}"
    )


def picture_is_told(state: State) -> bool:
    """Whether there are fiducials enough, and not all at one place."""
    rest = state.predictor.data.rest
    return len(state.predictor.scene.fiducials) >= _FEWEST and bool(np.ptp(rest, axis=0).any())


def observed_variant(state: State, term: Term) -> Variant:
    """A term of the picture, whose shifts are linear in its amounts; nothing is solved."""
    predictor, count = state.predictor, len(state.predictor.scene.fiducials)
    forward, columns = predictor.forward(state.model), list[Array]()
    for p in term.effect.amounts:
        one, shift = term.with_values({p.name: p.scale}), np.zeros_like(state.predicted)
        for action in predictor.actions:
            for step, frame in enumerate(action.frames):
                at = state.predicted[frame, :count]
                shift[frame, :count] = one.effect.observed(at, one.values, forward.frame(action, step), "") - at
        columns.append(state.errors.whiten(predictor.data.vector(np.nan_to_num(shift / p.scale))))
    return Variant(term, tuple(amounts(term, [p.name for p in term.effect.amounts])), np.column_stack(columns))
