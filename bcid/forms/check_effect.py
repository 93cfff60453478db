"""Whether an effect keeps its contract, tried on a small box that is pulled, turned, loaded and brought back.

``mpirun -n 2 python -m bcid.forms.check_effect NAME-OR-FILE...`` prints the predictions that two ranks make together; the
comparison of ranks is made with it.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import traceback
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import permutations
from pathlib import Path
from typing import Any

import numpy as np
from dolfinx import fem
from mpi4py import MPI
from numpy.typing import NDArray

from bcid.collective import on_root
from bcid.errors import BcidError, InputError, SolveError
from bcid.forms import effects
from bcid.forms.effects.effect import ACTS_ON, Effect
from bcid.forms.forward import Forward, Prediction
from bcid.forms.mesh import BodyMesh
from bcid.forms.model import Dose, Model
from bcid.forms.parameter import Parameter
from bcid.forms.rotation import from_vector
from bcid.forms.solve import Settings
from bcid.forms.trajectory import poses
from bcid.measurement import Action
from bcid.scene import Grasp, Level, Material, Plane, Region, Scene
from bcid.units import parse_unit

Array = NDArray[np.float64]

_BOX = np.array([0.06, 0.02, 0.04])
_BRICKS = (4, 1, 2)
_ANCHORS = ("left",)
_EXACT = Settings(rtol=1e-12)
# Positions are computed to about this part of the body's size.
_ROUND_OFF = 1e-9
_FUNCTIONS = (
    "energy",
    "potential",
    "work",
    "stiffness",
    "natural",
    "constants",
    "drive",
    "observe",
)


@dataclass(frozen=True)
class Finding:
    """Outcome of one check; `ok` is None when it could not be made."""

    check: str
    ok: bool | None
    text: str

    def __str__(self) -> str:
        word = {True: "ok   ", False: "WRONG", None: "--   "}[self.ok]
        return f"{word}  {self.check}: {self.text}"


@dataclass(frozen=True)
class Units:
    """How many SI units one unit of another system has: numbers of a body that is similar in every way."""

    metre: float = 1.0
    kilogram: float = 1.0
    second: float = 1.0

    def __call__(self, value: float, unit: str) -> float:
        """A value of the box in SI, made that of the similar body."""
        metre, kilogram, second, _degree = parse_unit(unit)[1]
        return value * self.metre**metre * self.kilogram**kilogram * self.second**second


SI = Units()
OTHER = Units(2.0, 3.0, 1.5)


def box(units: Units = SI) -> BodyMesh:
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


def scene(units: Units = SI) -> Scene:
    """The box: lying on its bottom, with two patches, held at the end x = 60 mm."""

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
        support="bottom",
        source="of the check",
    )


def actions(units: Units = SI) -> list[Action]:
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


class Trial:
    """An effect on the box, at its first place or the one that is given."""

    def __init__(self, effect: Effect, place: str | None = None, units: Units = SI) -> None:
        self.effect, self.units = effect, units
        self.scene, self.mesh, self.actions = scene(units), box(units), actions(units)
        self.bare = Model.of(self.scene)
        places = effect.places(self.scene, frozenset(_ANCHORS)) if effect.places else [""]
        self.place = places[0] if place is None else place

    # -- values
    # ------------------------------------------------------------------------------------------------------------

    def amount(self, parameter: Parameter, part: float) -> float:
        """A part of the typical amount."""
        if parameter.reciprocal:
            value = parameter.typical / part
        else:
            neutral = self.bare.neutral(parameter)
            assert neutral is not None
            value = neutral + part * parameter.typical
            if parameter.check(value):
                value = neutral - part * parameter.typical
        return self.units(value, parameter.unit)

    def none(self, parameter: Parameter) -> float:
        """Value of no influence, or the amount of nearly none."""
        return self.amount(parameter, 1e-6 if parameter.reciprocal else 0.0)

    def values(self, part: float = 1.0, only: str = "") -> dict[str, float]:
        """A part of the typical amount (of one parameter, the others being without influence), somewhere and somehow."""
        found = {}
        for p in self.effect.amounts:
            found[p.name] = self.amount(p, part) if part and only in ("", p.name) else self.none(p)
        for p in self.effect.shapes:
            start = p.default if p.default is not None else (p.scan[0] if p.scan else 0.0)
            value = start + p.typical if p.check(start + p.typical) is None else start
            found[p.name] = self.units(value, p.unit)
        return found

    def model(self, values: Mapping[str, float]) -> Model:
        """The box's model with the effect."""
        # Bounds are those of numbers in SI; what stands for them in other units is not compared with them.
        free = tuple(replace(p, lower=-np.inf, upper=np.inf, scan=()) for p in self.effect.parameters)
        effect = self.effect if self.units == SI else replace(self.effect, parameters=free)
        return self.bare + Dose(effect, values, place=self.place)

    # -- predictions
    # -------------------------------------------------------------------------------------------------------

    def forward(self, model: Model, comm: Any = MPI.COMM_SELF) -> Forward:
        """The box with a model, ready to predict."""
        return Forward(self.scene, 0, comm, model, _EXACT, self.mesh)

    @cached_property
    def plain(self) -> Array:
        """Positions without the effect."""
        return self.positions(self.forward(self.bare))

    @cached_property
    def dosed(self) -> Forward:
        """The box with the effect; its numbers may be changed."""
        return self.forward(self.model(self.values()))

    def positions(self, forward: Forward) -> Array:
        """Where the fiducials are seen."""
        return self.predicted(forward).positions

    def predicted(self, forward: Forward) -> Prediction:
        """The prediction, with the states."""
        prediction = forward.predict(_ANCHORS, self.actions, keep=True)
        if prediction.failure:
            raise SolveError(
                f"the box could not be solved with {forward.model.constants()}: {prediction.failure.reason}; "
                "choose a smaller typical, or look for a sign"
            )
        return prediction

    def at(self, values: Mapping[str, float]) -> Array:
        """Positions with these values, by changing numbers only."""
        self.dosed.set_model(self.model(values))
        return self.positions(self.dosed)

    # -- residual and tangent at a state that is no equilibrium
    # ------------------------------------------------------------

    def deform(self, amplitude: float = 1.0) -> None:
        """Take a state, a last state and memories that are the same every time, and of that amplitude."""
        equilibrium, random = self.dosed.equilibrium, np.random.default_rng(1)
        span, nodes = self.mesh.size, equilibrium.body.nodes / self.mesh.size
        wave = np.cos(nodes @ random.normal(size=(3, 3)) * 2 + random.uniform(0, 6, 3))
        equilibrium.u.x.array[:] = amplitude * 0.02 * span * wave.ravel()
        for constant in equilibrium.terms.anchored.values():
            constant.value = 1.0
        for memory in equilibrium.terms.memories.values():
            memory.dt.value, memory.moving.value = self.units(0.7, "s"), 1.0
            memory.last.x.array[:] = amplitude * 0.013 * span * np.sin(3 * nodes).ravel()
            for variable in memory.variables.values():
                variable.x.array[:] = amplitude * random.normal(size=len(variable.x.array)) * 0.1

    def numbers(self, values: Mapping[str, float]) -> None:
        """Set the effect's numbers."""
        self.dosed.set_model(self.model(values))

    def forces(self, form: Any = None) -> Array:
        """Residual at the present state, of a form or of the whole."""
        return self.dosed.equilibrium.forces() if form is None else np.array(fem.assemble_vector(form).array)

    def tangent(self) -> Array:
        """Tangent at the present state."""
        return sum(fem.assemble_matrix(form).to_dense() for form in self.dosed.equilibrium.tangent_forms)


