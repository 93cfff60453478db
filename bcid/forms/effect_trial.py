"""A model of a small box on which an effect is tried: pulled, turned, loaded and brought back."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import permutations
from pathlib import Path

import numpy as np
from dolfinx import fem
from mpi4py import MPI
from numpy.typing import NDArray

from bcid.base.collective import Comm
from bcid.base.errors import SolveError
from bcid.base.units import parse_unit
from bcid.forms import materials
from bcid.forms.effects.effect import Effect
from bcid.forms.forward import Forward, Prediction
from bcid.forms.mesh import BodyMesh
from bcid.forms.model import Model, Term
from bcid.forms.parameter import Parameter, Shape
from bcid.forms.solver.equilibrium import Settings
from bcid.measurement import Action
from bcid.scene import Grasp, Level, Material, Plane, Region, Scene
from bcid.scene.parts import BodyRegion, Sphere
from bcid.scene.rotation import from_vector

Array = NDArray[np.float64]

ANCHORS = ("left",)
# Positions are computed to about this part of the body's size.
ROUND_OFF = 1e-9
_BOX = np.array([0.06, 0.02, 0.04])
_BRICKS = (4, 1, 2)
_EXACT = Settings(rtol=1e-12)
# A time, in s of the box, when what comes and goes acts.
_AMID = 0.7


@dataclass(frozen=True)
class SimilarUnits:
    """How many SI units one unit of another system has: numbers of a body that is similar in every way."""

    metre: float = 1.0
    kilogram: float = 1.0
    second: float = 1.0

    def __call__(self, value: float, unit: str) -> float:
        """A value of the box in SI, made that of the similar body."""
        metre, kilogram, second, _degree = parse_unit(unit)[1]
        return value * self.metre**metre * self.kilogram**kilogram * self.second**second


SI = SimilarUnits()
OTHER = SimilarUnits(2.0, 3.0, 1.5)


def box(units: SimilarUnits = SI) -> BodyMesh:
    """A box of 60 x 20 x 40 mm, cut into bricks of six tetrahedra."""
    grid = np.stack(np.meshgrid(*(np.arange(n + 1) for n in _BRICKS), indexing="ij"), axis=-1).reshape(-1, 3)
    number = np.arange(len(grid)).reshape(*(n + 1 for n in _BRICKS))
    cells = []
    for corner in np.ndindex(*_BRICKS):
        for order in permutations(range(3)):
            path = np.vstack([np.zeros(3, int), np.cumsum(np.eye(3, dtype=int)[list(order)], axis=0)]) + corner
            cell = [int(number[tuple(place)]) for place in path]
            odd = np.linalg.det(np.eye(3)[list(order)]) < 0
            cells.append([cell[0], cell[2], cell[1], cell[3]] if odd else cell)
    return BodyMesh(grid / np.array(_BRICKS) * _BOX * units.metre, np.array(cells, dtype=np.int64))


def scene(units: SimilarUnits = SI) -> Scene:
    """The box: lying on its bottom, with two patches and a region in its middle, held at the end x = 60 mm."""

    def face(axis: int, upper: bool) -> Region:
        point, normal = [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]
        point[axis], normal[axis] = (float(_BOX[axis]) * units.metre if upper else 0.0), 1.0
        return Region(plane=Plane((point[0], point[1], point[2]), (normal[0], normal[1], normal[2])))

    def at(x: float, y: float, z: float) -> tuple[float, float, float]:
        return units(x, "m"), units(y, "m"), units(z, "m")

    return Scene(
        name="box",
        geometry=Path("box"),
        length_unit=1.0,
        levels=(Level(1),),
        material=Material("neo_hooke", {"young": f"{units(15e3, 'Pa')!r} Pa", "poisson": 0.35}),
        patches={"left": face(0, False), "back": face(2, False)},
        grasps={"gripper": Grasp(face(0, True), at(0.06, 0.01, 0.02))},
        fiducials={
            "a": at(0.013, 0.02, 0.012),
            "b": at(0.031, 0.02, 0.027),
            "c": at(0.044, 0.013, 0.04),
            "d": at(0.022, 0.02, 0.033),
        },
        places={"bottom": face(1, False), "top": face(1, True)},
        regions={"core": BodyRegion(sphere=Sphere(at(0.03, 0.01, 0.02), units(0.014, "m")))},
        support="bottom",
        source="of the check",
    )


def actions(units: SimilarUnits = SI) -> list[Action]:
    """There and back, with a turn, under a load that grows; the steps are not equally long."""
    part = np.array([0.0, 0.5, 1.0, 0.8, 0.3])
    count = np.arange(len(part))
    return [
        Action(
            "1",
            count,
            count,
            "gripper",
            units(1.0, "m") * part[:, None] * np.array([0.004, -0.002, 0.003]),
            np.array([from_vector(p * np.array([5.0, 3.0, -8.0])) for p in part]),
            {"top": units(1.0, "N") * count[:, None] * np.array([0.002, 0.004, -0.003])},
            units(1.0, "s") * np.array([0.0, 1.0, 2.5, 3.0, 4.0]),
        )
    ]


class EffectTrial:
    """An effect on the box, at its first place or the one that is given. `with` frees what it has built."""

    def __init__(self, effect: Effect, place: str | None = None, units: SimilarUnits = SI) -> None:
        self.effect, self.units = effect, units
        self.scene, self.mesh, self.actions = scene(units), box(units), actions(units)
        self._take_other_form()
        self.bare = Model.of(self.scene)
        places = effect.places(self.scene, frozenset(ANCHORS)) if effect.places else [""]
        self.place = places[0] if place is None else place
        self._built: list[Forward] = []

    def _take_other_form(self) -> None:
        """An effect that is the law's own form of the volumetric energy is tried on a law with another."""
        volumetric, material = self.effect.volumetric, self.scene.material
        law = materials.law(material.law)
        # The forms have names, whatever the point and the numbers are.
        if volumetric and law.volumetric in volumetric(None, {p.name: 0.0 for p in self.effect.parameters}):  # type: ignore[arg-type]
            self.scene = replace(self.scene, material=replace(material, volumetric=law.other_forms()[-1]))

    def __enter__(self) -> EffectTrial:
        return self

    def __exit__(self, *_: object) -> None:
        self.destroy()

    def destroy(self) -> None:
        """Free the PETSc objects: a process has so many communicators, and each solver takes some."""
        while self._built:
            self._built.pop().destroy()

    # -- values
    # ------------------------------------------------------------------------------------------------------------

    def amount(self, parameter: Parameter, part: float) -> float:
        """A part of the scale."""
        if parameter.reciprocal:
            value = parameter.scale / part
        else:
            neutral = self.bare.neutral(parameter)
            assert neutral is not None
            value = neutral + part * parameter.scale
            if parameter.check(value):
                value = neutral - part * parameter.scale
        return self.units(value, parameter.unit)

    def none(self, parameter: Parameter) -> float:
        """Value of no influence, or the amount of nearly none."""
        return self.amount(parameter, 1e-6 if parameter.reciprocal else 0.0)

    def values(self, part: float = 1.0, only: str = "") -> dict[str, float]:
        """A part of the scale (of one parameter, the others being without influence), somewhere and somehow."""
        found = {}
        for p in self.effect.amounts:
            found[p.name] = self.amount(p, part) if part and only in ("", p.name) else self.none(p)
        for p in self.effect.shapes:
            start = p.default if p.default is not None else (p.scan[0] if p.scan else 0.0)
            value = start + p.scale if p.check(start + p.scale) is None else start
            found[p.name] = self.units(value, p.unit)
        return found

    def model(self, values: Mapping[str, float]) -> Model:
        """The box's model with the effect."""
        # Bounds are those of numbers in SI; what stands for them in other units is not compared with them.
        free = tuple(_unbounded(p) for p in self.effect.parameters)
        effect = self.effect if self.units == SI else replace(self.effect, parameters=free)
        return self.bare + Term(effect, values, place=self.place)

    # -- predictions
    # -------------------------------------------------------------------------------------------------------

    def forward(self, model: Model, comm: Comm = MPI.COMM_SELF) -> Forward:
        """The box with a model, ready to predict; collective on `comm`."""
        self._built.append(Forward(self.scene, 0, comm, model, _EXACT, self.mesh))
        return self._built[-1]

    @cached_property
    def plain(self) -> Array:
        """As `positions`, without the effect."""
        return self.positions(self.forward(self.bare))

    @cached_property
    def with_effect(self) -> Forward:
        """The box with the effect; its numbers may be changed."""
        return self.forward(self.model(self.values()))

    def positions(self, forward: Forward) -> Array:
        """Where the fiducials are seen, shape (frames, fiducials, 3), m. Collective and errors as `predicted`."""
        return self.predicted(forward).positions

    def predicted(self, forward: Forward) -> Prediction:
        """The prediction, with the states; collective on the communicator of `forward`.

        Raises:
            SolveError: a frame could not be solved.
        """
        prediction = forward.predict(ANCHORS, self.actions, keep=True)
        if prediction.failure:
            raise SolveError(
                f"the box could not be solved with {forward.model.constants()}: {prediction.failure.reason}; "
                "choose a smaller scale, or look for a sign"
            )
        return prediction

    def at(self, values: Mapping[str, float]) -> Array:
        """As `positions`, with these values, by changing numbers only."""
        self.with_effect.set_model(self.model(values))
        return self.positions(self.with_effect)

    # -- residual and tangent at a state that is no equilibrium
    # ------------------------------------------------------------

    def deform(self, amplitude: float = 1.0) -> None:
        """Take a state, a last state and memories that are the same every time, and of that amplitude."""
        equilibrium, random = self.with_effect.equilibrium, np.random.default_rng(1)
        span, nodes = self.mesh.size, equilibrium.body.nodes / self.mesh.size
        wave = np.cos(nodes @ random.normal(size=(3, 3)) * 2 + random.uniform(0, 6, 3))
        equilibrium.u.x.array[:] = amplitude * 0.02 * span * wave.ravel()
        for constant in (*equilibrium.weak_form.anchored.values(), *equilibrium.weak_form.grasped.values()):
            constant.value = 1.0
        for memory in equilibrium.weak_form.memories.values():
            memory.dt.value, memory.moving.value = self.units(0.7, "s"), 1.0
            memory.last.x.array[:] = amplitude * 0.013 * span * np.sin(3 * nodes).ravel()
            for variable in memory.variables.values():
                variable.x.array[:] = amplitude * random.normal(size=len(variable.x.array)) * 0.1

    def numbers(self, values: Mapping[str, float]) -> None:
        """Set the effect's numbers, as they act at a time when each of them does."""
        self.with_effect.set_model(self.model(values))
        self.with_effect.equilibrium.set_constants(self.with_effect.model.acting(1.0, self.units(_AMID, "s")))

    def forces(self) -> Array:
        """Residual at the present state, shape (unknowns,)."""
        return self.with_effect.equilibrium.forces()

    def slope(self, parameter: Parameter, time: float | None = None) -> Array:
        """Derivative of the residual by an amount, per part of its scale, at the present state and a time, shape (unknowns,).

        The time (of the units of the trial) is that of `numbers` by default.
        """
        term = self.with_effect.model.terms[0]
        found = np.zeros(len(self.forces()))
        at = self.units(_AMID, "s") if time is None else time
        for name, slope in term.effect.slopes(parameter.name, at, term.values).items():
            form = self.with_effect.equilibrium.weak_form.derivative(term, name)
            found += 0.0 if form is None else slope * np.array(fem.assemble_vector(form).array)
        return (self.amount(parameter, 1.0) - self.none(parameter)) * found

    def tangent(self) -> Array:
        """Tangent at the present state, shape (unknowns, unknowns)."""
        return sum(fem.assemble_matrix(form).to_dense() for form in self.with_effect.equilibrium.tangent_forms)


def _unbounded(p: Parameter) -> Parameter:
    """A parameter that may take any value."""
    if isinstance(p, Shape):
        return replace(p, lower=-np.inf, upper=np.inf, scan=())
    return replace(p, lower=-np.inf, upper=np.inf)
