"""Which components of which rows a measurement shows: the coordinates of a fiducial, or one along the normal of a surface."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bcid.measurement import Measurement
from bcid.scene import Scene

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Seen:
    """Takes what is seen out of arrays (frames, rows, 3, ...).

    A surface mark has one component: that along the normal of the surface, which stands in place of its first coordinate.

    Attributes:
        mask: which components were seen, shape (frames, rows, 3).
        normals: unit normals of the surface at marks, NaN for rows whose coordinates are seen, shape (frames, rows, 3).
    """

    mask: NDArray[np.bool_]
    normals: Array

    @classmethod
    def of(cls, measured: Array, normals: Array) -> Seen:
        """Of positions (frames, rows, 3) with NaN where nothing was seen."""
        mask = np.isfinite(measured)
        mask[..., 1:] &= ~np.isfinite(normals[..., 1:])
        return cls(mask, normals)

    def within(self, frames: NDArray[np.bool_]) -> Seen:
        """Of some frames, (frames,), alone."""
        return Seen(self.mask & frames[:, None, None], self.normals)

    def take(self, values: Any) -> Any:
        """What is seen of values (frames, rows, 3, ...), shape (n, ...)."""
        found = np.asarray(values[self.mask])
        along, frames, rows = self._along
        if len(along):
            found[along] = np.einsum("na,na...->n...", self.normals[frames, rows], values[frames, rows])
        return found

    @cached_property
    def _along(self) -> tuple[NDArray[np.int64], ...]:
        """Which of the seen values are along a normal, and their frames and rows."""
        frames, rows, _ = np.nonzero(self.mask)
        along = np.flatnonzero(np.isfinite(self.normals[frames, rows, 0]))
        return along, frames[along], rows[along]

    def take_frame(self, index: int, values: Array) -> Array:
        """What is seen in one frame of values (rows, 3), shape (n,)."""
        normals, along = self.normals[index], np.isfinite(self.normals[index, :, 0])
        if along.any():
            values = values.copy()
            values[along, 0] = np.einsum("na,na->n", normals[along], values[along])
        return np.asarray(values[self.mask[index]])

    @property
    def directions(self) -> Array:
        """Unit vector of every seen component, shape (n, 3)."""
        return np.asarray(self.take(np.broadcast_to(np.eye(3), (*self.mask.shape, 3))))


def normals_of(scene: Scene, measurement: Measurement, rows: int) -> Array:
    """Normals (frames, rows, 3) of a measurement in the order of a scene's fiducials, NaN where coordinates are seen."""
    found = np.full((len(measurement.positions), rows, 3), np.nan)
    if measurement.normals is not None:
        found[:, [scene.fiducial_names.index(name) for name in measurement.fiducial_names]] = measurement.normals
    return found
