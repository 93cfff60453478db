"""Small problems with a known answer, and independent looks at what the solver holds."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import permutations
from pathlib import Path
from typing import Any

import numpy as np
from dolfinx import fem
from mpi4py import MPI
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csr_matrix

from bcid.forms.mesh import BodyMesh
from bcid.forms.mesh.body import Body
from bcid.forms.model import Model
from bcid.forms.solver.equilibrium import Equilibrium, Settings
from bcid.forms.solver.status import Status
from bcid.forms.solver.supports import Pose
from bcid.measurement import Action
from bcid.scene import Grasp, Level, Material, Region, Scene

Array = NDArray[np.float64]
Field = Callable[[Array], Array]

FACES = ("x0", "x1", "y0", "y1", "z0", "z1")
"""Groups of every box: x0 is the face at the smallest x, x1 the one at the largest."""


def box(
    size: tuple[float, float, float],
    divisions: tuple[int, int, int],
    warp: Field | None = None,
    mirrored: bool = False,
) -> BodyMesh:
    """A box from the origin, cut into bricks of six tetrahedra, with its faces as groups; "all" is the whole boundary.

    Args:
        size: length of the edges, m.
        divisions: bricks along each.
        warp: moves the nodes (n, 3), the faces with them.
        mirrored: neighbouring bricks are mirror images, so that an even number of them has no preferred side.
    """
    nx, ny, nz = divisions
    grid = np.stack(np.meshgrid(*(np.arange(n + 1) for n in divisions), indexing="ij"), axis=-1).reshape(-1, 3)
    number = np.arange(len(grid)).reshape(nx + 1, ny + 1, nz + 1)
    cells = []
    for corner in np.ndindex(nx, ny, nz):
        turn = np.array([1 if mirrored and c % 2 else 0 for c in corner])
        for order in permutations(range(3)):
            place = turn.copy()
            path = [place.copy()]
            for axis in order:
                place[axis] = 1 - place[axis]
                path.append(place.copy())
            cells.append([number[tuple(np.array(corner) + p)] for p in path])
    points = grid / np.array(divisions) * np.array(size)
    tetrahedra = _oriented(points, np.array(cells, dtype=np.int64))
    mesh = BodyMesh(points, tetrahedra)
    on = {
        f"{'xyz'[a]}{e}": (grid[:, a] == e * divisions[a])[mesh.boundary].all(axis=1) for a in range(3) for e in (0, 1)
    }
    groups = {name: mesh.boundary[chosen] for name, chosen in on.items()} | {"all": mesh.boundary}
    moved = points if warp is None else warp(points)
    return BodyMesh(moved, _oriented(moved, tetrahedra), groups)


def _oriented(points: Array, cells: NDArray[np.int64]) -> NDArray[np.int64]:
    a, b, c, d = (points[cells[:, i]] for i in range(4))
    turned = np.einsum("ij,ij->i", np.cross(b - a, c - a), d - a) < 0
    cells = cells.copy()
    cells[turned, 2], cells[turned, 3] = cells[turned, 3], cells[turned, 2].copy()
    return cells


def crumpled(points: Array, size: float, amount: float, seed: int = 0) -> Array:
    """Nodes of a cube [0, size]^3 with the inner ones moved at random by up to `amount`."""
    inner = np.abs(points - size / 2).max(axis=1, keepdims=True) < size * (0.5 - 1e-9)
    shift = np.random.default_rng(seed).uniform(-amount, amount, points.shape)
    return np.asarray(points + shift * inner)


def scene_of(
    patches: tuple[str, ...] = ("x0",),
    grasp: str = "",
    centre: tuple[float, float, float] = (0.0, 0.0, 0.0),
    places: tuple[str, ...] = FACES,
    fiducials: Mapping[str, tuple[float, float, float]] | None = None,
    degree: int = 1,
    down: tuple[float, float, float] = (0.0, 0.0, -1.0),
) -> Scene:
    """A scene without a file: patches, places and the grasp have the names of their groups."""
    return Scene(
        name="problem",
        geometry=Path("problem.npz"),
        length_unit=1.0,
        levels=(Level(degree),),
        material=Material("neo_hooke", {"young": "15 kPa", "poisson": 0.35}),
        patches={name: Region((name,)) for name in patches},
        grasps={grasp: Grasp(Region((grasp,)), centre)} if grasp else {},
        fiducials=dict(fiducials or {}),
        places={name: Region((name,)) for name in places},
        down=down,
    )


def move(
    translations: Any, grasp: str = "patch", loads: dict[str, Array] | None = None, rotations: Any = None
) -> Action:
    """One action; translations in m, shape (steps, 3), without rotation unless given."""
    translations = np.asarray(translations, dtype=float)
    count = np.arange(len(translations))
    turns = np.tile([1.0, 0, 0, 0], (len(count), 1)) if rotations is None else np.asarray(rotations)
    return Action("1", count, count, grasp, translations, turns, loads or {})


def straight(target: tuple[float, float, float], steps: int, grasp: str = "patch") -> Action:
    """A straight motion to `target` (m) in equal steps."""
    return move(np.linspace(0, 1, steps + 1)[:, None] * np.array(target), grasp)


def pull_and_lift(steps: int = 20) -> Action:
    """The motion of the benchmark in tests/data: to (10, 0, 0) mm, then to (10, 0, 10) mm, in `steps` steps each."""
    up = np.arange(steps + 1)[:, None] / steps
    first = up * [0.01, 0, 0]
    return move(np.vstack([first, first[-1] + up[1:] * [0, 0, 0.01]]))


class Prescribed(Equilibrium):
    """An equilibrium whose gripper holds the whole boundary and deforms it as `field` says, not rigidly."""

    field: Field = staticmethod(np.zeros_like)

    def _prescribe(self, pose: Pose) -> None:
        super()._prescribe(pose)
        self.supports.gripper.x.array[:] = (pose.load_factor * self.field(self.body.nodes)).ravel()

    @classmethod
    def on(
        cls, mesh: BodyMesh, model: Model, degree: int = 1, rtol: float = 1e-8, comm: Any = MPI.COMM_SELF
    ) -> Prescribed:
        """One whose grasp is the mesh's group "all"."""
        scene = scene_of(patches=(), grasp="all", degree=degree, places=())
        return cls(Body(comm, mesh, degree, model.mixed), model, scene, Settings(rtol=rtol))


