"""Another unit of length, and absurd sizes, are refused before a fine mesh is made; sound scenes are not."""

import dataclasses
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bcid.base.errors import InputError
from bcid.forms.forward import check_geometry
from bcid.forms.mesh import level_mesh, loading
from bcid.scene import Level, Scene
from validation.reliability.scanned import box, image, save, scene_of, scene_text, sphere

ROOT = Path(__file__).resolve().parents[2]
SCENES = [
    ROOT / f"examples/scenes/{name}.toml" for name in ("bar", "beam", "finger_hidden", "gallbladder", "slab", "strip")
]
UNITS = {"m": 1.0, "cm": 1e-2, "um": 1e-6, "in": 0.0254}
BAR = """DefineConstant[h = {10}, lc = {8}, width = {100}];
Point(1) = {0, 0, 0, lc}; Point(2) = {width, 0, 0, lc}; Point(3) = {width, 10, 0, lc}; Point(4) = {0, 10, 0, lc};
Line(1) = {1, 2}; Line(2) = {2, 3}; Line(3) = {3, 4}; Line(4) = {4, 1};
Curve Loop(1) = {1, 2, 3, 4}; Plane Surface(1) = {1};
MORE
made[] = Extrude {0, 0, 20} { Surface{1}; LAYERS };
Physical Volume("body") = {made[1]}; Physical Surface("back") = {1};
"""


def fiducials(points: np.ndarray) -> str:
    """Entries of a scene for points (n, 3), mm."""
    return "\n".join(f'm{i} = "{x} {y} {z} mm"' for i, (x, y, z) in enumerate(points))


def bar(folder: Path, more: str = "", layers: str = "") -> Scene:
    """A bar whose points state the size of elements themselves."""
    text = BAR.replace("MORE", more).replace("LAYERS", layers)
    (folder / "bar.geo").write_text(text, encoding="utf-8")
    corners = box((100.0, 10.0, 20.0))[0]
    more = scene_text("bar.geo", (8.0,), 'all = "back"', fiducials=fiducials(corners))
    (folder / "bar.toml").write_text(more, encoding="utf-8")
    return Scene.read(folder / "bar.toml")


def ball(folder: Path, name: str) -> Scene:
    """A sphere of 30 mm around the origin with elements of 10 mm: as a surface, or as a label of an image."""
    points, triangles = sphere()
    marks = {"sizes": (10.0,), "fiducials": fiducials(points[::97])}
    if name.endswith(".stl"):
        return scene_of(save(folder / name, points, triangles), **marks)
    axes = np.arange(-34.0, 36.0, 2.0)
    inside = sum(np.square(np.meshgrid(axes, axes, axes, indexing="ij"))) < 30**2
    affine = np.diag([2.0, 2.0, 2.0, 1.0])
    affine[:3, 3] = axes[0]
    return scene_of(image(folder / name, inside.astype(np.uint8), affine), more="label = 1", **marks)


def slab() -> Scene:
    scene = Scene.read(ROOT / "examples/scenes/slab.toml")
    return dataclasses.replace(scene, levels=(Level(1, 0.01),))


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """How many tetrahedra the meshes have that children make."""
    counts: list[int] = []
    read = loading.read_in_child

    def counted(*arguments: Any, **more: Any) -> dict[str, Any]:
        found = read(*arguments, **more)
        counts.append(len(found["cells"]))
        return found

    monkeypatch.setattr(loading, "read_in_child", counted)
    loading._load.cache_clear()
    return counts


@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize("body", ["slab.geo", "ball.stl", "ball.nii"])
def test_check_geometry_with_another_unit_refuses_before_many_elements_are_made(
    tmp_path: Path, made: list[int], body: str, unit: str
) -> None:
    scene = slab() if body == "slab.geo" else ball(tmp_path, body)
    with pytest.raises(InputError, match="length_unit"):
        check_geometry(dataclasses.replace(scene, length_unit=UNITS[unit]))
    assert sum(made) < 20_000


@pytest.mark.parametrize("parameters", [{"lc": 1e-6}, {"lc": 1e-3}, {"width": 1e6, "lc": 1e-2}], ids=str)
def test_level_mesh_of_a_geo_that_states_absurd_sizes_is_refused(
    tmp_path: Path, made: list[int], parameters: dict[str, float]
) -> None:
    scene = dataclasses.replace(bar(tmp_path), parameters=parameters)
    with pytest.raises(InputError, match=rf"elements of {parameters['lc']:g}.* more than 5,000,000; choose larger"):
        level_mesh(scene, scene.levels[0])
    assert not made


def test_level_mesh_of_a_geo_whose_curves_are_numbered_passes_over_the_sizes_of_points(tmp_path: Path) -> None:
    numbered = "Transfinite Curve{1, 3} = 11; Transfinite Curve{2, 4} = 3; Transfinite Surface{1};"
    scene = dataclasses.replace(bar(tmp_path, numbered, "Layers{4};"), parameters={"lc": 1e-3})
    assert level_mesh(scene, scene.levels[0]).volume == pytest.approx(2e-5)


@pytest.mark.parametrize("path", SCENES, ids=lambda path: path.stem)
def test_check_geometry_of_an_example_passes_the_rough_mesh(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = Scene.read(path)
    right = level_mesh(scene, scene.levels[0])
    monkeypatch.setattr(loading, "MANY", 0)
    check_geometry(scene)
    np.testing.assert_array_equal(level_mesh(scene, scene.levels[0]).points, right.points)


@pytest.mark.parametrize("seed", range(10))
def test_check_geometry_of_a_sheet_beam_or_block_of_any_size_passes_the_rough_mesh(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, seed: int
) -> None:
    """Boxes with edges in ratios up to 60, of 1 mm to 10 m, anywhere, with one to twenty markers on a part of one face."""
    draw = np.random.default_rng(seed)
    size = 10 ** draw.uniform(0, 4) / np.array([1.0, *draw.choice([1.5, 8.0, 60.0], 2)])
    points, triangles = box(tuple(size))
    start = draw.uniform(-2, 2, 3) * size
    corner = draw.uniform(0, 0.7, 2)
    marks = corner + draw.uniform(0, 0.3, (draw.integers(1, 21), 2))
    places = start + np.c_[marks, np.ones(len(marks))] * size
    body = save(tmp_path / "b.stl", points + start, triangles)
    anywhere = 'all = { box = ["-100 -100 -100 m", "100 100 100 m"] }'
    scene = scene_of(body, sizes=(float(f"{size.min() * 2:.4g}"),), patches=anywhere, fiducials=fiducials(places))
    monkeypatch.setattr(loading, "MANY", 0)
    check_geometry(scene)
    assert math.prod(size) * 1e-9 == pytest.approx(level_mesh(scene, scene.levels[0]).volume, rel=0.01)
