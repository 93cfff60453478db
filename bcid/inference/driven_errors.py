"""What errors of driven places do to the measured values: noise of the points, where they are at rest, what lies between them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bcid.forms.mesh import BodyMesh
from bcid.forms.solver.driven_boundary import place_modes
from bcid.inference.data import Data
from bcid.scene import Scene

Array = NDArray[np.float64]
DRIVEN = "driven"
# Noise of a frame is left out in directions in which it is smaller than this part of what the values have themselves, and where
# there are more directions than this.
_LEAST, _MOST = 0.2, 600


@dataclass(frozen=True)
class DrivenErrors:
    """Errors of the driven places of a scene on one mesh.

    Attributes:
        scene: with points for all that is driven.
        counts: modes of noise and of what lies between points, by place.
    """

    scene: Scene
    counts: dict[str, tuple[int, int]]

    @classmethod
    def of(cls, scene: Scene, mesh: BodyMesh) -> DrivenErrors:
        """Of the driven places of a scene."""
        found = {}
        for name in scene.driven:
            noise, between = place_modes(mesh, scene, name, mesh.points[:1])
            found[name] = noise.shape[1], between.shape[1]
        return cls(scene, found)

    @property
    def size(self) -> float:
        """Standard deviation of the points that drive, of noise and of where they are at rest, RMS, m."""
        known = [driven.kriging.noise**2 + driven.offset**2 for driven in self.scene.driven.values()]
        return float(np.sqrt(np.mean(known)))

    def columns(self, data: Data, moved: Array) -> Array:
        """Errors of one standard deviation, (n, k), m.

        Args:
            data: the values.
            moved: by a unit of each mode, (frames, rows, 3, modes), see `DrivenBoundary.error_increments`.
        """
        seen = np.nan_to_num(data.vector(moved))
        noise, lasting, first = [], [], 0
        for name, driven in self.scene.driven.items():
            of_noise, between = self.counts[name]
            grown = self._grown(data, name)[:, None]
            for _ in driven.along:
                ends = first + of_noise, first + of_noise + between
                noise.append(driven.kriging.noise * seen[:, first : ends[0]])
                lasting += [driven.offset * seen[:, first : ends[0]], grown * seen[:, ends[0] : ends[1]]]
                first = ends[1]
        return np.hstack([*lasting, _by_frame(data, np.hstack(noise))])

    def _grown(self, data: Data, name: str) -> Array:
        """How large the displacements of a place's points are when each value is seen, as part of their RMS, shape (n,)."""
        sizes = np.zeros(len(data.mask))
        for action in data.measurement.actions:
            sizes[action.frames] = np.sqrt(np.mean(action.boundary[name] ** 2, axis=(1, 2)))
        return np.asarray((sizes / max(float(np.sqrt(np.mean(sizes**2))), 1e-30))[data.frame])


def _by_frame(data: Data, columns: Array) -> Array:
    """Errors that are others in each frame, (n, m), as columns of their own for each: those that matter, (n, k), m."""
    sigma = np.where(np.isfinite(data.sigma), data.sigma, np.inf)
    frames = [np.flatnonzero(data.frame == frame) for frame in np.unique(data.frame)]
    parts = [np.linalg.svd(columns[rows] / sigma[rows, None], full_matrices=False)[:2] for rows in frames]
    largest = np.sort(np.concatenate([sizes for _, sizes in parts]))[::-1]
    least = max(_LEAST, float(largest[_MOST])) if len(largest) > _MOST else _LEAST
    found = []
    for rows, (basis, sizes) in zip(frames, parts, strict=True):
        kept = sizes > least
        own = np.zeros((len(data), int(kept.sum())))
        own[rows] = basis[:, kept] * sizes[kept] * sigma[rows, None]
        found.append(own)
    return np.hstack(found)
