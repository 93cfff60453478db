"""Places on the surface that springs may hold, however stiff they are.

A spring of stiffness k per area on a spot of weighted area A pulls with f = -k A u at its mean movement u. With the compliance Q of
the place to such a force u = u0 + Q f, so that f = -(Q + 1/(k A))^-1 u0; and what a unit of force does to a marker is known. This
holds to first order however stiff the spring is; the sensitivity to a stiffness from none holds for soft ones only. Springs that
act along some directions only have the parts of Q and u0 along these; a stop acts where u0 is on its side.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from bcid.forms.mesh.body import Body
from bcid.forms.quadrature import QuadraturePoints

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Grip:
    """How springs on a spot act.

    Attributes:
        along: whether along the surface too, and not only across it.
        side: 1 where only if it moves outwards, -1 inwards, 0 both ways.
    """

    along: bool = True
    side: int = 0

    def directions(self, normal: Array) -> Array:
        """Unit vectors of what is held where this is the outward normal, shape (3, m), the normal alone unless `along`."""
        return np.eye(3) if self.along else normal[:, None]


class Holds:
    """Spots on the surface of a body that is private to the process.

    Args:
        body: the body.
        points: of its surface.
        weights: of the spots at the points, shape (spots, q).

    Attributes:
        areas: their weighted areas, shape (spots,), m^2.
        normals: their mean outward normals, shape (spots, 3).
    """

    def __init__(self, body: Body, points: QuadraturePoints, weights: Sequence[Array]) -> None:
        self.areas = np.array([float(points.weights @ w) for w in weights])
        normals = np.array([(points.weights * w) @ points.normals for w in weights])
        self.normals = normals / np.maximum(np.linalg.norm(normals, axis=1), 1e-12 * self.areas)[:, None]
        count = len(body.nodes)
        rows = points.nodes.ravel()
        columns = [
            np.bincount(rows, ((w * points.weights)[:, None] * points.shapes).ravel(), minlength=count) for w in weights
        ]
        self._means = sp.csr_matrix(np.array(columns) / self.areas[:, None])
        self._dofs = body.displacement_dofs.reshape(-1, 3)
        self._unknowns = int(body.space.dofmap.index_map.size_local * body.space.dofmap.index_map_bs)

    def at(self, unknowns: Array, solve: Callable[[Array], Array]) -> Array:
        """Compliance and movement of each spot, see `bcid.forms.sensitivity.Works.held`, shape (spots, 4, 3)."""
        found = np.zeros((len(self.areas), 4, 3))
        found[:, 3] = self._means @ unknowns[self._dofs]
        loads = np.zeros((self._unknowns, 3 * len(self.areas)))
        for axis in range(3):
            loads[self._dofs[:, axis], axis::3] = self._means.T.toarray()
        moved = solve(loads)[self._dofs].reshape(len(self._dofs), 3, len(self.areas), 3)
        for k in range(len(self.areas)):
            found[k, :3] = np.einsum("n,naj->aj", self._means[k].toarray().ravel(), moved[:, :, k])
        return found


def held_by(stiffness: float, area: float, held: Array, normal: Array, grip: Grip) -> Array:
    """Force (N) of springs of a stiffness (Pa/m) on a spot in each frame, shape (frames, 3); zero where nothing is known.

    Args:
        stiffness, area: of the springs, and of the spot, m^2.
        held: what `Holds.at` gives of the spot, shape (frames, 4, 3).
        normal: its outward normal, (3,).
        grip: how they act.
    """
    held_along = grip.directions(normal)
    known = np.isfinite(held).all(axis=(1, 2))
    moved = held[known, 3] @ held_along
    if grip.side:
        moved[:, 0] = grip.side * np.maximum(grip.side * moved[:, 0], 0.0)
    compliance = held_along.T @ held[known, :3] @ held_along + np.eye(held_along.shape[1]) / (stiffness * area)
    found = np.zeros((len(held), 3))
    found[known] = -np.linalg.solve(compliance, moved[..., None])[..., 0] @ held_along.T
    return found
