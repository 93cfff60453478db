"""F5: faults of the solver at any step of a trajectory, once or for good; and a missing compiler."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
from petsc4py import PETSc

from bcid import Scene
from bcid.forms.forward import Forward, Prediction
from bcid.forms.solver.equilibrium import Equilibrium
from bcid.forms.solver.status import Status
from validation.reliability import ROOT, SLAB, Reached
from validation.reliability.inputs import small_scene
from validation.reliability.solving import pull

_ANCHORS = frozenset("34")
_NEAR = 1e-7


class Fault:
    """Stands in for a method: after so many calls it does something else, once or for good."""

    def __init__(self, method: Callable[..., Any], instead: Callable[..., Any], after: int, once: bool) -> None:
        self.method, self.instead, self.after, self.once = method, instead, after, once
        self.calls = 0

    def __call__(self, *arguments: Any) -> Any:
        """Call the one or the other."""
        self.calls += 1
        if self.calls == self.after + 1 or (self.calls > self.after and not self.once):
            return self.instead(*arguments)
        return self.method(*arguments)


def faults(equilibrium: Equilibrium) -> dict[str, tuple[Any, str, Callable[..., Any]]]:
    """By name: the object and its method that fails, and what it does then."""
    factor = equilibrium.factor

    def pivot() -> bool:
        factor.count += 1
        factor.usable, factor.negative = False, None
        return False

    def starved(*_: Any) -> bool:
        raise PETSc.Error(55)

    def not_a_number(F: Any) -> None:
        F.array[:] = np.nan

    def line(*_: Any) -> Any:
        return PETSc.SNES.ConvergedReason.DIVERGED_LINE_SEARCH

    return {
        "zero pivot": (factor, "refresh", pivot),
        "memory": (factor, "solve", starved),
        "NaN": (equilibrium, "_assemble_forces", not_a_number),
        "det F <= 0": (equilibrium, "smallest_jacobian", lambda: -1.0),
        "line search": (equilibrium, "_judge", line),
    }


def predicted(forward: Forward, count: int) -> Prediction:
    """A pull in so many steps."""
    return forward.predict(_ANCHORS, [pull(np.array([0.8, 0.6, 0.0]), 0.012, count, "II")], keep=True)


def wrong(found: Prediction, right: Prediction) -> str:
    """What is wrong with a disturbed prediction; "" if nothing is."""
    trajectory = found.trajectories[0]
    good = np.isfinite(found.positions).all(axis=(1, 2))
    if trajectory.status is Status.CONVERGED:
        if not good.all():
            return "converged, but not all steps are there"
    elif not trajectory.reason or good.sum() != trajectory.steps or good[trajectory.steps :].any():
        return f"{trajectory}: {int(good.sum())} steps are there"
    if sorted(found.states or {}) != list(range(int(good.sum()))):
        return "not every good step is kept"
    missed = float(np.abs(found.positions[good] - right.positions[good]).max(initial=0.0))
    return f"off by {missed:.2g} m" if missed > _NEAR else ""


def faulty(count: int = 12, seed: int = 0) -> Reached:
    """F5: every fault after every number of calls, in a pull of `count` steps."""
    forward = Forward(Scene.read(SLAB), 1)
    right = predicted(forward, count)
    misses: list[str] = []
    ends: Counter[str] = Counter()
    for name, (item, method, instead) in faults(forward.equilibrium).items():
        spy = Fault(getattr(item, method), instead, 10**9, True)
        with mock.patch.object(item, method, spy):
            predicted(forward, count)
        for after in range(spy.calls):
            for once in (True, False):
                with mock.patch.object(item, method, Fault(getattr(item, method), instead, after, once)):
                    found = predicted(forward, count)
                fault = wrong(found, right)
                status = found.trajectories[0].status
                ends[f"{name}: {status}"] += 1
                if fault:
                    misses.append(f"{name} after {after} calls, {'once' if once else 'for good'}: {fault}")
        again = predicted(forward, count)
        if wrong(again, right) or not again.complete:
            misses.append(f"{name}: leaves a trace")
    forward.destroy()
    said = _without_compiler()
    text = (
        ", ".join(f"{what} {times}" for what, times in sorted(ends.items())) + f"; without a compiler: exit code {said}"
    )
    goal = "zero pivot, NaN, det F <= 0, line search, memory at any step: a named status, the last good step kept; "
    goal += "no compiler: exit code 3"
    return Reached(goal, text, not misses and said == 3, tuple(misses))


def _without_compiler() -> int:
    """Exit code of a simulation that has no C compiler, and an empty cache."""
    with tempfile.TemporaryDirectory(prefix="bcid-") as name:
        folder = Path(name)
        words = [
            sys.executable,
            "-m",
            "bcid",
            "simulate",
            str(small_scene(folder)),
            "--anchors",
            "3",
            "--motion",
            "pull",
        ]
        environment = os.environ | {"CC": "/nonexistent", "XDG_CACHE_HOME": str(folder / "cache")}
        done = subprocess.run(
            [*words, "--level", "0", "--quiet", "-o", str(folder / "made")],
            env=environment,
            capture_output=True,
            text=True,
            check=False,
            cwd=ROOT,
        )
        named = "could not be compiled" in done.stderr and "Traceback" not in done.stderr
        return done.returncode if named and not (folder / "made").exists() else -1
