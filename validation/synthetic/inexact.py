"""What a laboratory has slightly wrong in everything that its scene states, as the truth of a case has it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from bcid.forms.mesh import BodyMesh
from bcid.forms.mesh.closest import closest_on_triangles
from bcid.forms.scene_errors import grip_term
from bcid.measurement import Action
from bcid.scene import Scene
from validation.synthetic.chance import Rng
from validation.synthetic.true_law import TrueLaw

Array = NDArray[np.float64]
# Standard deviations: m, parts, degrees.
MARKERS, THICKNESS, BORDERS, GRIP, GRIP_TURN, CAMERA, POISSON = 0.4e-3, 0.03, 1e-3, 0.5e-3, 0.5, 0.3, 0.03
# Of what is drawn nothing is further off than so many of them.
_MOST = 2.5


@dataclass(frozen=True)
class Inexact:
    """How a body and what is reported of it differ from the scene.

    Attributes:
        markers: shifts of the fiducials along the surface, in the scene's order, m.
        thickness: extent of the body along `down`, relative to the scene's.
        borders: how far the surface is drawn along itself in the middle of the body, across and along, m; borders go with it.
        grips: by action, what the gripper is off: x, y, z (m) and rotation about these axes (deg), from its first step on.
        camera: turn of the measured frame about each axis, deg.
        poisson: added to Poisson's ratio.
        law: of the body, where the scene has another.
    """

    markers: tuple[tuple[float, ...], ...]
    thickness: float
    borders: tuple[float, float]
    grips: tuple[tuple[float, ...], ...]
    camera: tuple[float, float, float]
    poisson: float
    law: TrueLaw

    @classmethod
    def draw(cls, rng: Rng, scene: Scene, mesh: BodyMesh, actions: int) -> Inexact:
        """Any; `mesh` is one of the scene's body, which tells how its surface runs."""

        def normal(size: float, *shape: int) -> Array:
            return size * np.clip(rng.normal(size=shape), -_MOST, _MOST)

        shifts = _along(normal(MARKERS, len(scene.fiducials), 3), _normals_at(mesh, scene.rest))
        grips = np.hstack([normal(GRIP, actions, 3), normal(GRIP_TURN, actions, 3)])
        across, along = (float(v) for v in normal(BORDERS, 2))
        x, y, z = (float(v) for v in normal(CAMERA, 3))
        return cls(
            tuple(tuple(float(v) for v in row) for row in shifts),
            1 + float(normal(THICKNESS, 1)[0]),
            (across, along),
            tuple(tuple(float(v) for v in row) for row in grips),
            (x, y, z),
            float(normal(POISSON, 1)[0]),
            TrueLaw.draw(rng),
        )

    def scene(self, scene: Scene) -> Scene:
        """As the body really is: where the markers sit, its Poisson's ratio, and its law."""
        places = (scene.rest + np.array(self.markers)) @ self._stretch(scene)
        values = dict(scene.material.values)
        values["poisson"] = float(values["poisson"]) + self.poisson
        fiducials = {n: (float(x), float(y), float(z)) for n, (x, y, z) in zip(scene.fiducials, places, strict=True)}
        return self.law.scene(replace(scene, fiducials=fiducials, material=replace(scene.material, values=values)))

    def mesh(self, scene: Scene, mesh: BodyMesh) -> BodyMesh:
        """The body as large as it is, with the borders of patches where they are."""
        low, high = mesh.points.min(axis=0), mesh.points.max(axis=0)
        part = (mesh.points - low) / (high - low)
        moved = np.zeros_like(mesh.points)
        axes = [axis for axis in range(3) if abs(scene.down[axis]) < 0.5]
        for axis, size in zip(axes, self.borders, strict=True):
            # Nothing moves at the ends, so that the body keeps its shape.
            moved[:, axis] = size * np.sin(np.pi * part[:, axis])
        # Where the surface is curved it moves along itself.
        nodes, normals = _node_normals(mesh)
        moved[nodes] = _along(moved[nodes], normals)
        return replace(mesh, points=(mesh.points + moved) @ self._stretch(scene))

    def actions(self, commanded: list[Action]) -> list[Action]:
        """What the gripper really does."""
        drive = grip_term().effect.drive
        assert drive is not None
        names = ("x", "y", "z", "rx", "ry", "rz")
        return [drive(a, dict(zip(names, off, strict=True))) for a, off in zip(commanded, self.grips, strict=True)]

    def seen(self, scene: Scene, positions: Array) -> Array:
        """Positions (frames, fiducials, 3), m, in the frame in which they are reported."""
        middle = scene.rest.mean(axis=0)
        turn = Rotation.from_rotvec(self.camera, degrees=True).as_matrix()
        return np.asarray((positions - middle) @ turn.T + middle)

    def _stretch(self, scene: Scene) -> Array:
        down = np.array(scene.down)
        return np.asarray(np.eye(3) + (self.thickness - 1) * np.outer(down, down))


def _along(vectors: Array, normals: Array) -> Array:
    """Vectors (n, 3) without their parts along unit normals (n, 3)."""
    return np.asarray(vectors - np.einsum("ij,ij->i", vectors, normals)[:, None] * normals)


def _node_normals(mesh: BodyMesh) -> tuple[NDArray[np.int64], Array]:
    """Nodes of the surface (n,), and unit normals there (n, 3): means of those of the faces around, weighted by area."""
    a, b, c = (mesh.points[mesh.boundary[:, i]] for i in range(3))
    total = np.zeros_like(mesh.points)
    for corner in range(3):
        np.add.at(total, mesh.boundary[:, corner], np.cross(b - a, c - a))
    nodes = np.unique(mesh.boundary)
    return nodes, total[nodes] / np.linalg.norm(total[nodes], axis=1)[:, None]


def _normals_at(mesh: BodyMesh, places: Array) -> Array:
    """Unit normals (n, 3) of the faces that are nearest to places (n, 3), m."""
    corners = mesh.points[mesh.boundary]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    near = [np.linalg.norm(closest_on_triangles(corners, place) - place, axis=1).argmin() for place in places]
    return np.asarray(normals[near] / np.linalg.norm(normals[near], axis=1)[:, None])
