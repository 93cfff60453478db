"""Random pulls and memory, reduced; docs/reliability.md has the full sizes."""

from __future__ import annotations

import re

import numpy as np

from bcid import Scene
from bcid.forms.forward import Forward
from validation.reliability import SLAB, solving


def test_random_pulls_converge_where_they_can() -> None:
    found = solving.convergence(60)
    assert found.met, found.reached
    assert re.search(r"60 of 60 \(.*; [1-9]\d* more were drawn", found.reached)


def test_a_pull_through_an_anchor_is_told_from_one_away_from_it() -> None:
    """Along the way from the gripper to the nearest patch, and the other way."""
    scene = Scene.read(SLAB)
    forward = Forward(scene, 1)
    points = forward.mesh.points
    grasp = next(iter(scene.grasps))
    held = points[forward.mesh.select(scene.grasps[grasp].region, grasp)].reshape(-1, 3).mean(axis=0)
    patches = {
        name: points[forward.mesh.select(r, name)].reshape(-1, 3).mean(axis=0) for name, r in scene.patches.items()
    }
    nearest = min(patches, key=lambda name: float(np.linalg.norm(patches[name] - held)))
    way = (patches[nearest] - held) / np.linalg.norm(patches[nearest] - held)
    found = [
        solving.crushed(forward, frozenset({nearest}), solving.pull(sign * way, 0.03, 15, grasp))
        for sign in (1.0, -1.0)
    ]
    forward.destroy()
    assert found == [True, False]


def test_memory_does_not_grow() -> None:
    found = solving.memory(300, settled=100, far=2)
    assert found.met, found.reached
