"""A world in FElupe: ``python felupe_world.py SPEC OUTPUT`` computes the motion of the markers. Units mm, kPa (forces mN).

SPEC is JSON (see `validation.outside.worlds`). OUTPUT takes an array `motion` (pulls, steps + 1, markers, 3), mm, of the world;
`plain`, the same with nothing wrong; and `toggled` (patches, pulls, markers, 3), the change of the last step, mm, where
the attachment of one patch is toggled, to first order. The script imports nothing of bcid.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import felupe
import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.linalg import spsolve

Array = np.ndarray[Any, np.dtype[np.float64]]
Indices = np.ndarray[Any, np.dtype[np.int64]]
Spec = Mapping[str, Any]
# Linear elements along x, y, z of the coarsest grid whose lines run along the borders of all patches.
GRID = (8, 2, 4)
TOLERANCE = 1e-6
# Share of a pull at which the first order is taken.
TANGENT = 0.01
# A load that cannot be followed in steps of this share of a pull's step is given up.
SMALLEST = 1 / 64


class Springs:
    """Forces per reference area on nodes, as a function of their distance from where they rest: an item of FElupe.

    `law` gives forces (nodes, 3) and their derivatives (nodes, 3, 3) per area for distances (nodes, 3).
    """

    def __init__(self, field: Any, nodes: Indices, areas: Array, law: Callable[[Array], tuple[Array, Array]]) -> None:
        self.field, self.nodes, self.areas, self.law = field, nodes, areas, law
        self.rest = np.zeros((len(nodes), 3))
        self.results = felupe.mechanics._helpers.Results()
        self.assemble = felupe.mechanics._helpers.Assemble(vector=self._vector, matrix=self._matrix)

    def _distances(self) -> Array:
        return np.asarray(self.field[0].values[self.nodes] - self.rest)

    def _vector(self, field: Any = None, parallel: bool = False) -> Any:
        forces = np.zeros(self.field[0].values.shape)
        forces[self.nodes] = self.areas[:, None] * self.law(self._distances())[0]
        return csr_matrix(forces.reshape(-1, 1))

    def _matrix(self, field: Any = None, parallel: bool = False) -> Any:
        blocks = self.areas[:, None, None] * self.law(self._distances())[1]
        dofs = 3 * self.nodes[:, None] + np.arange(3)
        rows, columns = np.broadcast_arrays(dofs[:, :, None], dofs[:, None, :])
        size = self.field[0].values.size
        return csr_matrix((blocks.ravel(), (rows.ravel(), columns.ravel())), shape=(size, size))


def linear(stiffness: float) -> Callable[[Array], tuple[Array, Array]]:
    """Springs of a stiffness per area, kPa/mm."""
    return lambda d: (stiffness * d, np.broadcast_to(stiffness * np.eye(3), (len(d), 3, 3)))


def cohesive(stiffness: float, length: float) -> Callable[[Array], tuple[Array, Array]]:
    """Traction k d exp(-|d|/length): it grows to its largest value at `length` (mm), then fades (Xu & Needleman 1993)."""

    def law(d: Array) -> tuple[Array, Array]:
        size = np.linalg.norm(d, axis=1)
        fade = stiffness * np.exp(-size / length)
        outer = d[:, :, None] * d[:, None, :] / (np.maximum(size, 1e-12) * length)[:, None, None]
        return fade[:, None] * d, fade[:, None, None] * (np.eye(3) - outer)

    return law


def second_invariant(mu: float, bulk: float, scale: float) -> Any:
    """psi = mu k (sqrt(1 + (J^(-4/3) I2 - 3)/k) - 1) + bulk/2 (ln J)^2, with k = `scale`: shear softens with strain."""

    def first_piola(F: Array) -> Array:
        J = np.linalg.det(np.moveaxis(F, (0, 1), (-2, -1)))
        C = np.einsum("ki...,kj...->ij...", F, F)
        I1 = np.einsum("ii...->...", C)
        I2 = (I1**2 - np.einsum("ij...,ij...->...", C, C)) / 2 * J ** (-4 / 3)
        inverse = np.moveaxis(np.linalg.inv(np.moveaxis(F, (0, 1), (-2, -1))), (-1, -2), (0, 1))
        slope = 2 * J ** (-4 / 3) * (I1 * F - np.einsum("ik...,kj...->ij...", F, C)) - 4 / 3 * I2 * inverse
        return np.asarray(mu / 2 / np.sqrt(1 + np.maximum(I2 - 3, 0) / scale) * slope + bulk * np.log(J) * inverse)

    def elasticity(x: Any, **_more: Any) -> list[Array]:
        F, step = x[0], 1e-6
        A = np.zeros((3, 3, *F.shape))
        for k in range(3):
            for m in range(3):
                there = np.zeros_like(F)
                there[k, m] = step
                A[:, :, k, m] = (first_piola(F + there) - first_piola(F - there)) / (2 * step)
        return [(A + np.moveaxis(A, (0, 1), (2, 3))) / 2]

    return felupe.Material(stress=lambda x, **_more: [first_piola(x[0]), x[-1]], elasticity=elasticity)


class Body:
    """A box in quadratic hexahedra of 27 nodes, its borders where the world has them."""

    def __init__(self, spec: Spec, refine: int) -> None:
        self.size = np.array(spec["size"], dtype=float)
        self.world: Mapping[str, Any] = spec["world"]
        count = refine * np.array(GRID)
        beyond = int(self.world.get("beyond", 0)) * refine
        low = np.array([-beyond * self.size[0] / count[0], 0.0, 0.0])
        mesh = felupe.Cube(a=tuple(low), b=tuple(self.size), n=tuple(count + [beyond, 0, 0] + 1))
        mesh = mesh.add_midpoints_edges().add_midpoints_faces().add_midpoints_volumes()
        self.rest = np.array(mesh.points)
        # Distance of the nodes along each axis.
        self.spacing = self.size / count / 2
        thickness = self.world.get("thickness")
        if thickness:
            wave = np.cos(np.pi * (thickness["along"] @ (self.rest / self.size)[:, [0, 2]].T) + thickness["phase"])
            mesh.points[:, 1] = self.size[1] - (self.size[1] - self.rest[:, 1]) * (1 + thickness["share"] * wave)
        self.mesh = mesh
        self.far = np.flatnonzero(self.rest[:, 0] < low[0] + 1e-6) if beyond else np.zeros(0, dtype=int)
        mu = spec["young"] / 2 / (1 + spec["poisson"])
        lam = spec["young"] * spec["poisson"] / (1 + spec["poisson"]) / (1 - 2 * spec["poisson"])
        energy = self.world.get("second_invariant")
        self.law = (
            second_invariant(mu, lam + 2 * mu / 3, energy["scale"])
            if energy
            else felupe.NeoHookeCompressible(mu=mu, lmbda=lam)
        )

    def nodes(self, box: Any) -> Indices:
        """Nodes of a rectangle, given by its lowest and highest corner in shares of the body's size."""
        low, high = np.array(box, dtype=float) * self.size
        return np.flatnonzero(np.all((self.rest > low - 1e-6) & (self.rest < high + 1e-6), axis=1))

    def areas(self, box: Any) -> Array:
        """Area of each node of a rectangle by Simpson's rule (mm^2); it is exact for quadratic functions."""
        low, high = np.array(box, dtype=float) * self.size
        weights = np.ones(len(self.nodes(box)))
        for axis in np.flatnonzero(high > low + 1e-9):
            index = np.rint((self.rest[self.nodes(box), axis] - low[axis]) / self.spacing[axis]).astype(int)
            ends = (index == 0) | (index == index.max())
            weights *= self.spacing[axis] / 3 * np.where(ends, 1.0, np.where(index % 2, 4.0, 2.0))
        return weights


