"""The meshes, forward models and derivatives of a scene, each made once in a process."""

from __future__ import annotations

import math
from collections.abc import Iterable

from bcid.base.collective import Comm, in_turns
from bcid.base.scheduler import Team
from bcid.forms.forward import Forward
from bcid.forms.gripper_force import ForceScale
from bcid.forms.mesh import BodyMesh, level_mesh
from bcid.forms.model import Model
from bcid.forms.sensitivity import Sensitivity
from bcid.forms.set_tangent import SetTangents
from bcid.forms.solver.equilibrium import Settings
from bcid.scene import Scene


class ForwardModels:
    """Forward models by level and kind of model, private to the process or to a team, with what derives from them.

    Args:
        scene: with the ladder of levels.
        comm: meshes are made on one rank of it, and forms compiled in turns.
        settings: accuracy and patience of the solver.
        forces: how force and torque of the gripper are compared, where they are.
        per_rank: a mesh with more unknowns than this is shared by a team of ranks, as far as there are any; None to share none.
    """

    def __init__(
        self, scene: Scene, comm: Comm, settings: Settings, forces: ForceScale | None, per_rank: int | None = None
    ) -> None:
        self.scene, self.comm, self.settings, self.forces, self.per_rank = scene, comm, settings, forces, per_rank
        self._teams: dict[tuple[int, bool], Team] = {}
        self._meshes: dict[int, BodyMesh] = {}
        self._forwards: dict[tuple[int, str], Forward] = {}
        self._sensitivities: dict[Forward, Sensitivity] = {}
        self._tangents: dict[Forward, SetTangents] = {}

    def mesh(self, level: int) -> BodyMesh:
        """Of a level; collective."""
        if level not in self._meshes:
            self._meshes[level] = level_mesh(self.scene, self.scene.levels[level], self.comm)
        return self._meshes[level]

    def unknowns(self, level: int) -> int:
        """Of a level; collective."""
        return self.mesh(level).unknowns(self.scene.levels[level].degree, False)

    def of(self, model: Model, level: int) -> Forward:
        """The forward model of these parts that move the body, with their values; collective."""
        key = level, model.name
        if key not in self._forwards:
            mesh, team = self.mesh(level), self.team(model, level)
            together, first = (
                (None, self.comm.rank == 0) if team is None else (team.comm, self.comm.rank < team.comm.size)
            )
            self._forwards[key] = in_turns(
                self.comm,
                first,
                lambda: Forward(self.scene, level, together, model, self.settings, mesh, self.forces),
            )
        self._forwards[key].set_model(model)
        return self._forwards[key]

    def team(self, model: Model, level: int) -> Team | None:
        """The ranks that share the mesh of a level with this one; None where meshes are not shared. Collective."""
        if self.per_rank is None:
            return None
        key = level, model.mixed
        if key not in self._teams:
            unknowns = self.mesh(level).unknowns(self.scene.levels[level].degree, model.mixed)
            wanted = math.ceil(unknowns / self.per_rank)
            count = self.comm.size
            self._teams[key] = Team.of(
                self.comm, max(d for d in range(1, count + 1) if count % d == 0 and (d <= wanted or d == 1))
            )
        return self._teams[key]

    def sensitivity(self, forward: Forward) -> Sensitivity:
        """Of one of the forward models."""
        if forward not in self._sensitivities:
            self._sensitivities[forward] = Sensitivity(forward)
        return self._sensitivities[forward]

    def tangents(self, forward: Forward) -> SetTangents:
        """Of one of the forward models: what tells other sets of anchors to first order."""
        if forward not in self._tangents:
            self._tangents[forward] = SetTangents(forward)
        return self._tangents[forward]

    def drop(self, keep: Iterable[str] = ()) -> None:
        """Free what was built for models of other names."""
        names = set(keep)
        for key in [key for key in self._forwards if key[1] not in names]:
            forward = self._forwards.pop(key)
            self._tangents.pop(forward, None)
            if forward in self._sensitivities:
                self._sensitivities.pop(forward).destroy()
            forward.destroy()

    def destroy(self) -> None:
        """Free everything of this process; collective where meshes are shared."""
        self.drop()
        for team in self._teams.values():
            team.free()
        self._teams.clear()
