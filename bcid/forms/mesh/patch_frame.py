"""Axes in the plane of a patch, and how far it reaches along them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bcid.scene.parts import Vector, horizontal

Array = NDArray[np.float64]


@dataclass(frozen=True)
class PatchFrame:
    """The plane that fits a patch best, in the rest state.

    Attributes:
        centre: middle of the patch along both axes, m.
        axes: unit vectors in the plane: the x axis as far as it lies in it (the y axis where the patch faces x), and one across.
        half: half of the patch's extent along each, m.
    """

    centre: Vector
    axes: tuple[Vector, Vector]
    half: tuple[float, float]

    @classmethod
    def of(cls, corners: Array) -> PatchFrame:
        """Of a patch with these corners of its facets, (n, 3), m."""
        middle = corners.mean(axis=0)
        normal = np.linalg.svd(corners - middle, full_matrices=False)[2][-1]
        # Which way it points is chance.
        normal = normal * np.sign(normal[np.abs(normal).argmax()])
        axes = horizontal(_vector(normal))
        along = (corners - middle) @ np.array(axes).T
        low, high = along.min(axis=0), along.max(axis=0)
        half = (high - low) / 2
        return cls(_vector(middle + (low + high) / 2 @ np.array(axes)), axes, (float(half[0]), float(half[1])))

    def plane(self, place: Any) -> tuple[Any, Any]:
        """Where a place (x, y, z), m, of numbers, arrays or UFL, is along the axes from the centre, m."""
        x, y = (sum((place[i] - self.centre[i]) * axis[i] for i in range(3)) for axis in self.axes)
        return x, y


def _vector(values: Array) -> Vector:
    x, y, z = (float(value) for value in values)
    return x, y, z