def motion(spec: Spec, anchored: list[str], refine: int, steps: int) -> Array:
    """Displacements of the markers from their stress-free places, (pulls, steps + 1, markers, 3), mm."""
    body = Body(spec, refine)
    places = np.array(spec["markers"]) * body.size
    seen = np.array([np.argmin(np.linalg.norm(body.rest - place, axis=1)) for place in places])
    return np.array([_pull(spec, body, anchored, pull, steps)[:, seen] for pull in spec["pulls"]])


def _pull(spec: Spec, body: Body, anchored: list[str], pull: Spec, steps: int) -> Array:
    """Displacements of all nodes after each step of a pull, from rest on."""
    world = body.world
    region = felupe.RegionTriQuadraticHexahedron(body.mesh)
    field = felupe.FieldContainer([felupe.Field(region, dim=3)])
    items: list[Any] = [felupe.SolidBody(umat=body.law, field=field)]
    held, patches = [body.far], spec["patches"]
    for name in anchored:
        law = world.get("adhesion", {}) if world.get("adhesion", {}).get("patch") == name else None
        box = world["partly"]["box"] if world.get("partly", {}).get("patch") == name else patches[name]
        if law:
            items.append(Springs(field, body.nodes(box), body.areas(box), cohesive(law["stiffness"], law["length"])))
        else:
            held.append(body.nodes(box))
    pressure = None
    if world.get("pressure"):
        mask = np.isin(np.arange(len(body.rest)), body.nodes(world["pressure"]["box"]))
        boundary = felupe.RegionTriQuadraticHexahedronBoundary(body.mesh, mask=mask)
        surface = felupe.FieldContainer([felupe.Field(boundary, dim=3)])
        pressure = felupe.SolidBodyPressure(surface, pressure=0.0)
        items.append(pressure)
    grip = spec["grasps"][pull["grasp"]]
    gripped, pad = body.nodes(grip), None
    if world.get("pad"):
        pad = Springs(field, gripped, body.areas(grip), linear(world["pad"]["stiffness"]))
        items.append(pad)
        gripped = np.zeros(0, dtype=int)
    fixed = np.setdiff1d(np.unique(np.concatenate(held)), gripped)
    dof0 = (3 * np.concatenate([fixed, gripped])[:, None] + np.arange(3)).ravel()
    dof1 = np.setdiff1d(np.arange(field[0].values.size), dof0)

    def load(share: float, inside: float) -> None:
        """Equilibrium with the gripper at a share of its way, and a share of the pressure."""
        place = np.array(pull["to"]) * share
        if pad is not None:
            pad.rest[:] = place
        if pressure is not None:
            pressure.update(world["pressure"]["kPa"] * inside)
        values = np.concatenate([np.zeros((len(fixed), 3)), np.broadcast_to(place, (len(gripped), 3))])
        felupe.newtonraphson(
            items=items, dof0=dof0, dof1=dof1, ext0=values.ravel(), solver=spsolve, maxiter=40, tol=TOLERANCE, verbose=0
        )

    def pulled(begun: int, part: float) -> None:
        """Equilibrium at a part of a step."""
        load((begun + part) / steps, 1.0)

    # The pressure acts before the gripper moves.
    _followed(field, lambda part: load(0.0, part))
    found = [np.array(field[0].values)]
    for step in range(steps):
        _followed(field, partial(pulled, step))
        found.append(np.array(field[0].values))
    return np.array(found)


