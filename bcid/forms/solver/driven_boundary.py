"""Places of the boundary whose displacement is that of measured points, smoothly interpolated."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from dolfinx import fem
from numpy.typing import NDArray

from bcid.base.errors import InputError
from bcid.forms.mesh import BodyMesh
from bcid.forms.mesh.body import Body
from bcid.scene import Region, Scene
from bcid.scene.parts import Driven

Array = NDArray[np.float64]
# Modes of the error of a place by noise, and as many of what lies between the points, at most.
MOST_MODES = 100
AXES = (0, 1, 2)


class DrivenBoundary:
    """What measured points drive on one body: Dirichlet conditions, and the error of their values.

    Collective on the body's communicator where it is built.

    Args:
        body: the meshed body.
        scene: with points for all that is `driven`, or for none: then nothing can be put anywhere.
        places: every named region of the scene.

    Attributes:
        conditions: the DOLFINx conditions of all places but grasps.
    """

    def __init__(self, body: Body, scene: Scene, places: Mapping[str, Region]) -> None:
        self.body, self.scene = body, scene
        self.conditions: list[Any] = []
        self._weights: dict[str, Array] = {}
        self._fields: list[tuple[str, int | None, Any]] = []
        for name, driven in scene.driven.items():
            if name in scene.grasps:
                continue
            for axis in (None,) if driven.along == AXES else driven.along:
                space = body.displacement_space if axis is None else body.axis_space(axis)
                value = fem.Function(space)
                self.conditions.append(body.dirichlet(places[name], f"driven.{name}", value, axis))
                self._fields.append((name, axis, value))

    def put(self, boundary: Mapping[str, Array]) -> None:
        """Displacements (points, 3), m, of the points of each place."""
        for name, axis, value in self._fields:
            if axis is None:
                value.x.array[:] = self.moved(name, boundary)
            else:
                nodes = value.function_space.tabulate_dof_coordinates()
                value.x.array[:] = (
                    self._weights_at(f"{name}/{axis}", self.scene.driven[name], nodes) @ _of(name, boundary)[:, axis]
                )

    def moved(self, name: str, boundary: Mapping[str, Array]) -> Array:
        """Displacement of every node if it moved as a place does, shape (3 * nodes,), m."""
        displacements = _of(name, boundary)
        return np.asarray((self._weights_at(name, self.scene.driven[name], self.body.nodes) @ displacements).ravel())

    def _weights_at(self, key: str, driven: Driven, nodes: Array) -> Array:
        if key not in self._weights:
            self._weights[key] = driven.kriging.weights(nodes)
        return self._weights[key]

    def error_increments(self, gripped: NDArray[np.int32]) -> Array:
        """What each mode of `place_modes` prescribes: by place, then axis; shape (unknowns, modes), m. On one rank.

        `gripped` are the unknowns that the gripper holds.
        """
        body = self.body
        dofs = body.displacement_dofs.reshape(-1, 3)
        columns = []
        for name, driven in self.scene.driven.items():
            held = gripped if name in self.scene.grasps else self._held(name)
            modes = np.hstack(place_modes(body.mesh, self.scene, name, body.nodes))
            for axis in driven.along:
                column = np.zeros((body.unknowns, modes.shape[1]))
                column[dofs[:, axis]] = modes
                column[np.setdiff1d(dofs[:, axis], held)] = 0.0
                columns.append(column)
        return np.hstack(columns)

    def _held(self, name: str) -> NDArray[np.int32]:
        """Unknowns that are prescribed at a place."""
        pairs = zip(self._fields, self.conditions, strict=True)
        return np.concatenate([condition.dof_indices()[0] for (place, _, _), condition in pairs if place == name])


def place_modes(mesh: BodyMesh, scene: Scene, name: str, at: Array) -> tuple[Array, Array]:
    """Errors of a driven place along an axis, at places (n, 3), m: by noise of one metre, and of what is between points, (n, k)."""
    region = scene.grasps[name].region if name in scene.grasps else scene.places[name]
    nodes = mesh.points[np.unique(mesh.select(region, f"driven.{name}"))]
    return scene.driven[name].kriging.error_modes(at, nodes, MOST_MODES)


def _of(name: str, boundary: Mapping[str, Array]) -> Array:
    if name not in boundary:
        raise InputError(f"driven.{name}: it is driven by measured points, and no measurement of them is given here")
    return boundary[name]
