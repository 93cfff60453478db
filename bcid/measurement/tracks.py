"""The tracks of a recording: what its markers and its gripper did, in the file's units, before they are a measurement."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bcid.base.errors import InputError

Array = NDArray[np.float64]


@dataclass
class Tracks:
    """What was read, in the file's units: one entry per frame; and by what the rigid motion of [align] misses its markers, m."""

    actions: list[str]
    steps: list[int]
    times: list[float]
    positions: dict[str, Array]
    translation: Array | None = None
    rotation: Array | None = None
    pose: Array | None = None
    wrench: Array | None = None
    grasps: list[str] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)
    aligned: float | None = None


def select(recording: Tracks, frames: tuple[int, int | None, int, int | None], source: Path) -> None:
    """Keep the frame of rest and every so many frames of each action, and number them from 0."""
    first, last, every, rest = frames
    chosen: list[int] = []
    steps: list[int] = []
    places: dict[str, list[int]] = {}
    for i, action in enumerate(recording.actions):
        places.setdefault(action, []).append(i)
    for action, mine in places.items():
        if any(recording.steps[b] <= recording.steps[a] for a, b in pairwise(mine)):
            raise InputError(f"{source}: the steps of action {action} do not rise: sort the rows, one for each step")
        kept = mine[first : None if last is None else last + 1 : every]
        if rest is not None and kept and rest != first:
            kept = [mine[rest], *kept]
        chosen += kept
        steps += range(len(kept))
    recording.actions = [recording.actions[i] for i in chosen]
    recording.times = [recording.times[i] for i in chosen]
    recording.steps = steps
    recording.positions = {name: values[chosen] for name, values in recording.positions.items()}
    recording.grasps = [recording.grasps[i] for i in chosen] if recording.grasps else []
    recording.translation = None if recording.translation is None else recording.translation[chosen]
    for part in ("rotation", "pose", "wrench"):
        values = getattr(recording, part)
        setattr(recording, part, None if values is None else values[chosen])
