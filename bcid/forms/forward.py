"""One level of the ladder, ready to predict: from an anchor set and the motions to the fiducial trajectories."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import ufl
from dolfinx import fem, la
from numpy.typing import NDArray

from bcid.base.collective import Comm
from bcid.forms import compiled
from bcid.forms.effects.effect import Frame
from bcid.forms.gripper_force import ROWS, ForceScale, GripperForce
from bcid.forms.mesh import BodyMesh, level_mesh
from bcid.forms.mesh.body import Body
from bcid.forms.mesh.length_unit import check_length_unit, fiducial_limit
from bcid.forms.model import Model
from bcid.forms.observe import Observer, attach, points_of
from bcid.forms.solver.equilibrium import Equilibrium, Settings
from bcid.forms.solver.status import Status
from bcid.forms.solver.supports import Pose
from bcid.forms.solver.trajectory import Trajectory, follow, poses
from bcid.measurement import Action
from bcid.scene import Scene

Array = NDArray[np.float64]
Watch = Callable[[int, Array], bool | None]
Look = Callable[[int, Pose], None]
# Nodes of another mesh are looked for so far outside of this one, in its longest edge.
_OUTSIDE = (1e-3, 0.1, 1.0)


@dataclass(frozen=True)
class Prediction:
    """Fiducial trajectories of one candidate.

    Attributes:
        positions: shape (frames, fiducials, 3), m, with two further rows where force and torque of the gripper are asked for
            (see `bcid.forms.gripper_force`); NaN in frames that were not reached.
        trajectories: how each action went.
        states: this rank's unknowns in each frame that was reached, when they were asked for.
        wrench: force (N) and torque (N m) of the gripper, shape (frames, 6); NaN in frames that were not reached, zero
            without a grasp; None unless `Forward.detail` has added it.
        displacement: at the nodes of the mesh, shape (frames, nodes, 3), m; likewise.
        energy: strain energy density at the nodes of the mesh, shape (frames, nodes), J/m^3; likewise.
    """

    positions: Array
    trajectories: tuple[Trajectory, ...]
    states: dict[int, Array] | None = None
    wrench: Array | None = None
    displacement: Array | None = None
    energy: Array | None = None

    @property
    def complete(self) -> bool:
        """Whether every frame was reached."""
        return bool(np.isfinite(self.positions).all())

    @property
    def stopped(self) -> bool:
        """Whether it ended early because that was wanted."""
        return not self.complete and self.failure is None

    @property
    def failure(self) -> Trajectory | None:
        """The action that could not be followed, if any."""
        return next((t for t in self.trajectories if t.status is not Status.CONVERGED), None)


def check_geometry(scene: Scene, level: int = 0, comm: Comm | None = None) -> None:
    """Mesh a level and refuse places that are not on it and fiducials that are off the body; collective on `comm`.

    Raises:
        InputError: with every problem.
    """
    mesh = level_mesh(scene, scene.levels[level], comm)
    limit = fiducial_limit(scene, mesh)
    check_length_unit(scene, mesh, limit)
    attach(mesh, points_of(scene.fiducials, scene.members), limit, scene.source)


class Forward:
    """Body, equilibrium and observer of one mesh level, built once per process. Collective on `comm`.

    Args:
        scene: the scene.
        level: which level of its ladder.
        comm: ranks that share the mesh; COMM_SELF (the default) makes it private to the process.
        model: the model; by default the scene's.
        settings: accuracy and patience of the solver.
        mesh: the level's mesh, if it was made already.
        forces: what force and torque of the gripper are divided by, where they are predicted beside the fiducials.
    """

    def __init__(
        self,
        scene: Scene,
        level: int = 0,
        comm: Comm | None = None,
        model: Model | None = None,
        settings: Settings | None = None,
        mesh: BodyMesh | None = None,
        forces: ForceScale | None = None,
    ) -> None:
        from mpi4py import MPI

        comm = MPI.COMM_SELF if comm is None else comm
        self.scene, self.level, self.comm = scene, level, comm
        self.model = model or Model.of(scene)
        self.mesh = mesh or level_mesh(scene, scene.levels[level], comm)
        self.body = Body(comm, self.mesh, scene.levels[level].degree, self.model.mixed)
        self.equilibrium = Equilibrium(self.body, self.model, scene, settings)
        limit = fiducial_limit(scene, self.mesh)
        self.observer = Observer(self.body, scene.fiducials, limit, scene.source, scene.members)
        self.gripper_force = GripperForce(self.equilibrium, forces) if forces else None

    @cached_property
    def strain_energy(self) -> StrainEnergy:
        """Of the present state; collective where it is built."""
        return StrainEnergy(self.equilibrium)

    @property
    def describe(self) -> str:
        """The level in words."""
        nodes, cells = len(self.mesh.points), len(self.mesh.cells)
        return f"{nodes} nodes, {cells} tetrahedra, degree {self.body.degree}, {self.body.unknowns} unknowns"

    def predict(
        self,
        anchors: Iterable[str],
        actions: Sequence[Action],
        watch: Watch | None = None,
        keep: bool = False,
        rtol: float | None = None,
        known: Mapping[int, Array] | None = None,
        look: Look | None = None,
    ) -> Prediction:
        """Fiducial positions while the actions are made with these patches anchored.

        Args:
            anchors: names of the anchored patches.
            actions: the motions; each starts from the undeformed state.
            watch: called after each frame with its index and the predicted positions (fiducials, 3); when it returns
                False the rest is not computed. See `bcid.forms.solver.trajectory.follow` for frames that come twice.
            keep: also keep the state of every frame, for `detail`.
            rtol: accuracy, by default that of the settings.
            known: states that are nearly right by frame, as a rougher prediction has kept them: where to start from.
            look: called in each frame, with its index and the pose, while the equilibrium is in its state.
        """
        frames = 1 + max(int(action.frames.max()) for action in actions)
        positions = np.full((frames, self.rows, 3), np.nan)
        states: dict[int, Array] = {}
        equilibrium = self.equilibrium
        equilibrium.rtol = equilibrium.settings.rtol if rtol is None else rtol
        trajectories: list[Trajectory] = []
        stages = ((a, *stage) for a in map(self.model.driven, actions) for stage in self.model.stages(anchors, a))
        for whole, held, first, end in stages:
            action = whole if end == len(whole) else whole.until(end)
            equilibrium.hold(held, action.grasp)

            def seen(step: int, pose: Pose, action: Action = action, first: int = first) -> bool | None:
                if step < first:
                    return None
                frame = int(action.frames[step])
                positions[frame] = self._shown(pose, self.frame(action, step))
                if keep:
                    states[frame] = equilibrium.u.x.array.copy()
                if look is not None:
                    look(frame, pose)
                return None if watch is None else watch(frame, positions[frame])

            numbered = [(k, int(f)) for k, f in enumerate(action.frames) if k >= first]
            steps = {k: known[f] for k, f in numbered if f in known} if known else None
            trajectories.append(follow(equilibrium, action, seen, steps))
            missed = action.frames[max(first, trajectories[-1].steps) :]
            positions[missed] = np.nan
            for frame in missed:
                states.pop(int(frame), None)
            # An action that cannot be followed says nothing of the others.
            if len(missed) and trajectories[-1].status is Status.CONVERGED:
                break
        return Prediction(positions, tuple(trajectories), states if keep else None)

    def nearly(self, other: Forward, states: Mapping[int, Array]) -> dict[int, Array]:
        """States on another mesh of the same body as states on this one: where a prediction may start from (`known`).

        None with a pressure as unknown, or where a node of this mesh is far outside of the other. Local to the process:
        neither mesh may be shared over ranks.
        """
        if self.model.mixed or other.model.mixed:
            return {}
        target, source = self.body.displacement_space, other.body.displacement_space
        cells = np.arange(len(self.mesh.cells), dtype=np.int32)
        corners = other.mesh.points[other.mesh.cells]
        reach = float(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max())
        there, here = fem.Function(source), fem.Function(target)

        def carried(values: Array | float, data: Any) -> Array:
            there.x.array[:] = values
            here.interpolate_nonmatching(there, cells, data)
            return np.array(here.x.array)

        # The further away a node may be, the more cells each is looked for in: 0.02 to 0.23 s for 2900 cells.
        for part in _OUTSIDE:
            found = fem.create_interpolation_data(target, source, cells, padding=part * reach)
            if np.allclose(carried(1.0, found), 1.0):
                return {frame: carried(state, found) for frame, state in states.items()}
        return {}

    def detail(self, anchors: Iterable[str], actions: Sequence[Action], prediction: Prediction) -> Prediction:
        """The prediction with `wrench`, `displacement` and `energy`, from the states that it kept."""
        states = prediction.states
        if states is None:
            raise ValueError("detail: the states are needed; predict with keep=True")
        wrench = np.full((len(prediction.positions), 6), np.nan)
        displacement = np.full((len(prediction.positions), len(self.mesh.points), 3), np.nan)
        energy = displacement[..., 0].copy()
        stages = ((a, *stage) for a in map(self.model.driven, actions) for stage in self.model.stages(anchors, a))
        for action, held, first, end in stages:
            self.equilibrium.hold(held, action.grasp)
            for step, (pose, frame) in enumerate(zip(poses(action)[:end], action.frames[:end], strict=True)):
                if int(frame) not in states:
                    continue
                self.equilibrium.set_state(pose, states[int(frame)])
                if step >= first:
                    wrench[frame] = self.equilibrium.wrench(pose)
                    displacement[frame] = self.body.at_mesh_nodes(self.equilibrium.displacement())
                    energy[frame] = self.strain_energy.at_mesh_nodes()
                self.equilibrium.accept(pose)
        return replace(prediction, wrench=wrench, displacement=displacement, energy=energy)

    @property
    def rows(self) -> int:
        """How many rows a predicted frame has: fiducials, and force and torque where they are predicted."""
        return len(self.observer.rest) + (ROWS if self.gripper_force else 0)

    def _shown(self, pose: Pose, frame: Frame) -> Array:
        """What is measured of the present state, shape (rows, 3), m; collective."""
        seen = self.model.observed(self.fiducials(), frame)
        return seen if self.gripper_force is None else np.vstack([seen, self.gripper_force.rows(pose)])

    def fiducials(self) -> Array:
        """Positions of the fiducials (fiducials, 3), m, in the present state; collective."""
        return self.observer.positions(self.equilibrium.displacement())

    def frame(self, action: Action, step: int) -> Frame:
        """What an observation effect may know of a step of an action."""
        names, time = tuple(self.scene.fiducial_names), float(action.clock[step])
        return Frame(int(action.numbered[step]), action.name, int(action.steps[step]), time, names, self.observer.rest)

    def set_model(self, model: Model) -> None:
        """Another model of the same parts, with other values; nothing is compiled."""
        if model.name != self.model.name:
            raise ValueError(f"set_model: {model.name} has other parts than {self.model.name}")
        self.model = self.equilibrium.model = model
        self.equilibrium.set_constants(model.numbers())

    def destroy(self) -> None:
        """Free the PETSc objects; collective."""
        self.equilibrium.destroy()


class StrainEnergy:
    """Averages of the law's energy, as effects change it, around each node: the lumped projection on linear elements.

    Args:
        equilibrium: whose state it is of.
    """

    def __init__(self, equilibrium: Equilibrium) -> None:
        self.body, weak_form = equilibrium.body, equilibrium.weak_form
        space = fem.functionspace(self.body.domain, ("Lagrange", 1))
        around = ufl.TestFunction(space)
        density, degree = weak_form.density(weak_form.model.terms)
        self._form = compiled.form(density * around * weak_form.measure(degree))
        self._space = space
        self._volume = self._at_nodes(compiled.form(around * weak_form.measure(1)))

    def at_mesh_nodes(self) -> Array:
        """J/m^3 at the nodes of the mesh, shape (nodes,), the same on every rank; collective on those that share the mesh."""
        return self._at_nodes(self._form) / self._volume

    def _at_nodes(self, form: fem.Form) -> Array:
        """An assembled vector by node of the mesh."""
        vector = fem.assemble_vector(form)
        vector.scatter_reverse(la.InsertMode.add)
        return self.body.at_mesh_nodes(vector.array, self._space)
