"""The two levels of a comparison: the fine one, and the working one with elements three times as large."""

from __future__ import annotations

from dataclasses import replace

from bcid.base.collective import Comm
from bcid.forms.mesh import level_mesh
from bcid.scene import Level, Scene

# So many unknowns of the fine level are affordable.
_AFFORDABLE = 40_000
# The working mesh has elements so many times as large as those of the fine one.
_COARSER = 3.0


def affordable(scene: Scene, comm: Comm) -> int:
    """The last level of a ladder with at most `_AFFORDABLE` unknowns; collective."""
    mixed = scene.material.formulation == "mixed"
    for number in reversed(range(1, len(scene.levels))):
        level = scene.levels[number]
        if level_mesh(scene, level, comm).unknowns(level.degree, mixed) <= _AFFORDABLE:
            return number
    return 0


def pair(scene: Scene, fine: int) -> tuple[Level, ...]:
    """Working level and fine level: elements of the same degree, three times as large and as they are.

    A mesh file cannot be made coarser than it is: there the level below serves, if it has the same degree.
    """
    level = scene.levels[fine]
    if level.element_size is not None:
        return replace(level, element_size=_COARSER * level.element_size), level
    if level.refinements > 0:
        return replace(level, refinements=level.refinements - 1), level
    return (level,)
