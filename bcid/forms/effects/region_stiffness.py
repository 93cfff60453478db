"""Region stiffness: a part of the body whose outline is known is stiffer or softer than the rest.

The law's energy is multiplied by ratio^s, where s is the share of a cell that lies in the region: a physical volume of the mesh,
or what a shape of the scene's [regions] encloses. Cells that an outline cuts so are between those that lie beside each other and
those that lie one behind the other (the logarithmic mixture of K. Lichtenecker, Phys. Z. 27, 1926); of a mesh that is fitted to
the region there are none.
"""

from __future__ import annotations

from typing import Any

from bcid.forms.effects._needs import regions
from bcid.forms.effects.effect import BodyEffect, Constants, Point
from bcid.forms.parameter import Amount
from bcid.scene import Scene


def stiffness(point: Point, c: Constants) -> Any:
    """Factor of the strain energy."""
    return c["ratio"] ** point.share(point.place)


def places(scene: Scene, _anchors: frozenset[str]) -> list[str]:
    """The regions whose stiffness is not stated by constants of their own."""
    return [name for name, region in scene.regions.items() if not set(region.constants) - {"poisson"}]


effect = BodyEffect(
    name="region_stiffness",
    parameters=(
        Amount("ratio", "1", "its stiffness to that of the body", lower=0.02, upper=50.0, neutral=1.0, scale=1.0),
    ),
    about="a region of the body is stiffer or softer",
    acts_on="material",
    stiffness=stiffness,
    places=places,
    needs=regions,
)
