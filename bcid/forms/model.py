"""The model: a law, plus effects, plus loads, plus what is held. Parts join with ``+``.

model = Model.of(scene) + Term("gravity", {"weight": 9810.0}) + Anchors({"1", "2"}) + Held("II")
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import ufl

from bcid.base.errors import InputError, nearest
from bcid.base.units import quantity
from bcid.forms import effects, materials
from bcid.forms.course import of_table
from bcid.forms.effects.effect import NOT_IN_WRINKLES, Array, BodyEffect, Effect, Frame, Point
from bcid.forms.effects.roller import RIGID
from bcid.forms.materials.law import VOLUMETRIC, Law, Volumetric
from bcid.forms.parameter import Amount, Parameter
from bcid.measurement import Action
from bcid.scene import Scene, Values
from bcid.scene.parts import Vector, horizontal


@dataclass(frozen=True)
class Anchors:
    """The patches that are fixed."""

    patches: frozenset[str]

    def __init__(self, patches: Iterable[str] = ()) -> None:
        object.__setattr__(self, "patches", frozenset(patches))


@dataclass(frozen=True)
class Held:
    """The grasp that the gripper moves; "" when nothing is grasped."""

    grasp: str


@dataclass(frozen=True)
class Term:
    """An effect with its parameter values (SI), as a part of a model.

    `effect` is an `Effect` or the name of one of the catalogue; `place` is where it acts, for effects that have places.

    Raises:
        InputError: a value is missing, unknown or out of bounds.
    """

    effect: Effect
    values: Mapping[str, float]
    label: str = ""
    place: str = ""

    def __init__(self, effect: Effect | str, values: Mapping[str, float], label: str = "", place: str = "") -> None:
        known = effects.effect(effect) if isinstance(effect, str) else effect
        problems = known.check(values)
        if problems:
            raise InputError("; ".join(problems))
        defaults = {p.name: p.default for p in known.parameters if p.default is not None}
        object.__setattr__(self, "effect", known)
        object.__setattr__(self, "values", defaults | dict(values))
        object.__setattr__(self, "place", place)
        object.__setattr__(self, "label", label or (f"{known.name}({place})" if place else known.name))

    def with_values(self, values: Mapping[str, float]) -> Term:
        """The same effect at the same place with other values."""
        return Term(self.effect, {**self.values, **values}, self.label, self.place)

    def full(self, name: str) -> str:
        """Full name of one of its parameters, as in `Model.constants`."""
        return f"{self.label}.{name}"

    def acting(self, time: float, values: Mapping[str, float] | None = None) -> dict[str, float]:
        """The numbers that act at a time (s), by full name; of its own values by default."""
        return {self.full(name): value for name, value in self.effect.at(time, values or self.values).items()}

    @property
    def free(self) -> tuple[str, ...]:
        """Full names of the numbers that a fit may move: no first frame, no switch, and nothing that stands for none."""
        moving = [
            p
            for p in self.effect.parameters
            if not (p.onset or p.switch) and (p.off is None or self.values[p.name] != p.off)
        ]
        return tuple(self.full(p.name) for p in moving)


def region_name(region: str, constant: str) -> str:
    """Full name of a constant that a region of the body has of its own."""
    return f"regions.{region}.{constant}"


def pressure(place: str, value: float) -> Term:
    """A pressure (Pa) that follows the surface of a place and pushes into the body.

    Virtual work: p J F^-T N . v per rest area (Bonet & Wood 2008, section 8.5.3).
    """

    def work(point: Point, c: Mapping[str, Any]) -> Any:
        kin = point.kin
        return c["pressure"] * kin.J * ufl.inner(ufl.inv(kin.F).T * point.N, point.v) * point.surface(place)

    follower = BodyEffect(
        "pressure",
        (Amount("pressure", "Pa", "pressure into the body", neutral=0.0),),
        "follower pressure",
        work=work,
        symmetric=False,
    )
    return Term(follower, {"pressure": value}, f"pressure on {place}")


def traction(place: str, vector: Iterable[float]) -> Term:
    """A dead traction (Pa per rest area, three components) on a place."""
    names = ("tx", "ty", "tz")
    values = dict(zip(names, vector, strict=True))

    def work(point: Point, c: Mapping[str, Any]) -> Any:
        return -ufl.inner(ufl.as_vector([c[n] for n in names]), point.v) * point.surface(place)

    dead = BodyEffect(
        "traction", tuple(Amount(n, "Pa", "dead traction", neutral=0.0) for n in names), "dead traction", work=work
    )
    return Term(dead, values, f"traction on {place}")


@dataclass(frozen=True)
class Model:
    """Everything the forward model needs besides the mesh.

    Attributes:
        law: the material law.
        values: its constants, SI.
        formulation: "displacement", or "mixed" (displacement and pressure).
        volumetric: form of the volumetric energy; None for the law's own.
        terms: effects and surface loads with their values.
        anchors: names of the fixed patches.
        grasp: name of the grasp, or "".
        down: unit vector of gravity.
        fibre_axes: unit vectors of the plane of fibres, at 0 and at 90 degrees; the horizontal plane by default.
        wrinkles: whether the body is a sheet that wrinkles, see `bcid.forms.tension_field`.
        rollers: what holds a place along an axis, whatever is anchored, as (place, axis) with axis 0, 1 or 2.
        region_constants: constants of the law that regions of the body have of their own, SI, by region.
    """

    law: Law
    values: Mapping[str, float]
    formulation: str = "displacement"
    volumetric: Volumetric | None = None
    terms: tuple[Term, ...] = ()
    anchors: frozenset[str] = frozenset()
    grasp: str = ""
    down: tuple[float, float, float] = (0.0, -1.0, 0.0)
    fibre_axes: tuple[Vector, Vector] = horizontal((0.0, -1.0, 0.0))
    rollers: tuple[tuple[str, int], ...] = field(default=())
    region_constants: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    wrinkles: bool = False

    def __post_init__(self) -> None:
        problems = self.law.check(self.values, self.mixed)
        if self.wrinkles:
            problems += check_wrinkles(self.law, self.mixed, self.terms)
        if problems:
            raise InputError("; ".join(problems))

    @property
    def mixed(self) -> bool:
        """Whether a pressure is an unknown too."""
        return self.formulation == "mixed"

    @property
    def symmetric(self) -> bool:
        """Whether the tangent is symmetric."""
        return all(term.effect.symmetric for term in self.terms)

    @property
    def name(self) -> str:
        """As in tables: "neo_hooke + gravity"."""
        return " + ".join([self.law.name, *(term.label for term in self.terms)])

    def __add__(self, part: Term | Anchors | Held) -> Model:
        """The model with one more part; a second part of the same name is refused."""
        if isinstance(part, Anchors):
            return replace(self, anchors=part.patches)
        if isinstance(part, Held):
            return replace(self, grasp=part.grasp)
        if any(part.label == term.label for term in self.terms):
            raise InputError(f"the model has '{part.label}' already: {self.name}")
        return replace(self, terms=(*self.terms, part))

    def constants(self) -> dict[str, float]:
        """Every number of the model by its full name, as "young" or "gravity.weight"."""
        numbers = dict(self.law.complete(self.values))
        for term in self.terms:
            numbers |= {term.full(name): value for name, value in term.values.items()}
        return numbers

    def neutral(self, parameter: Parameter) -> float | None:
        """Value at which a parameter of an effect has no influence in this model."""
        return float(self.law.complete(self.values)[parameter.law]) if parameter.law else parameter.neutral

    def acting(self, part: float, time: float) -> dict[str, float]:
        """The numbers of the effects at a time (s), when only a part (0 to 1) of each acts.

        A spring that replaces a rigid hold acts in full from the start: at rest it does nothing.
        """
        result: dict[str, float] = {}
        for term in self.terms:
            values = dict(term.values)
            for parameter in term.effect.amounts:
                neutral = self.neutral(parameter)
                if neutral is not None and not parameter.reciprocal:
                    values[parameter.name] = neutral + part * (values[parameter.name] - neutral)
            result |= term.acting(time, values)
        return result

    def numbers(self) -> dict[str, float]:
        """Every number of the weak form by its full name, as it is at a time of 0 s: the law's, and what acts of the effects."""
        own = {region_name(r, n): float(v) for r, one in self.region_constants.items() for n, v in one.items()}
        return dict(self.law.complete(self.values)) | own | self.acting(1.0, 0.0)

    def with_values(self, numbers: Mapping[str, float]) -> Model:
        """The model with other numbers by full name, as in `constants`.

        Raises:
            InputError: a value is out of bounds, or a name unknown.
        """
        known = self.constants()
        for name in numbers:
            if name not in known:
                raise InputError(f"the model has no number '{name}'; {nearest(name, known)}")
        law = {name: float(numbers.get(name, value)) for name, value in self.law.complete(self.values).items()}
        terms = tuple(
            term.with_values({n: float(numbers[term.full(n)]) for n in term.values if term.full(n) in numbers})
            for term in self.terms
        )
        return replace(self, values=law, terms=terms)

    def without(self, label: str) -> Model:
        """The model without one of its effects."""
        return replace(self, terms=tuple(term for term in self.terms if term.label != label))

    def added(self, begun: Model) -> tuple[Term, ...]:
        """The effects that another model lacks."""
        labels = {term.label for term in begun.terms}
        return tuple(term for term in self.terms if term.label not in labels)

    def freed(self, anchors: Iterable[str]) -> frozenset[str]:
        """The anchored patches that an effect holds instead of a rigid anchor."""
        anchors = frozenset(anchors)
        freeing = [term.place for term in self.terms if term.effect.frees]
        return frozenset(p for p in anchors if any(place in ("", p) for place in freeing))

    @property
    def gives(self) -> bool:
        """Whether an effect holds what the gripper moves, instead of a rigid gripper."""
        return any(term.effect.gives for term in self.terms)

    def held(self, anchors: frozenset[str], frame: int) -> frozenset[str]:
        """The anchored patches that are held in a frame of the measurement."""
        for term in self.terms:
            if term.effect.held:
                anchors = term.effect.held(anchors, frame, term.values, term.place)
        return anchors

    def stages(self, anchors: Iterable[str], action: Action) -> list[tuple[frozenset[str], int, int]]:
        """Which patches are held in an action: the patches, the first step, and the one after the last.

        In each it is followed from rest as if they had been held all along: a patch that comes off is off since its start.
        """
        sets = [self.held(frozenset(anchors), int(frame)) for frame in action.numbered]
        firsts = [k for k, held in enumerate(sets) if k == 0 or held != sets[k - 1]]
        return [(sets[a], a, b) for a, b in zip(firsts, [*firsts[1:], len(sets)], strict=True)]

    def driven(self, action: Action) -> Action:
        """What the gripper really did when an action was commanded."""
        for term in self.terms:
            action = term.effect.driven(action, term.values)
        return action

    def observed(self, positions: Array, frame: Frame) -> Array:
        """Where the fiducials (fiducials, 3) appear in a frame when they are at given positions, m."""
        for term in self.terms:
            positions = term.effect.observed(positions, term.values, frame, term.place)
        return positions

    @property
    def stiffnesses(self) -> dict[str, float]:
        """Constants of the law that are stiffnesses, Pa: without known forces only what they are to each other matters."""
        constants = self.law.complete(self.values)
        return {p.name: float(constants[p.name]) for p in self.law.parameters if p.unit == "Pa" and constants[p.name]}

    @property
    def remembers(self) -> bool:
        """Whether an equilibrium depends on the ones before it."""
        return any(term.effect.memory or term.effect.uses_past for term in self.terms)

    @property
    def jumps(self) -> bool:
        """Whether the body moves otherwise from a frame on."""
        return any(term.effect.moves and term.effect.sudden for term in self.terms)

    @property
    def definite(self) -> bool:
        """Whether the tangent of a stable state is symmetric and positive definite."""
        return self.symmetric and not self.mixed

    @property
    def reversible(self) -> bool:
        """Whether that tangent depends on the state alone, so that a motion can go back to an earlier one."""
        return self.definite and not self.remembers

    @property
    def conservative(self) -> bool:
        """Whether all work of the gripper is stored: every effect has a potential, and none acts by the clock."""
        return not self.remembers and not any(term.effect.work or term.effect.acting for term in self.terms)

    @property
    def steady(self) -> bool:
        """Whether what is seen depends on the pose alone: not on time, nor on the frames before, nor on the picture's number."""
        return not self.remembers and not any(
            term.effect.acting or term.effect.drive or term.effect.observe or term.effect.held for term in self.terms
        )

    @classmethod
    def of(cls, scene: Scene) -> Model:
        """The model that a scene describes, without anchors and grasp.

        Raises:
            InputError: an unknown law or effect, or wrong values.
        """
        problems: list[str] = []
        model = _model(scene, problems)
        if problems or model is None:
            raise InputError("\n".join([f"scene {scene.source}:", *(f"  {problem}" for problem in problems)]))
        return model


