"""Partial anchor: a part of an anchored patch is held by springs, or hardly at all, and the rest of it rigidly.

Potential: k/(2 w) |u|^2 per rest area of the patch that is its place (of each, where it has none), of the components that it holds;
that patch is no longer fixed. Of the compliance 1/k (m/Pa) a point has the share w = 1/(1 + exp((border - s)/0.1)) + 1e-4, where
s goes from -1 at one edge of the patch to 1 at the other in the direction of `angle`. An infinite stiffness is the rigid anchor; a
small one leaves the part beyond the border free.
"""

from __future__ import annotations

import math
from typing import Any

from bcid.forms.effects.effect import BodyEffect, Constants, Point
from bcid.forms.mesh.patch_frame import PatchFrame
from bcid.forms.parameter import Amount, Shape

# Of half the patch: what gives and what holds are told apart over this, so that a border moves smoothly through facets.
_WIDTH = 0.1
# Share of what holds rigidly.
_RIGID = 1e-4


def share(frame: PatchFrame, place: tuple[Any, Any], c: Constants, functions: Any) -> Any:
    """Share of the compliance at a place (x, y) in the plane of a patch, m; `functions` has cos, sin, exp and sqrt."""
    angle = c["angle"] * (math.pi / 180)
    cos, sin, (x, y), (a, b) = functions.cos(angle), functions.sin(angle), place, frame.half
    along = (x * cos + y * sin) / functions.sqrt((a * cos) ** 2 + (b * sin) ** 2)
    return 1 / (1 + functions.exp((c["border"] - along) / _WIDTH)) + _RIGID


def potential(point: Point, c: Constants) -> Any:
    """Energy of the springs."""
    import ufl

    def stored(patch: str) -> Any:
        frame = point.frame(patch)
        stiffness = c["stiffness"] / share(frame, frame.plane(point.X), c, ufl)
        return stiffness / 2 * sum(point.u[axis] ** 2 for axis in point.held_along(patch))

    patches = [point.place] if point.place else point.patches
    return sum(point.anchored(patch) * stored(patch) * point.surface(patch) for patch in patches)


effect = BodyEffect(
    name="partial_anchor",
    parameters=(
        Amount(
            "stiffness",
            "Pa/m",
            "force per area and displacement of the part that gives",
            lower=0.0,
            open_lower=True,
            neutral=math.inf,
            scale=1e6,
        ),
        Shape(
            "angle", "deg", "on which side it gives: from the x axis in the patch's plane (y where the patch faces x)",
            default=0.0, scale=10.0, period=360.0, scan=(0.0, 90.0, 180.0, 270.0),
        ),
        Shape(
            "border", "1", "where it begins to give, from one edge of the patch (-1) to the other (1)",
            default=0.0, lower=-1.0, upper=1.0, scale=0.2, scan=(-0.5, 0.0, 0.5),
        ),
    ),
    about="a part of an anchored patch is not held",
    acts_on="boundary",
    potential=potential,
    share=share,
    frees=True,
    places=lambda scene, anchors: [patch for patch in sorted(anchors) if scene.held_along(patch)],
)  # fmt: skip
