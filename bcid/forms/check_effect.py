"""Whether an effect keeps its contract, tried on a small box (see `bcid.forms.effect_trial`).

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
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from bcid.base.collective import Comm, on_root
from bcid.base.errors import BcidError, InputError
from bcid.base.units import parse_unit
from bcid.forms import effects
from bcid.forms.effect_trial import ANCHORS, OTHER, ROUND_OFF, EffectTrial, box, scene
from bcid.forms.effects.effect import ACTS_ON, Effect
from bcid.forms.parameter import Parameter
from bcid.forms.solver.trajectory import poses

Array = NDArray[np.float64]

_FUNCTIONS = (
    "energy",
    "potential",
    "work",
    "stiffness",
    "growth",
    "reshaped",
    "constants",
    "volumetric",
    "drive",
    "held",
    "observe",
)


@dataclass(frozen=True)
class CheckResult:
    """Outcome of one check; `ok` is None when it could not be made."""

    check: str
    ok: bool | None
    text: str

    def __str__(self) -> str:
        word = {True: "ok   ", False: "WRONG", None: "--   "}[self.ok]
        return f"{word}  {self.check}: {self.text}"


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
    if effect.memory and not effect.advance:
        wrong.append("it has a memory that nothing advances: give advance")
    if not effect.symmetric and not effect.work:
        wrong.append("symmetric = False, but what has an energy has a symmetric tangent: leave it out")
    if effect.places and not effect.places(scene(), frozenset(ANCHORS)):
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
    if not (np.isfinite(p.scale) and p.scale > 0):
        yield f"{p.name}: scale = {p.scale}: give a positive size that is notable"
    elif p.neutral is not None and not p.reciprocal and all(p.check(p.neutral + s * p.scale) for s in (1, -1)):
        yield f"{p.name}: {p.scale} from its neutral value is outside the bounds on both sides: choose a smaller scale"
    if not p.about:
        yield f"{p.name}: about is empty: say what it means"


def vanishes(trial: EffectTrial) -> str:
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
        if not nearer < 0.2 * away + ROUND_OFF * size:
            return f"a ten times smaller term leaves {nearer / away:.2g} of the difference to the model without it"
    tolerance = 1e-4 * size if limit else ROUND_OFF * size
    if not away < tolerance:
        return f"at {none} a fiducial is {away * 1e3:.2g} mm from where it is without it: it must be the same"
    return ""


def _bare_forces(trial: EffectTrial) -> Array:
    """Residual of the model without the effect at the state of the model with it."""
    forward = trial.forward(trial.bare)
    forward.equilibrium.u.x.array[:] = trial.with_effect.equilibrium.u.x.array
    return forward.equilibrium.forces()


def acts(trial: EffectTrial) -> str:
    """Each amount must move something at its scale."""
    idle = []
    for p in trial.effect.amounts:
        moved = np.abs(trial.at(trial.values(1.0, p.name)) - trial.plain).max()
        if not moved > 10 * ROUND_OFF * trial.mesh.size:
            idle.append(p.name)
    return f"nothing moves at the scale of {', '.join(idle)}: raise scale, or look for a unit" if idle else ""


def follows_numbers(trial: EffectTrial) -> str:
    """What it does depends on its numbers and the state alone: a change of numbers is all that a fit makes."""
    values = trial.values(0.6)
    changed, again = trial.at(values), trial.positions(trial.forward(trial.model(values)))
    gap = np.abs(changed - again).max() / trial.mesh.size
    if gap < ROUND_OFF:
        return ""
    return (
        f"the same values give positions that differ by {gap:.1e} of the size when they are set later and when the model is "
        "built with them: it must use the numbers and the state it is handed, and nothing else (no float(), no global)"
    )


def seen_by_tangent(trial: EffectTrial) -> str:
    """The tangent must be the derivative of the residual: what it misses falls with the square of the step."""
    trial.numbers(trial.values())
    unknown = trial.with_effect.equilibrium.u.x.array
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


def agrees_with_differences(trial: EffectTrial) -> str:
    """Smooth in its amounts, the same by `WeakForm.part`, and predicted by one linear solve."""
    for p in trial.effect.amounts:
        for check in (_smooth_forces, _smooth_positions):
            if text := check(trial, p):
                return f"{p.name}: {text}"
    return ""


def _slopes(of: Callable[[float], Array]) -> tuple[Array, float, float]:
    """Slope at 0 (Richardson, twice), its size, and how much the differences fail to settle as the step is halved."""
    start = of(0.0)
    first, second, third = (np.asarray((of(h) - start) / h) for h in (0.04, 0.02, 0.01))
    change, later = np.abs(first - second).max(), np.abs(second - third).max()
    return (8 * third - 6 * second + first) / 3, float(np.abs(third).max()), float(later - 0.7 * change)


def _smooth_forces(trial: EffectTrial, p: Parameter) -> str:
    if p.reciprocal or not trial.effect.mechanical:
        return ""

    def forces(step: float) -> Array:
        trial.numbers({**trial.values(0.0), p.name: trial.amount(p, step)})
        trial.deform()
        return trial.forces()

    slope, size, unsettled = _slopes(forces)
    if unsettled > 1e-7 * size:
        return f"difference quotients of the residual do not settle as the step is halved (by {unsettled / size:.1e})"
    trial.numbers(trial.values(0.0))
    trial.deform()
    derived = trial.slope(p)
    gap = np.abs(derived - slope).max()
    return "" if gap < 1e-6 * size else f"its derivative by {p.name} is not that of the residual (by {gap / size:.1e})"


def _smooth_positions(trial: EffectTrial, p: Parameter) -> str:
    def positions(step: float) -> Array:
        return trial.at({**trial.values(0.0), p.name: trial.amount(p, max(step, 1e-6) if p.reciprocal else step)})

    slope, size, unsettled = _slopes(positions)
    noise = 100 * ROUND_OFF * trial.mesh.size
    if unsettled > 1e-4 * size + noise:
        return f"difference quotients of the positions do not settle as the step is halved (by {unsettled / size:.1e})"
    effect = trial.effect
    if not effect.mechanical or effect.drive or effect.observe or effect.frees or effect.gives:
        return ""
    if effect.memory or effect.uses_past:
        return ""
    gap = np.abs(_sensitivity(trial, p) - slope).max()
    if gap < 0.02 * size + noise:
        return ""
    return f"K du = -dR/d{p.name} predicts positions that the whole model does not show (by {gap / size:.1e})"


def _sensitivity(trial: EffectTrial, p: Parameter) -> Array:
    """What a small term does to the fiducials, by one linear solve per frame with the converged tangent."""
    trial.numbers(trial.values(0.0))
    forward, equilibrium = trial.with_effect, trial.with_effect.equilibrium
    states = trial.predicted(forward).states
    assert states is not None
    action = trial.actions[0]
    equilibrium.hold(ANCHORS, action.grasp)
    rows = []
    for pose, frame in zip(poses(action), action.frames, strict=True):
        equilibrium.set_state(pose, states[int(frame)])
        free = np.setdiff1d(np.arange(equilibrium.body.unknowns), equilibrium.supports.prescribed)
        tangent, slope = trial.tangent(), trial.slope(p, pose.time)
        moved = np.zeros(equilibrium.body.unknowns)
        moved[free] = np.linalg.solve(tangent[np.ix_(free, free)], -slope[free])
        rows.append(forward.observer.positions(moved.reshape(-1, 3)) - forward.observer.rest)
    return np.array(rows)


def symmetry(trial: EffectTrial) -> str:
    """The tangent must be symmetric where the effect says so: it is factorised as such."""
    if not trial.effect.symmetric or not trial.effect.mechanical:
        return ""
    trial.numbers(trial.values())
    trial.deform()
    tangent = trial.tangent()
    gap = np.abs(tangent - tangent.T).max() / np.abs(tangent).max()
    return "" if gap < 1e-10 else f"its tangent is not symmetric (by {gap:.1e}): say symmetric=False, or give an energy"


def units(trial: EffectTrial) -> str:
    """A similar body, in every way larger, heavier and slower, must do the same."""
    for p in trial.effect.amounts:
        here = trial.at(trial.values(1.0, p.name)) - trial.plain
        with EffectTrial(trial.effect, trial.place, OTHER) as other:
            there = (other.at(other.values(1.0, p.name)) - other.plain) / OTHER.metre
        gap = np.abs(here - there).max()
        if gap > 1e-5 * np.abs(here).max() + 10 * ROUND_OFF * trial.mesh.size:
            return (
                f"{p.name} ({p.unit}) does {np.abs(there).max() / np.abs(here).max():.3g} times as much in a similar body that is "
                "larger, heavier and slower: a parameter has another unit than it says, or the formula holds a number with a "
                "dimension (make that a parameter)"
            )
    return ""


CHECKS: dict[str, tuple[Callable[[EffectTrial], str], str]] = {
    "vanishes": (vanishes, "at its neutral value nothing is left of it"),
    "acts": (acts, "every amount moves the fiducials at its scale"),
    "numbers": (follows_numbers, "it depends on its numbers and the state alone"),
    "tangent": (seen_by_tangent, "the tangent is the derivative of the residual"),
    "differences": (agrees_with_differences, "differences of the residual and of the positions agree with the tangent"),
    "symmetry": (symmetry, "the tangent is symmetric where it says so"),
    "units": (units, "a similar body does the same: its units are consistent"),
}


def run(name: str, trial: EffectTrial) -> CheckResult:
    """One of `CHECKS`; an error inside the effect is a finding too."""
    check, good = CHECKS[name]
    try:
        wrong = check(trial)
    except BcidError as error:
        wrong = str(error)
    except Exception as error:
        wrong = f"{type(error).__name__}: {error} ({_place_of(error)})"
    return CheckResult(name, not wrong, wrong or good)


def _place_of(error: BaseException) -> str:
    frame = traceback.extract_tb(error.__traceback__)[-1]
    return f"{frame.filename}:{frame.lineno}"


def findings(effect: Effect, file: str = "") -> Iterator[CheckResult]:
    """All checks that one rank can make."""
    try:
        wrong = definition(effect, Path(file).stem if file else "")
        trial = None if wrong else EffectTrial(effect)
    except Exception as error:
        wrong = f"{type(error).__name__}: {error} ({_place_of(error)})"
    yield CheckResult("definition", not wrong, wrong or "name, units, bounds and functions are complete")
    if wrong or trial is None:
        return
    with trial:
        for name in CHECKS:
            yield run(name, trial)


# -- ranks
# ------------------------------------------------------------------------------------------------------------------


def together(effect: Effect, comm: Comm) -> Array:
    """Positions at the scale, computed by all ranks of `comm` together."""
    with EffectTrial(effect) as trial:
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


def ranks(effect: Effect, source: str, comm: Comm, shared: Array | None = None) -> CheckResult:
    """The same on one rank and on several; collective on `comm`. `shared`: what several ranks gave, if known."""
    name, count = "ranks", comm.size if comm.size > 1 else 2
    try:
        if shared is None and comm.size > 1:
            shared = together(effect, comm)
        elif shared is None:
            if not shutil.which("mpirun"):
                return CheckResult(name, None, "not tried: there is no mpirun here")
            shared = on_two_ranks([source])[effect.name]
        gap = np.abs(shared - together(effect, MPI.COMM_SELF)).max() / box().size
    except (BcidError, subprocess.TimeoutExpired) as error:
        return CheckResult(name, False, str(error))
    if gap < ROUND_OFF:
        return CheckResult(name, True, f"the same on one and on {count} ranks")
    text = f"positions on {count} ranks differ from those on one by {gap:.1e} of the size"
    return CheckResult(name, False, f"{text}: what it does at a point must not depend on how the mesh is shared out")


def known(source: str) -> Effect:
    """An effect by the path of its file, or by its name in the catalogue."""
    return effects.load(source) if _is_file(source) else effects.effect(source)


def _is_file(source: str) -> bool:
    return source.endswith(".py") or os.sep in source


def check_effect(source: str, comm: Comm, say: Callable[[str], None]) -> None:
    """Check an effect given by file or by name, one line per finding; collective on `comm`.

    Raises:
        InputError: it cannot be read, or does not keep the contract.
    """
    effect = known(source)

    def alone() -> list[bool]:
        made = []
        for finding in findings(effect, source if _is_file(source) else ""):
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
