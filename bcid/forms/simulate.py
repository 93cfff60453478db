"""Making a measurement from a scene: what the fiducials would show, with noise added."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from bcid.base.collective import Comm
from bcid.base.errors import SolveError
from bcid.forms.forward import Forward
from bcid.forms.gripper_force import torque_per_force
from bcid.forms.mesh import BodyMesh
from bcid.forms.mesh.body_mesh import among
from bcid.forms.mesh.patches import divided
from bcid.forms.model import Model
from bcid.forms.solver.equilibrium import Settings
from bcid.measurement import WRENCH, Action, Measurement
from bcid.measurement.contents import Cloud, frames_of, motions_dataset
from bcid.scene import Scene

Array = NDArray[np.float64]
Numbers = NDArray[np.int64]


def simulate(
    scene: Scene,
    anchors: Iterable[str],
    actions: Sequence[Action],
    level: int | None = None,
    noise: float | None = None,
    random_state: int = 0,
    comm: Comm | None = None,
    model: Model | None = None,
    wrench: bool = False,
    times: Array | None = None,
    wrench_noise: float = 0.0,
    surface: int = 0,
) -> Measurement:
    """What the fiducials of a scene would show; the mesh is shared by the ranks of `comm`, and the result is the same on all.

    Args:
        scene: the scene; divided patches are replaced by their pieces.
        anchors: names of the anchored patches.
        actions: the motions, numbered along one frame axis (see `bcid.scene.motions.actions`).
        level: mesh level; the finest by default.
        noise: standard deviation of the white noise added to every coordinate, m; by default the scene's, 0 for none.
        random_state: of the noise; the same number gives the same noise for any number of ranks.
        comm: MPI communicator; COMM_SELF by default.
        model: the model; by default the scene's.
        times: of the frames, s; by default one second per step.
        wrench: also record force and torque of the gripper.
        wrench_noise: standard deviation of the white noise added to a force, N; that of a torque is in proportion to the largest.
        surface: how many points of the surface are seen in each frame, anywhere but where the body is held or lies.

    Raises:
        InputError: measured points drive a place of the scene.
        SolveError: the forward model found no acceptable equilibrium; nothing is made up for the rest.
    """
    scene.check_undriven("simulated")
    scene = divided(scene, comm)
    level = len(scene.levels) - 1 if level is None else level
    forward = Forward(scene, level, comm, model, Settings(rtol=1e-8))
    try:
        detailed = wrench or surface > 0
        prediction = forward.predict(anchors, actions, keep=detailed)
        if detailed and not prediction.failure:
            prediction = forward.detail(anchors, actions, prediction)
    finally:
        forward.destroy()
    if prediction.failure:
        raise SolveError(f"{prediction.failure.reason}; try smaller steps, or another level")
    sigma = (scene.noise_sigma or 0.0) if noise is None else noise
    text = f"simulated: scene {scene.name}, level {level}, anchors {' '.join(sorted(anchors)) or 'none'}"
    made = recorded(scene, actions, prediction.positions, sigma, np.random.default_rng(random_state), times, text)
    if wrench:
        assert prediction.wrench is not None
        # Positions have the same noise with and without forces.
        made = with_wrenches(made, prediction.wrench, wrench_noise, np.random.default_rng([random_state, 1]))
    if surface:
        assert prediction.displacement is not None
        shown = shown_facets(scene, forward.mesh, anchors)
        points = np.random.default_rng([random_state, 2])
        made = replace(
            made, cloud=simulated_cloud(made, forward.mesh, shown, prediction.displacement, surface, sigma, points)
        )
    return made


def with_wrenches(made: Measurement, wrenches: Array, sigma: float, rng: np.random.Generator) -> Measurement:
    """A measurement with force (N) and torque (N m) of the gripper, shape (frames, 6), besides, with white noise.

    `sigma` is that of a force, N; that of a torque is in proportion to the largest.
    """
    data = made.data.assign_coords(component=WRENCH)
    of_torque = sigma * torque_per_force(wrenches)
    if sigma:
        wrenches = wrenches + rng.normal(0.0, 1.0, wrenches.shape) * np.repeat([sigma, of_torque], 3)
    data["wrench"] = (("frame", "component"), wrenches)
    return replace(made, data=data, wrench_sigma=sigma or None, torque_sigma=of_torque or None)


def recorded(
    scene: Scene,
    actions: Sequence[Action],
    positions: Array,
    sigma: float,
    rng: np.random.Generator,
    times: Array | None = None,
    description: str = "",
) -> Measurement:
    """The measurement in which fiducials are seen at `positions` (frames, fiducials, 3), m, with white noise added.

    Args:
        scene, actions, times: as in `simulate`.
        sigma: standard deviation of the noise, m; 0 for none.
        rng: where the noise comes from.
        description: what the measurement says of itself.
    """
    if sigma:
        positions = positions + rng.normal(0.0, sigma, positions.shape)
    seconds = [float(step) for action in actions for step in action.steps] if times is None else list(times)
    data = motions_dataset(actions, seconds, scene.fiducial_names, positions)
    places = sorted({place for action in actions for place in action.loads})
    if places:
        none = {action.name: np.zeros((len(action), 3)) for action in actions}
        loads = [np.vstack([a.loads.get(place, none[a.name]) for a in actions]) for place in places]
        data = data.assign_coords(place=places)
        data["load"] = (("frame", "place", "axis"), np.stack(loads, axis=1))
    return Measurement(data, sigma or None, description=description, source="simulation")


def shown_facets(scene: Scene, mesh: BodyMesh, anchors: Iterable[str]) -> Numbers:
    """Triangles of the boundary that are not held, gripped or lain on, shape (k, 3)."""
    regions = {f"patch {name}": scene.patches[name] for name in anchors}
    regions |= {f"grasp {name}": grasp.region for name, grasp in scene.grasps.items()}
    if scene.support:
        regions[f"place {scene.support}"] = scene.places[scene.support]
    hidden = np.zeros(len(mesh.boundary), dtype=bool)
    for name, region in regions.items():
        hidden |= among(mesh.boundary, mesh.select(region, name))
    return mesh.boundary[~hidden]


def simulated_cloud(
    made: Measurement,
    mesh: BodyMesh,
    triangles: Numbers,
    displacement: Array,
    count: int,
    sigma: float,
    rng: np.random.Generator,
) -> Cloud:
    """`count` points in each frame of a measurement, other ones in each, anywhere on triangles (k, 3) of a mesh.

    Args:
        displacement: of the nodes of the mesh, shape (frames, nodes, 3), m.
        sigma: standard deviation of the white noise of every coordinate, m.
        rng: where points and noise come from.
    """
    a, b, c = (mesh.points[triangles[:, k]] for k in range(3))
    areas = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    frames = len(displacement)
    chosen = rng.choice(len(triangles), (frames, count), p=areas / areas.sum())
    # Uniform over each triangle.
    root, along = np.sqrt(rng.random((frames, count))), rng.random((frames, count))
    weights = np.stack([1 - root, root * (1 - along), root * along], axis=-1)
    nodes = triangles[chosen]
    points = mesh.points[nodes] + displacement[np.arange(frames)[:, None, None], nodes]
    seen = np.einsum("fnk,fnka->fna", weights, points).reshape(-1, 3) + rng.normal(0.0, sigma, (frames * count, 3))
    return Cloud(seen, np.full(len(seen), np.nan), frames_of(made.data), np.repeat(np.arange(frames), count))
