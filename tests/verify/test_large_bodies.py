"""Bodies too large to be factorised: multigrid gives what the direct solver gives, on awkward bodies as well."""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI
from petsc4py import PETSc
from verify.problems import Array, box, scene_of, straight

from bcid.forms.mesh import BodyMesh
from bcid.forms.mesh.body import Body
from bcid.forms.model import Anchors, Held, Model
from bcid.forms.solver.equilibrium import Equilibrium, Settings
from bcid.forms.solver.status import Status
from bcid.forms.solver.trajectory import follow

PULL = straight((0.004, 0.0, 0.002), 2, "x1")
DIVISIONS = (40, 26, 4)
EXACT = 1e-9


@dataclass
class Awkward:
    """A slab of 16,605 unknowns, more than the coarsest level may have, that is hard to solve for."""

    height: float = 0.008
    poisson: float = 0.35
    anchor: str = "x0"

    def solver(self, linear: str, rtol: float = EXACT) -> Equilibrium:
        mesh = box((0.1, 0.065, self.height), DIVISIONS)
        corner = np.flatnonzero(np.linalg.norm(mesh.points[:, :2], axis=1) < 0.004)
        groups = mesh.groups | {"corner": corner[:, None]}
        scene = scene_of(("x0", "corner"), "x1")
        model = Model.of(scene) + Anchors({self.anchor}) + Held("x1")
        model = model.with_values({"poisson": self.poisson})
        body = Body(MPI.COMM_SELF, BodyMesh(mesh.points, mesh.cells, groups))
        return Equilibrium(body, model, scene, Settings(rtol=rtol, linear=linear))


CASES = {
    "plain": Awkward(),
    "nearly incompressible": Awkward(poisson=0.49),
    "stretched elements": Awkward(height=0.0008),
    "held at few nodes": Awkward(anchor="corner"),
}


@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_multigrid_gives_the_field_of_the_direct_solver(case: Awkward) -> None:
    """However loosely single corrections are solved, the iteration ends by the same rule."""
    fields = []
    for linear in ("direct", "gamg"):
        solver = case.solver(linear)
        result = follow(solver, PULL, lambda _k, _pose: None)
        assert result.status is Status.CONVERGED, result.reason
        solver._assemble_forces(solver.vector)
        unbalanced = np.delete(solver.internal, solver.supports.reacting)
        assert np.linalg.norm(unbalanced) <= EXACT * solver._scale()
        fields.append(solver.u.x.array.copy())
        solver.destroy()
    direct, multigrid = fields
    assert np.abs(multigrid - direct).max() < 1e-8 * np.abs(direct).max()


@pytest.fixture
def solver() -> Iterator[Equilibrium]:
    made = Awkward().solver("gamg", rtol=1e-6)
    yield made
    made.destroy()


def hierarchies(solver: Equilibrium) -> int:
    assert solver.factor.multigrid is not None
    return solver.factor.multigrid.built


def test_a_hierarchy_serves_many_tangents_and_one_set_of_anchors(solver: Equilibrium) -> None:
    result = follow(solver, PULL, lambda _k, _pose: None)
    assert result.factorisations > 3
    assert hierarchies(solver) == 1
    solver.hold({"x0"}, "x1")
    assert follow(solver, PULL, lambda _k, _pose: None).status is Status.CONVERGED
    assert hierarchies(solver) == 1
    solver.hold({"corner"}, "x1")
    held = follow(solver, PULL, lambda _k, _pose: None)
    assert held.status is Status.CONVERGED
    assert hierarchies(solver) == 2


def test_a_tangent_serves_again_where_it_hardly_limits(solver: Equilibrium) -> None:
    """Where one iteration left so little that what the tangent has changed since is below what is asked for."""
    begun, near, far = 1e-4, 1e-2, 2e-3
    assert not solver.factor.aim(begun, 0)
    assert solver.factor.aim(near, 1)
    assert not solver.factor.aim(begun, 0), "what an earlier solve left says nothing"
    assert not solver.factor.aim(far, 1)
    result = follow(solver, PULL, lambda _k, _pose: None)
    # One more is for the first lifting.
    assert result.factorisations < result.iterations + 1


