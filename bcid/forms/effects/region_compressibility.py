"""Region compressibility: a part of the body whose outline is known has another Poisson's ratio than the rest.

In the region the constant poisson of the law is replaced as by `compressibility`: it is poisson + s (own - poisson), where s is the
share of a cell that lies in the region (see `region_stiffness`). Without influence at the law's own value.
"""

from __future__ import annotations

from bcid.forms.effects._needs import regions
from bcid.forms.effects._poisson import law_with_poisson, poisson
from bcid.forms.effects.effect import BodyEffect
from bcid.measurement import Measurement
from bcid.scene import Scene


def places(scene: Scene, _anchors: frozenset[str]) -> list[str]:
    """The regions whose own Poisson's ratio is not stated."""
    return [name for name, region in scene.regions.items() if "poisson" not in region.constants]


def needs(scene: Scene, measurement: Measurement) -> str:
    """A region whose Poisson's ratio is not stated, and a law that has one."""
    stated = "" if places(scene, frozenset()) else "the scene states the poisson of every region"
    return regions(scene, measurement) or stated or law_with_poisson(scene, measurement)


effect = BodyEffect(
    name="region_compressibility",
    parameters=(poisson,),
    about="a region of the body has another Poisson's ratio",
    acts_on="material",
    constants=lambda c: {"poisson": c["poisson"]},
    places=places,
    needs=needs,
)