def gradually(equilibrium: Equilibrium, steps: int) -> Status:
    """Apply the model's own effects and loads in equal steps, from the present state."""
    status = Status.CONVERGED
    for k in range(1, steps + 1):
        status = equilibrium.solve(Pose(load_factor=k / steps))
        if status is not Status.CONVERGED:
            break
    return status


def forces(equilibrium: Equilibrium) -> Array:
    """Internal nodal forces of the present state (one rank), without dead loads, in the order of the unknowns."""
    return equilibrium.forces()


def tangent(equilibrium: Equilibrium) -> csr_matrix:
    """The whole tangent of the present state (one rank), without boundary conditions."""
    return csr_matrix(sum(fem.assemble_matrix(form).to_scipy() for form in equilibrium.tangent_forms))


def free(equilibrium: Equilibrium) -> NDArray[np.int64]:
    """Unknowns that nothing holds (one rank)."""
    held = np.unique(np.concatenate([bc.dof_indices()[0] for bc in equilibrium.supports.conditions]))
    return np.setdiff1d(np.arange(equilibrium.body.unknowns), held)


def lowest_eigenvalue(equilibrium: Equilibrium) -> float:
    """Smallest eigenvalue of the tangent of the free unknowns by LAPACK, N/m: negative when the state is unstable."""
    loose = free(equilibrium)
    return float(np.linalg.eigvalsh(tangent(equilibrium)[loose][:, loose].toarray())[0])


def out_of_balance(equilibrium: Equilibrium) -> float:
    """Largest force on a free node against the largest on a held one (one rank)."""
    all_forces = forces(equilibrium)
    all_forces[equilibrium.body.displacement_dofs] -= equilibrium.supports.external
    loose = free(equilibrium)
    held = np.setdiff1d(np.arange(len(all_forces)), loose)
    return float(np.abs(all_forces[loose]).max() / np.abs(all_forces[held]).max())


def rates(errors: ArrayLike, sizes: ArrayLike) -> Array:
    """Observed order between each two neighbours of a sequence of errors."""
    e, h = np.asarray(errors, dtype=float), np.asarray(sizes, dtype=float)
    return np.asarray(np.log(e[1:] / e[:-1]) / np.log(h[1:] / h[:-1]))


def integral(form: Any, comm: Any = MPI.COMM_SELF) -> float:
    """Value of a UFL functional."""
    return float(comm.allreduce(fem.assemble_scalar(fem.form(form))))


def two_pulls(steps: int = 6) -> list[Action]:
    """Two pulls of the benchmark slab by 12 mm, from rest in so many steps."""
    unturned, number = np.tile([1.0, 0.0, 0.0, 0.0], (steps, 1)), np.arange(steps)
    ways = {"I": (1, 0, 0), "III": (0.6, 0.8, 0)}
    return [
        Action(
            str(k), k * steps + number, number, grasp, 0.012 / (steps - 1) * number[:, None] * np.array(way), unturned
        )
        for k, (grasp, way) in enumerate(ways.items())
    ]
