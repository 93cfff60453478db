"""Patches made of surfaces: pieces tile them on every level, have numbers in order, and levels that miss some are passed over."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from bcid.base.errors import InputError
from bcid.forms.mesh import BodyMesh, level_mesh
from bcid.forms.mesh.patches import divided, element_size, extents, first_level, halves, touching
from bcid.scene import Box, Level, Plane, Region, Scene

ROOT = Path(__file__).resolve().parents[2]
SLAB = Scene.read(ROOT / "examples/scenes/slab.toml")
GALLBLADDER = Scene.read(ROOT / "examples/scenes/gallbladder.toml")
BOTTOM = Region(("patch_7", "patch_8"))
LIVER = Region(tuple(f"patch_{i}" for i in range(1, 7)))


def one(scene: Scene, region: Region, size: float) -> Scene:
    """The scene with one region to divide, and no other patches."""
    return replace(scene, patches={"edge": region}, divide={"edge": size})


@cache
def bare_mesh(name: str, level: int) -> BodyMesh:
    """A level of a scene. Without the grasps: the slab's bottom holds theirs, which is refused for other reasons."""
    scene = {"slab": SLAB, "gallbladder": GALLBLADDER}[name]
    return level_mesh(replace(scene, patches={}, grasps={}), scene.levels[level])


def rows(entities: np.ndarray) -> list[tuple[int, ...]]:
    return [tuple(row) for row in np.sort(entities, axis=1)]


def facets(mesh: BodyMesh, region: Region) -> list[tuple[int, ...]]:
    """Facets of a region; none is no error."""
    try:
        return rows(mesh.select(region, "piece"))
    except InputError:
        return []


@pytest.mark.parametrize(
    ("scene", "region", "size", "count"),
    [
        (SLAB, BOTTOM, 0.0125, 32),
        (SLAB, Region(("patch_1", "patch_2", "patch_3")), 0.010, 11),
        (SLAB, Region(plane=Plane((0.0, 0.0, 0.0), (0.0, 1.0, 0.0))), 0.025, 16),
        (GALLBLADDER, LIVER, 0.008, 32),
        (GALLBLADDER, LIVER, 0.016, 8),
    ],
)
def test_pieces_tile_the_surface_on_every_level(scene: Scene, region: Region, size: float, count: int) -> None:
    pieces = divided(one(scene, region, size))
    assert not pieces.divide
    assert list(pieces.patches) == [f"edge.{i}" for i in range(1, count + 1)]
    assert max(extents(pieces).values()) <= 1.25001 * size
    for level in range(len(scene.levels)):
        mesh = bare_mesh(scene.name, level)
        for each in (mesh, mesh.refined()) if level < 3 else (mesh,):
            found = [row for piece in pieces.patches.values() for row in facets(each, piece)]
            assert len(found) == len(set(found)), "a facet is in two pieces"
            assert set(found) == set(rows(each.select(region, "edge"))), "a facet is in no piece"


def test_a_middle_on_the_cut_belongs_to_the_upper_piece_whatever_its_round_off() -> None:
    """Nodes moved by less than meshes are accurate must not change which facets a piece has."""
    points = np.array([[0, 0, 0], [3, 0, 0], [0, 3, 0], [0, 0, 3]], dtype=float)
    base = np.array([[0, 1, 2]])
    lower, upper = (
        Region(("base",), within=Box(*corners))
        for corners in (((-np.inf,) * 3, (1.0, np.inf, np.inf)), ((1.0, -np.inf, -np.inf), (np.inf,) * 3))
    )
    for shift in (-1e-9, 0.0, 1e-9):
        mesh = BodyMesh(points + np.array([shift, 0, 0]), np.array([[0, 1, 2, 3]]), {"base": base})
        assert facets(mesh, upper) == [(0, 1, 2)]
        assert facets(mesh, lower) == []


def test_pieces_are_numbered_as_the_halves_come() -> None:
    """x is cut first where extents are equal; the lower half has the lower numbers."""
    pieces = divided(one(SLAB, Region(("patch_7",)), 0.025))
    mesh = level_mesh(replace(SLAB, patches={}), SLAB.levels[2])
    middles = {name: mesh.points[mesh.select(r, name)].mean(axis=(0, 1)) * 1e3 for name, r in pieces.patches.items()}
    expected = {"edge.1": (12.5, 62.5), "edge.2": (12.5, 87.5), "edge.3": (37.5, 62.5), "edge.4": (37.5, 87.5)}
    for name, (x, z) in expected.items():
        assert middles[name][[0, 2]] == pytest.approx([x, z], abs=2.0)
    strip = divided(one(SLAB, Region(("patch_3", "patch_4")), 0.020))
    at = [mesh.points[mesh.select(r, name)][:, :, 2].mean() for name, r in strip.patches.items()]
    assert len(at) == 4
    assert at == sorted(at)


def test_pieces_stand_where_the_patch_stood() -> None:
    scene = replace(SLAB, divide={"2": 0.025, "3": 0.1})
    assert list(divided(scene).patches) == ["1", "2.1", "2.2", "3.1", *"45678"]
    assert divided(SLAB) is SLAB


