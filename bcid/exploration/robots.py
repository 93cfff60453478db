"""Robots: whatever makes a pull and looks at the fiducials. Two are here, a simulated one and one that works through a folder."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Protocol

import numpy as np

from bcid.base.errors import InputError, MachineError, SolveError, nearest
from bcid.base.inside_folder import read_inside
from bcid.base.run_folder import write_whole
from bcid.base.units import unit_factor
from bcid.forms.simulate import recorded, with_wrenches
from bcid.measurement import Action, Measurement
from bcid.measurement.folder_writer import grasp_lines
from bcid.predict.pull_predictor import PullPredictor
from bcid.scene import Scene

# Between two looks into a folder, s.
_POLL = 0.2


class Robot(Protocol):
    """Makes pulls. It lives on rank 0 only; after each pull the gripper is at rest again."""

    def move(self, action: Action) -> None:
        """Begin a pull; `action.name` is its number."""

    def observe(self) -> Measurement:
        """What was seen of the pull that was begun last: one action, as the gripper really moved, from rest."""


class Simulated:
    """A body whose anchors are known, seen by a camera with noise; its gripper feels forces where the predictor predicts them.

    Args:
        predictor: of what the body is really made of, on a mesh of its own, private to the process (COMM_SELF).
        anchors: names of its anchored patches.
        noise: standard deviation of each coordinate, m; 0 for none.
        random_state: of the noise; pull number k of a state always has the same noise.
        wrench_noise: standard deviation of a force, N.

    Raises:
        InputError: an anchor is not in the scene.
    """

    def __init__(
        self,
        predictor: PullPredictor,
        anchors: Iterable[str],
        noise: float,
        random_state: int = 0,
        wrench_noise: float = 0.0,
    ) -> None:
        self.predictor, self.anchors = predictor, frozenset(anchors)
        self.noise, self.wrench_noise, self.random_state = noise, wrench_noise, random_state
        for name in sorted(self.anchors - set(predictor.scene.patches)):
            raise InputError(f"patch '{name}' is not in the scene; {nearest(name, predictor.scene.patches)}")
        self._action: Action | None = None

    def move(self, action: Action) -> None:
        """Take the pull as made."""
        self._action = action

    def observe(self) -> Measurement:
        """What the camera saw.

        Raises:
            SolveError: the pull cannot be followed.
        """
        assert self._action is not None
        action = self._action
        predicted = self.predictor.predict([(self.anchors, action)])[0]
        if predicted.failed:
            raise SolveError(f"the simulated robot cannot make pull {action.name}: the model cannot be followed")
        rng = np.random.default_rng([self.random_state, int(action.name)])
        scene = self.predictor.scene
        text = f"simulated: scene {scene.name}, level {self.predictor.level}"
        count, gripper = len(scene.fiducials), self.predictor.gripper
        seen = recorded(scene, [action], predicted.positions[:, :count], self.noise, rng, action.clock, text)
        if gripper is None:
            return seen
        return with_wrenches(seen, gripper.wrenches(predicted.positions[:, count:]), self.wrench_noise, rng)


class Folder:
    """Any real set-up: bcid writes the wanted pull into a folder and waits until a measurement lies beside it.

        DIR/0001/wanted.toml    the pull in words, and the units of wanted.csv
        DIR/0001/wanted.csv     the poses of the gripper, as in the grasps.csv of a measurement folder; it appears last
        DIR/0001/measurement/   what was seen, put there by whoever drives the robot: written under another name, then renamed

    Args:
        folder: DIR.
        scene: the scene; measurements must fit it.
        wait: give up after so many seconds; the exploration can be continued.
        length_unit, time_unit: of wanted.csv.
    """

    def __init__(
        self, folder: Path, scene: Scene, wait: float = 3600.0, length_unit: str = "mm", time_unit: str = "s"
    ) -> None:
        self.folder, self.scene, self.wait = folder, scene, wait
        self.units = length_unit, time_unit
        self._place: Path | None = None

    def move(self, action: Action) -> None:
        """Ask for a pull; one that was asked for before, by an exploration that was interrupted, is not asked for again.

        Raises:
            InputError: another pull was asked for under this number.
            MachineError: the folder cannot be written.
        """
        self._place = self.folder / f"{int(action.name):04d}"
        length, seconds = unit_factor(self.units[0], "m"), unit_factor(self.units[1], "s")
        text = "\n".join(grasp_lines([action], length, seconds)) + "\n"
        file = self._place / "wanted.csv"
        if os.path.lexists(file):
            if read_inside(self._place, file.name) != text.encode():
                raise InputError(f"{file}: asks for another pull already; give this exploration a folder of its own")
            return
        furthest = float(np.linalg.norm(action.translation, axis=1).max()) / length
        words = f"grasp {action.grasp}, at most {furthest:.4g} {self.units[0]} from rest, and back"
        head = [f'length_unit = "{self.units[0]}"', f'time_unit = "{self.units[1]}"', f"pull = {json.dumps(words)}"]
        write_whole(file.with_suffix(".toml"), "\n".join(head) + "\n")
        write_whole(file, text)

    def observe(self) -> Measurement:
        """The measurement that was put beside the wanted pull; waits for it.

        Raises:
            InputError: it cannot be read, does not fit the scene, or does not hold one action.
            MachineError: there was none in time.
        """
        assert self._place is not None
        place = self._place / "measurement"
        end = time.monotonic() + self.wait
        while not place.is_dir():
            if time.monotonic() > end:
                raise MachineError(
                    f"{place}: no measurement after {self.wait:g} s; the same command goes on waiting for it"
                )
            time.sleep(_POLL)
        measurement = Measurement.read(place)
        measurement.check(self.scene)
        if len(measurement.action_names) != 1:
            raise InputError(
                f"{place}: holds {len(measurement.action_names)} actions; expected the one that was asked for"
            )
        return measurement
