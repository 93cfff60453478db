"""Forces of a file of their own, with another clock than the images: brought to their frames by time, or by the gripper's way."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from bcid.base.errors import InputError
from bcid.measurement.contents import WRENCH
from bcid.measurement.tracks import Rows, Tracks

Array = NDArray[np.float64]
# A gripper goes back where its way falls by more than this part of the furthest; clocks agree where ways differ by less (RMS).
_BACK, _AGREES = 0.05, 0.1
# Offsets that are tried, over both durations, before the best is refined; and the part of the frames that must be in the record.
_OFFSETS, _OVERLAP = 2001, 0.5


@dataclass(frozen=True)
class ForceRecording:
    """What a file of forces holds, in the units of the mapping.

    Attributes:
        path: the file.
        wrench: force and torque, shape (samples, 6), NaN where there is no column.
        time: by its own clock, shape (samples,), or None.
        way: how far the gripper is from rest, shape (samples,), or None.
        offset: what has to be added to the time of the images for that of the forces; None where the ways tell.
    """

    path: Path
    wrench: Array
    time: Array | None
    way: Array | None
    offset: float | None

    @classmethod
    def read(cls, folder: Path, told: Mapping[str, Any], delimiter: str, decimal: str) -> ForceRecording:
        """The file that [force] of a mapping names.

        Args:
            folder: of the mapping.
            told: the table [force], checked.
            delimiter: between the columns of the file.
            decimal: "." or ",", of its numbers.

        Raises:
            InputError: with every problem of the file.
        """
        path = folder / str(told["file"])
        rows = Rows.read(path, delimiter, decimal)
        clocks = [str(told.get(key, "")) for key in ("time", "way")]
        columns = [*told["wrench"], *clocks]
        rows.require(columns)
        values = rows.numbers(columns)
        rows.problems.raise_if_any()
        wrench = values[:, : len(WRENCH)]
        time, way = (values[:, len(WRENCH) + i] if name else None for i, name in enumerate(clocks))
        way = None if way is None else np.abs(way - way[0])
        offset = told.get("offset", None if way is not None else 0.0)
        if time is not None and (back := np.flatnonzero(np.diff(time) < 0)).size:
            raise InputError(f"{path}: {told['time']}: the times go back in line {rows.rows[int(back[0]) + 1][0]}")
        return cls(path, wrench, time, way, None if offset is None else float(offset))

    def at(self, recording: Tracks) -> Array:
        """Force and torque in the frames of a recording, shape (frames, 6); NaN in frames that the file does not reach.

        Raises:
            InputError: the way of the gripper does not tell which sample belongs to a frame.
        """
        if self.time is None:
            assert self.way is not None
            return self._between(self._rising(self._way_of(recording)), np.maximum.accumulate(self.way))
        times = np.array(recording.times, dtype=float)
        offset = self._offset(times, self._way_of(recording)) if self.offset is None else self.offset
        return self._between(times + offset, self.time)

    def _between(self, wanted: Array, known: Array) -> Array:
        found = [np.interp(wanted, known, column, left=np.nan, right=np.nan) for column in self.wrench.T]
        return np.stack(found, axis=1)

    def _way_of(self, recording: Tracks) -> Array:
        """How far the gripper is from rest in each frame."""
        if recording.translation is None:
            raise InputError(
                f"{self.path}: force.way: the gripper's motion is not known; give columns.translation or [gripper]"
            )
        return np.linalg.norm(recording.translation, axis=1)

    def _rising(self, way: Array) -> Array:
        """The way of the gripper, of one action that does not go back."""
        most = max(float(way.max()), 1e-300)
        if (np.maximum.accumulate(way) - way).max() > _BACK * most:
            raise InputError(
                f"{self.path}: force.way: the gripper goes back, and comes twice to a place: give force.time too"
            )
        return way

    def _offset(self, times: Array, way: Array) -> float:
        """What makes both ways agree best, at least half of the frames being in the record."""
        assert self.time is not None
        assert self.way is not None
        own, clock = self.way, self.time

        def misses(offset: float) -> float:
            apart = np.interp(times + offset, clock, own, left=np.nan, right=np.nan) - way
            seen = np.isfinite(apart)
            return float(np.sqrt(np.mean(apart[seen] ** 2))) if seen.mean() >= _OVERLAP else math.inf

        tried = np.linspace(clock[0] - times[-1], clock[-1] - times[0], _OFFSETS)
        costs = np.array([misses(float(one)) for one in tried])
        best = float(tried[int(costs.argmin())])
        step = float(tried[1] - tried[0])
        found = minimize_scalar(
            misses, bounds=(best - step, best + step), method="bounded", options={"xatol": 1e-4 * step}
        )
        offset = float(found.x) if found.fun <= costs.min() else best
        if misses(offset) > _AGREES * max(float(way.max()), 1e-300):
            raise InputError(
                f"{self.path}: force.way: at no offset of the clocks does the gripper go there as it does in {len(times)} frames; "
                "check length_unit and time_unit, or give force.offset"
            )
        return offset
