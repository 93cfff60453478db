"""Candidates evaluated as one would with the tutorial: each with boundary conditions, problem and Newton solver of its own, from
the undeformed state, a step at a time from the step before, LU by MUMPS, residual 1e-8 of the step's first, nothing stopped early.

    python -m validation.bench.peers.tutorial_search SIZE_MM DEGREE MEASUREMENT CANDIDATE...

The forms are compiled once. Mesh, fiducials and chi-square are bcid's, so that the misfits can be compared; none of that is timed.
"""

from __future__ import annotations

from validation.bench.peers.problem import Clock, memory

# isort: split
import json
import math
import sys
import time
from typing import Any

import dolfinx
import numpy as np
import ufl
from dolfinx import default_scalar_type, fem
from mpi4py import MPI

from bcid import Measurement, Scene
from bcid.forms.mesh import level_mesh
from bcid.forms.mesh.body import Body
from bcid.forms.mesh.length_unit import fiducial_limit
from bcid.forms.observe import Observer
from bcid.inference.misfit import Misfit
from bcid.measurement import Action
from bcid.scene import Region
from bcid.scene.rotation import rotate
from validation.bench.bench_slab import decoded, encoded, measurement, with_level
from validation.bench.peers.tutorial import neo_hooke, newton

YOUNG, POISSON = 15e3, 0.35
# What the tutorial sets for its quadratic displacement; for linear ones UFL's own estimate is cheaper.
DEGREE_OF_RULE = {2: 4}


class TutorialSearch:
    """Evaluates candidates on one mesh.

    Args:
        scene: a scene with one level.
        seen: the measurement to compare with.
    """

    def __init__(self, scene: Scene, seen: Measurement) -> None:
        level = scene.levels[0]
        mesh = level_mesh(scene, level)
        self.scene = scene
        self.body = Body(MPI.COMM_SELF, mesh, level.degree)
        self.space = self.body.displacement_space
        self.observer = Observer(self.body, scene.fiducials, fiducial_limit(scene, mesh))
        self.misfit = Misfit(scene, seen)
        self.actions = seen.actions
        self.u = fem.Function(self.space)
        self.gripper = fem.Function(self.space)
        mu, lam = YOUNG / 2 / (1 + POISSON), YOUNG * POISSON / (1 + POISSON) / (1 - 2 * POISSON)
        domain = self.body.domain
        _, stress = neo_hooke(self.u, fem.Constant(domain, mu), fem.Constant(domain, lam))
        rule = DEGREE_OF_RULE.get(level.degree)
        dx = ufl.dx if rule is None else ufl.dx(metadata={"quadrature_degree": rule})
        residual = ufl.inner(ufl.grad(ufl.TestFunction(self.space)), stress) * dx
        self.residual, self.tangent = fem.form(residual), fem.form(ufl.derivative(residual, self.u))

    def conditions(self, candidate: frozenset[str], grasp: str) -> list[Any]:
        """The anchored patches fixed, the grasp on the gripper; where they share nodes the gripper wins."""
        zero = np.zeros(3, default_scalar_type)
        held = [fem.dirichletbc(zero, self._dofs(self.scene.patches[p]), self.space) for p in sorted(candidate)]
        return [*held, fem.dirichletbc(self.gripper, self._dofs(self.scene.grasps[grasp].region))]

    def _dofs(self, region: Region) -> Any:
        facets = self.body.local_entities(self.body.mesh.select(region, "region"))
        return fem.locate_dofs_topological(self.space, 2, facets)

    def evaluate(self, candidate: frozenset[str]) -> dict[str, Any]:
        """Chi-square of a candidate (infinite when Newton's method fails), its iterations and CPU seconds."""
        start = time.process_time()
        chi2, iterations, why = 0.0, 0, ""
        try:
            for action in self.actions:
                more, count = self._follow(candidate, action)
                chi2, iterations = chi2 + more, iterations + count
        except RuntimeError as error:
            chi2, why = math.inf, str(error).strip().splitlines()[-1]
        seconds = time.process_time() - start
        plain = chi2 if math.isfinite(chi2) else None
        return {"candidate": encoded(candidate), "chi2": plain, "iterations": iterations, "cpu_s": seconds, "why": why}

    def _follow(self, candidate: frozenset[str], action: Action) -> tuple[float, int]:
        self.u.x.array[:] = 0.0
        solve = newton(self.residual, self.u, self.conditions(candidate, action.grasp), self.tangent)
        arm = self.body.nodes - np.array(self.scene.grasps[action.grasp].centre)
        chi2, iterations = 0.0, 0
        for k in range(len(action)):
            moved = action.translation[k] + rotate(action.rotation[k], arm) - arm
            self.gripper.x.array[:] = moved.ravel()
            if np.abs(moved).max() > 0 or k > 0:
                iterations += solve()
            predicted = self.observer.positions(self.u.x.array.reshape(-1, 3))
            chi2 += self.misfit.frame(int(action.frames[k]), predicted)[0]
        return chi2, iterations


def main() -> None:
    """Evaluate the candidates of the command line."""
    size, degree, name, *words = sys.argv[1:]
    clock = Clock("DOLFINx, tutorial", f"dolfinx {dolfinx.__version__}")
    search = TutorialSearch(with_level(float(size), int(degree)), measurement(name))
    clock.start()
    outcomes = [search.evaluate(decoded(word)) for word in words]
    clock.stop()
    record = clock.record | {"outcomes": outcomes, "unknowns": search.body.unknowns, "rss_mb": memory()}
    record["iterations"] = sum(outcome["iterations"] for outcome in outcomes)
    print(json.dumps(record), flush=True)


if __name__ == "__main__":
    main()
