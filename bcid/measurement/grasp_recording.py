"""The gripper's poses for a foreign recording, from a grasps.csv as a measurement folder has it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from bcid.base.errors import Problems, nearest
from bcid.measurement.contents import Units
from bcid.measurement.folder import read_grasps
from bcid.measurement.tracks import Tracks


def take_grasps(recording: Tracks, path: Path, units: Units) -> None:
    """Give every frame of a recording the pose that a file has for its action and step, in `units`.

    Raises:
        InputError: the file is damaged, or has other actions or steps than the recording.
    """
    actions = {action.name: action for action in read_grasps(path, units)}
    problems = Problems(f"motions {path}")
    frames = list(zip(recording.actions, recording.steps, strict=True))
    for name, action in actions.items():
        own = {step for other, step in frames if other == name}
        if not own:
            problems.add(
                path, f"action '{name}' is not in the recording; {nearest(name, dict.fromkeys(recording.actions))}"
            )
            continue
        known = {int(step) for step in action.steps}
        missing, more = own - known, known - own
        for steps, said in (
            (missing, "no pose for step {}"),
            (more, "a pose for step {}, which the recording has not"),
        ):
            if steps:
                few = ", ".join(map(str, sorted(steps)[:5])) + (", ..." if len(steps) > 5 else "")
                text = f"action {name}: holds {said.format(few)}; steps count the frames that are used, from rest, which is 0"
                problems.add(path, text)
    problems.raise_if_any()
    poses = {
        (name, int(step)): (action.grasp, *pose)
        for name, action in actions.items()
        for step, *pose in zip(action.steps, action.translation, action.rotation, strict=True)
    }
    still = "", np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])
    chosen = [poses.get(frame, still) for frame in frames]
    recording.grasps = [grasp for grasp, _, _ in chosen]
    recording.translation = np.array([place for _, place, _ in chosen]) / units.factors[0]
    recording.rotation = np.array([turn for _, _, turn in chosen])