def check_wrinkles(law: Law, mixed: bool, terms: Iterable[Term]) -> list[str]:
    """Why a sheet of a law with effects cannot wrinkle, one readable line each."""
    problems = [f"{term.effect.name} {NOT_IN_WRINKLES}" for term in terms if not term.effect.wrinkles]
    if not law.isotropic:
        problems.append(f"the law '{law.name}' depends on directions: a sheet that wrinkles needs an isotropic law")
    if mixed:
        problems.append('a sheet that wrinkles needs formulation = "displacement": no pressure holds where it is slack')
    return problems


def check_physics(scene: Scene) -> list[str]:
    """Problems of a scene's law, constants and effects, one readable line each."""
    problems: list[str] = []
    _model(scene, problems)
    return problems


def _model(scene: Scene, problems: list[str]) -> Model | None:
    material = scene.material
    try:
        law = materials.law(material.law)
    except InputError as error:
        problems.append(f"material.law: {error}")
        return None
    values = _numbers(material.values, law.parameters, "material", problems)
    mixed = material.formulation == "mixed"
    if not problems:
        problems += [f"material.{problem}" for problem in law.check(values, mixed)]
    form = material.volumetric
    if form and (wrong := law.check_volumetric(form, mixed)):
        problems.append(f"material.volumetric: {wrong}")
    if mixed and any(level.degree < 2 for level in scene.levels):
        problems.append("material.formulation: the mixed formulation needs degree = 2 on every level")
    own = _region_constants(scene, law, values, problems)
    terms = [_term(name, written, scene, problems) for name, written in scene.effects.items()]
    if problems:
        return None
    rollers = (Term("roller", {"stiffness": RIGID}, place=place) for place, axes in scene.held.items() if not axes)
    found = (*(term for term in terms if term), *rollers, *_regions(scene, terms, problems))
    if scene.wrinkles:
        problems += [f"geometry.wrinkles: {problem}" for problem in check_wrinkles(law, mixed, found)]
    if problems:
        return None
    held = tuple((place, axis) for place, axes in scene.held.items() for axis in axes)
    volumetric = next((one for one in VOLUMETRIC if one == form), None)
    model = Model(law, values, material.formulation, volumetric, terms=found, rollers=held)
    model = replace(model, down=scene.down, fibre_axes=scene.fibre_axes)
    return replace(model, region_constants=own, wrinkles=scene.wrinkles)


