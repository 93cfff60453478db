"""What is prescribed on a body: anchored patches, rollers, the gripper's place, and dead loads."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import basix
import basix.ufl
import numpy as np
from numpy.typing import NDArray

from bcid.base.errors import InputError, nearest
from bcid.forms.mesh.body import Body
from bcid.forms.solver.driven_boundary import DrivenBoundary
from bcid.scene import Region, Scene
from bcid.scene.rotation import rotate

Array = NDArray[np.float64]

Index = NDArray[np.int32]


@dataclass(frozen=True)
class Pose:
    """Where the gripper is, and the dead loads: what a step prescribes.

    Attributes:
        translation: from the rest pose, m.
        rotation: unit quaternion (w, x, y, z) about the rest centre of the grasp.
        loads: force on each loaded place, N.
        boundary: displacements of the points that drive a place, (points, 3), m, by place.
        load_factor: fraction of the effects that acts, 0 to 1 (below 1 only while they are being applied).
        time: s.
    """

    translation: Array = field(default_factory=lambda: np.zeros(3))
    rotation: Array = field(default_factory=lambda: np.array([1.0, 0.0, 0.0, 0.0]))
    loads: Mapping[str, Array] = field(default_factory=dict)
    load_factor: float = 1.0
    time: float = 0.0
    boundary: Mapping[str, Array] = field(default_factory=dict)

    def vector(self, lever: float) -> Array:
        """All numbers in one row, the rotation as what it moves at the end of a lever (m)."""
        loads = [self.loads[place] for place in sorted(self.loads)]
        moved = [self.boundary[place].ravel() for place in sorted(self.boundary)]
        return np.concatenate([self.translation, 2 * lever * self.rotation, *loads, *moved])


class Supports:
    """Dirichlet conditions and dead loads of one body; what is made for a place once is kept.

    Args:
        body: the meshed body.
        scene: where patches and grasps are.
        places: every named region of the scene.
        rollers: places held in one axis only, as (place, axis).
        owned: number of unknowns that this rank owns.
        gripper: displacement of every node if it moved with the gripper, a DOLFINx Function.

    Attributes:
        conditions: the DOLFINx conditions in force.
        boundary: what measured points drive.
        prescribed: numbers of the unknowns that are prescribed, on this rank, ghosts included.
        reacting: those that this rank owns.
        grasp: where the gripper holds, or "".
        gripped: numbers of the unknowns that the gripper holds.
        sprung: whether they are held by springs, and not prescribed.
        led: numbers of the unknowns that the gripper or measured points lead.
        external: dead forces on this rank's nodes, ghosts included, shape (3 * nodes,), N.
        loaded: whether there are any.
    """

    def __init__(
        self,
        body: Body,
        scene: Scene,
        places: Mapping[str, Region],
        rollers: Iterable[tuple[str, int]],
        owned: int,
        gripper: Any,
    ) -> None:
        self.body, self.scene, self.places, self.rollers, self._owned = body, scene, places, tuple(rollers), owned
        self.gripper = gripper
        self._made: dict[str, Any] = {}
        self._weights: dict[str, Array] = {}
        self.external = np.zeros(3 * len(body.nodes))
        self.loaded = False
        self.boundary = DrivenBoundary(body, scene, self.places)
        self._mine = body.displacement_dofs < owned

    # -- what is held
    # ---------------------------------------------------------------------------------------------------------------

    def hold(self, anchors: Iterable[str], grasp: str, sprung: bool = False) -> None:
        """Hold these patches, the rollers, and the gripper's place ("": none); collective.

        Where that is `sprung` it is not prescribed.
        """
        scene, anchors = self.scene, sorted(set(anchors))
        conditions = [
            self._condition(f"patch {name}", scene.patches.get(name), axis)
            for name in anchors
            for axis in _each(scene.held_along(name))
        ]
        self.grasp, self.sprung = grasp, sprung and bool(grasp)
        self.gripped: Index = np.zeros(0, np.int32)
        if grasp:
            region = scene.grasps[grasp].region if grasp in scene.grasps else None
            gripping = self._condition(f"grasp {grasp}", region, None)
            self.gripped = gripping.dof_indices()[0]
            conditions += [] if self.sprung else [gripping]
        leading = [*([] if self.sprung else [self.gripped]), *(c.dof_indices()[0] for c in self.boundary.conditions)]
        self.led: Index = np.unique(np.concatenate(leading or [np.zeros(0, np.int32)]))
        conditions += [self._condition(f"place {place}", self.places.get(place), axis) for place, axis in self.rollers]
        self.conditions = conditions = [*conditions, *self.boundary.conditions]
        dofs = [condition.dof_indices()[0] for condition in conditions]
        self.prescribed: Index = np.unique(np.concatenate(dofs or [np.zeros(0, np.int32)]))
        self.reacting = self.prescribed[self.prescribed < self._owned]

    def _condition(self, what: str, region: Region | None, axis: int | None) -> Any:
        key = f"{what}/{axis}"
        if key not in self._made:
            if region is None:
                kind, name = what.split(" ", 1)
                known = {"patch": list(self.scene.patches), "grasp": list(self.scene.grasps)}.get(
                    kind, list(self.places)
                )
                raise InputError(f"{kind} '{name}' is not in scene {self.scene.source}; {nearest(name, known)}")
            value = self.gripper if what.startswith("grasp ") else None
            self._made[key] = self.body.dirichlet(region, what, value, axis)
        return self._made[key]

    def nodes(self, patch: str) -> NDArray[np.int64]:
        """Numbers of this rank's nodes that an anchored patch holds; collective when it is first asked about."""
        held = self._condition(f"patch {patch}", self.scene.patches.get(patch), None).dof_indices()[0]
        return np.unique(np.flatnonzero(np.isin(self.body.displacement_dofs, held)) // 3)

    # -- where it is held, and how loaded
    # ---------------------------------------------------------------------------------------------------------------

    def put(self, pose: Pose) -> None:
        """Gripper and dead loads of a pose."""
        if self.grasp:
            self.gripper.x.array[:] = self.moved(pose)
        self.boundary.put(pose.boundary)
        self.loaded = bool(pose.loads)
        self.external[:] = self.load(pose.loads)

    @property
    def driven(self) -> tuple[Index, Array]:
        """This rank's own unknowns of displacement, and how far the gripper has moved them if it held everything, m."""
        return self.body.displacement_dofs[self._mine], np.asarray(self.gripper.x.array[self._mine])

    def unload(self) -> None:
        """No dead loads."""
        self.loaded = False
        self.external[:] = 0.0

    def moved(self, pose: Pose) -> Array:
        """Displacement of every node if it moved with the gripper, shape (3 * nodes,), m."""
        if self.grasp in self.scene.driven:
            return self.boundary.moved(self.grasp, pose.boundary)
        arm = self.body.nodes - self.centre
        moved = pose.translation + rotate(pose.rotation, arm) - arm
        if self.scene.thickness:
            # A sheet stays in its plane.
            moved[:, 2] = 0.0
        return np.asarray(moved.ravel())

    def arms(self, pose: Pose) -> Array:
        """From the moved centre of the grasp to where the gripper has every node, shape (nodes, 3), m."""
        return self.body.nodes + self.moved(pose).reshape(-1, 3) - self.centre - pose.translation

    @property
    def lever(self) -> float:
        """How far what the gripper holds is from where it turns about, m (RMS of the nodes, at rest); 0 without a gripper."""
        if not self.grasp:
            return 0.0
        mesh = self.body.mesh
        held = np.unique(mesh.select(self.scene.grasps[self.grasp].region, f"grasp {self.grasp}"))
        return float(np.sqrt(np.mean(np.sum((mesh.points[held] - self.centre) ** 2, axis=1))))

    @property
    def centre(self) -> Array:
        """Where the gripper holds at rest, m."""
        return np.array(self.scene.grasps[self.grasp].centre)

    def load(self, loads: Mapping[str, Array]) -> Array:
        """Dead forces on this rank's nodes for a force (N) on each place, shape (3 * nodes,), N."""
        forces = np.zeros_like(self.external)
        for place, force in loads.items():
            forces += self._weight(place) * np.tile(force, len(forces) // 3)
        return forces

    def _weight(self, place: str) -> Array:
        """Share of a dead force on `place` that each displacement component carries, shape (3 * nodes,)."""
        if place not in self._weights:
            if place not in self.places:
                raise InputError(f"loads: place '{place}' is not in the scene; {nearest(place, self.places)}")
            self._weights[place] = np.repeat(nodal_weights(self.body, self.places[place], f"place {place}"), 3)
        return self._weights[place]

    # -- vectors of unknowns
    # ---------------------------------------------------------------------------------------------------------------

    def applied(self, internal: Array) -> Array:
        """Forces of gripper, anchors and dead loads on this rank's own unknowns, N.

        Args:
            internal: internal minus dead forces on them.
        """
        forces = self.dead()
        forces[self.reacting] += internal[self.reacting]
        return forces

    def dead(self) -> Array:
        """Dead loads on this rank's own unknowns, N."""
        forces = np.zeros(self._owned)
        if self.loaded:
            forces[self.body.displacement_dofs[self._mine]] = self.external[self._mine]
        return forces

    def met(self, state: Array) -> Array:
        """A copy of this rank's unknowns with what is prescribed at its place."""
        wanted = state.copy()
        for condition in self.conditions:
            condition.set(wanted)
        return wanted


def _each(axes: tuple[int, ...]) -> tuple[int | None, ...]:
    """Axes to be held one by one; None for all at once."""
    return (None,) if len(axes) == 3 else axes


def nodal_weights(body: Body, region: Region, what: str) -> Array:
    """Share of a uniformly spread force that each displacement node carries; collective.

    The integral of the shape functions over the place (surface, line or point) divided by its measure: the shares of
    all ranks add up to one. At degree 2 a flat triangle puts everything on its edge middles, a line 1/6, 4/6, 1/6 on
    its three nodes.

    Returns:
        shape (nodes,), zero on ghosts.
    """
    entities = body.mesh.select(region, what)
    dimension = entities.shape[1] - 1
    measures = _measures(body.mesh.points, entities)
    table: dict[tuple[float, ...], float] = {}
    for nodes, share in zip(entities, measures / measures.sum(), strict=True):
        for place, part in _shares(body.mesh.points[nodes], body.degree, dimension):
            key = _key(place, body.mesh.size)
            table[key] = table.get(key, 0.0) + share * part
    owned = body.displacement_space.dofmap.index_map.size_local
    weights = np.zeros(len(body.nodes))
    for i, node in enumerate(body.nodes[:owned]):
        weights[i] = table.get(_key(node, body.mesh.size), 0.0)
    return weights


def _key(place: Array, size: float) -> tuple[float, ...]:
    return tuple(np.round(place / size, 9) + 0.0)


def _measures(points: Array, entities: NDArray[np.int64]) -> Array:
    corners = points[entities]
    if entities.shape[1] == 1:
        return np.ones(len(entities))
    if entities.shape[1] == 2:
        return np.linalg.norm(corners[:, 1] - corners[:, 0], axis=1)
    return np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2


def _shares(corners: Array, degree: int, dimension: int) -> list[tuple[Array, float]]:
    """Places of the nodes of one entity and their shares."""
    if dimension == 0:
        return [(corners[0], 1.0)]
    places, shares = _of_reference(degree, dimension)
    return list(zip(corners[0] + places @ (corners[1:] - corners[0]), shares, strict=True))


@cache
def _of_reference(degree: int, dimension: int) -> tuple[Array, list[float]]:
    """Nodes of the reference line or triangle, (k, dimension), and the means of their shape functions."""
    cell = (basix.CellType.interval, basix.CellType.triangle)[dimension - 1]
    element = basix.ufl.element("Lagrange", cell.name, degree).basix_element
    points, weights = basix.make_quadrature(cell, degree)
    means = weights @ element.tabulate(0, points)[0, :, :, 0] / weights.sum()
    return np.asarray(element.points), [float(mean) for mean in means]