def _followed(field: Any, load: Callable[[float], None]) -> None:
    """Bring a load from nothing to the whole, in smaller steps where Newton's method does not converge."""
    at, step = 0.0, 1.0
    while at < 1:
        before = np.array(field[0].values)
        try:
            load(at + step)
            at += step
        except felupe.tools.NewtonConvergenceError:
            field[0].values[:] = before
            step /= 2
            if step < SMALLEST:
                raise


def _toggled(spec: Spec, anchored: list[str]) -> list[Array]:
    """Change at the end of each pull where one patch is toggled, with nothing wrong, to first order in the pull."""
    pulls = [{**pull, "to": (TANGENT * np.array(pull["to"])).tolist()} for pull in spec["pulls"]]
    small = {**spec, "world": {}, "pulls": pulls}
    before = motion(small, anchored, 1, 1)[:, -1]
    found: list[Array] = []
    for name in spec["patches"]:
        other = [patch for patch in anchored if patch != name] if name in anchored else [*anchored, name]
        # A body without anchors moves as the gripper does, by more than any noise.
        after = motion(small, other, 1, 1)[:, -1] if other else np.full_like(before, 1.0)
        found.append(np.asarray((after - before) / TANGENT, dtype=np.float64))
    return found


def main() -> None:
    """The world, and what there is to compare it with."""
    with open(sys.argv[1], encoding="utf-8") as file:
        spec = json.load(file)
    refine, steps, anchored = int(spec["refine"]), int(spec["steps"]), list(spec["anchored"])
    world = motion(spec, anchored, refine, steps)
    plain = motion({**spec, "world": {}}, anchored, refine, steps) if spec["world"] else world
    toggled = _toggled(spec, anchored) if spec["toggle"] else []
    np.savez(sys.argv[2], motion=world, plain=plain, toggled=np.array(toggled))


if __name__ == "__main__":
    main()
