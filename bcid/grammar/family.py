"""A family of terms: a formula, the numbers in it, and the effect that it makes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bcid.forms.parameter import Amount, Shape
from bcid.grammar.deformed import Deformed

Array = NDArray[np.float64]
Values = Mapping[str, float]

# Where a term acts: in the whole body, on a named surface, or about a place on the surface or in the body.
BODY, SURFACE, SPOT, INNER_SPOT = "body", "surface", "spot", "inner spot"
# The kind of a family of terms that leave the body alone.
OBSERVATION = "observation"
# What energies with a direction are looked for as.
FIBRES = "fibres"
# Degree of quadrature on the boundary: a spot is smaller than the facets of a coarse mesh.
FINE = 12


@dataclass(frozen=True)
class Family:
    """Terms of one form.

    Attributes:
        name: an identifier.
        kind: "energy", "boundary", "body force" or "observation".
        about: one phrase.
        formula: as it is written in a text.
        code: lines of Python with UFL that end in ``return``: the energy per rest volume of a term in the body, or per rest area on
            a surface; the virtual work per rest area where `works`; see `bcid.grammar.observation_terms` for terms of the picture.
        amounts, shapes: its numbers; shapes of a spot (cx, cy, cz, radius) are added by where it acts.
        unit: change of the residual per unit of each amount at deformed points: first Piola stress, (q, 3, 3, amounts), of an
            energy; traction or body force with the sign of the residual, (q, 3, amounts), of the others.
        where: one of the above.
        works: whether `code` is virtual work, of a term without a potential, with a tangent that is not symmetric.
        scans: values of the shapes that are tried, all together.
        polyconvex: what is known of that, in words; empty where the question does not arise.
        instead_of: see `bcid.forms.effects.effect.Effect`.
        catalogue: name of the effect of the catalogue that it is made of; `code` and `unit` are empty then.
        steady: name of the family whose amounts follow a course, or grow with the pull, in it.
        times: knots of that course, s.
        remembers: whether `code` uses what was before, and `unit` the movement since the last step.
    """

    name: str
    kind: str
    about: str
    formula: str
    code: str
    amounts: tuple[Amount, ...]
    shapes: tuple[Shape, ...]
    unit: Callable[[Deformed, Values], Array] | None = None
    where: str = BODY
    works: bool = False
    scans: tuple[dict[str, float], ...] = ({},)
    polyconvex: str = ""
    instead_of: str = ""
    catalogue: str = ""
    steady: str = ""
    times: tuple[float, ...] = ()
    remembers: bool = False

    @property
    def parameters(self) -> tuple[Any, ...]:
        """All numbers, amounts first."""
        return (*self.amounts, *self.shapes)

    @property
    def group(self) -> str:
        """What it is looked for with: energies with a direction apart from others, for many bodies are known to have none."""
        directed = any(shape.name in ("azimuth", "angle") for shape in self.shapes)
        return FIBRES if self.kind == "energy" and directed else self.kind

    @property
    def local(self) -> bool:
        """Whether it acts about a place."""
        return self.where in (SPOT, INNER_SPOT)
