"""bcid on the problem of `validation.bench.peers`: ``python -m validation.bench.bcid_trajectory MESH FIELD``."""

from __future__ import annotations

from validation.bench.peers.problem import LEG, Clock, arguments, problem

# isort: split
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from dolfinx.fem import petsc
from mpi4py import MPI

import bcid
from bcid.forms.mesh import BodyMesh
from bcid.forms.mesh.body import Body
from bcid.forms.model import Anchors, Held, Model
from bcid.forms.solver.equilibrium import Equilibrium, Settings
from bcid.forms.solver.status import Status
from bcid.forms.solver.trajectory import follow
from bcid.measurement import Action
from bcid.scene import Grasp, Level, Material, Region, Scene

MM = 1e-3
# The peers stop at 1e-8 of the first residual, which Newton's last step leaves far behind; an old tangent does not.
RTOL = 1e-9


def equilibrium(mesh: BodyMesh, settings: Settings | None = None) -> Equilibrium:
    """The slab of tests/data/README.md on a mesh with the node groups "fixed" and "patch"."""
    scene = Scene(
        name="slab40",
        geometry=Path("slab40.npz"),
        length_unit=MM,
        levels=(Level(1),),
        material=Material("neo_hooke", {"young": "15 kPa", "poisson": 0.35}),
        patches={"fixed": Region(("fixed",))},
        grasps={"patch": Grasp(Region(("patch",)), (0.09, 0.05, 0.005))},
        fiducials={},
    )
    model = Model.of(scene) + Anchors({"fixed"}) + Held("patch")
    return Equilibrium(Body(MPI.COMM_SELF, mesh), model, scene, settings)


def motion(places: np.ndarray) -> Action:
    """The gripper at these places (steps, 3), m, one after the other; the first is rest."""
    steps = np.arange(len(places))
    turns = np.tile([1.0, 0.0, 0.0, 0.0], (len(places), 1))
    return Action("1", steps, steps, "patch", places, turns)


def pull_and_lift() -> Action:
    """The motion of the benchmark: 20 steps to (10, 0, 0) mm, 20 more to (10, 0, 10) mm."""
    up = np.arange(LEG + 1)[:, None] / LEG
    first = up * [10 * MM, 0, 0]
    return motion(np.vstack([first, first[-1] + up[1:] * [0, 0, 10 * MM]]))


def seconds(what: Callable[[], Any], least: float = 0.05, count: int = 5) -> float:
    """Median CPU seconds of a call, of at least `count` and at least `least` seconds of them."""
    times: list[float] = []
    while len(times) < count or sum(times) < least:
        start = time.process_time()
        what()
        times.append(time.process_time() - start)
    return float(np.median(times))


def residual(eq: Equilibrium) -> None:
    """Assemble the residual of the present state."""
    with eq.vector.localForm() as local:
        local.set(0.0)
    for form in eq.residual_forms:
        petsc.assemble_vector(eq.vector, form)


def parts(eq: Equilibrium) -> dict[str, float]:
    """Seconds of one residual and of one triangular solve with the present factor: what an iteration cannot do without."""
    eq.verify()
    return {
        "residual_s": seconds(lambda: residual(eq)),
        "triangular_s": seconds(lambda: eq.factor.solve(eq.vector, eq.correction)),
    }


def main() -> None:
    """One trajectory."""
    name, field = arguments()
    clock = Clock("bcid", f"bcid {bcid.__version__}")
    data = problem(name)
    groups = {part: data[part][:, None] for part in ("fixed", "patch")}
    eq = equilibrium(BodyMesh(data["points"] * MM, data["cells"], groups), Settings(rtol=RTOL))
    clock.start()
    result = follow(eq, pull_and_lift(), lambda _k, _pose: None)
    clock.stop()
    if result.status is not Status.CONVERGED:
        raise RuntimeError(result.reason)
    clock.record |= {"steps": result.steps - 1, "iterations": result.iterations}
    clock.record |= {"factorisations": result.factorisations}
    displacement = np.asarray(eq.body.at_mesh_nodes(eq.displacement()) / MM)
    clock.finish(field, displacement, **parts(eq))


if __name__ == "__main__":
    main()
