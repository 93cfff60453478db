"""A simulated body as two cameras would film it: images, calibration and motions as a recording, beside the truth."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bcid.base.errors import SolveError
from bcid.base.run_folder import write_whole
from bcid.forms.forward import Forward
from bcid.forms.mesh import BodyMesh
from bcid.forms.mesh.closest import closest_on_triangles
from bcid.forms.mesh.patches import divided
from bcid.measurement import Action
from bcid.measurement.folder_writer import grasp_lines
from bcid.scene import Scene
from bcid.vision.camera import SIDES, Cameras
from validation.rendering.appearance import Appearance
from validation.rendering.instruments import instruments
from validation.rendering.renderer import Renderer
from validation.rendering.rig import Pose, stereo_rig
from validation.rendering.shot import Gripper
from validation.rendering.vectors import unit

Array = NDArray[np.float64]

# How far the gripper's box reaches beyond what it holds, and away from the body, m.
_AROUND, _HANDLE = 0.004, 0.025
# Cosine of the angle between facets of one side of the body.
_SAME_SIDE = 0.8


@dataclass(frozen=True)
class RenderedRecording:
    """A recording and its truth.

    Attributes:
        recording: the recording file, for `bcid track`.
        beads: centres of the beads in the body's frame, shape (frames, beads, 3), m.
        visible: whether each camera can see each bead, shape (frames, 2, beads).
    """

    recording: Path
    beads: Array
    visible: NDArray[np.bool_]


@dataclass(frozen=True)
class SurfaceMotion:
    """How the surface of a body moves.

    Attributes:
        points: nodes of the mesh, shape (frames, nodes, 3), m.
        triangles: of the surface, outward, shape (triangles, 3).
        fiducials, normals: places on the surface and its outward normals there, shapes (frames, fiducials, 3).
        grasps: lower and upper corner of what each grasp holds, at rest, and its centre, m.
    """

    points: Array
    triangles: NDArray[np.int64]
    fiducials: Array
    normals: Array
    grasps: dict[str, tuple[Array, Array, Array]]


def moved(scene: Scene, anchors: Iterable[str], actions: Sequence[Action], level: int | None = None) -> SurfaceMotion:
    """Solve the forward model on a level (the finest by default) and keep the surface.

    Raises:
        SolveError: the model found no acceptable equilibrium.
    """
    scene = divided(scene, None)
    forward = Forward(scene, len(scene.levels) - 1 if level is None else level)
    try:
        prediction = forward.predict(anchors, actions, keep=True)
        if prediction.failure:
            raise SolveError(f"{prediction.failure.reason}; try smaller steps, or another level")
        displacement = forward.detail(anchors, actions, prediction).displacement
    finally:
        forward.destroy()
    assert displacement is not None
    mesh = forward.mesh
    points = mesh.points + displacement
    grasps = {}
    for name, grasp in scene.grasps.items():
        held = mesh.points[np.unique(mesh.select(grasp.region, f"grasp {name}"))]
        grasps[name] = held.min(axis=0), held.max(axis=0), np.array(grasp.centre)
    return SurfaceMotion(points, mesh.boundary, prediction.positions, _normals(mesh, points, scene.rest), grasps)


def _normals(mesh: BodyMesh, points: Array, places: Array) -> Array:
    """Outward normals (frames, places, 3) of the surface where places lie at rest, smooth over its facets."""
    triangles = mesh.boundary
    corners = mesh.points[triangles]
    flat = unit(_facets(corners))
    facets = _facets(points[:, triangles])
    result = np.empty((len(points), len(places), 3))
    for number, place in enumerate(places):
        nearest = closest_on_triangles(corners, place)
        best = int(np.linalg.norm(nearest - place, axis=1).argmin())
        weights = np.linalg.lstsq(np.vstack([corners[best].T, np.ones(3)]), np.append(nearest[best], 1.0), rcond=None)[
            0
        ]
        # Facets beyond an edge of the body say nothing of this side of it.
        same = flat @ flat[best] > _SAME_SIDE
        at = [np.sum(facets[:, same & (triangles == node).any(axis=1)], axis=1) for node in triangles[best]]
        result[:, number] = np.einsum("cfx,c->fx", unit(np.array(at)), weights)
    return unit(result)


def _facets(corners: Array) -> Array:
    """Normals (..., 3) of triangles (..., 3, 3), as long as twice their area."""
    return np.asarray(np.cross(corners[..., 1, :] - corners[..., 0, :], corners[..., 2, :] - corners[..., 0, :]))


def render_recording(
    scene: Scene,
    motion: SurfaceMotion,
    actions: Sequence[Action],
    folder: Path,
    appearance: Appearance | None = None,
    rig: tuple[Cameras, Pose] | None = None,
    random_state: int = 0,
    hidden: float = 0.0,
) -> RenderedRecording:
    """Render the images of a motion and write a recording: left/, right/, cameras.json, grasps.csv, recording.toml.

    Args:
        scene: whose fiducials carry the beads.
        motion: of its body, see `moved`.
        actions: that made it.
        folder: to be made.
        appearance: of beads, body and light.
        rig: cameras, and the pose of the body's frame in the left one; by default those of the benchmark.
        random_state: of noise, texture, decoys and instruments.
        hidden: share of the beads that instruments hide from one of the cameras.
    """
    appearance = appearance or Appearance()
    cameras, pose = rig or stereo_rig()
    beads = np.array([appearance.centres(p, n) for p, n in zip(motion.fiducials, motion.normals, strict=True)])
    rods = instruments(hidden, beads, cameras, pose, random_state, appearance.diameter)
    for side in SIDES:
        (folder / side).mkdir(parents=True)
    visible = np.zeros((len(beads), 2, beads.shape[1]), dtype=bool)
    hints: Array | None = None
    with Renderer(cameras, pose, appearance, random_state) as renderer:
        for action in actions:
            for step, frame in enumerate(action.frames):
                gripper = _gripper(motion, action, step)
                made = renderer.frame(
                    motion.points[frame], motion.triangles, beads[frame], motion.normals[frame], gripper, rods[frame]
                )
                visible[frame] = made.visible
                hints = made.pixels[0] if hints is None else hints
                _save(folder, int(frame), made.left, made.right)
    cameras.write(folder / "cameras.json")
    write_whole(folder / "grasps.csv", "\n".join(grasp_lines(actions, 1e-3, 1.0)) + "\n")
    assert hints is not None
    recording = folder / "recording.toml"
    seen = np.flatnonzero(visible[0].all(axis=0))
    write_whole(recording, _recording(appearance, {scene.fiducial_names[i]: hints[i] for i in seen}))
    return RenderedRecording(recording, beads, visible)


def _gripper(motion: SurfaceMotion, action: Action, step: int) -> Gripper | None:
    """A box around what the grasp holds, with a handle away from the body."""
    if not action.grasp:
        return None
    lower, upper, centre = motion.grasps[action.grasp]
    away = centre - motion.points[0].mean(axis=0)
    axis = int(np.argmax(np.abs(away)))
    lower, upper = lower - _AROUND, upper + _AROUND
    if away[axis] > 0:
        upper[axis] += _HANDLE
    else:
        lower[axis] -= _HANDLE
    return Gripper(action.translation[step], action.rotation[step], lower, upper, centre)


def _save(folder: Path, number: int, left: NDArray[np.uint8], right: NDArray[np.uint8]) -> None:
    import cv2

    for side, image in zip(SIDES, (left, right), strict=True):
        cv2.imwrite(str(folder / side / f"{number:04d}.png"), image)


def _recording(appearance: Appearance, hints: dict[str, Array]) -> str:
    seen = [f'"{name}" = [{u:.0f}, {v:.0f}]' for name, (u, v) in hints.items()]
    lines = [
        'format = "bcid-recording/1"',
        'cameras = "cameras.json"',
        'left = "left"',
        'right = "right"',
        'grasps = "grasps.csv"',
    ]
    lines += ["", "[beads]", f'diameter = "{appearance.diameter * 1e3:g} mm"', "", "[seen]", *seen]
    return "\n".join(lines) + "\n"
