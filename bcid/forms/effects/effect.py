"""An effect: something physical that a plain hyperelastic body, a sure grip or an ideal camera lacks."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from bcid.base.errors import nearest
from bcid.forms.parameter import Parameter
from bcid.measurement import Action, Measurement
from bcid.scene import Scene

if TYPE_CHECKING:
    from ufl.core.expr import Expr

    from bcid.forms.kinematics import Kinematics
    from bcid.forms.mesh.patch_frame import PatchFrame

Array = NDArray[np.float64]
Constants = Mapping[str, Any]

# Step of a difference, in units of a parameter's scale, of what is a function and no form.
STEP = 1e-3
NOT_IN_WRINKLES = (
    "cannot act in a sheet that wrinkles: which stress its folds leave is known of isotropic laws without memory alone"
)
ACTS_ON = ("body force", "material", "boundary", "grasp", "observation")


@dataclass(frozen=True)
class Past:
    """What an effect with memory knows of the last step; everything is UFL.

    Attributes:
        u: displacement at the last step, m.
        kin: deformation measures of it.
        dt: time since then, s; at step 0, before which the body has long been at rest, 1e9.
        moving: 0 at step 0, 1 after.
        memory: the effect's own variables by name.
    """

    u: Expr
    kin: Kinematics
    dt: Expr
    moving: Expr
    memory: Mapping[str, Expr]


@dataclass(frozen=True)
class Point:
    """What an effect may use at a material point; everything is UFL.

    Attributes:
        u: displacement, m.
        v: virtual displacement.
        kin: deformation measures of u.
        X: rest position, m.
        N: outward normal in the rest state (on the boundary).
        normal: the same of a named place where it is needed at its nodes: ``normal(name)``, zero away from it.
        down: unit vector of gravity.
        centre: middle of the body's bounding box in the rest state, m.
        size: its diagonal, m.
        shear: initial shear modulus of the law, Pa.
        place: where the effect acts, one of its `places`.
        surface: measure of a named place, ``surface(name)``, m^2 in the rest state.
        share: part of each cell that lies in a region of the body, ``share(name)``.
        frame: axes in the plane of a patch, ``frame(patch)``.
        boundary: measure of the whole boundary, m^2 in the rest state.
        support: name of the scene's support surface, "" if it has none.
        patches: names of all patches.
        held_along: axes (0, 1, 2) along which a patch holds where it is anchored, ``held_along(patch)``.
        anchored: 1 where a patch is anchored, else 0: ``anchored(patch)``.
        gripper: displacement if everything moved with the gripper, m.
        grasps: names of all grasps that are surfaces.
        grasped: 1 where the gripper holds by springs what it holds, else 0: ``grasped(grasp)``.
        grip: measure of what a gripper holds, ``grip(grasp)``, m^2 in the rest state.
        past: the last step, for effects with memory.
    """

    u: Expr
    v: Expr
    kin: Kinematics
    X: Expr
    N: Expr
    normal: Callable[[str], Expr]
    down: Expr
    centre: Expr
    size: float
    shear: Any
    place: str
    surface: Callable[[str], Any]
    share: Callable[[str], Expr]
    frame: Callable[[str], PatchFrame]
    boundary: Any
    support: str
    patches: tuple[str, ...]
    held_along: Callable[[str], tuple[int, ...]]
    anchored: Callable[[str], Any]
    gripper: Expr
    grasps: tuple[str, ...]
    grasped: Callable[[str], Any]
    grip: Callable[[str], Any]
    past: Past


@dataclass(frozen=True)
class Frame:
    """One step of one action, as an observation effect sees it.

    Attributes:
        index: number of the frame in the measurement.
        action: name of the action.
        step: step of the action.
        time: s.
        names: of the fiducials.
        rest: their stress-free positions, shape (fiducials, 3), m.
    """

    index: int
    action: str
    step: int
    time: float
    names: tuple[str, ...]
    rest: Array


@dataclass(frozen=True)
class Effect:
    """What all effects of the catalogue have; what one does says its kind: `BodyEffect`, `AnchorEffect`,
    `GripEffect` or `ObservationEffect`.

    At the neutral value of every parameter that has one the effect must vanish, whatever the others are: those with a
    neutral value say how much there is of it, the others where, in which direction or how fast it acts.

    Attributes:
        name: name of its file, used in scenes, tables and JSON.
        parameters: each with unit, neutral value, bounds and scale.
        about: one phrase.
        places: the places it can act at, given scene and anchors; by default it has none.
        needs: why it cannot act in a scene and measurement, in words; "" if it can.
        instead_of: what the scene may have slightly wrong (a name of `bcid.scene.uncertainty`) that this is when it is large; of a
            law "law.part" and "law.second", see `bcid.forms.scene_errors.law_form`.
        only_named: whether it is looked for only where it is named, for it does nearly what a scene does that is slightly wrong.
        acting: the values that act at a time (s), which all other functions are handed instead of the parameters' own; those by
            default. With every amount neutral they must not change with time.
    """

    name: str
    parameters: tuple[Parameter, ...]
    about: str
    places: Callable[[Scene, frozenset[str]], list[str]] | None = None
    needs: Callable[[Scene, Measurement], str] | None = None
    instead_of: str = ""
    only_named: bool = False
    acting: Callable[[float, Mapping[str, float]], Mapping[str, float]] | None = None

    # What an effect of a kind does not do.

    @property
    def acts_on(self) -> str:
        return ""

    @property
    def energy(self) -> Callable[[Point, Constants], Expr] | None:
        return None

    @property
    def potential(self) -> Callable[[Point, Constants], Any] | None:
        return None

    @property
    def work(self) -> Callable[[Point, Constants], Any] | None:
        return None

    @property
    def stiffness(self) -> Callable[[Point, Constants], Expr] | None:
        return None

    @property
    def around(self) -> Callable[[Array, Mapping[str, float]], Array] | None:
        return None

    @property
    def ahead(self) -> bool:
        return False

    @property
    def growth(self) -> Callable[[Point, Constants], Expr] | None:
        return None

    @property
    def reshaped(self) -> Callable[[Point, Constants], Expr] | None:
        return None

    @property
    def constants(self) -> Callable[[Constants], Mapping[str, Any]] | None:
        return None

    @property
    def volumetric(self) -> Callable[[Point, Constants], Mapping[str, Any]] | None:
        return None

    @property
    def memory(self) -> Mapping[str, tuple[int, ...]] | None:
        return None

    @property
    def advance(self) -> Callable[[Point, Constants], Mapping[str, Expr]] | None:
        return None

    @property
    def wrinkles(self) -> bool:
        return True

    @property
    def frees(self) -> bool:
        return False

    @property
    def share(self) -> Callable[[PatchFrame, tuple[Any, Any], Constants, Any], Any] | None:
        return None

    @property
    def gives(self) -> bool:
        return False

    @property
    def uses_past(self) -> bool:
        return False

    @property
    def symmetric(self) -> bool:
        return True

    @property
    def drive(self) -> Callable[[Action, Mapping[str, float]], Action] | None:
        return None

    @property
    def retimed(self) -> Callable[[Array, Mapping[str, float]], Array] | None:
        return None

    @property
    def held(self) -> Callable[[frozenset[str], int, Mapping[str, float], str], frozenset[str]] | None:
        return None

    @property
    def observe(self) -> Callable[[Array, Mapping[str, float], Frame, str], Array] | None:
        return None

    @property
    def mechanical(self) -> bool:
        """Whether it adds to the equilibrium itself (not only to the motion or the picture of it)."""
        return any((self.energy, self.potential, self.work, self.changes_law))

    @property
    def changes_law(self) -> bool:
        """Whether it changes the strain energy itself."""
        return any((self.stiffness, self.growth, self.reshaped, self.constants, self.volumetric))

    @property
    def moves(self) -> bool:
        """Whether it moves the body, and does not only change what is seen of it."""
        return bool(self.mechanical or self.drive or self.held)

    @property
    def smooth(self) -> bool:
        """Whether what it does in the body depends on where the gripper is, whatever the time and the way there."""
        return not (
            self.sudden or self.memory or self.uses_past or self.acting or self.observe or self.retimed or self.held
        )

    @property
    def sudden(self) -> bool:
        """Whether it begins in a frame."""
        return any(p.onset for p in self.parameters)

    @property
    def amounts(self) -> tuple[Parameter, ...]:
        """The parameters that say how much there is of it."""
        return tuple(p for p in self.parameters if p.neutral is not None)

    @property
    def shapes(self) -> tuple[Parameter, ...]:
        """The parameters that say where, in which direction or how fast it acts."""
        return tuple(p for p in self.parameters if p.neutral is None)

    def at(self, time: float, values: Mapping[str, float]) -> Mapping[str, float]:
        """The values that act at a time, s."""
        return self.acting(time, values) if self.acting else values

    def slopes(self, name: str, time: float, values: Mapping[str, float]) -> dict[str, float]:
        """How the values that act at a time, s, change with a parameter; those that do not are left out."""
        if self.acting is None:
            return {name: 1.0}
        step = STEP * next(p for p in self.parameters if p.name == name).scale
        more, less = (self.acting(time, {**values, name: values[name] + h}) for h in (step, -step))
        found = {key: (more[key] - less[key]) / (2 * step) for key in more}
        return {key: slope for key, slope in found.items() if slope}

    def driven(self, action: Action, values: Mapping[str, float]) -> Action:
        """What the gripper really did, when an action was commanded: each step by the values that act at its time."""
        if self.drive is None or self.acting is None:
            return self.drive(action, values) if self.drive else action
        moved = [self.drive(action, self.acting(float(time), values)) for time in action.clock]
        loads = {place: np.array([m.loads[place][k] for k, m in enumerate(moved)]) for place in action.loads}
        translation = np.array([m.translation[k] for k, m in enumerate(moved)])
        rotation = np.array([m.rotation[k] for k, m in enumerate(moved)])
        return replace(action, translation=translation, rotation=rotation, loads=loads)

    def observed(self, positions: Array, values: Mapping[str, float], frame: Frame, place: str) -> Array:
        """Where the fiducials (fiducials, 3) appear in a frame when they are at given positions, m."""
        return self.observe(positions, self.at(frame.time, values), frame, place) if self.observe else positions

    def not_applicable(self, scene: Scene, measurement: Measurement) -> str:
        """Why it cannot act in a scene and measurement, in words; "" if it can."""
        if scene.wrinkles and not self.wrinkles:
            return f"{self.name} {NOT_IN_WRINKLES}"
        return self.needs(scene, measurement) if self.needs else ""

    def check(self, values: Mapping[str, object]) -> list[str]:
        """Problems of parameter values, one readable line each."""
        known = {parameter.name: parameter for parameter in self.parameters}
        problems = [f"unknown parameter '{name}'; {nearest(name, known)}" for name in values if name not in known]
        problems += [
            f"parameter '{name}' is missing" for name, p in known.items() if name not in values and p.default is None
        ]
        checks = (known[name].check(value) for name, value in values.items() if name in known)
        return [f"{self.name}: {problem}" for problem in [*problems, *checks] if problem]


@dataclass(frozen=True)
class BodyEffect(Effect):
    """Something that acts in the body or on its boundary. At least one of the functions must be given.

    Attributes:
        acts_on: "body force", "material" or "boundary"; "grasp" for what holds in the gripper's place.
        energy: energy per rest volume (J/m^3), which joins the strain energy.
        potential: a form whose value is an energy (J), such as one on the boundary.
        work: a form, the virtual work that the effect adds to the residual, for what has no energy.
        stiffness: factor of the law's strain energy.
        around: change of `stiffness` at points (n, 3), m, per unit of its one amount, for an effect with a centre (cx, cy, cz)
            and a radius, m: places all over the body are then tried.
        ahead: whether it is a ball with a centre (cx, cy, cz) and a radius, m, outside of the body at rest: places that the body
            moves to are then tried.
        growth: 3 x 3 tensor by which the rest state is already stretched: the law sees F . growth.
        reshaped: 3 x 3 tensor G of derivatives of the scene's rest positions by the true ones, where the body at rest is another
            than the scene's: the law sees I + grad u . G.
        constants: constants of the law that it replaces, by name; with a place, a region of the body, only there.
        volumetric: parts (1: all) of other forms of the law's volumetric energy that take the place of its own, by form.
        memory: shapes of variables kept from step to step, by name, such as {"Q": (3, 3)}; of what acts on the boundary they are
            vectors at the nodes, (3,).
        advance: their values after a step.
        wrinkles: whether it may act in a sheet that wrinkles: what it stores is of the strain alone, whatever its direction.
        frees: whether the anchored patches at its place are no longer fixed, because the effect holds them.
        share: of springs whose compliance is not the same all over a patch, the share of a place in its plane, from the patch's
            frame, the place (x, y), m, the values, and a module with cos, sin, exp and sqrt.
        gives: whether what the gripper holds is no longer prescribed, because the effect holds it.
        uses_past: whether `energy`, `potential` or `work` use `Point.past`.
        symmetric: False when the tangent of `work` is not symmetric (a follower load).
    """

    acts_on: str = "body force"
    energy: Callable[[Point, Constants], Expr] | None = None
    potential: Callable[[Point, Constants], Any] | None = None
    work: Callable[[Point, Constants], Any] | None = None
    stiffness: Callable[[Point, Constants], Expr] | None = None
    around: Callable[[Array, Mapping[str, float]], Array] | None = None
    ahead: bool = False
    growth: Callable[[Point, Constants], Expr] | None = None
    reshaped: Callable[[Point, Constants], Expr] | None = None
    constants: Callable[[Constants], Mapping[str, Any]] | None = None
    volumetric: Callable[[Point, Constants], Mapping[str, Any]] | None = None
    memory: Mapping[str, tuple[int, ...]] | None = None
    advance: Callable[[Point, Constants], Mapping[str, Expr]] | None = None
    wrinkles: bool = True
    frees: bool = False
    share: Callable[[PatchFrame, tuple[Any, Any], Constants, Any], Any] | None = None
    gives: bool = False
    uses_past: bool = False
    symmetric: bool = True


@dataclass(frozen=True)
class AnchorEffect(Effect):
    """Something that makes anchored patches hold at some times only.

    Attributes:
        acts_on: "boundary".
        held: which of the anchored patches are held in a frame, from their names, its number, the values and the place.
    """

    acts_on: str = "boundary"
    held: Callable[[frozenset[str], int, Mapping[str, float], str], frozenset[str]] | None = None


@dataclass(frozen=True)
class GripEffect(Effect):
    """Something that makes the gripper move other than it was told.

    Attributes:
        acts_on: "grasp", or "observation" for what is a matter of clocks.
        drive: what the gripper really did, when an action was commanded.
        retimed: where that is what was commanded for other times: these (s), for those of an action.
    """

    acts_on: str = "grasp"
    drive: Callable[[Action, Mapping[str, float]], Action] | None = None
    retimed: Callable[[Array, Mapping[str, float]], Array] | None = None


@dataclass(frozen=True)
class ObservationEffect(Effect):
    """Something that changes what is seen, and leaves the body alone.

    Attributes:
        acts_on: "observation".
        observe: where the fiducials (fiducials, 3) appear in a frame, when they are at given positions.
    """

    acts_on: str = "observation"
    observe: Callable[[Array, Mapping[str, float], Frame, str], Array] | None = None
