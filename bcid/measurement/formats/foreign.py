"""What a foreign file holds, whatever its format; what a mapping says of how to read it; and its reader in a process of its own."""

from __future__ import annotations

from collections.abc import Mapping as Table
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bcid.base.confined import read_in_child
from bcid.base.errors import InputError

Array = NDArray[np.float64]
# The quality of a point of image or volume correlation: 1 is best, 0 that it was not correlated.
CORRELATION = "correlation"
# Time of a reader, s, and how much more a byte of the file may take.
_SECONDS, _SECONDS_PER_BYTE = 30.0, 1e-6


@dataclass(frozen=True)
class Foreign:
    """Markers, rigid bodies and forces by their labels in the file, along one axis of frames.

    Attributes:
        format: in words.
        times: of the frames, s, shape (frames,).
        points: positions by label, shape (frames, 3), in `unit`; NaN where a marker was not seen.
        bodies: poses of rigid bodies by label, shape (frames, 7): position in `unit`, unit quaternion (w, x, y, z).
        wrenches: by label, shape (frames, 6): force, N, and torque, as the file has them.
        quality: by kind ("score", "error", "cameras", "correlation") and label, shape (frames,).
        unit: of lengths; "" if the file states none.
        numbered: whether the points have no names but numbers from 1.
        clocked: whether the file, or the mapping, says when its frames were taken; if not, one is a time_unit.
        rest: positions without stress by label, shape (3,), where the file has them beside those of its frames.
        displacements: whether the file has displacements, which count from `rest`.
        empty: labels that the file names and holds no data for.
        notes: what was not read, to be told by `bcid import`.
    """

    format: str
    times: Array
    points: dict[str, Array]
    bodies: dict[str, Array] = field(default_factory=dict)
    wrenches: dict[str, Array] = field(default_factory=dict)
    quality: dict[str, dict[str, Array]] = field(default_factory=dict)
    unit: str = ""
    numbered: bool = False
    clocked: bool = True
    rest: dict[str, Array] = field(default_factory=dict)
    displacements: bool = False
    empty: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def frames(self) -> int:
        """Number of frames."""
        return len(self.times)

    def correlated(self, quality: Array) -> Foreign:
        """The same with the correlation of each point, (frames, points), NaN where there is none; those without any are lost.

        Where no point has any it is no such measure, and nothing is lost.
        """
        lost = ~(quality > 0)
        if lost.all():
            return replace(self, notes=(*self.notes, "the quality of all points is 0: it is not used"))
        points = {
            label: np.where(gone[:, None], np.nan, at)
            for (label, at), gone in zip(self.points.items(), lost.T, strict=True)
        }
        each = dict(zip(self.points, quality.T, strict=True))
        count = int((lost & np.isfinite(np.stack([at[:, 0] for at in self.points.values()], axis=1))).sum())
        notes = (f"positions without a correlation count as not seen: {count}",) if count else ()
        return replace(self, points=points, quality={**self.quality, CORRELATION: each}, notes=(*self.notes, *notes))

    @property
    def rate(self) -> float:
        """Frames per second, from the median interval; NaN for less than two frames."""
        steps = np.diff(self.times)
        middle = float(np.median(steps)) if len(steps) else 0.0
        return 1.0 / middle if middle > 0 else float("nan")


@dataclass(frozen=True)
class How:
    """What a mapping says of how to read a file; formats take what concerns them.

    Attributes:
        arrays: the table [arrays]: paths of arrays and the order of their dimensions.
        columns: the table [columns]; of files with arrays, paths of them.
        time: the mapping's time_unit, s.
        rate: frames per second of a file without times; None for one in each time_unit.
        clock: label of a marker whose times are those of the frames; of ROS bags.
    """

    arrays: Table[str, Any] = field(default_factory=dict)
    columns: Table[str, Any] = field(default_factory=dict)
    time: float = 1.0
    rate: float | None = None
    clock: str = ""

    def count(self, frames: int) -> Array:
        """Times of the frames of a file that has none, s, shape (frames,)."""
        return np.asarray(np.arange(frames) * (self.time if self.rate is None else 1.0 / self.rate))


def fetched(
    module: str, path: Path, what: str, arguments: Sequence[str] = (), *, in_place: bool = False
) -> dict[str, Any]:
    """Arrays by name that a reader makes of a file; see `bcid.base.confined.read_in_child`.

    Raises:
        InputError: the file is no readable `what`.
    """
    limit = _SECONDS + _SECONDS_PER_BYTE * path.stat().st_size
    try:
        return read_in_child(module, path, arguments, seconds=limit, in_place=in_place)
    except (InputError, TimeoutError) as error:
        raise InputError(f"{path}: is not a readable {what}: {error}; is it whole? Export or copy it again") from None


def needed(package: str) -> InputError:
    """That a package is missing, as the reader in the child says it."""
    return InputError(f"reading it needs the package {package}; install bcid[mocap]")
