"""Dots that look like beads and do not move with the body, on the background and on the gripper."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from validation.rendering.appearance import Appearance
from validation.rendering.blockers import Blockers
from validation.rendering.rig import between
from validation.rendering.shot import Gripper, Plane, Shot
from validation.rendering.view import View

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Decoys:
    """Dots that do not move with the body: fixed ones (n, 3), and ones on the gripper at rest (g, 3); body frame, m."""

    fixed: Array
    held: Array

    def place(self, gripper: Gripper | None) -> Array:
        """Where they are now; those of the gripper only if there is one."""
        return self.fixed if gripper is None else np.concatenate([self.fixed, gripper.place(self.held)])


def scattered(
    appearance: Appearance, views: list[View], shot: Shot, floor: Plane, random: np.random.Generator
) -> Decoys:
    """As many decoys as `look` says: a third on the gripper if there is one, the others where both cameras see the floor."""
    held: Array = np.empty((0, 3))
    if shot.gripper is not None:
        held = _on_gripper(appearance.decoys // 3, appearance, views, shot.gripper, random)
    blockers = [Blockers(shot, view.pose) for view in views]
    found: list[Array] = []
    for _ in range(100 * appearance.decoys):
        if len(found) == appearance.decoys - len(held):
            break
        place = _on_floor(views[int(random.integers(2))], floor, random)
        if place is None:
            continue
        place = place + appearance.radius * floor[1]
        apart = all(np.linalg.norm(place - other) > 3 * appearance.diameter for other in found)
        if apart and all(_in_sight(view, place, b) for view, b in zip(views, blockers, strict=True)):
            found.append(place)
    return Decoys(np.reshape(found, (-1, 3)), held)


def _on_floor(view: View, floor: Plane, random: np.random.Generator) -> Array | None:
    """A point of the background that a random pixel sees."""
    height, width = view.lens.rays.shape[:2]
    ray = view.pose[0].T @ np.append(view.lens.rays[random.integers(height), random.integers(width)], 1.0)
    eye = -view.pose[0].T @ view.pose[1]
    facing = ray @ floor[1]
    ahead = (floor[0] - eye) @ floor[1] / facing if facing < 0 else -1.0
    return np.asarray(eye + ahead * ray) if ahead > 0 else None


def _in_sight(view: View, place: Array, blockers: Blockers) -> bool:
    point = view.of(place)[None]
    pixel = view.lens.camera.project(point)[0]
    if not ((pixel > 0) & (pixel < np.array(view.lens.camera.size) - 1)).all():
        return False
    return not blockers.hide(point * (1 - 1e-6), np.empty((0, 3)), 0.0)[0]


def _on_gripper(
    count: int, appearance: Appearance, views: list[View], gripper: Gripper, random: np.random.Generator
) -> Array:
    """Points (count, 3) that touch the face of the box at rest that looks most at the cameras."""
    eye = gripper.at_rest(between([view.pose for view in views]))
    middle, half = (gripper.lower + gripper.upper) / 2, (gripper.upper - gripper.lower) / 2
    axis = int(np.argmax(np.abs(eye - middle) - half))
    places = middle + random.uniform(-0.8, 0.8, (count, 3)) * half
    places[:, axis] = middle[axis] + np.sign(eye - middle)[axis] * (half[axis] + appearance.radius)
    return np.asarray(places)
