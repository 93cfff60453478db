"""The grammar: every term that is tried on a body, and what each would do."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from bcid.base.options import KINDS
from bcid.forms.effects.effect import Effect
from bcid.forms.force_bumps import farthest_point_sample
from bcid.forms.forward import Forward
from bcid.forms.model import Term
from bcid.forms.quadrature import QuadraturePoints
from bcid.grammar.boundary_terms import body_forces, boundary_terms
from bcid.grammar.deformed import Deformed
from bcid.grammar.effect_file import made, source
from bcid.grammar.energies import energies
from bcid.grammar.family import BODY, FINE, INNER_SPOT, SPOT, SURFACE, Family
from bcid.grammar.holds import Holds
from bcid.grammar.other_laws import other_laws
from bcid.grammar.replaced_law import ReplacedLaw

Array = NDArray[np.float64]
# Spots are tried at so many places on the surface and in the body, of these sizes relative to it.
_PLACES, _RADII = {SPOT: 100, INNER_SPOT: 50}, (0.06, 0.13)
# Springs of any stiffness are tried on every second of those of the surface, with the smaller size.
_THINNED = 2
# Beyond so many radii a spot does nothing.
_REACH = 3.0
# Products of so many terms are formed at a time.
_BLOCK = 64
# Degree of quadrature in the body: scores are no more exact than the linear answer they are.
_INSIDE = 3


@dataclass(frozen=True)
class TermVariant:
    """A term of a family with its shapes, at a place.

    Attributes:
        family: of the term.
        shapes: values of its shapes.
        place: name of the surface it acts on, or "".
    """

    family: Family
    shapes: dict[str, float] = field(default_factory=dict)
    place: str = ""


class Grammar:
    """All terms for a body on one mesh that is private to the process, and the virtual work that each does.

    Args:
        forward: of the body.
        kinds: of `bcid.base.options.KINDS`, those that are tried.
    """

    def __init__(self, forward: Forward, kinds: Sequence[str] = KINDS) -> None:
        self.forward = forward
        body, model = forward.body, forward.model
        shear = float(model.law.shear(model.law.complete(model.values)))
        points = body.mesh.points
        box = np.array([points.min(axis=0), points.max(axis=0)])
        self.centre, self.size = box.mean(axis=0), float(np.linalg.norm(box[1] - box[0]))
        first, second = (np.array(axis) for axis in model.fibre_axes)
        self.axes = np.array([first, second, np.cross(first, second)])
        law = ReplacedLaw.of(model)
        families = [
            *energies(shear, law),
            *other_laws(shear, law),
            *boundary_terms(shear, box),
            *body_forces(shear, box),
        ]
        self.families = [family for family in families if family.group in kinds]
        self.inside = QuadraturePoints.volume(body, _INSIDE)
        self.outside = QuadraturePoints.boundary(body, FINE)
        scene = forward.scene
        self.surfaces = self.outside.on(body, {**scene.patches, **scene.places})
        self.held_spots = self._spots(SPOT, _RADII[:1])[::_THINNED]
        self._holds = Holds(
            body,
            self.outside,
            [self.outside.spot(np.array([s[f"c{axis}"] for axis in "xyz"]), s["radius"]) for s in self.held_spots],
        )
        self.variants = [variant for family in self.families for variant in self._variants(family)]
        self.ends = np.cumsum([len(v.family.amounts) for v in self.variants])
        self._effects: dict[str, Effect] = {}

    def _variants(self, family: Family) -> list[TermVariant]:
        """A family in every way that is tried."""
        if family.where == SURFACE:
            return [TermVariant(family, {}, name) for name, inside in self.surfaces.items() if inside.any()]
        if family.where == BODY:
            return [TermVariant(family, dict(scan)) for scan in family.scans]
        return [TermVariant(family, spot) for spot in self._spots(family.where, _RADII)]

    def _spots(self, where: str, radii: Sequence[float]) -> list[dict[str, float]]:
        """Places all over the surface or the body, with these radii relative to its size."""
        places = self.outside.places if where == SPOT else self.inside.places
        return [
            dict(zip(("cx", "cy", "cz"), map(float, c), strict=True)) | {"radius": r * self.size}
            for c in farthest_point_sample(places, _PLACES[where])
            for r in radii
        ]

    def about(self, surface: str) -> dict[str, float]:
        """A spot about the middle of a named surface, of its area."""
        on = self.surfaces[surface]
        weights = self.outside.weights[on]
        middle = weights @ self.outside.places[on] / weights.sum()
        shapes = dict(zip(("cx", "cy", "cz"), map(float, middle), strict=True))
        return shapes | {"radius": math.sqrt(float(weights.sum()) / (2 * math.pi))}

    @property
    def holds(self) -> int:
        """Number of places that springs may hold."""
        return len(self.held_spots)

    @property
    def areas(self) -> Array:
        """Their weighted areas, shape (holds,), m^2."""
        return self._holds.areas

    @property
    def normals(self) -> Array:
        """Their outward normals, shape (holds, 3)."""
        return self._holds.normals

    def held(self, unknowns: Array, solve: Callable[[Array], Array]) -> Array:
        """Compliance and movement of each, see `bcid.forms.sensitivity.Works`."""
        return self._holds.at(unknowns, solve)

    @property
    def count(self) -> int:
        """Of all amounts of all terms."""
        return int(self.ends[-1]) if len(self.ends) else 0

    def term(self, variant: TermVariant) -> Term:
        """A variant as a part of a model, doing nothing."""
        family = variant.family
        if family.name not in self._effects:
            text = source(family, family.name, {}, "", (), list(self.surfaces))
            self._effects[family.name] = made(text)
        values = {p.name: 0.0 for p in family.amounts} | variant.shapes
        return Term(self._effects[family.name], values, place=variant.place)

    def like(self, family: Family) -> Callable[[Term], Term]:
        """A function that gives the term of a family with the shapes and the place of another term."""
        return lambda term: self.term(
            TermVariant(family, {p.name: term.values[p.name] for p in family.shapes}, term.place)
        )

    def works(self, unknowns: Array, fields: Array, before: Array) -> Array:
        """Virtual work of every term on fields of displacement, per unit of each of its amounts.

        Args:
            unknowns: the state, shape (unknowns,).
            fields: shape (unknowns, fields), m.
            before: the state of the last step, shape (unknowns,); the same at rest.

        Returns:
            Shape (fields, count), J.
        """
        dofs = self.forward.body.displacement_dofs.reshape(-1, 3)
        u, virtual = unknowns[dofs], fields[dofs]
        result = np.zeros((fields.shape[1], self.count))
        for points, outside in ((self.inside, False), (self.outside, True)):
            chosen = [k for k, v in enumerate(self.variants) if (v.family.kind == "boundary") is outside]
            deformed = self._deformed(points, u, u - before[dofs])
            for gradients in (True, False):
                some = [k for k in chosen if (self.variants[k].family.kind == "energy") is gradients]
                if some:
                    tests = points.gradients(virtual) if gradients else points.values(virtual)
                    self._add(result, some, deformed, tests.reshape(len(points.weights), -1, fields.shape[1]))
        return result

    def _add(self, result: Array, chosen: Sequence[int], deformed: Deformed, tests: Array) -> None:
        """The virtual works of some variants on fields (q, components, fields), those of a spot at the points that it reaches."""
        spots: dict[tuple[float, ...], list[int]] = {}
        for k in chosen:
            spots.setdefault(
                tuple(self.variants[k].shapes.values()) if self.variants[k].family.local else (), []
            ).append(k)
        for where, variants in spots.items():
            near = deformed.points.within(np.array(where[:3]), _REACH * where[3]) if where else slice(None)
            self._add_at(result, variants, deformed.at(near), tests[near])

    def _add_at(self, result: Array, chosen: Sequence[int], deformed: Deformed, tests: Array) -> None:
        """The same at all points, block by block."""
        weighted = (deformed.points.weights[:, None, None] * tests).astype(np.float32).reshape(-1, tests.shape[2])
        for first in range(0, len(chosen), _BLOCK):
            block = chosen[first : first + _BLOCK]
            units = [self._unit(self.variants[k], deformed) for k in block]
            columns = np.concatenate(
                [np.arange(self.ends[k] - u.shape[1], self.ends[k]) for k, u in zip(block, units, strict=True)]
            )
            result[:, columns] = weighted.T @ np.hstack(units, dtype=np.float32, casting="same_kind")

    def _unit(self, variant: TermVariant, deformed: Deformed) -> Array:
        """What a variant adds to the residual at the points per unit of its amounts, shape (q * components, amounts)."""
        assert variant.family.unit is not None
        found = variant.family.unit(deformed, variant.shapes)
        if variant.place:
            found = found * self.surfaces[variant.place].reshape(-1, *([1] * (found.ndim - 1)))
        return np.asarray(found.reshape(-1, found.shape[-1]))

    def _deformed(self, points: QuadraturePoints, u: Array, since: Array) -> Deformed:
        gradient = points.gradients(u)
        where = self.centre, self.size, self.axes
        return Deformed(points, points.values(u), np.eye(3) + gradient, *where, points.values(since))
