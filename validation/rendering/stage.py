"""What VTK draws: body, gripper and instruments, as pinhole pictures on a background that is left empty."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bcid.base.errors import InputError
from bcid.base.off_screen import off_screen
from bcid.scene.rotation import rotate
from bcid.vision.images import Image
from validation.rendering.appearance import Appearance
from validation.rendering.shapes import Triangles, box_mesh, normals_of, rod_mesh, shaded_body
from validation.rendering.shot import Rod, Shot
from validation.rendering.vectors import frame_along
from validation.rendering.view import View

Array = NDArray[np.float64]

# Grey and gloss of the gripper and of instruments.
_METAL, _GLOSS = 0.5, 0.55
# Texture of the tissue: pixels of one period, and per correlation length, which is so long, m.
_TILE, _FINE, _LENGTH = 512, 8, 3e-3


class Surface:
    """Triangles that VTK draws in the greys given; made once, then moved.

    Args:
        plotter: where it is drawn.
        triangles: shape (m, 3).
        count: of points.
        grey, gloss: of the surface.
    """

    def __init__(self, plotter: Any, triangles: Triangles, count: int, grey: float, gloss: float) -> None:
        import pyvista as pv

        self.grey, self.gloss = grey, gloss
        self.points: Array = np.zeros((count, 3))
        self.normals: Array = np.zeros((count, 3))
        self.mesh = pv.PolyData(np.zeros((count, 3)), np.column_stack([np.full(len(triangles), 3), triangles]).ravel())
        self.mesh.point_data["grey"] = np.zeros((count, 3), dtype=np.uint8)
        still = {"reset_camera": False, "render": False}
        self.actor = plotter.add_mesh(self.mesh, scalars="grey", rgb=True, lighting=False, **still)

    def place(self, points: Array, normals: Array) -> None:
        """Move to points (n, 3) with unit normals (n, 3), body frame."""
        self.points, self.normals = points, normals
        self.mesh.points[:] = points
        self.mesh.Modified()

    def light(self, view: View) -> None:
        """Give the points the greys that a camera sees."""
        levels = view.shade(view.of(self.points), self.normals @ view.pose[0].T, self.grey, self.gloss)
        self.mesh.point_data["grey"][:] = np.rint(levels).astype(np.uint8)[:, None]
        self.mesh.Modified()


class Stage:
    """Body, gripper and instruments as VTK draws them, on a background that is left empty.

    Args:
        window: width and height of the pictures, px.
        shot: the first frame.
        appearance: what the pictures appearance like.
        random: makes the texture.
    """

    def __init__(
        self, window: tuple[int, int], shot: Shot, appearance: Appearance, random: np.random.Generator
    ) -> None:
        self._size = window
        self._plotter = off_screen(window, "none")
        self._plotter.set_background("black")
        self._plotter.camera_set = True
        self._plotter.render_window.SetMultiSamples(0)
        self._plotter.render_window.SetAlphaBitPlanes(1)
        self._count, self._triangles, self._beads = len(shot.points), shot.triangles, len(shot.beads)
        self._split, self._faces = shaded_body(shot)
        # A texture can only darken: the tissue is as much brighter before.
        bright = 1 + 3 * appearance.texture
        self._body = Surface(self._plotter, self._faces, len(self._split), appearance.body * bright, 0.0)
        if appearance.texture > 0:
            self._body.mesh.active_texture_coordinates = _texture_places(shot.points[self._split])
            self._body.actor.texture = _texture(appearance, random)
        self._grid, self._grid_normals, box = box_mesh(12)
        self._box = Surface(self._plotter, box, len(self._grid), _METAL, _GLOSS)
        self._rods: list[Surface] = []

    def close(self) -> None:
        self._plotter.close()

    def place(self, shot: Shot) -> None:
        """Move everything to where it is in a frame."""
        if len(shot.points) != self._count or not np.array_equal(shot.triangles, self._triangles):
            raise InputError("triangles: the body's mesh is another one than in the first frame; make another Renderer")
        if len(shot.beads) != self._beads:
            raise InputError(f"beads: {len(shot.beads)}, but {self._beads} in the first frame; make another Renderer")
        points = shot.points[self._split]
        self._body.place(points, normals_of(points, self._faces))
        self._box.actor.visibility = shot.gripper is not None
        if shot.gripper is not None:
            gripper = shot.gripper
            grid = gripper.lower + self._grid * (gripper.upper - gripper.lower)
            self._box.place(gripper.place(grid), rotate(gripper.rotation, self._grid_normals))
        self._place_rods(shot.rods)

    def _place_rods(self, rods: list[Rod]) -> None:
        along, normals, faces = rod_mesh()
        while len(self._rods) < len(rods):
            self._rods.append(Surface(self._plotter, faces, len(along), 0.8 * _METAL, _GLOSS))
        for i, surface in enumerate(self._rods):
            surface.actor.visibility = i < len(rods)
            if i < len(rods):
                turned = normals @ frame_along(rods[i].end - rods[i].start)
                axis = rods[i].start + along[:, None] * (rods[i].end - rods[i].start)
                surface.place(axis + rods[i].radius * turned, turned)

    def draw(self, view: View) -> Image:
        """Grey and cover, 0 to 255, of the pinhole picture of a camera, shape (height, width, 2); no cover is background."""
        import cv2
        from vtkmodules.util.numpy_support import vtk_to_numpy
        from vtkmodules.vtkCommonCore import vtkUnsignedCharArray

        for surface in (self._body, self._box, *self._rods):
            if surface.actor.visibility:
                surface.light(view)
        self._aim(view)
        window = self._plotter.render_window
        window.Render()
        values = vtkUnsignedCharArray()
        width, height = self._size
        window.GetRGBACharPixelData(0, 0, width - 1, height - 1, 0, values)
        drawn = vtk_to_numpy(values).reshape(height, width, 4)
        # VTK's first row is the lowest one.
        return np.asarray(cv2.flip(cv2.merge([cv2.extractChannel(drawn, 0), cv2.extractChannel(drawn, 3)]), 0))

    def _aim(self, view: View) -> None:
        rotation, translation = view.pose
        camera, eye = self._plotter.camera, -rotation.T @ translation
        camera.position, camera.focal_point, camera.up = eye, eye + rotation[2], -rotation[1]
        # VTK's angle is that of a window around the axis, which is then moved by the centre, in half windows.
        camera.view_angle = math.degrees(2 * math.atan(view.lens.half[1]))
        camera.SetWindowCenter(view.lens.middle[0] / view.lens.half[0], -view.lens.middle[1] / view.lens.half[1])
        self._plotter.renderer.ResetCameraClippingRange()


def _texture_places(points: Array) -> Array:
    """Texture coordinates (n, 2) of points (n, 3) at rest: seen along a direction that no face is likely to contain."""
    turn = frame_along(np.array([0.53, 0.67, 0.52]))
    return np.asarray((points @ turn.T)[:, :2] * _FINE / (_LENGTH * _TILE))


def _texture(appearance: Appearance, random: np.random.Generator) -> Any:
    """A mottling that repeats without seams."""
    import pyvista as pv

    frequency = np.fft.fftfreq(_TILE)
    decay = np.exp(-2 * (math.pi * _FINE / 2) ** 2 * (frequency[:, None] ** 2 + frequency**2))
    field = np.fft.ifft2(np.fft.fft2(random.standard_normal((_TILE, _TILE))) * decay).real
    factor = (1 + appearance.texture * field / field.std()) / (1 + 3 * appearance.texture)
    image = np.rint(255 * np.clip(factor, 0, 1)).astype(np.uint8)
    texture = pv.Texture(np.repeat(image[..., None], 3, axis=-1))
    texture.repeat, texture.interpolate = True, True
    return texture