# -- the checks: each tells what is wrong, or "" if nothing is
# ------------------------------------------------------------------------------------------------------------------


def definition(effect: Effect, stem: str = "") -> str:
    """What is wrong with what the effect says of itself."""
    wrong: list[str] = []
    if not effect.name.isidentifier():
        wrong.append(f"name '{effect.name}': use letters, digits and _, as in a variable")
    if stem and effect.name != stem:
        wrong.append(f"its name is '{effect.name}' but that of its file '{stem}': make them the same")
    if effect.acts_on not in ACTS_ON:
        wrong.append(f"acts_on = '{effect.acts_on}': allowed are {', '.join(ACTS_ON)}")
    if not any(getattr(effect, name) for name in _FUNCTIONS):
        wrong.append(f"it does nothing: give one of {', '.join(_FUNCTIONS)}")
    if not effect.amounts:
        wrong.append("no parameter has a neutral value: one must say how much there is of it")
    names = [p.name for p in effect.parameters]
    wrong += [f"parameter '{name}' is declared twice" for name in set(names) if names.count(name) > 1]
    wrong += [text for p in effect.parameters for text in _declaration(p)]
    if set(effect.memory) and not effect.advance:
        wrong.append("it has a memory that nothing advances: give advance")
    if not effect.symmetric and not effect.work:
        wrong.append("symmetric = False, but what has an energy has a symmetric tangent: leave it out")
    if effect.places and not effect.places(scene(), frozenset(_ANCHORS)):
        wrong.append("places gives none for a body with patches, fiducials and a support")
    return "; ".join(wrong)


