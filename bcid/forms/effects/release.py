"""Release: an anchored patch comes off, and stays off.

From the frame with the number `onset` on (counted over the whole measurement from 0) the patch that is its place is not held
any more. `released` is 1 for that, and 0 for a patch that stays. The body is elastic, so that it does not matter how it got there:
what is seen after the onset is what the other anchors alone show. With effects that remember it is taken to have been off since
the start of the action in which it comes off.
"""

from __future__ import annotations

from collections.abc import Mapping

from bcid.forms.effects.effect import AnchorEffect
from bcid.forms.parameter import Amount, Shape


def held(anchors: frozenset[str], frame: int, values: Mapping[str, float], place: str) -> frozenset[str]:
    """The patches that are held in a frame."""
    return anchors - {place} if values["released"] > 0.5 and frame >= values["onset"] else anchors


effect = AnchorEffect(
    name="release",
    parameters=(
        Amount(
            "released", "1", "1 where it comes off, 0 where it stays", lower=0.0, upper=1.0, neutral=0.0, scale=1.0,
            switch=True,
        ),
        Shape("onset", "1", "first frame in which it is off", default=0.0, lower=0.0, scan=(0.0,), onset=True),
    ),
    about="an anchored patch comes off and stays off",
    held=held,
    places=lambda _scene, anchors: sorted(anchors),
)  # fmt: skip