def _regions(scene: Scene, terms: Sequence[Term | None], problems: list[str]) -> list[Term]:
    """Parts of the body whose stiffness is known."""
    known = [
        Term("region_stiffness", {"ratio": one.ratio}, place=name) for name, one in scene.regions.items() if one.ratio
    ]
    stated = {term.label for term in terms if term}
    for term in known:
        if term.label in stated:
            problems.append(f"regions.{term.place}.ratio: effects.region_stiffness has it as well; state it once")
        problems += [f"regions.{term.place}: {problem}" for problem in term.effect.check(dict(term.values))]
    return known


def _region_constants(
    scene: Scene, law: Law, values: Mapping[str, float], problems: list[str]
) -> dict[str, dict[str, float]]:
    """Constants that regions have of their own, SI."""
    found: dict[str, dict[str, float]] = {}
    for name, region in scene.regions.items():
        if not region.constants:
            continue
        key, wrong = f"regions.{name}.constants", list[str]()
        found[name] = _numbers(region.constants, law.parameters, key, wrong)
        if not wrong:
            checked = law.check({**values, **found[name]}, scene.material.formulation == "mixed")
            wrong = [f"{key}: {problem}" for problem in checked]
        problems += wrong
        for constant in region.constants:
            effect = "region_compressibility" if constant == "poisson" else "region_stiffness"
            if scene.effects.get(effect, {}).get("place") == name:
                problems.append(f"{key}.{constant}: effects.{effect} says it as well; state it once")
    return found


