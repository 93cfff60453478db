"""Finite elements of another code: quadratic tetrahedra in NumPy, stresses and tangents written out by hand, N and mm.

It shares nothing with bcid's forms but the mesh generator and the linear solver: what it computes judges them.
Shape functions, and quadrature of degree 4 with eleven points: Keast, Comput. Methods Appl. Mech. Eng. 55, 1986.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import combinations
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import gmsh
import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from petsc4py import PETSc

Array = NDArray[np.float64]
# Ends of the edges in gmsh's order.
EDGES = (0, 1), (1, 2), (2, 0), (3, 0), (3, 2), (3, 1)
SLOPES: Array = np.array([[-1.0, -1.0, -1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
# Newton's method, and how often a step is halved.
ITERATIONS, HALVINGS, CLOSE = 14, 6, 1e-7


def shapes(at: Array) -> Array:
    """Shape functions at barycentric coordinates (4,), shape (10,)."""
    return np.array([*(at * (2 * at - 1)), *(4 * at[a] * at[b] for a, b in EDGES)])


def slopes(at: Array) -> Array:
    """Their derivatives by the last three coordinates, shape (10, 3)."""
    edges = [4 * (at[a] * SLOPES[b] + at[b] * SLOPES[a]) for a, b in EDGES]
    return np.array([*((4 * at - 1)[:, None] * SLOPES), *edges])


def quadrature() -> tuple[Array, Array]:
    """Points (11, 4) and weights (11,) on a tetrahedron of volume 1/6."""
    far, near = 11 / 14, 1 / 14
    a, b = 0.3994035761667992, 0.1005964238332008
    points = [[0.25] * 4]
    points += [[far if i == k else near for i in range(4)] for k in range(4)]
    points += [[a if i in pair else b for i in range(4)] for pair in combinations(range(4), 2)]
    weights = [-0.01315555555555556] + [0.007622222222222222] * 4 + [0.02488888888888889] * 6
    return np.array(points), np.array(weights)


@dataclass(frozen=True)
class Mesh:
    """Straight quadratic tetrahedra.

    Attributes:
        points: shape (n, 3), mm.
        cells: shape (m, 10).
        faces: of each physical surface, shape (f, 6).
    """

    points: Array
    cells: NDArray[np.int64]
    faces: dict[str, NDArray[np.int64]]

    @classmethod
    def of(cls, file: Path, size: float) -> Mesh:
        """Of a .geo file whose element size is `h`, mm."""
        text = re.sub(r"h = \{[\d.]+", f"h = {{{size:g}", file.read_text(encoding="utf-8"))
        gmsh.initialize(interruptible=False)
        with TemporaryDirectory() as folder:
            (Path(folder) / "body.geo").write_text(text, encoding="utf-8")
            gmsh.option.setNumber("General.Terminal", 0)
            gmsh.open(str(Path(folder) / "body.geo"))
        gmsh.model.mesh.generate(3)
        gmsh.model.mesh.setOrder(2)
        tags, points, _ = gmsh.model.mesh.getNodes()
        number = dict(zip(tags, range(len(tags)), strict=True))
        groups: dict[str, Any] = {}
        for dimension, tag in gmsh.model.getPhysicalGroups():
            found = []
            for entity in gmsh.model.getEntitiesForPhysicalGroup(dimension, tag):
                kinds, _, nodes = gmsh.model.mesh.getElements(dimension, entity)
                for kind, those in zip(kinds, nodes, strict=True):
                    count = {11: 10, 9: 6}[int(kind)]
                    found.append(np.array([number[i] for i in those]).reshape(-1, count))
            groups[gmsh.model.getPhysicalName(dimension, tag)] = np.vstack(found)
        gmsh.finalize()
        cells, x = groups.pop("body"), np.asarray(points).reshape(-1, 3)
        for k, (a, b) in enumerate(EDGES, 4):
            x[cells[:, k]] = (x[cells[:, a]] + x[cells[:, b]]) / 2
        used = np.unique(cells)
        back = np.full(len(x), -1)
        back[used] = np.arange(len(used))
        return cls(x[used], back[cells], {name: back[faces] for name, faces in groups.items()})


@dataclass
class Body:
    """A neo-Hookean body with what may act in it.

    Attributes:
        mesh: of the body at rest.
        young, poisson: of the law mu/2 (I1 - 3 - 2 ln J) + lambda/2 (ln J)^2, MPa.
        fibres: k1 (MPa) and angle (degrees) of k1/2 (I4 - 1)^2, in the plane of x and z.
        active: likewise an amplitude, of amplitude/2 (I4 - 1).
        weight: body force against y, N/mm^3.
        ball: centre, radius (mm) and ratio of the stiffness of an inclusion.
        springs: patches that are held by springs, N/mm^3.
    """

    mesh: Mesh
    young: float
    poisson: float
    fibres: tuple[float, float] | None = None
    active: tuple[float, float] | None = None
    weight: float = 0.0
    ball: tuple[Array, float, float] | None = None
    springs: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        mesh = self.mesh
        self.mu = self.young / 2 / (1 + self.poisson)
        self.lam = self.young * self.poisson / (1 + self.poisson) / (1 - 2 * self.poisson)
        points, weights = quadrature()
        values, steps = np.array([shapes(p) for p in points]), np.array([slopes(p) for p in points])
        corners = mesh.points[mesh.cells]
        jacobian = np.einsum("eai,qaj->eqij", corners, steps)
        self.volumes = np.linalg.det(jacobian) * weights
        self.gradients = np.einsum("qaj,eqji->eqai", steps, np.linalg.inv(jacobian))
        self.dofs = (3 * mesh.cells[:, :, None] + np.arange(3)).reshape(len(mesh.cells), 30)
        self.count = 3 * len(mesh.points)
        self.stiff = np.ones_like(self.volumes)
        if self.ball:
            centre, radius, ratio = self.ball
            away = np.linalg.norm(np.einsum("qa,eai->eqi", values, corners) - centre, axis=2)
            self.stiff = 1 + (ratio - 1) / (1 + np.exp(np.clip((away - radius) / (0.1 * radius), -50, 50)))
        self.loads = np.zeros(self.count)
        np.add.at(self.loads, 3 * mesh.cells + 1, -self.weight * np.einsum("eq,qa->ea", self.volumes, values))
        self.held = sp.csr_matrix((self.count, self.count))
        for patch, stiffness in self.springs.items():
            self.held = self.held + self._springs(mesh.faces[patch], stiffness)

    def _springs(self, faces: NDArray[np.int64], stiffness: float) -> Any:
        """Matrix of springs on faces; six points of degree 4 (Dunavant 1985)."""
        points, weights = [], []
        for far, near, weight in (
            (0.816847572980459, 0.091576213509771, 0.109951743655322),
            (0.108103018168070, 0.445948490915965, 0.223381589678011),
        ):
            points += [[far if i == k else near for i in range(3)] for k in range(3)]
            weights += [weight] * 3
        at = np.array(points)
        values = np.hstack([at * (2 * at - 1), 4 * at * np.roll(at, -1, axis=1)])
        unit = np.einsum("q,qa,qb->ab", weights, values, values)
        x = self.mesh.points[faces[:, :3]]
        area = np.linalg.norm(np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]), axis=1) / 2
        found = sp.csr_matrix((self.count, self.count))
        for axis in range(3):
            rows = 3 * faces + axis
            where = np.repeat(rows, 6, axis=1).ravel(), np.tile(rows, 6).ravel()
            data = stiffness * (area[:, None, None] * unit).ravel()
            found = found + sp.csr_matrix((data, where), shape=found.shape)
        return found

    def balance(self, u: Array, share: float) -> tuple[Array, Any] | None:
        """Residual and tangent at displacements u with a share of the weight; None where an element is inside out."""
        moved, unit = u.reshape(-1, 3)[self.mesh.cells], np.eye(3)
        F = unit + np.einsum("eai,eqaj->eqij", moved, self.gradients)
        J = np.linalg.det(F)
        if (J <= 0).any():
            return None
        inverse = np.linalg.inv(F)
        turned, log = np.swapaxes(inverse, -1, -2), np.log(J)[..., None, None]
        stress = self.stiff[..., None, None] * (self.mu * (F - turned) + self.lam * log * turned)
        tangent = self.mu * np.einsum("ik,jl->ijkl", unit, unit) + self.lam * np.einsum(
            "eqji,eqlk->eqijkl", inverse, inverse
        )
        tangent += (self.mu - self.lam * log)[..., None, None] * np.einsum("eqli,eqjk->eqijkl", inverse, inverse)
        tangent *= self.stiff[..., None, None, None, None]
        for slope, rise, angle in self._along():
            a = np.array([np.cos(np.radians(angle)), 0.0, np.sin(np.radians(angle))])
            along = F @ a
            pull = slope + rise * ((along**2).sum(axis=-1) - 1)
            stress = stress + pull[..., None, None] * along[..., :, None] * a
            tangent += pull[..., None, None, None, None] * np.einsum("ik,j,l->ijkl", unit, a, a)
            tangent += 2 * rise * np.einsum("eqi,j,eqk,l->eqijkl", along, a, along, a)
        residual = np.zeros(self.count)
        forces = np.einsum("eq,eqij,eqaj->eai", self.volumes, stress, self.gradients)
        np.add.at(residual, self.dofs.ravel(), forces.ravel())
        where = np.repeat(self.dofs, 30, axis=1).ravel(), np.tile(self.dofs, (1, 30)).ravel()
        matrix = sp.csr_matrix((self._matrices(tangent).ravel(), where), shape=self.held.shape)
        return residual + self.held @ u - share * self.loads, matrix + self.held

    def _along(self) -> list[tuple[float, float, float]]:
        """Of fibres and active stress: pull at rest, its rise with I4, and angle."""
        found = [(0.0, 2 * self.fibres[0], self.fibres[1])] if self.fibres else []
        return found + ([(self.active[0], 0.0, self.active[1])] if self.active else [])

    def _matrices(self, tangent: Array) -> Array:
        """Of all elements, shape (m, 30, 30)."""
        count = len(self.dofs)
        found = np.zeros((count, 30, 30))
        for q in range(tangent.shape[1]):
            strain = np.zeros((count, 3, 3, 10, 3))
            for axis in range(3):
                strain[:, axis, :, :, axis] = np.swapaxes(self.gradients[:, q], 1, 2)
            flat = strain.reshape(count, 9, 30)
            weighed = tangent[:, q].reshape(count, 9, 9) * self.volumes[:, q, None, None]
            found += np.swapaxes(flat, 1, 2) @ (weighed @ flat)
        return found

    def equilibrium(self, u: Array, held: NDArray[np.int64], goal: Array, shares: tuple[float, float]) -> Array:
        """Displacements (3 n,) where some are prescribed, from others; between two shares of the weight. It may halve the step.

        Raises:
            ArithmeticError: there is none.
        """
        free, begun, done, size = np.setdiff1d(np.arange(self.count), held), u[held].copy(), 0.0, 1.0
        while done < 1:
            part = min(1.0, done + size)
            found = self._newton(
                u, held, free, begun + part * (goal - begun), shares[0] + part * (shares[1] - shares[0])
            )
            if found is not None:
                u, done, size = found, part, 1.5 * size
            elif size < 0.5**HALVINGS:
                raise ArithmeticError("no equilibrium")
            else:
                size /= 2
        return u

    def _newton(
        self, u: Array, held: NDArray[np.int64], free: NDArray[np.int64], goal: Array, share: float
    ) -> Array | None:
        u, jump = u.copy(), goal - u[held]
        for iteration in range(ITERATIONS):
            found = self.balance(u, share)
            if found is None:
                return None
            residual, matrix = found
            rows = matrix[free]
            step = _solved(rows[:, free], -residual[free] - rows[:, held] @ jump)
            u[held] += jump
            u[free] += step
            jump = np.zeros_like(jump)
            if iteration and np.abs(step).max() < CLOSE:
                return u
        return None

    def seen(self, places: Array) -> list[tuple[NDArray[np.int64], Array]]:
        """Nodes and shape functions of each of some places (k, 3) in the body, or next to it."""
        corners = self.mesh.points[self.mesh.cells[:, :4]]
        inverse = np.linalg.inv(np.swapaxes(corners[:, 1:] - corners[:, :1], 1, 2))
        found = []
        for place in places:
            local = np.einsum("eij,ej->ei", inverse, place - corners[:, 0])
            whole = np.column_stack([1 - local.sum(axis=1), local])
            cell = int(whole.min(axis=1).argmax())
            at = np.clip(whole[cell], 0, None)
            found.append((self.mesh.cells[cell], shapes(at / at.sum())))
        return found


def _solved(matrix: Any, right: Array) -> Array:
    """Of a symmetric system, by MUMPS."""
    matrix = matrix.tocsr()
    matrix.sort_indices()
    csr = matrix.indptr.astype(PETSc.IntType), matrix.indices.astype(PETSc.IntType), matrix.data
    A = PETSc.Mat().createAIJ(matrix.shape, csr=csr, comm=PETSc.COMM_SELF)
    solver = PETSc.KSP().create(PETSc.COMM_SELF)
    solver.setType("preonly")
    solver.getPC().setType("lu")
    solver.getPC().setFactorSolverType("mumps")
    solver.setOperators(A)
    x, b = A.createVecs()
    b.array[:] = right
    solver.solve(b, x)
    found: Array = x.array.copy()
    for one in (A, solver, x, b):
        one.destroy()
    return found
