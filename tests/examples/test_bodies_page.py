"""The scenes of docs/bodies.md, on files as the page describes them."""

import re
from collections.abc import Callable
from pathlib import Path

import meshio
import numpy as np
import pytest

from bcid.forms.model import check_physics
from bcid.forms.scene_check import check_scene
from bcid.forms.scene_table import table
from bcid.scene import Scene
from validation.reliability.scanned import box, image, save

PROJECT = Path(__file__).resolve().parents[2]
SCENES = re.findall(
    r"^```toml\n(format = .*?)^```", (PROJECT / "docs/bodies.md").read_text(encoding="utf-8"), re.M | re.S
)


def block(path: Path) -> None:
    points, triangles = box(cells=6)
    save(path, points, triangles, attachment=(points[:, 0] < 1).astype(np.int32))


def organ(path: Path) -> None:
    """A ball of 25 mm around the origin, labelled 2, on a plate labelled 3."""
    affine = np.diag([2.0, 2.0, 2.0, 1.0])
    affine[:3, 3] = -40
    places = np.stack(np.meshgrid(*[np.arange(41) * 2.0 - 40] * 3, indexing="ij"), axis=-1)
    ball = np.linalg.norm(places, axis=-1) < 25
    image(path, np.where(ball, 2, np.where(places[..., 2] < -15, 3, 0)).astype(np.uint8), affine)


def bricks(path: Path) -> None:
    steps = [np.linspace(0, size, 4) for size in (60.0, 40.0, 20.0)]
    points = np.stack(np.meshgrid(*steps, indexing="ij"), axis=-1).reshape(-1, 3)
    index = np.arange(64).reshape(4, 4, 4)
    corners = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)]
    cells = np.stack([index[a : a + 3, b : b + 3, c : c + 3].ravel() for a, b, c in corners], axis=1)
    side = (points[:, 0] < 1).astype(float)
    meshio.write(path, meshio.Mesh(points, [("hexahedron", cells)], point_data={"side": side}))


MAKERS: dict[str, Callable[[Path], None]] = {"block.ply": block, "organ.nii.gz": organ, "bricks.vtu": bricks}


def test_there_is_one_of_each() -> None:
    assert [re.findall('^file = "(.*?)"', text, re.M)[0] for text in SCENES] == list(MAKERS)


@pytest.mark.parametrize(("name", "text"), zip(MAKERS, SCENES, strict=True), ids=list(MAKERS))
def test_scenes_of_the_page(name: str, text: str, tmp_path: Path) -> None:
    MAKERS[name](tmp_path / name)
    (tmp_path / "scene.toml").write_text(text, encoding="utf-8")
    found = check_scene(Scene.read(tmp_path / "scene.toml", physics=check_physics))
    assert found.mesh.volume > 0
    assert all(place.area > 0 for place in found.places)
    assert all(rung.meshed for rung in found.rungs)
    assert name in table(found)