def _term(name: str, written: Values, scene: Scene, problems: list[str]) -> Term | None:
    try:
        effect = effects.effect(name)
    except InputError as error:
        problems.append(f"effects.{name}: {error}")
        return None
    try:
        effect, written = of_table(effect, written)
    except InputError as error:
        problems.append(f"effects.{name}: {error}")
        return None
    place = written.get("place", "") if effect.places else ""
    numbers = {key: value for key, value in written.items() if not (effect.places and key == "place")}
    values = _numbers(numbers, effect.parameters, f"effects.{name}", problems)
    found = effect.check(values)
    if effect.places:
        # Which patches are anchored is not known yet: any may be.
        allowed = effect.places(scene, frozenset(scene.patches))
        if place not in allowed:
            named = "is missing" if place == "" else f"= {place!r}"
            found.append(f"{name}: place {named}; {nearest(str(place), [p for p in allowed if p])}")
    problems += [f"effects.{problem}" for problem in found]
    return None if found else Term(effect, values, place=place)


def _numbers(written: Values, parameters: tuple[Parameter, ...], where: str, problems: list[str]) -> dict[str, Any]:
    """SI values; a parameter with a dimension must carry its unit, a pure number must not."""
    units = {parameter.name: parameter.unit for parameter in parameters}
    values: dict[str, Any] = {}
    for name, value in written.items():
        unit = units.get(name, "1")
        if unit != "1":
            try:
                value = quantity(value, unit)
            except InputError as error:
                problems.append(f"{where}.{name}: {error}")
                continue
        elif name in units and isinstance(value, str):
            problems.append(f"{where}.{name}: expected a bare number without unit, found '{value}'")
            continue
        values[name] = value
    return values