def _declaration(p: Parameter) -> Iterator[str]:
    if not p.name.isidentifier():
        yield f"parameter name '{p.name}': use letters, digits and _, as in a variable"
    try:
        if parse_unit(p.unit)[0] != 1.0:
            yield f"{p.name}: unit '{p.unit}' is not SI: inside, units are products of m, s, N, Pa, kg, deg"
    except InputError as error:
        yield f"{p.name}: {error}"
    if not (np.isfinite(p.typical) and p.typical > 0):
        yield f"{p.name}: typical = {p.typical}: give a positive size that is notable"
    elif p.neutral is not None and not p.reciprocal and all(p.check(p.neutral + s * p.typical) for s in (1, -1)):
        yield f"{p.name}: {p.typical} from its neutral value is outside the bounds on both sides: choose a smaller typical"
    if not p.about:
        yield f"{p.name}: about is empty: say what it means"


def vanishes(trial: Trial) -> str:
    """At the neutral value nothing may be left of it."""
    none, size = trial.values(0.0), trial.mesh.size
    limit = [p for p in trial.effect.amounts if p.reciprocal]
    if not limit and trial.effect.mechanical:
        trial.numbers(none)
        trial.deform()
        with_it, bare = trial.forces(), _bare_forces(trial)
        left = np.abs(with_it - bare).max() / np.abs(bare).max()
        if not left < 1e-10:
            return (
                f"at {none} the residual differs from that without it by {left:.1e} of its size: it must be zero there"
            )
    away = np.abs(trial.at(none) - trial.plain).max()
    if limit:
        nearer = np.abs(trial.at(trial.values(1e-7)) - trial.plain).max()
        if not nearer < 0.2 * away + _ROUND_OFF * size:
            return f"a ten times smaller dose leaves {nearer / away:.2g} of the difference to the model without it"
    tolerance = 1e-4 * size if limit else _ROUND_OFF * size
    if not away < tolerance:
        return f"at {none} a fiducial is {away * 1e3:.2g} mm from where it is without it: it must be the same"
    return ""


def _bare_forces(trial: Trial) -> Array:
    """Residual of the model without the effect at the state of the model with it."""
    forward = trial.forward(trial.bare)
    forward.equilibrium.u.x.array[:] = trial.dosed.equilibrium.u.x.array
    return forward.equilibrium.forces()


def acts(trial: Trial) -> str:
    """Each amount must move something at its typical size."""
    idle = []
    for p in trial.effect.amounts:
        moved = np.abs(trial.at(trial.values(1.0, p.name)) - trial.plain).max()
        if not moved > 10 * _ROUND_OFF * trial.mesh.size:
            idle.append(p.name)
    return f"nothing moves at the typical size of {', '.join(idle)}: raise typical, or look for a unit" if idle else ""


