"""Soft anchor: an anchored patch is held by springs instead of rigidly.

Potential: k/2 |u|^2 per rest area of the patch, of the components that it holds, with the stiffness k (Pa/m); a layer of Young's
modulus E and thickness h has about E/h. It acts on every anchored patch, or on the one that is its place; those patches are no
longer fixed. An infinite stiffness is the rigid anchor. A patch that holds along the normal of its surface, or within it, has no
axes, and stays as it is.
"""

from __future__ import annotations

import math
from typing import Any

from bcid.forms.effects.effect import BodyEffect, Constants, Point
from bcid.forms.parameter import Amount
from bcid.scene import Scene


def potential(point: Point, c: Constants) -> Any:
    """Energy of the springs."""

    def stored(patch: str) -> Any:
        return c["stiffness"] / 2 * sum(point.u[axis] ** 2 for axis in point.held_along(patch))

    patches = [point.place] if point.place else point.patches
    return sum(point.anchored(patch) * stored(patch) * point.surface(patch) for patch in patches)


def places(scene: Scene, anchors: frozenset[str]) -> list[str]:
    """All anchored patches that hold along axes together, and each of them."""
    if scene.patches and not any(map(scene.held_along, scene.patches)):
        return []
    return ["", *(patch for patch in sorted(anchors) if scene.held_along(patch))]


effect = BodyEffect(
    name="soft_anchor",
    parameters=(
        Amount(
            "stiffness",
            "Pa/m",
            "force per area and displacement",
            lower=0.0,
            open_lower=True,
            neutral=math.inf,
            scale=1e6,
        ),
    ),
    about="anchored patches are held by springs instead of rigidly",
    acts_on="boundary",
    potential=potential,
    frees=True,
    places=places,
)
