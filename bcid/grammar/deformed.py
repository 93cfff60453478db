"""A deformed body at quadrature points, in numbers: what `bcid.forms.kinematics` is in UFL."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from bcid.forms.quadrature import QuadraturePoints

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Deformed:
    """Displacements at points of a body.

    Attributes:
        points: where.
        u: displacement, shape (q, 3), m.
        F: deformation gradient, shape (q, 3, 3).
        centre: middle of the body's bounding box at rest, shape (3,), m.
        size: its diagonal, m.
        axes: unit vectors at 0 and 90 degrees in the plane of fibres, and across it, shape (3, 3), by row.
        since: displacement since the last step, shape (q, 3), m.
    """

    points: QuadraturePoints
    u: Array
    F: Array
    centre: Array
    size: float
    axes: Array
    since: Array

    def at(self, chosen: slice | NDArray[np.bool_]) -> Deformed:
        """At some of the points alone; all of them for a slice."""
        if isinstance(chosen, slice):
            return self
        some = replace(
            self, points=self.points.some(chosen), u=self.u[chosen], F=self.F[chosen], since=self.since[chosen]
        )
        # Many overlapping choices are made: determinants and inverses are those of all points.
        some.__dict__.update(J=self.J[chosen], inverse_transposed=self.inverse_transposed[chosen])
        return some

    @cached_property
    def J(self) -> Array:
        """Volume ratio, shape (q,)."""
        return np.asarray(np.linalg.det(self.F))

    @cached_property
    def inverse_transposed(self) -> Array:
        """F^-T, shape (q, 3, 3)."""
        return np.asarray(np.swapaxes(np.linalg.inv(self.F), 1, 2))

    @cached_property
    def C(self) -> Array:
        """Right Cauchy-Green tensor, shape (q, 3, 3)."""
        return np.asarray(np.swapaxes(self.F, 1, 2) @ self.F)

    @cached_property
    def _first(self) -> Array:
        return np.asarray(np.trace(self.C, axis1=1, axis2=2))

    @cached_property
    def _second(self) -> Array:
        return np.asarray((self._first**2 - np.einsum("qij,qij->q", self.C, self.C)) / 2)

    @cached_property
    def first(self) -> Array:
        """I1bar - 3, shape (q,)."""
        return np.asarray(self.J ** (-2 / 3) * self._first - 3)

    @cached_property
    def second(self) -> Array:
        """I2bar - 3, shape (q,)."""
        return np.asarray(self.J ** (-4 / 3) * self._second - 3)

    @cached_property
    def first_slope(self) -> Array:
        """d(I1bar)/dF, shape (q, 3, 3)."""
        inside = self.F - _scaled(self._first / 3, self.inverse_transposed)
        return _scaled(2 * self.J ** (-2 / 3), inside)

    @cached_property
    def second_slope(self) -> Array:
        """d(I2bar)/dF, shape (q, 3, 3)."""
        inside = _scaled(self._first, self.F) - self.F @ self.C
        inside -= _scaled(2 * self._second / 3, self.inverse_transposed)
        return _scaled(2 * self.J ** (-4 / 3), inside)

    @cached_property
    def volume_slope(self) -> Array:
        """dJ/dF, shape (q, 3, 3)."""
        return _scaled(self.J, self.inverse_transposed)

    @cached_property
    def _principal(self) -> tuple[Array, Array]:
        """Eigenvalues of C, shape (q, 3), and unit vectors, shape (q, 3, 3), by column."""
        values, vectors = np.linalg.eigh(self.C)
        return np.asarray(values), np.asarray(vectors)

    def power_slope(self, exponent: float) -> Array:
        """Derivative by F of the sum of the isochoric principal stretches to a power, shape (q, 3, 3)."""
        values, vectors = self._principal
        powers = (self.J[:, None] ** (-2 / 3) * values) ** (exponent / 2)
        apart = exponent * (powers - powers.mean(axis=1, keepdims=True)) / values
        return np.asarray(self.F @ np.einsum("qip,qp,qjp->qij", vectors, apart, vectors))

    def spot(self, centre: tuple[float, float, float], radius: float) -> Array:
        """`QuadraturePoints.spot`, computed once for all terms at a place; shape (q,)."""
        if (centre, radius) not in self._spots:
            self._spots[centre, radius] = self.points.spot(np.array(centre), radius)
        return self._spots[centre, radius]

    @cached_property
    def _spots(self) -> dict[tuple[tuple[float, float, float], float], Array]:
        return {}

    def direction(self, azimuth: float, elevation: float) -> Array:
        """Unit vector at angles in degrees: in the plane of fibres, and out of it; shape (3,)."""
        a, e = np.radians([azimuth, elevation])
        return np.asarray(np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)]) @ self.axes)


def _scaled(by: Array, tensors: Array) -> Array:
    return np.asarray(by[:, None, None] * tensors)
