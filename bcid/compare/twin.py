"""The simulated twin of a measurement: predictions and signatures of any model and anchor set, spread over the ranks."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bcid.collective import agree
from bcid.compare.data import Data, MeshError
from bcid.errors import BcidError, InputError
from bcid.forms.forward import Forward, Prediction
from bcid.forms.mesh import BodyMesh, level_mesh
from bcid.forms.model import Model
from bcid.forms.sensitivity import Sensitivity, Signatures, Wanted
from bcid.forms.solve import Settings
from bcid.measurement import Action, Measurement
from bcid.progress import Progress, Silent
from bcid.scene import Scene

Array = NDArray[np.float64]
# Elements twice as small leave a quarter of the error.
_ORDER = 2
_LEAST_GAIN = 0.5


@dataclass(frozen=True)
class Reply:
    """Prediction of a model: positions the same on every rank, states where they were computed.

    Attributes:
        positions: shape (frames, fiducials, 3), m; NaN in frames that could not be reached.
        parts: this rank's own predictions, by action.
        failure: why it could not be followed to the end, or "".
    """

    positions: Array
    parts: dict[str, Prediction]
    failure: str = ""


class Twin:
    """Predicts what a measurement should have shown. All methods are collective on `comm`; actions are spread over ranks.

    Args:
        scene: the scene.
        measurement: its motions are repeated.
        comm: an MPI communicator.
        level: the working level.
        settings: accuracy and patience of the solver.
        progress: told what goes on (rank 0).

    Attributes:
        data: the measured values.
        trajectories: forward trajectories by level, in whole-trajectory equivalents.
    """

    def __init__(
        self,
        scene: Scene,
        measurement: Measurement,
        comm: Any,
        level: int,
        settings: Settings | None = None,
        progress: Progress | None = None,
    ) -> None:
        if not 0 <= level < len(scene.levels):
            raise InputError(f"level {level}: the scene has levels 0 to {len(scene.levels) - 1}")
        self.scene, self.measurement, self.comm, self.level = scene, measurement, comm, level
        self.settings = settings or Settings(rtol=1e-7)
        self.progress = progress or Silent()
        self.data = Data(scene, measurement)
        self.actions = measurement.actions
        self.trajectories: dict[int, float] = {}
        self._forwards: dict[tuple[int, str], Forward] = {}
        self._sensitivities: dict[tuple[int, str], Sensitivity] = {}
        self._meshes: dict[int, BodyMesh] = {}

    @property
    def finer(self) -> int | None:
        """The level that the working level is compared with, if there is one; the coarser one below the finest."""
        if self.level + 1 < len(self.scene.levels):
            return self.level + 1
        return self.level - 1 if self.level > 0 else None

    def forward(self, model: Model, level: int | None = None) -> Forward:
        """The forward model of these parts, with its values, private to the process."""
        level = self.level if level is None else level
        key = level, model.name
        if key not in self._forwards:
            if level not in self._meshes:
                self._meshes[level] = level_mesh(self.scene, self.scene.levels[level], self.comm)
            # One rank compiles the forms, the others find them in the cache.
            for turn in (0, 1):
                error = None
                if (self.comm.rank > 0) == turn:
                    try:
                        forward = Forward(self.scene, level, None, model, self.settings, self._meshes[level])
                        self._forwards[key] = forward
                    except BcidError as caught:
                        error = caught
                agree(self.comm, error)
        self._forwards[key].set_model(model)
        return self._forwards[key]

    def drop(self, keep: Iterable[Model] = ()) -> None:
        """Free what was built for models other than these."""
        names = {model.name for model in keep}
        for key in [key for key in self._forwards if key[1] not in names]:
            self._forwards.pop(key).destroy()
            self._sensitivities.pop(key, None)

    def mine(self, actions: Iterable[Action]) -> list[Action]:
        """The actions that this rank computes: the longest first, each to the rank with the least to do."""
        loads = [0] * self.comm.size
        chosen = []
        for action in sorted(actions, key=lambda a: (-len(a), a.name)):
            rank = loads.index(min(loads))
            loads[rank] += len(action)
            if rank == self.comm.rank:
                chosen.append(action)
        return sorted(chosen, key=lambda a: int(a.frames[0]))

    def predict(
        self,
        model: Model,
        anchors: Iterable[str],
        level: int | None = None,
        actions: Iterable[Action] | None = None,
        keep: bool = False,
    ) -> Reply:
        """What the model shows with these patches anchored.

        Args:
            model: law, effects and their values.
            anchors: the anchored patches.
            level: mesh level; the working level by default.
            actions: only these; all by default.
            keep: keep the states, for `signatures`.
        """
        actions = self.actions if actions is None else list(actions)
        level = self.level if level is None else level
        forward = self.forward(model, level)
        positions = np.full(self.data.mask.shape, np.nan)
        parts, failure, error = {}, "", None
        for action in self.mine(actions):
            try:
                part = forward.predict(anchors, [action], keep=keep)
            except BcidError as caught:
                error = caught
                break
            positions[action.frames] = part.positions[action.frames]
            parts[action.name] = part
            failure = failure or (part.failure.reason if part.failure else "")
        agree(self.comm, error)
        gathered = self.comm.allgather((positions, failure))
        total = np.full_like(positions, np.nan)
        for found, _ in gathered:
            total = np.where(np.isnan(total), found, total)
        share = sum(len(a) for a in actions) / sum(len(a) for a in self.actions)
        self.trajectories[level] = self.trajectories.get(level, 0.0) + share
        return Reply(total, parts, next((why for _, why in gathered if why), ""))

    def signatures(self, model: Model, anchors: Iterable[str], reply: Reply, wanted: Wanted) -> Signatures:
        """Signatures along all actions of a reply that kept its states, the same on every rank."""
        forward = self.forward(model)
        key = self.level, model.name
        if key not in self._sensitivities:
            self._sensitivities[key] = Sensitivity(forward)
        sensitivity = self._sensitivities[key]
        error, parts = None, []
        for action in self.mine(a for a in self.actions):
            try:
                parts.append(sensitivity.of(anchors, [action], self._whole(reply.parts[action.name]), wanted))
            except BcidError as caught:
                error = caught
                break
        agree(self.comm, error)
        gathered = [part for parts in self.comm.allgather(parts) for part in parts]
        return _merged(gathered)

    def _whole(self, part: Prediction) -> Prediction:
        """A part's positions in the frames of the whole measurement."""
        positions = np.full(self.data.mask.shape, np.nan)
        positions[: len(part.positions)] = part.positions
        return replace(part, positions=positions)

    def mesh_error(self, model: Model, anchors: Iterable[str], reply: Reply) -> MeshError:
        """What the next level of the ladder says of the working level's error."""
        other = self.finer
        if other is None:
            return MeshError.unknown(self.data.mask.shape)
        second = self.predict(model, anchors, other)
        if second.failure or reply.failure:
            return MeshError.unknown(self.data.mask.shape)
        own, its = (self._unknowns(level) for level in (self.level, other))
        gain = max(abs((max(own, its) / min(own, its)) ** (_ORDER / 3) - 1), _LEAST_GAIN)
        if other > self.level:
            return MeshError.between(reply.positions, second.positions, gain)
        difference = (reply.positions - second.positions) / gain
        return MeshError(difference, difference, True)

    def _unknowns(self, level: int) -> int:
        return self._meshes[level].unknowns(self.scene.levels[level].degree, False)

    def destroy(self) -> None:
        """Free the PETSc objects."""
        self.drop()


def _merged(parts: list[Signatures]) -> Signatures:
    """Parts that cover different frames, as one."""

    def join(arrays: list[Any]) -> Any:
        result = arrays[0].copy()
        for other in arrays[1:]:
            fill = np.isnan(result)
            result[fill] = other[fill]
        return result

    first = parts[0]
    probes = [{name: join([p.probes[i][name] for p in parts]) for name in one} for i, one in enumerate(first.probes)]
    law = {name: join([p.law[name] for p in parts]) for name in first.law}
    stiffness = None if first.stiffness is None else join([p.stiffness for p in parts])
    forces = None if first.forces is None else join([p.forces for p in parts])
    return Signatures(probes, law, stiffness, forces)
