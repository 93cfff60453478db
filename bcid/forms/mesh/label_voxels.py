"""The labels of an image inside of a body: which one is at a place."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class LabelVoxels:
    """A part of a label image.

    Attributes:
        labels: of the voxels, shape (x, y, z).
        to_voxels: from places (m) to numbers of voxels, an affine of shape (4, 4).
    """

    labels: NDArray[np.int32]
    to_voxels: Array

    @classmethod
    def of(cls, labels: NDArray[np.int32], frame: Array, unit: float) -> LabelVoxels:
        """From the affine (4, 4) of voxels to places in a unit of so many m."""
        scaled = frame.copy()
        scaled[:3] *= unit
        return cls(labels, np.asarray(np.linalg.inv(scaled), dtype=float))

    def at(self, places: Array) -> NDArray[np.int32]:
        """Label of the voxel that holds each place (..., 3), m; beyond the image that of the nearest voxel, shape (...)."""
        voxel = np.round(places @ self.to_voxels[:3, :3].T + self.to_voxels[:3, 3]).astype(np.int64)
        inside = np.clip(voxel, 0, np.array(self.labels.shape) - 1)
        return np.asarray(self.labels[inside[..., 0], inside[..., 1], inside[..., 2]])
