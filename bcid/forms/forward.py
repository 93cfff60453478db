"""One level of the ladder, ready to predict: from an anchor set and the motions to the fiducial trajectories."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bcid.forms.body import Body
from bcid.forms.mesh import BodyMesh, level_mesh
from bcid.forms.model import Model
from bcid.forms.observe import Observer, attach
from bcid.forms.solve import Equilibrium, Pose, Settings, Status
from bcid.forms.trajectory import Trajectory, follow
from bcid.measurement import Action
from bcid.scene import Scene

Array = NDArray[np.float64]
Watch = Callable[[int, Array], bool | None]


@dataclass(frozen=True)
class Prediction:
    """Fiducial trajectories of one candidate.

    Attributes:
        positions: shape (frames, fiducials, 3), m; NaN in frames that were not reached.
        wrench: force (N) and torque (N m) of the gripper, shape (frames, 6); NaN likewise, zero without a grasp.
        trajectories: how each action went.
        displacement: at the nodes of the mesh, shape (frames, nodes, 3), m, when it was asked for.
        complete: whether every frame was reached.
    """

    positions: Array
    wrench: Array
    trajectories: tuple[Trajectory, ...]
    displacement: Array | None = None

    @property
    def complete(self) -> bool:
        """Whether every frame was reached."""
        return bool(np.isfinite(self.positions).all())

    @property
    def failure(self) -> Trajectory | None:
        """The action that could not be followed, if any."""
        return next((t for t in self.trajectories if t.status is not Status.CONVERGED), None)


def fiducial_limit(scene: Scene, mesh: BodyMesh) -> float:
    """How far from the mesh a fiducial may be, m: the scene's `attach_within`, or 5 % of the body's size."""
    return 0.05 * mesh.size if scene.attach_within is None else scene.attach_within


def check_geometry(scene: Scene, level: int = 0, comm: Any = None) -> None:
    """Mesh a level and refuse places that are not on it and fiducials that are off the body; collective on `comm`.

    Raises:
        InputError: with every problem.
    """
    mesh = level_mesh(scene, scene.levels[level], comm)
    attach(mesh, scene.fiducials, fiducial_limit(scene, mesh), scene.source)


class Forward:
    """Body, equilibrium and observer of one mesh level, built once per process. Collective on `comm`.

    Args:
        scene: the scene.
        level: which level of its ladder.
        comm: ranks that share the mesh; COMM_SELF (the default) makes it private to the process.
        model: the model; by default the scene's.
        settings: accuracy and patience of the solver.
        mesh: the level's mesh, if it was made already.
    """

    def __init__(
        self,
        scene: Scene,
        level: int = 0,
        comm: Any = None,
        model: Model | None = None,
        settings: Settings | None = None,
        mesh: BodyMesh | None = None,
    ) -> None:
        from mpi4py import MPI

        comm = MPI.COMM_SELF if comm is None else comm
        self.scene, self.level, self.comm = scene, level, comm
        self.model = model or Model.of(scene)
        self.mesh = mesh or level_mesh(scene, scene.levels[level], comm)
        self.body = Body(comm, self.mesh, scene.levels[level].degree, self.model.mixed)
        self.equilibrium = Equilibrium(self.body, self.model, scene, settings)
        self.observer = Observer(self.body, scene.fiducials, fiducial_limit(scene, self.mesh), scene.source)

    @property
    def describe(self) -> str:
        """The level in words."""
        nodes, cells = len(self.mesh.points), len(self.mesh.cells)
        return f"{nodes} nodes, {cells} tetrahedra, degree {self.body.degree}, {self.body.unknowns} unknowns"

    def predict(
        self, anchors: Iterable[str], actions: Sequence[Action], watch: Watch | None = None, fields: bool = False
    ) -> Prediction:
        """Fiducial positions while the actions are made with these patches anchored.

        Args:
            anchors: names of the anchored patches.
            actions: the motions; each starts from the undeformed state.
            watch: called after each frame with its index and the predicted positions (fiducials, 3); when it returns
                False the rest is not computed.
            fields: also keep the displacement of every mesh node.
        """
        frames = 1 + max(int(action.frames.max()) for action in actions)
        positions = np.full((frames, len(self.observer.rest), 3), np.nan)
        wrench = np.full((frames, 6), np.nan)
        displacement = np.full((frames, len(self.mesh.points), 3), np.nan) if fields else None
        equilibrium = self.equilibrium
        trajectories = []
        for action in actions:
            equilibrium.hold(anchors, action.grasp)

            def seen(step: int, pose: Pose, action: Action = action) -> bool | None:
                frame = int(action.frames[step])
                positions[frame] = self.observer.positions(equilibrium.displacement())
                wrench[frame] = equilibrium.wrench(pose)
                if displacement is not None:
                    displacement[frame] = self.body.at_mesh_nodes(equilibrium.displacement())
                return None if watch is None else watch(frame, positions[frame])

            trajectories.append(follow(equilibrium, action, seen))
            if trajectories[-1].steps < len(action):
                break
        return Prediction(positions, wrench, tuple(trajectories), displacement)

    def destroy(self) -> None:
        """Free the PETSc objects; collective."""
        self.equilibrium.destroy()