def test_halves() -> None:
    scene = halves(SLAB, "7")
    assert list(scene.patches) == [*"123456", "7.1", "7.2", "8"]
    again = halves(scene, "7.2")
    assert list(again.patches) == [*"123456", "7.1", "7.2.1", "7.2.2", "8"]
    mesh = level_mesh(SLAB, SLAB.levels[2])
    low, high, behind, ahead = (
        mesh.points[mesh.select(s.patches[n], n)].mean(axis=(0, 1)) * 1e3
        for s, n in ((scene, "7.1"), (scene, "7.2"), (again, "7.2.1"), (again, "7.2.2"))
    )
    assert low[[0, 2]] == pytest.approx([12.5, 75], abs=2)
    assert high[[0, 2]] == pytest.approx([37.5, 75], abs=2)
    assert behind[[0, 2]] == pytest.approx([37.5, 62.5], abs=2)
    assert ahead[[0, 2]] == pytest.approx([37.5, 87.5], abs=2)
    assert extents(again)["7.2.2"] == pytest.approx(0.025)
    assert extents(scene)["7.1"] == pytest.approx(0.050)
    with pytest.raises(InputError, match="patch '9' is not in scene"):
        halves(SLAB, "9")
    taken = replace(SLAB, patches={"7": BOTTOM, "7.2": LIVER})
    with pytest.raises(InputError, match=r"has a patch '7\.2' already; rename it"):
        halves(taken, "7")


def test_what_cannot_be_divided() -> None:
    scene = replace(SLAB, divide={"1": 1e-4, "7": 1e-3})
    with pytest.raises(InputError, match="makes more than 512 pieces") as error:
        divided(scene)
    assert "patches.1: divide = '0.1 mm'" in str(error.value)
    assert "patches.7: divide = '1 mm'" in str(error.value)
    with pytest.raises(InputError, match="no physical group 'patch_x'; did you mean"):
        divided(one(SLAB, Region(("patch_x",)), 0.01))
    beam = Scene.read(ROOT / "examples/scenes/beam.toml")
    with pytest.raises(InputError, match="only surfaces are divided"):
        divided(one(beam, Region(("tip_edge",)), 0.01))


def test_levels_that_do_not_show_every_piece_are_passed_over() -> None:
    whole = replace(SLAB, patches={"edge": Region(("patch_7",))})
    assert first_level(whole, 0, 3) == (0, [])
    pieces = divided(replace(whole, divide={"edge": 0.0125}))
    level, passed = first_level(pieces, 0, 3)
    assert level == 1
    assert passed == [
        "level 0 (elements of 50 mm) shows no facet of 14 piece(s): edge.1, edge.2, edge.3, edge.5, edge.6, edge.7, ..."
    ]
    assert first_level(pieces, 2, 3) == (2, [])
    with pytest.raises(InputError, match=r"level 0 \(elements of 50 mm\) shows no facet.*make larger pieces, or allow"):
        first_level(pieces, 0, 0)
    with pytest.raises(InputError, match="no facet has its middle in this piece") as error:
        level_mesh(pieces, pieces.levels[0])
    assert "level 0 (elements of 50 mm): 14 problems" in str(error.value)
    assert "larger pieces, or take a finer level (--level)" in str(error.value)


def test_pieces_of_a_mesh_file_are_looked_for_on_the_refined_mesh(tmp_path: Path) -> None:
    points = "1 0 0 0\n2 30 0 0\n3 0 30 0\n4 0 0 30"
    head = '$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$PhysicalNames\n1\n2 1 "base"\n$EndPhysicalNames\n'
    text = f"{head}$Nodes\n4\n{points}\n$EndNodes\n$Elements\n2\n1 2 2 1 1 1 3 2\n2 4 2 2 1 1 2 3 4\n$EndElements\n"
    (tmp_path / "body.msh").write_text(text, encoding="utf-8")
    levels = tuple(Level(1, None, n) for n in range(3))
    scene = replace(SLAB, geometry=tmp_path / "body.msh", levels=levels, grasps={}, fiducials={"a": (0.0, 0.0, 0.0)})
    pieces = divided(one(scene, Region(("base",)), 0.015))
    assert list(pieces.patches) == ["edge.1", "edge.2", "edge.3"]
    level, passed = first_level(pieces, 0, 2)
    assert level == 1
    assert passed == ["level 0 (0 refinements) shows no facet of 2 piece(s): edge.2, edge.3"]
    assert len(level_mesh(pieces, levels[1]).points) == 10
    assert element_size(pieces, 2) == pytest.approx(element_size(pieces, 0) / 4)
    assert element_size(pieces, 0) == pytest.approx((30 + 30 * np.sqrt(2)) / 2e3)
    assert element_size(SLAB, 1) == 0.020


def test_patches_that_touch_share_an_edge_and_not_only_a_corner() -> None:
    near = touching(SLAB, 0)
    assert near["7"] == {"2", "3", "8"}
    assert near["1"] == {"2"}
    assert touching(halves(SLAB, "7"), 2)["7.1"] == {"2", "3", "7.2", "8"}