def follows_numbers(trial: Trial) -> str:
    """What it does depends on its numbers and the state alone: a change of numbers is all that a fit makes."""
    values = trial.values(0.6)
    changed, again = trial.at(values), trial.positions(trial.forward(trial.model(values)))
    gap = np.abs(changed - again).max() / trial.mesh.size
    if gap < _ROUND_OFF:
        return ""
    return (
        f"the same values give positions that differ by {gap:.1e} of the size when they are set later and when the model is "
        "built with them: it must use the numbers and the state it is handed, and nothing else (no float(), no global)"
    )


def seen_by_tangent(trial: Trial) -> str:
    """The tangent must be the derivative of the residual: what it misses falls with the square of the step."""
    trial.numbers(trial.values())
    unknown = trial.dosed.equilibrium.u.x.array
    for amplitude, where in ((0.0, "at rest"), (1.0, "deformed")):
        trial.deform(amplitude)
        start = unknown.copy()
        across = np.random.default_rng(2).normal(size=len(start)) * 1e-3 * trial.mesh.size
        force, slope = trial.forces(), trial.tangent() @ across
        sizes = 0.5 ** np.arange(3, 8)
        missed = []
        for size in sizes:
            unknown[:] = start + size * across
            missed.append(np.abs(trial.forces() - force - size * slope).max())
        unknown[:] = start
        rate = np.log2(np.maximum(missed, 1e-300))[[0, -1]]
        order = (rate[0] - rate[1]) / (len(sizes) - 1)
        exact = max(missed) < 1e-11 * np.abs(slope).max()
        if not (exact or order > 1.8):
            return (
                f"{where}, what the tangent misses falls with the power {order:.2f} of the step, not 2: the residual jumps "
                "or has a kink there, or hides from UFL's derivative"
            )
    return ""


def agrees_with_differences(trial: Trial) -> str:
    """Smooth in its amounts, the same by `Terms.part`, and predicted by one linear solve."""
    for p in trial.effect.amounts:
        for check in (_smooth_forces, _smooth_positions):
            if text := check(trial, p):
                return f"{p.name}: {text}"
    return ""


def _slopes(of: Callable[[float], Array]) -> tuple[Array, float, float]:
    """Slope at 0 (extrapolated), its size, and how much the differences fail to settle as the step is halved."""
    start = of(0.0)
    first, second, third = (np.asarray((of(h) - start) / h) for h in (0.04, 0.02, 0.01))
    change, later = np.abs(first - second).max(), np.abs(second - third).max()
    return 2 * third - second, float(np.abs(third).max()), float(later - 0.7 * change)


def _smooth_forces(trial: Trial, p: Parameter) -> str:
    if p.reciprocal or not trial.effect.mechanical:
        return ""
    trial.numbers(trial.values())
    dose = trial.dosed.model.doses[0]
    part = trial.dosed.equilibrium.terms.part(dose)

    def forces(form: Any) -> Callable[[float], Array]:
        def of(step: float) -> Array:
            trial.numbers({**trial.values(0.0), p.name: trial.amount(p, step)})
            trial.deform()
            return trial.forces(form)

        return of

    slope, size, unsettled = _slopes(forces(part))
    if unsettled > 1e-7 * size:
        return f"difference quotients of the residual do not settle as the step is halved (by {unsettled / size:.1e})"
    whole, _, _ = _slopes(forces(None))
    gap = np.abs(whole - slope).max()
    return "" if gap < 1e-6 * size else f"the residual's derivative is not that of its own part (by {gap / size:.1e})"


def _smooth_positions(trial: Trial, p: Parameter) -> str:
    def positions(step: float) -> Array:
        return trial.at({**trial.values(0.0), p.name: trial.amount(p, max(step, 1e-6) if p.reciprocal else step)})

    slope, size, unsettled = _slopes(positions)
    noise = 100 * _ROUND_OFF * trial.mesh.size
    if unsettled > 1e-4 * size + noise:
        return f"difference quotients of the positions do not settle as the step is halved (by {unsettled / size:.1e})"
    effect = trial.effect
    if not effect.mechanical or effect.drive or effect.observe or effect.frees or effect.memory or effect.uses_past:
        return ""
    gap = np.abs(_signature(trial, p) - slope).max()
    if gap < 0.02 * size + noise:
        return ""
    return f"K du = -dR/d{p.name} predicts positions that the whole model does not show (by {gap / size:.1e})"


