"""The two levels of a comparison: a working one, and a fine one that tells how wrong it is."""

from __future__ import annotations

from dataclasses import replace

from bcid.base.collective import Comm
from bcid.forms.mesh import level_mesh
from bcid.forms.mesh.patches import first_level
from bcid.scene import Level, Scene

# So many unknowns of a level of the ladder are affordable.
_AFFORDABLE = 40_000
# Elements of both levels are so many times as large as those of the ladder's: of the working one as large as leaves it so many
# unknowns, of the fine one as small as gives it no more than so many.
_TIMES, _WORKING, _FINE = (1.0, 1.5, 2.0, 3.0), 2_000, 20_000


def affordable(scene: Scene, comm: Comm) -> int:
    """The last level of a ladder with at most `_AFFORDABLE` unknowns; collective."""
    for number in reversed(range(1, len(scene.levels))):
        if _unknowns(scene, scene.levels[number], comm) <= _AFFORDABLE:
            return number
    return 0


def pair(scene: Scene, number: int, comm: Comm) -> tuple[Level, ...]:
    """Working level and fine level that belong to a level of the ladder; collective.

    The working level has larger elements of the same degree. The fine one has elements of one degree more: where patches end, in
    unknowns the error falls twice as fast with the degree as with the size of elements, and elsewhere by another order (Babuska &
    Suri, SIAM Rev. 36, 1994).

    A mesh file cannot be made coarser than it is: there the level below is the working one, or else the level itself; and where
    elements of one degree more are too many unknowns, the level is the fine one. It is with pressures too, and the working one has
    elements three times as large: cubic elements with quadratic pressures are not verified.
    """
    level = scene.levels[number]
    if scene.material.formulation == "mixed" and level.element_size is not None:
        return _larger(level)[-1], level
    finer = replace(level, degree=level.degree + 1)
    if level.element_size is None:
        fits = scene.material.formulation != "mixed" and _unknowns(scene, finer, comm) <= _FINE
        fine = finer if fits else level
        working = replace(level, refinements=max(level.refinements - 1, 0))
        return (working, fine) if working != fine else (level,)
    few = (one for one in _showing(scene, level, comm)[::-1] if _unknowns(scene, one, comm) >= _WORKING)
    finest = _showing(scene, finer, comm)
    many = (one for one in finest if _unknowns(scene, one, comm) <= _FINE)
    return next(few, level), next(many, finest[-1])


def _showing(scene: Scene, level: Level, comm: Comm) -> list[Level]:
    """A level and those with larger elements on which every piece of a patch has a facet; collective."""
    larger = _larger(level)[::-1]
    first, _ = first_level(replace(scene, levels=tuple(larger)), 0, len(larger) - 1, comm)
    return larger[first:][::-1]


def _larger(level: Level) -> list[Level]:
    assert level.element_size is not None
    return [replace(level, element_size=times * level.element_size) for times in _TIMES]


def _unknowns(scene: Scene, level: Level, comm: Comm) -> int:
    mixed = scene.material.formulation == "mixed"
    return level_mesh(scene, level, comm).unknowns(level.degree, mixed)
