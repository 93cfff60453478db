"""The bodies that are shipped besides the slab: their meshes are sound on every level, and they can be pulled."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from verify.problems import move, straight

from bcid.forms.forward import Forward
from bcid.forms.mesh import BodyMesh, level_mesh
from bcid.forms.model import check_physics
from bcid.forms.solver.status import Status
from bcid.scene import Scene

VOLUME = {"gallbladder": 30.9e-6, "beam": 90e-6}


def read(project: Path, name: str) -> Scene:
    return Scene.read(project / "examples" / "scenes" / f"{name}.toml", physics=check_physics)


def facets_of(entities: NDArray[np.int64]) -> set[tuple[int, ...]]:
    return {tuple(map(int, nodes)) for nodes in np.sort(entities, axis=1)}


@pytest.fixture(scope="module", params=["gallbladder", "beam"])
def ladder(request: pytest.FixtureRequest, project: Path) -> tuple[Scene, list[BodyMesh]]:
    """A scene and its meshes, every one of them checked by `level_mesh`."""
    scene = read(project, request.param)
    return scene, [level_mesh(scene, level) for level in scene.levels]


def test_the_ladder_climbs_towards_the_same_body(ladder: tuple[Scene, list[BodyMesh]]) -> None:
    scene, meshes = ladder
    nodes = [len(mesh.points) for mesh in meshes]
    assert 30 <= nodes[0] <= 60
    assert all(b > 1.5 * a for a, b in pairwise(nodes))
    assert meshes[-1].volume == pytest.approx(VOLUME[scene.name], rel=0.01)
    assert meshes[0].volume == pytest.approx(VOLUME[scene.name], rel=0.25)


def test_every_named_part_lies_on_the_boundary(ladder: tuple[Scene, list[BodyMesh]]) -> None:
    scene, meshes = ladder
    regions = {**scene.patches, **{name: grasp.region for name, grasp in scene.grasps.items()}}
    for mesh in meshes:
        boundary, taken = facets_of(mesh.boundary), set[tuple[int, ...]]()
        for name, region in regions.items():
            facets = facets_of(mesh.select(region, name))
            assert facets <= boundary
            assert not facets & taken
            taken |= facets


def test_the_patches_are_on_the_liver_side_in_two_rows_of_three(project: Path) -> None:
    scene = read(project, "gallbladder")
    mesh = level_mesh(scene, scene.levels[2])
    middle = {
        name: 1e3 * mesh.points[np.unique(mesh.select(region, name))].mean(axis=0)
        for name, region in scene.patches.items()
    }
    assert list(middle) == list("123456")
    assert all(middle[name][1] < -4 for name in middle)
    assert middle["1"][0] < middle["2"][0] - 10 < middle["3"][0] - 20
    assert all(middle[a][2] > 3 > -3 > middle[b][2] for a, b in ("14", "25", "36"))
    assert all(y > 5e-3 for _, y, _ in scene.fiducials.values())
    neck = mesh.points[np.unique(mesh.select(scene.grasps["neck"].region, "neck"))]
    assert np.linalg.norm(neck.mean(axis=0) - scene.grasps["neck"].centre) < 2e-3


@pytest.mark.parametrize("level", [0, 1, 2])
def test_a_pull_at_the_neck_converges(project: Path, level: int) -> None:
    forward = Forward(read(project, "gallbladder"), level)
    for anchors, target in (("25", (0.008, 0.0, 0.0)), ("123456", (0.0, 0.006, 0.004))):
        prediction = forward.predict(anchors, [straight(target, 4, "neck")])
        assert prediction.failure is None
        moved = np.linalg.norm(prediction.positions[-1] - forward.observer.rest, axis=1)
        assert 0.2e-3 < moved.max() < 0.008
    forward.destroy()


@pytest.mark.parametrize("level", [0, 1])
def test_the_beam_sags_on_every_level(project: Path, level: int) -> None:
    forward = Forward(read(project, "beam"), level)
    prediction = forward.predict(["clamp"], [move(np.zeros((1, 3)), grasp="")])
    assert [t.status for t in prediction.trajectories] == [Status.CONVERGED]
    assert -0.0072 < (prediction.positions[-1] - forward.observer.rest)[:, 2].mean() < -0.0060
    forward.destroy()