def _signature(trial: Trial, p: Parameter) -> Array:
    """What a small dose does to the fiducials, by one linear solve per frame with the converged tangent."""
    trial.numbers(trial.values(0.0))
    forward, equilibrium = trial.dosed, trial.dosed.equilibrium
    states = trial.predicted(forward).states
    assert states is not None
    action, step = trial.actions[0], 1e-3
    equilibrium.hold(_ANCHORS, action.grasp)
    part = equilibrium.terms.part(forward.model.doses[0])
    dosed = trial.model({**trial.values(0.0), p.name: trial.amount(p, step)})
    rows = []
    for pose, frame in zip(poses(action), action.frames, strict=True):
        equilibrium.set_state(pose, states[int(frame)])
        free = np.setdiff1d(np.arange(equilibrium.body.unknowns), equilibrium._held)
        tangent, before = trial.tangent(), trial.forces(part)
        equilibrium.set_constants(dosed.acting(1.0, pose.time))
        slope = (trial.forces(part) - before) / step
        moved = np.zeros(equilibrium.body.unknowns)
        moved[free] = np.linalg.solve(tangent[np.ix_(free, free)], -slope[free])
        rows.append(forward.observer.positions(moved.reshape(-1, 3)) - forward.observer.rest)
    return np.array(rows)


def symmetry(trial: Trial) -> str:
    """The tangent must be symmetric where the effect says so: it is factorised as such."""
    if not trial.effect.symmetric or not trial.effect.mechanical:
        return ""
    trial.numbers(trial.values())
    trial.deform()
    tangent = trial.tangent()
    gap = np.abs(tangent - tangent.T).max() / np.abs(tangent).max()
    return "" if gap < 1e-10 else f"its tangent is not symmetric (by {gap:.1e}): say symmetric=False, or give an energy"


def units(trial: Trial) -> str:
    """A similar body, in every way larger, heavier and slower, must do the same."""
    other = Trial(trial.effect, trial.place, OTHER)
    for p in trial.effect.amounts:
        here = trial.at(trial.values(1.0, p.name)) - trial.plain
        there = (other.at(other.values(1.0, p.name)) - other.plain) / OTHER.metre
        gap = np.abs(here - there).max()
        if gap > 1e-5 * np.abs(here).max() + 10 * _ROUND_OFF * trial.mesh.size:
            return (
                f"{p.name} ({p.unit}) does {np.abs(there).max() / np.abs(here).max():.3g} times as much in a similar body that is "
                "larger, heavier and slower: a parameter has another unit than it says, or the formula holds a number with a "
                "dimension (make that a parameter)"
            )
    return ""


CHECKS: dict[str, tuple[Callable[[Trial], str], str]] = {
    "vanishes": (vanishes, "at its neutral value nothing is left of it"),
    "acts": (acts, "every amount moves the fiducials at its typical size"),
    "numbers": (follows_numbers, "it depends on its numbers and the state alone"),
    "tangent": (seen_by_tangent, "the tangent is the derivative of the residual"),
    "differences": (agrees_with_differences, "differences of the residual and of the positions agree with the tangent"),
    "symmetry": (symmetry, "the tangent is symmetric where it says so"),
    "units": (units, "a similar body does the same: its units are consistent"),
}


def run(name: str, trial: Trial) -> Finding:
    """One of `CHECKS`; an error inside the effect is a finding too."""
    check, good = CHECKS[name]
    try:
        wrong = check(trial)
    except BcidError as error:
        wrong = str(error)
    except Exception as error:
        wrong = f"{type(error).__name__}: {error} ({_place_of(error)})"
    return Finding(name, not wrong, wrong or good)


def _place_of(error: BaseException) -> str:
    frame = traceback.extract_tb(error.__traceback__)[-1]
    return f"{frame.filename}:{frame.lineno}"


