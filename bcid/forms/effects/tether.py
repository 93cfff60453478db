"""Tether: springs along one direction hold a patch that is not anchored, as a ligament does.

Potential: k/2 (a . u)^2 per rest area of the patch that is its place, with the stiffness k (Pa/m) and the direction
a = cos(angle) e1 + sin(angle) e2, e1 and e2 being the axes of the scene's `fibre_plane`. The other end is fixed, and so far away
that the direction does not change.
"""

from __future__ import annotations

from typing import Any

import ufl

from bcid.forms.effects._direction import angle
from bcid.forms.effects.effect import BodyEffect, Constants, Point
from bcid.forms.parameter import Amount


def potential(point: Point, c: Constants) -> Any:
    """Energy of the springs."""
    along = ufl.inner(point.kin.direction(c["angle"]), point.u)
    return c["stiffness"] / 2 * along**2 * point.surface(point.place)


effect = BodyEffect(
    name="tether",
    parameters=(
        Amount("stiffness", "Pa/m", "force per area and displacement", lower=0.0, neutral=0.0, scale=1e5),
        # (a . u) a is a polynomial in cos 2a: three values determine it.
        angle(harmonics=1),
    ),
    about="springs along one direction hold a patch that is not anchored",
    acts_on="boundary",
    potential=potential,
    places=lambda scene, anchors: [patch for patch in scene.patches if patch not in anchors],
)
