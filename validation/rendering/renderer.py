"""Pictures of a soft body with beads on it as two cameras see them, with known truth: what detection and tracking are tested on.

The beads are traced ray by ray through the lens, because the middle of their image is what is measured. Everything else (body,
gripper, instruments) is drawn by VTK as a pinhole picture and bent to the camera's image.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bcid.vision.camera import SIDES, Cameras
from bcid.vision.images import Image
from validation.rendering.appearance import Appearance
from validation.rendering.decoys import Decoys, scattered
from validation.rendering.footprint import Grey
from validation.rendering.lens import Lens
from validation.rendering.rig import Pose, both_poses
from validation.rendering.shot import Gripper, Rod, Shot
from validation.rendering.stage import Stage
from validation.rendering.view import View

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Stereo:
    """A pair of pictures and the truth about the k beads.

    Attributes:
        left, right: grey images, (height, width) of each camera.
        visible: whether each camera can see each bead, shape (2, k).
        pixels: where the beads' centres are, whether seen or not, shape (2, k, 2), px; NaN behind a camera.
    """

    left: Image
    right: Image
    visible: NDArray[np.bool_]
    pixels: Array


@dataclass(frozen=True)
class _Setup:
    """What the first frame fixes."""

    stage: Stage
    views: list[View]
    decoys: Decoys


class Renderer:
    """Draws frames of one body; use it in a with statement, which frees what VTK holds.

    The first frame fixes the triangles, the number of beads, the background (a plane below the body, across the mean normal
    of the beads), the texture and the decoys.

    Args:
        cameras: the two cameras; both must state the size of their images.
        pose: rotation (3, 3) and translation (3,), m, of the body's frame in the left camera's.
        appearance: what the pictures appearance like.
        random_state: seed of noise, texture and decoys; equal seeds and frames give equal pictures.

    Raises:
        InputError: a camera without a size, one whose distortion cannot be undone inside its image, a pose that is none.
    """

    def __init__(
        self, cameras: Cameras, pose: Pose, appearance: Appearance | None = None, random_state: int = 0
    ) -> None:
        self.appearance = appearance or Appearance()
        self._random = np.random.default_rng(random_state)
        self._poses = both_poses(cameras, pose)
        self._lenses = [Lens(side, camera) for side, camera in zip(SIDES, (cameras.left, cameras.right), strict=True)]
        (a, b), (c, d) = (lens.window for lens in self._lenses)
        for lens in self._lenses:
            lens.widen((max(a, c), max(b, d)))
        self._setup: _Setup | None = None

    def __enter__(self) -> Renderer:
        return self

    def __exit__(self, *_: object) -> None:
        if self._setup is not None:
            self._setup.stage.close()
            self._setup = None

    def frame(
        self,
        points: Array,
        triangles: NDArray[np.int64],
        beads: Array,
        normals: Array,
        gripper: Gripper | None = None,
        rods: Sequence[Rod] = (),
    ) -> Stereo:
        """One pair of pictures.

        Args:
            points: nodes of the body's surface as it is now, shape (n, 3), body frame, m.
            triangles: nodes of its triangles, shape (m, 3); the same in every frame.
            beads: centres of the beads, shape (k, 3), m; see `Appearance.centres`.
            normals: outward normals of the surface at the beads, shape (k, 3).
            gripper: None if there is none.
            rods: instruments that may hide something.

        Raises:
            InputError: arrays of other shapes or with values that are not finite, triangles of nodes that do not exist,
                another mesh or number of beads than before.
        """
        shot = Shot.of(points, triangles, beads, normals, gripper, rods)
        self._setup = setup = self._setup or self._begin(shot)
        setup.stage.place(shot)
        decoys = setup.decoys.place(shot.gripper)
        pictures, visible, pixels = [], [], []
        for view in setup.views:
            picture, seen, centres = view.picture(setup.stage.draw(view), shot, decoys)
            pictures.append(self._exposed(picture))
            visible.append(seen)
            pixels.append(centres)
        return Stereo(pictures[0], pictures[1], np.array(visible), np.array(pixels))

    def _begin(self, shot: Shot) -> _Setup:
        floor = shot.floor(4 * self.appearance.diameter)
        rotation, translation = self._poses[0]
        lamp, middle = rotation.T @ (np.asarray(self.appearance.lamp) - translation), shot.points.mean(axis=0)
        views = [
            View(lens, pose, lamp, middle, floor, self.appearance)
            for lens, pose in zip(self._lenses, self._poses, strict=True)
        ]
        decoys = scattered(self.appearance, views, shot, floor, self._random)
        return _Setup(Stage(self._lenses[0].window, shot, self.appearance, self._random), views, decoys)

    def _exposed(self, picture: Grey) -> Image:
        """Blurred, noisy, 8 bit."""
        import cv2

        if self.appearance.blur > 0:
            picture = cv2.GaussianBlur(picture, (0, 0), self.appearance.blur, borderType=cv2.BORDER_REPLICATE)
        if self.appearance.noise > 0:
            noise = self._random.standard_normal(picture.shape, dtype=np.float32)
            picture = picture + np.float32(self.appearance.noise) * noise
        return np.asarray(np.clip(np.rint(picture, out=picture), 0, 255, out=picture).astype(np.uint8))