def test_a_hierarchy_that_has_become_bad_is_made_anew(solver: Equilibrium, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is told by the iterations that a digit takes."""
    assert solver.verify() is Status.CONVERGED
    solver.vector.array[:] = np.random.default_rng(0).normal(size=len(solver.vector.array_r))
    solver.factor.solve(solver.vector, solver.correction)
    solver.factor.refresh()
    assert hierarchies(solver) == 1
    monkeypatch.setattr("bcid.forms.solver.multigrid._WORN", 0.1)
    monkeypatch.setattr("bcid.forms.solver.multigrid._BEGIN", 0)
    solver.factor.solve(solver.vector, solver.correction)
    solver.factor.refresh()
    assert hierarchies(solver) == 2


def test_what_the_next_hierarchy_could_use_again_is_not_kept(solver: Equilibrium) -> None:
    """The products of a hierarchy are half of its memory; without them the next one is as good."""
    assert solver.verify() is Status.CONVERGED
    multigrid = solver.factor.multigrid
    assert multigrid is not None
    found = []
    for again in (False, True):
        multigrid._worn |= again
        solver.factor.refresh()
        hierarchy = multigrid._krylov.getPC()
        coarse = [hierarchy.getMGSmoother(level).getOperators()[0] for level in range(hierarchy.getMGLevels() - 1)]
        assert coarse
        assert not any(kept(matrix) for matrix in coarse)
        found.append(solver.factor.solve_block(np.ones((len(solver.u.x.array), 1))))
    assert hierarchies(solver) == 2
    close(*found)


def kept(matrix: PETSc.Mat) -> bool:
    """Whether PETSc keeps of what product a matrix is."""
    kind = ctypes.c_int(-1)
    assert ctypes.CDLL(PETSc.__file__).MatProductGetType(ctypes.c_void_p(matrix.handle), ctypes.byref(kind)) == 0
    return kind.value != 0


def test_large_and_small_tangents_are_the_same(solver: Equilibrium) -> None:
    """Constrained and full matrix, and what is lifted, for whatever is held."""
    small = Awkward().solver("direct")
    change = np.random.default_rng(0).normal(size=len(small.u.x.array))
    for anchors in ({"x0"}, {"corner"}):
        for one in (small, solver):
            one.hold(anchors, "x1")
            one._assemble_tangent()
        alike(solver.tangent.copied(), small.tangent.copied())
        for transpose in (False, True):
            expected = small.tangent.times(change, transpose)
            close(solver.tangent.times(change, transpose), expected)
            for one in (small, solver):
                held = one.supports.prescribed
                close(one.tangent.times_in(held, change[:, None], transpose)[:, 0], expected[held])
        alike(solver.tangent.copied(), small.tangent.copied())
        prescribed = np.zeros_like(change)
        prescribed[small.supports.prescribed] = change[small.supports.prescribed]
        free = np.setdiff1d(np.arange(len(change)), small.supports.prescribed)
        lifted = []
        for one in (small, solver):
            one.tangent.lifting(prescribed, one.vector, one.u.x.petsc_vec)
            lifted.append(one.vector.array_r[free].copy())
        close(*lifted)
    small.destroy()


def test_sensitivities_are_solved_for_accurately(solver: Equilibrium) -> None:
    right = np.random.default_rng(0).normal(size=(len(solver.u.x.array), 2))
    assert solver.verify() is Status.CONVERGED
    found = solver.factor.solve_block(right)
    assert np.abs(solver.tangent.copied() @ found - right).max() < 1e-7 * np.abs(right).max()


def alike(a: Any, b: Any) -> None:
    assert abs(a - b).max() < 1e-12 * abs(b).max()


def close(a: Array, b: Array) -> None:
    assert np.abs(a - b).max() < 1e-10 * np.abs(b).max()
