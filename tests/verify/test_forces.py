"""Forces: the gripper's wrench and the reactions balance the loads, and the wrench is the slope of the energy."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI
from numpy.typing import NDArray
from verify.problems import box, crumpled, forces, scene_of

from bcid.forms import materials
from bcid.forms.mesh import BodyMesh
from bcid.forms.mesh.body import Body
from bcid.forms.model import Anchors, Held, Model, Term
from bcid.forms.solver.equilibrium import Equilibrium, Settings
from bcid.forms.solver.status import Status
from bcid.forms.solver.supports import Pose, nodal_weights
from bcid.scene import Region
from bcid.scene.rotation import rotate

Array = NDArray[np.float64]
SIZE = 0.03
CENTRE = (SIZE, SIZE / 2, SIZE / 2)
LOAD = np.array([0.02, -0.01, 0.03])
WEIGHT = 2e4
DOWN = (0.0, -0.6, -0.8)


def cube() -> BodyMesh:
    """A crumpled cube with two more groups: "edge" at x = y = 0, and "corner" at the far end of the diagonal."""
    mesh = box((SIZE,) * 3, (3, 3, 3), warp=lambda points: crumpled(points, SIZE, 0.1 * SIZE / 3))
    along = np.flatnonzero((mesh.points[:, :2] < 1e-9).all(axis=1))
    along = along[np.argsort(mesh.points[along, 2])]
    corner = np.flatnonzero((mesh.points > SIZE - 1e-9).all(axis=1))
    extra = {"edge": np.c_[along[:-1], along[1:]], "corner": corner[:, None]}
    return BodyMesh(mesh.points, mesh.cells, mesh.groups | extra)


@pytest.fixture(scope="module", params=["P1", "P2", "mixed"])
def loaded(request: pytest.FixtureRequest) -> Iterator[Equilibrium]:
    degree, formulation = (1, "displacement") if request.param == "P1" else (2, "displacement")
    formulation = "mixed" if request.param == "mixed" else formulation
    model = Model(materials.law("neo_hooke"), {"young": 15e3, "poisson": 0.4}, formulation, down=DOWN)
    model = model + Term("gravity", {"weight": WEIGHT}) + Anchors({"x0"}) + Held("x1")
    scene = scene_of(grasp="x1", centre=CENTRE, places=("z1", "edge", "corner"), degree=degree, down=DOWN)
    body = Body(MPI.COMM_SELF, cube(), degree, model.mixed)
    equilibrium = Equilibrium(body, model, scene, Settings(rtol=1e-12))
    yield equilibrium
    equilibrium.destroy()


def pose(translation: Array | None = None, turn: Array | None = None) -> Pose:
    """A pulled and twisted pose with a hung weight; `translation` (m) and `turn` (rotation vector, rad) come on top."""
    moved = np.array([0.004, -0.002, 0.003]) + (0 if translation is None else translation)
    angle = 0.0 if turn is None else float(np.linalg.norm(turn))
    more = np.array([1.0, 0, 0, 0]) if turn is None else np.r_[np.cos(angle / 2), np.sin(angle / 2) * turn / angle]
    first = np.r_[np.cos(0.15), np.sin(0.15) * np.array([0.6, 0.0, 0.8])]
    return Pose(moved, _product(more, first), {"z1": LOAD})


def _product(a: Array, b: Array) -> Array:
    """Rotation b, then rotation a."""
    return np.r_[a[0] * b[0] - a[1:] @ b[1:], a[0] * b[1:] + b[0] * a[1:] + np.cross(a[1:], b[1:])]


def test_gripper_anchors_weight_and_load_are_in_balance(loaded: Equilibrium) -> None:
    assert loaded.solve(pose()) is Status.CONVERGED
    body, now = loaded.body, pose()
    placed = body.nodes + loaded.displacement()
    reactions = (forces(loaded)[body.displacement_dofs] - loaded.supports.external).reshape(-1, 3)
    anchored = np.isclose(body.nodes[:, 0], 0.0, atol=1e-9)
    v = ufl.TestFunction(body.displacement_space)
    weight = fem.assemble_vector(fem.form(WEIGHT * ufl.inner(ufl.as_vector(DOWN), v) * ufl.dx(body.domain))).array
    applied = weight.reshape(-1, 3) + loaded.supports.external.reshape(-1, 3)
    wrench = loaded.wrench(now)
    assert applied.sum(axis=0) == pytest.approx(LOAD + WEIGHT * SIZE**3 * np.array(DOWN), rel=1e-9)
    balance = wrench[:3] + reactions[anchored].sum(axis=0) + applied.sum(axis=0)
    assert np.abs(balance).max() <= 1e-9 * np.abs(wrench[:3]).max()
    turning = wrench[3:] + np.cross(np.array(CENTRE) + now.translation, wrench[:3])
    turning += np.cross(placed[anchored], reactions[anchored]).sum(axis=0) + np.cross(placed, applied).sum(axis=0)
    assert np.abs(turning).max() <= 1e-9 * np.abs(wrench[:3]).max() * SIZE


def test_the_wrench_is_the_slope_of_the_energy(loaded: Equilibrium) -> None:
    def potential(at: Pose) -> float:
        assert loaded.solve(at) is Status.CONVERGED
        return loaded.energy() - float(loaded.supports.external @ loaded.displacement().ravel())

    potential(pose())
    wrench = loaded.wrench(pose())
    for axis in range(3):
        step, turn = 1e-5 * np.eye(3)[axis], 1e-3 * np.eye(3)[axis]
        push = (potential(pose(translation=step)) - potential(pose(translation=-step))) / 2e-5
        twist = (potential(pose(turn=turn)) - potential(pose(turn=-turn))) / 2e-3
        assert push == pytest.approx(wrench[axis], rel=1e-4, abs=1e-5 * np.abs(wrench[:3]).max())
        assert twist == pytest.approx(wrench[3 + axis], rel=1e-4, abs=1e-5 * np.abs(wrench[3:]).max())


def test_a_body_that_nothing_else_holds_follows_the_gripper_without_force(loaded: Equilibrium) -> None:
    loaded.hold((), "x1")
    for part in np.arange(1, 7) / 6:
        turn = np.array([np.cos(0.4 * part), 0.0, np.sin(0.4 * part), 0.0])
        there = Pose(part * np.array([0.01, 0.02, -0.01]), turn, load_factor=0.0)  # without its weight
        assert loaded.solve(there) is Status.CONVERGED
    arm = loaded.body.nodes - CENTRE
    rigid = there.translation + rotate(there.rotation, arm) - arm
    assert np.abs(loaded.displacement() - rigid).max() < 1e-9 * SIZE
    assert np.abs(loaded.wrench(there)).max() < 1e-9
    assert abs(loaded.energy()) < 1e-12
    loaded.hold({"x0"}, "x1")


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("place", ["z1", "edge", "corner"])
def test_a_dead_load_is_shared_out_whole(degree: int, place: str) -> None:
    # On a surface, a line and a point: the shares add up to one, and their resultant goes through the middle of the
    # place.
    body = Body(MPI.COMM_SELF, cube(), degree)
    shares = nodal_weights(body, Region((place,)), place)
    middle = {"z1": [SIZE / 2, SIZE / 2, SIZE], "edge": [0.0, 0.0, SIZE / 2], "corner": [SIZE] * 3}[place]
    assert shares.sum() == pytest.approx(1.0, abs=1e-12)
    assert shares @ body.nodes == pytest.approx(middle, abs=1e-12)


@pytest.mark.parametrize("degree", [1, 2])
def test_a_surface_load_is_the_integral_of_a_traction(degree: int) -> None:
    body = Body(MPI.COMM_SELF, cube(), degree)
    v = ufl.TestFunction(body.displacement_space)
    ds = body.facet_measure([Region(("z1",))], ["z1"])
    spread = fem.assemble_vector(fem.form(v[0] / SIZE**2 * ds(1))).array.reshape(-1, 3)[:, 0]
    assert nodal_weights(body, Region(("z1",)), "z1") == pytest.approx(spread, abs=1e-12)
