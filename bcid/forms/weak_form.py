"""The weak form of a model in UFL: strain energy, what each effect adds, the residual and its derivatives, on one body."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any

import basix.ufl
import numpy as np
import ufl
from dolfinx import fem
from numpy.typing import NDArray

from bcid.base import compat
from bcid.base.errors import InputError, nearest
from bcid.forms import compiled
from bcid.forms.effects.effect import Effect, Past, Point
from bcid.forms.kinematics import Kinematics
from bcid.forms.mesh.body import Body
from bcid.forms.mesh.patch_frame import PatchFrame
from bcid.forms.mesh.shares import share
from bcid.forms.model import Model, Term, region_name
from bcid.forms.tension_field import UNWRINKLED, TensionField
from bcid.scene import Region, Scene

Array = NDArray[np.float64]
# Time before step 0, s: the body has long been at rest.
LONG = 1e9
# The quadrature of this degree has a negative weight.
_SOME_NEGATIVE = 3
# Stiffness of the springs of a patch that holds along a direction of its surface, in shear moduli per cube root of the volume: they
# give by about a millionth of that, and round-off of what slides past them is less than a billionth of the forces.
_STIFF = 1e6
# Quadrature where the stiffness varies within an element.
_VARYING = 4


class Memory:
    """What an effect keeps from step to step: the last displacement and variables of its own.

    Args:
        body: the body.
        u: the unknown.
        shapes: of the variables, by name.
        degree: of the quadrature at whose points the variables are kept; None for the nodes.
        axes: of the plane of fibres, see `Kinematics`.
    """

    def __init__(
        self, body: Body, u: Any, shapes: Mapping[str, tuple[int, ...]], degree: int | None, axes: Any
    ) -> None:
        self._u = u
        self.last = fem.Function(u.function_space)
        domain = body.domain
        self.dt = fem.Constant(domain, LONG)
        self.moving = fem.Constant(domain, 0.0)
        self.variables = {}
        for name, shape in shapes.items():
            space = body.displacement_space
            if degree is not None:
                element = basix.ufl.quadrature_element("tetrahedron", value_shape=shape, degree=degree)
                space = fem.functionspace(domain, element)
            self.variables[name] = fem.Function(space)
        displacement = ufl.split(self.last)[0] if body.mixed else self.last
        self.past = Past(displacement, Kinematics.of(displacement, axes), self.dt, self.moving, self.variables)
        self._following: dict[str, Any] = {}

    def follow(self, expressions: Mapping[str, Any]) -> None:
        """How the variables are advanced."""
        for name, expression in expressions.items():
            space = self.variables[name].function_space
            points = compat.interpolation_points(space)
            self._following[name] = compiled.expression(expression, points)

    def reset(self) -> None:
        """Long at rest, undeformed."""
        self.dt.value, self.moving.value = LONG, 0.0
        for function in (self.last, *self.variables.values()):
            function.x.array[:] = 0.0

    def advance(self) -> None:
        """The present state becomes the last one."""
        following = {}
        for name, expression in self._following.items():
            following[name] = fem.Function(self.variables[name].function_space)
            following[name].interpolate(expression)
        for name, function in following.items():
            self.variables[name].x.array[:] = function.x.array
        self.last.x.array[:] = self._u.x.array
        self.moving.value = 1.0


class WeakForm:
    """Weak form of a model on a body, with every number of it a Constant that can be changed without compiling again.

    Args:
        body: the body.
        model: law and effects.
        scene: where places are.
        u: the unknown.

    Attributes:
        constants: every number of the model by its full name.
        anchored: by patch, 1 where an anchor is replaced by what an effect does.
        grasped: by grasp, 1 where a rigid gripper is.
        gripper: displacement of every node if it moved with the gripper, a DOLFINx Function.
        memories: of the model's effects that have one, by label.
        probed: memories of effects that were asked about and are not part of the model.
        energies, works: forms that add up to the model's: one for the law and one for each effect, so that an effect is
            compiled once, whatever it is combined with.
        giving: numbers of those energies that hold in the gripper's place.
        sprung: patches that hold along a direction of their surface: by springs, for no unknown is such a displacement.
        led: 1 for the displacements that the gripper or measured points lead, else 0; a DOLFINx Function, for those springs.
    """

    def __init__(self, body: Body, model: Model, scene: Scene, u: Any) -> None:
        self.body, self.model, self.scene, self.u = body, model, scene, u
        self.constants: dict[str, fem.Constant] = {}
        self._numbers: dict[str, Any] = {}
        for name, value in model.numbers().items():
            self._number(name, value)
        self.anchored = {name: fem.Constant(body.domain, 0.0) for name in scene.patches}
        self.grasped = {name: fem.Constant(body.domain, 0.0) for name in scene.grasps}
        self.gripper = fem.Function(body.displacement_space)
        self.test = ufl.TestFunction(body.space)
        if body.mixed:
            self.displacement, self.pressure = ufl.split(u)
            self.virtual = ufl.split(self.test)[0]
        else:
            self.displacement, self.pressure, self.virtual = u, None, self.test
        self.kin = Kinematics.of(self.displacement, model.fibre_axes)
        self._normals: dict[str, Any] = {}
        self._shares: dict[str, Any] = {}
        self._frames: dict[str, PatchFrame] = {}
        self.memories: dict[str, Memory] = {}
        self.probed: dict[str, Memory] = {}
        self.energies, self.works = [self.stored(model.terms)], []
        self.giving: list[int] = []
        for term in model.terms:
            energy, work = self.added(term)
            self.giving += [len(self.energies)] if term.effect.gives else []
            self.energies += [] if energy is None else [energy]
            self.works += [] if work is None else [work]
        self.sprung = tuple(patch for patch in scene.patches if scene.held_direction(patch))
        self.led = fem.Function(body.displacement_space)
        self._grasp = -1.0
        if self.sprung:
            self.energies.append(sum(map(self._of_springs, self.sprung)))

    def _of_springs(self, patch: str) -> Any:
        """Energy of the springs that hold the nodes of a patch along a direction of its surface; a form.

        They sit at the nodes and leave those alone that are led, as a condition on unknowns does: were they spread over the
        surface, each facet of a curved one would hold along its own normal, and a node that is led would bend its neighbours.
        """
        u, along = self.displacement, ufl.inner(self.displacement, self.normal(patch)) ** 2
        square = along if self.scene.held_direction(patch) == "normal" else ufl.inner(u, u) - along
        stiffness = _STIFF * self.model.law.shear(self.law_constants(())) / self.body.mesh.volume ** (1 / 3)
        free = (1 - self.led[0]) * (1 - self.led[1]) * (1 - self.led[2])
        at_nodes = self.surface(patch)(metadata=self.body.nodal_rule)
        return self.anchored[patch] * stiffness / 2 * free * square * at_nodes

    def lead(self, dofs: NDArray[np.int32], grasp: str) -> None:
        """Which unknowns are led from now on, on this rank, ghosts included, and what the gripper holds."""
        if not self.sprung:
            return
        self.led.x.array[:] = np.isin(self.body.displacement_dofs, dofs)
        self._grasp = float(list(self.scene.grasps).index(grasp)) if grasp else -1.0

    def _number(self, name: str, value: float) -> Any:
        """A number of the model in UFL: its Constant, as a variable that forms can be differentiated by."""
        if name not in self.constants:
            self.constants[name] = fem.Constant(self.body.domain, float(value))
            self._numbers[name] = ufl.variable(self.constants[name])
        return self._numbers[name]

    @property
    def _positive(self) -> int:
        """Degree of the quadrature where something is remembered, or wrinkles: one without negative weights.

        Either makes a point stiffer or softer than its neighbours; with a negative weight the body would be unstable for it. Of
        quadratic elements degree 2 keeps the order of convergence as well (Ciarlet, The Finite Element Method, 1978, section 4.1).
        """
        degree = self.body.quadrature_degree
        return degree - 1 if degree == _SOME_NEGATIVE else degree

    @property
    def residuals(self) -> list[Any]:
        """Forms that add up to the residual, that of the law first."""
        return [*(ufl.derivative(energy, self.u, self.test) for energy in self.energies), *self.works]

    @property
    def places(self) -> dict[str, Region]:
        """Every named region of the scene."""
        scene = self.scene
        return {**{n: g.region for n, g in scene.grasps.items()}, **scene.patches, **scene.places}

    def measure(self, degree: int) -> Any:
        """Volume measure with a quadrature of this degree."""
        return ufl.Measure("dx", domain=self.body.domain, metadata={"quadrature_degree": degree})

    def term_constants(self, term: Term) -> dict[str, Any]:
        """The numbers of an effect by parameter, in UFL; made when it is not part of the model."""
        return {name: self._number(term.full(name), value) for name, value in term.effect.at(0.0, term.values).items()}

    def memory(self, term: Term) -> Memory:
        """What an effect remembers."""
        own = any(term.label == part.label for part in self.model.terms)
        memories = self.memories if own else self.probed
        if term.label not in memories:
            effect = term.effect
            degree = None if effect.acts_on == "boundary" else self._positive
            memories[term.label] = Memory(self.body, self.u, effect.memory or {}, degree, self.model.fibre_axes)
            if effect.advance:
                expressions = effect.advance(self.point(term), self.term_constants(term))
                memories[term.label].follow(expressions)
        return memories[term.label]

    def point(self, term: Term) -> Point:
        """What an effect may use."""
        body, model = self.body, self.model
        needs_past = term.effect.memory or term.effect.uses_past
        lower, upper = body.mesh.points.min(axis=0), body.mesh.points.max(axis=0)
        return Point(
            u=self.displacement,
            v=self.virtual,
            kin=self.folded(self.kin).kin if model.wrinkles and term.effect.energy else self.kin,
            X=ufl.SpatialCoordinate(body.domain),
            N=ufl.FacetNormal(body.domain),
            normal=self.normal,
            down=ufl.as_vector(model.down),
            centre=ufl.as_vector([float(value) for value in (lower + upper) / 2]),
            size=float(np.linalg.norm(upper - lower)),
            shear=model.law.shear(self.law_constants(())),
            place=term.place,
            surface=self.surface,
            share=self.share,
            frame=self.frame,
            boundary=self.boundary,
            support=self.scene.support,
            patches=tuple(self.scene.patches),
            held_along=self.scene.held_along,
            anchored=lambda patch: self.anchored[patch],
            gripper=self.gripper,
            grasps=tuple(self.grips),
            grasped=lambda grasp: self.grasped[grasp],
            grip=self.grip,
            past=self.memory(term).past if needs_past else None,  # type: ignore[arg-type]
        )

    def law_constants(self, terms: Iterable[Term]) -> dict[str, Any]:
        """The law's constants, some of which effects replace, and regions have of their own."""
        constants = {name: self._numbers[name] for name in self.model.law.complete(self.model.values)}
        own = {
            region: {name: self._numbers[region_name(region, name)] for name in numbers}
            for region, numbers in self.model.region_constants.items()
        }
        for term in terms:
            if term.effect.constants:
                held = own.setdefault(term.place, {}) if term.place else constants
                held |= term.effect.constants(self.term_constants(term))
        # What holds in a region comes after what holds everywhere, whatever the order of the effects.
        for region, numbers in own.items():
            share = self.share(region)
            constants |= {name: constants[name] + share * (value - constants[name]) for name, value in numbers.items()}
        return constants

    def stored(self, terms: Sequence[Term], grown: Any = None) -> Any:
        """Strain energy (a form), as the effects change it; `grown` is the logarithm of a growth of all lengths besides."""
        density, degree = self.density(terms, grown)
        return density * self.measure(degree)

    def density(self, terms: Sequence[Term], grown: Any = None) -> tuple[Any, int]:
        """Strain energy per volume of the undeformed body, as the effects change it, and a degree of quadrature for it."""
        model = self.model
        # Another body at rest comes before what happens to its material.
        kin, factor = self.reshaped(terms)
        varying = False
        for term in terms:
            c = self.term_constants(term)
            if term.effect.growth:
                stretch = term.effect.growth(self.point(term), c)
                kin = Kinematics.from_gradient(kin.F * stretch, kin.axes)
                # The law's energy is per volume of the natural state.
                factor = (factor or 1.0) / ufl.det(stretch)
            if term.effect.stiffness:
                factor = (factor or 1.0) * term.effect.stiffness(self.point(term), c)
                varying = True
        if grown is not None:
            kin = Kinematics.from_gradient(kin.F * ufl.exp(-grown), kin.axes)
            factor = (factor or 1.0) * ufl.exp(3 * grown)
        density = self._law(kin, terms)
        if model.wrinkles:
            field = self.folded(kin, terms)
            density = UNWRINKLED * density + (1 - UNWRINKLED) * (self._law(field.kin, terms) + field.folding)
        degree = self._positive if model.wrinkles else self.body.quadrature_degree
        degree = max(degree, _VARYING) if varying else degree
        return (density if factor is None else factor * density), degree

    def folded(self, kin: Kinematics, terms: Sequence[Term] = ()) -> TensionField:
        """The deformation of a sheet that wrinkles, with the law's constants as effects change them."""
        constants = self.law_constants(terms)
        return TensionField.of(kin, self.model.law.shear(constants), constants["poisson"])

    def _law(self, kin: Kinematics, terms: Sequence[Term]) -> Any:
        """The law's energy per volume of its natural state, of a sheet that stays flat."""
        model, constants = self.model, self.law_constants(terms)
        if self.pressure is not None:
            return model.law.psi_mixed(kin, self.pressure, constants, model.volumetric)
        density = model.law.psi(kin, constants, model.volumetric)
        for form, part in self.other_forms(terms):
            density += part * model.law.other_form(kin, constants, model.volumetric, form)
        return density

    def other_forms(self, terms: Sequence[Term]) -> list[tuple[str, Any]]:
        """Other forms of the volumetric energy, and the part of each that takes the place of the law's own."""
        found: list[tuple[str, Any]] = []
        for term in terms:
            if term.effect.volumetric:
                found += term.effect.volumetric(self.point(term), self.term_constants(term)).items()
        return found

    def reshaped(self, terms: Sequence[Term]) -> tuple[Kinematics, Any]:
        """The deformation of a body that effects give another shape at rest, and a factor of its volume; None where none do."""
        kin, factor = self.kin, None
        for term in terms:
            if term.effect.reshaped:
                shape = term.effect.reshaped(self.point(term), self.term_constants(term))
                gradient = kin.H * shape
                kin = Kinematics(gradient, ufl.Identity(3) + gradient, kin.axes)
                factor = (factor or 1.0) / ufl.det(shape)
        return kin, factor

    def added(self, term: Term, reshaped: Sequence[Term] = ()) -> tuple[Any, Any]:
        """Energy (a form or None) and virtual work (a form or None) that an effect adds.

        Args:
            term: with the effect.
            reshaped: effects that give the body another shape at rest.
        """
        effect, c = term.effect, self.term_constants(term)
        if effect.gives and not self.grips:
            raise InputError(f"{term.label}: no grasp of the scene is a surface: no springs can be spread over it")
        kin, factor = self.reshaped(reshaped)
        if self.model.wrinkles and effect.energy:
            kin = self.folded(kin).kin
        point = replace(self.point(term), kin=kin)
        density = effect.energy(point, c) if effect.energy else None
        if density is not None and factor is not None:
            density = factor * density
        energy = None if density is None else density * self.measure(self._degree_of(effect))
        if effect.potential:
            potential = effect.potential(point, c)
            energy = potential if energy is None else energy + potential
        return energy, effect.work(point, c) if effect.work else None

    def _degree_of(self, effect: Effect) -> int:
        """Degree of the quadrature of what an effect stores per volume.

        What acts in the place of the law takes away a part of it, which only goes where it is integrated.
        """
        if effect.memory:
            return self._positive
        # Body forces need more than the one point that is exact for the energy of linear elements.
        return self.body.quadrature_degree if effect.instead_of == "law" else 2 * self.body.degree

    def derivative(self, term: Term, name: str) -> Any:
        """Compiled derivative of the residual by a number of an effect; None where the residual does not depend on it.

        The effect need not be part of the model; its Constants are made then (see `term_constants`).
        """
        energy, work = self.added(term)
        beside = []
        if term.effect.reshaped:
            # What effects store in the material is stored in the other body.
            materials = [t for t in self.model.terms if t.effect.energy and t.effect.acts_on == "material"]
            beside = [self.added(t, [term])[0] for t in materials if not t.effect.memory]
        if term.effect.changes_law:
            others = [t for t in self.model.terms if t.effect.changes_law and t.label != term.label]
            stored = self.stored([*others, term])
            energy = stored if energy is None else energy + stored
        self.term_constants(term)
        return self._by_number([energy, *beside], [work], term.full(name))

    def law_derivative(self, name: str) -> Any:
        """Compiled derivative of the residual by a constant of the law; None where the residual does not depend on it."""
        return self._by_number(self.energies, self.works, name)

    def _by_number(self, energies: Sequence[Any], works: Sequence[Any], name: str) -> Any:
        """Of a sum of energies and works. Energies are differentiated by the number first: that leaves the least to UFL."""
        number, constant = self._numbers[name], self.constants[name]
        energies, works = (
            [f for f in forms if f is not None and constant in f.constants()] for forms in (energies, works)
        )
        parts = [ufl.derivative(ufl.diff(energy, number), self.u, self.test) for energy in energies]
        parts += [ufl.diff(work, number) for work in works]
        return compiled.form(sum(parts[1:], start=parts[0])) if parts else None

    @cached_property
    def _spreadable(self) -> list[str]:
        """The places that are surfaces."""
        return [n for n in self.places if self.body.mesh.select(self.places[n], n).shape[1] == 3]

    @cached_property
    def _surfaces(self) -> Any:
        """Measure of places and grips: one for both, since a form can hold only one set of marked facets."""
        names = [*self._spreadable, *(f"grasp {name}" for name in self.grips)]
        regions = [*(self.places[n] for n in self._spreadable), *(self.scene.grasps[n].region for n in self.grips)]
        return self.body.facet_measure(regions, names)

    @cached_property
    def grips(self) -> list[str]:
        """The grasps that are surfaces."""
        grasps = self.scene.grasps
        return [n for n in grasps if self.body.mesh.select(grasps[n].region, f"grasp {n}").shape[1] == 3]

    def grip(self, grasp: str) -> Any:
        """Measure of what a gripper holds, one of `grips`."""
        return self._surfaces(len(self._spreadable) + self.grips.index(grasp) + 1)

    def switches(self) -> list[float]:
        """What is held by effects, 1 or 0 for each patch and grasp, and where springs leave what is led: the number of a grasp."""
        numbers = [float(constant.value) for constant in (*self.anchored.values(), *self.grasped.values())]
        return [*numbers, self._grasp] if self.sprung else numbers

    @property
    def boundary(self) -> Any:
        """Measure of the whole boundary."""
        metadata = {"quadrature_degree": 2 * self.body.degree}
        return ufl.Measure("ds", domain=self.body.domain, metadata=metadata)

    def surface(self, name: str) -> Any:
        """Measure of a place, which is any patch, grasp or place of the scene."""
        return self._surfaces(self._spreadable.index(self._spread(name)) + 1)

    def share(self, name: str) -> Any:
        """Part of each cell that lies in a region of the body."""
        if name not in self.scene.regions:
            raise InputError(f"region '{name}' is not in the scene; {nearest(name, self.scene.regions)}")
        if name not in self._shares:
            found = share(self.body.mesh, self.scene.regions[name], f"regions.{name}")
            self._shares[name] = self.body.by_cell(found)
        return self._shares[name]

    def frame(self, patch: str) -> PatchFrame:
        """Axes in the plane of a patch."""
        if patch not in self._frames:
            mesh = self.body.mesh
            self._frames[patch] = PatchFrame.of(
                mesh.points[np.unique(mesh.select(self.places[patch], f"patch {patch}"))]
            )
        return self._frames[patch]

    def normal(self, name: str) -> Any:
        """Outward unit normal of a place at its nodes, zero away from it."""
        if self._spread(name) not in self._normals:
            self._normals[name] = self.body.normals(self.places[name], name)
        return self._normals[name]

    def _spread(self, name: str) -> str:
        """The name of a place over which something can be spread."""
        if not name:
            raise InputError('the scene names no support surface: add support = "NAME" with a place of that name')
        if name not in self.places:
            raise InputError(f"place '{name}' is not in the scene; {nearest(name, self.places)}")
        if name not in self._spreadable:
            raise InputError(f"place '{name}' is not a surface: nothing can be spread over it")
        return name