def findings(effect: Effect, file: str = "") -> Iterator[Finding]:
    """All checks that one rank can make."""
    try:
        wrong = definition(effect, Path(file).stem if file else "")
        trial = None if wrong else Trial(effect)
    except Exception as error:
        wrong = f"{type(error).__name__}: {error} ({_place_of(error)})"
    yield Finding("definition", not wrong, wrong or "name, units, bounds and functions are complete")
    if wrong or trial is None:
        return
    for name in CHECKS:
        yield run(name, trial)


# -- ranks
# ------------------------------------------------------------------------------------------------------------------


def together(effect: Effect, comm: Any) -> Array:
    """Positions at the typical dose, computed by all ranks of `comm` together."""
    trial = Trial(effect)
    return trial.positions(trial.forward(trial.model(trial.values()), comm))


def on_two_ranks(sources: Iterable[str]) -> dict[str, Array]:
    """`together` for effects given by name or file, by two new processes.

    Raises:
        InputError: they failed; with what they said.
    """
    # A child must not take itself for a rank of the job that this process may belong to.
    inherited = ("PMIX_", "PMI_", "OMPI_COMM_", "OMPI_UNIVERSE_")
    clean = {key: value for key, value in os.environ.items() if not key.startswith(inherited)}
    # Ranks that wait must not hold up the one they wait for, where there are fewer cores than ranks.
    clean |= {"OMPI_MCA_mpi_yield_when_idle": "1", "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    command = ["mpirun", "-n", "2", sys.executable, "-m", "bcid.forms.check_effect", *sources]
    child = subprocess.run(command, env=clean, capture_output=True, text=True, timeout=600)
    lines = [line for line in child.stdout.splitlines() if line.startswith("{")]
    if child.returncode or not lines:
        raise InputError(f"two ranks failed: {(child.stderr.strip() or child.stdout.strip())[-400:]}")
    return {name: np.array(positions) for name, positions in json.loads(lines[-1]).items()}


def ranks(effect: Effect, source: str, comm: Any, shared: Array | None = None) -> Finding:
    """The same on one rank and on several; collective on `comm`. `shared`: what several ranks gave, if known."""
    name, count = "ranks", comm.size if comm.size > 1 else 2
    try:
        if shared is None and comm.size > 1:
            shared = together(effect, comm)
        elif shared is None:
            if not shutil.which("mpirun"):
                return Finding(name, None, "not tried: there is no mpirun here")
            shared = on_two_ranks([source])[effect.name]
        gap = np.abs(shared - together(effect, MPI.COMM_SELF)).max() / box().size
    except (BcidError, subprocess.TimeoutExpired) as error:
        return Finding(name, False, str(error))
    if gap < _ROUND_OFF:
        return Finding(name, True, f"the same on one and on {count} ranks")
    text = f"positions on {count} ranks differ from those on one by {gap:.1e} of the size"
    return Finding(name, False, f"{text}: what it does at a point must not depend on how the mesh is shared out")


def known(source: str) -> Effect:
    """An effect by the path of its file, or by its name in the catalogue."""
    return effects.load(source) if source.endswith(".py") or os.sep in source else effects.effect(source)


def check_effect(source: str, comm: Any, say: Callable[[str], None]) -> None:
    """Check an effect given by file or by name, one line per finding; collective on `comm`.

    Raises:
        InputError: it cannot be read, or does not keep the contract.
    """
    effect = known(source)
    is_file = source.endswith(".py") or os.sep in source

    def alone() -> list[bool]:
        made = []
        for finding in findings(effect, source if is_file else ""):
            say(str(finding))
            made.append(finding.ok is not False)
        return made

    made = on_root(comm, alone)
    if len(made) > 1:
        last = ranks(effect, source, comm)
        say(str(last))
        made.append(last.ok is not False)
    if not all(made):
        left = "; the other checks were not made" if len(made) == 1 else ""
        raise InputError(f"effect {effect.name}: {made.count(False)} of {len(made)} checks failed{left}")


def _main(sources: list[str]) -> None:
    comm = MPI.COMM_WORLD
    made = {}
    for source in sources:
        effect = known(source)
        made[effect.name] = together(effect, comm).tolist()
    if comm.rank == 0:
        print(json.dumps(made), flush=True)


if __name__ == "__main__":
    _main(sys.argv[1:])
