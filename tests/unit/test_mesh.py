"""Meshes as arrays: what is refused, refinement, selection, and where fiducials are attached."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from bcid.errors import InputError
from bcid.forms.mesh import BodyMesh, checked, level_mesh
from bcid.forms.observe import attach, closest_on_triangles
from bcid.scene import Box, Level, Plane, Region, Scene

ROOT = Path(__file__).resolve().parents[2]
HERE = Path("body.msh")
POINTS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]], dtype=float)
CELLS = np.array([[0, 1, 2, 3], [1, 2, 3, 4]])


@pytest.fixture(scope="module")
def slab() -> BodyMesh:
    scene = Scene.read(ROOT / "examples/scenes/slab.toml")
    return level_mesh(scene, scene.levels[0])


@pytest.mark.parametrize(
    ("points", "cells", "said"),
    [
        (POINTS, np.zeros((0, 4), int), "holds no tetrahedra"),
        (np.where(POINTS == 1, np.nan, POINTS), CELLS, "not finite"),
        (POINTS, CELLS + 1, "names node 5, but there are 5 nodes"),
        (POINTS * [1, 1, 1e-9], CELLS, "is flat"),
        (POINTS, CELLS[[0, 0]], "stands twice"),
        (POINTS, np.array([[0, 1, 2, 3], [0, 1, 2, 4], [1, 2, 0, 3][:4]]), "twice|overlap"),
        (np.vstack([POINTS[:4], POINTS[:4] + 5]), np.array([[0, 1, 2, 3], [4, 5, 6, 7]]), "2 unconnected parts"),
        (np.vstack([POINTS, POINTS[:1]]), np.array([[0, 1, 2, 3], [1, 2, 3, 4], [5, 1, 2, 4]]), "same place|overlap"),
    ],
)
def test_damaged_meshes_are_refused(points: np.ndarray, cells: np.ndarray, said: str) -> None:
    with pytest.raises(InputError, match=said) as error:
        checked(BodyMesh(points, cells), HERE)
    assert "body.msh" in str(error.value)


def test_repairs_that_change_nothing() -> None:
    """Nodes that nothing uses are dropped, and cells are turned the right way round."""
    points = np.vstack([[[9, 9, 9]], POINTS])
    mesh = checked(BodyMesh(points, CELLS[:, [0, 1, 3, 2]] + 1, {"base": np.array([[1, 2, 3]])}), HERE)
    assert len(mesh.points) == 5
    assert mesh.volume == pytest.approx(1 / 6 + 1 / 3)
    np.testing.assert_allclose(mesh.points[mesh.groups["base"][0]], POINTS[:3])


def test_the_boundary_looks_outward(slab: BodyMesh) -> None:
    """The divergence theorem with the boundary's normals gives the volume."""
    a, b, c = (slab.points[slab.boundary[:, i]] for i in range(3))
    assert np.einsum("ij,ij->", a, np.cross(b, c)) / 6 == pytest.approx(slab.volume, rel=1e-12)
    assert slab.volume == pytest.approx(0.1 * 0.01 * 0.1, rel=1e-12)


def test_refinement_keeps_the_body_and_its_places(slab: BodyMesh) -> None:
    fine = slab.refined()
    assert len(fine.cells) == 8 * len(slab.cells)
    assert fine.volume == pytest.approx(slab.volume, rel=1e-12)
    checked(fine, HERE)
    for name, coarse in slab.groups.items():
        area = [_area(mesh.points[g]) for mesh, g in ((slab, coarse), (fine, fine.groups[name]))]
        assert area[0] == pytest.approx(area[1], rel=1e-12)
        boundary = {tuple(row) for row in np.sort(fine.boundary, axis=1)}
        assert all(tuple(row) in boundary for row in np.sort(fine.groups[name], axis=1))


def _area(corners: np.ndarray) -> float:
    return float(
        np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum() / 2
    )


def test_groups_boxes_and_planes_select_the_same(slab: BodyMesh) -> None:
    by_group = slab.select(Region(("patch_1",)), "patch 1")
    box = Region(box=Box((0.05, 0.0, 0.1), (0.1, 0.01, 0.1)))
    plane = Region(plane=Plane((0.0, 0.0, 0.1), (0.0, 0.0, 1.0)))
    as_set = lambda rows: {tuple(row) for row in np.sort(rows, axis=1)}  # noqa: E731
    assert as_set(slab.select(box, "box")) == as_set(by_group)
    both = as_set(by_group) | as_set(slab.select(Region(("patch_2",)), "patch 2"))
    assert as_set(slab.select(plane, "plane")) == both
    assert _area(slab.points[by_group]) == pytest.approx(0.05 * 0.01)
    with pytest.raises(InputError, match="no physical group 'patch_x'; did you mean"):
        slab.select(Region(("patch_x",)), "patch x")
    with pytest.raises(InputError, match="no facet of the boundary lies wholly"):
        slab.select(Region(box=Box((0.01, 0.001, 0.01), (0.02, 0.002, 0.02))), "patch y")


def test_the_closest_point_of_triangles() -> None:
    """Against a dense sampling of each triangle."""
    rng = np.random.default_rng(1)
    triangles, position = rng.normal(size=(40, 3, 3)), rng.normal(size=3)
    found = closest_on_triangles(triangles, position)
    s, t = (g.ravel() for g in np.meshgrid(np.linspace(0, 1, 201), np.linspace(0, 1, 201)))
    s, t = s[s + t <= 1], t[s + t <= 1]
    for triangle, point in zip(triangles, found, strict=True):
        samples = triangle[0] + np.outer(s, triangle[1] - triangle[0]) + np.outer(t, triangle[2] - triangle[0])
        nearest = np.linalg.norm(samples - position, axis=1).min()
        distance = np.linalg.norm(point - position)
        assert distance <= nearest + 1e-12
        assert distance >= nearest - 0.05


def test_fiducials_attach_or_are_refused(slab: BodyMesh) -> None:
    places = {"in": (0.05, 0.005, 0.05), "above": (0.05, 0.012, 0.05), "far": (0.05, 0.5, 0.05)}
    found = attach(slab, {k: places[k] for k in ("in", "above")}, 0.003)
    assert found["in"].distance == 0.0
    assert found["above"].distance == pytest.approx(0.002)
    np.testing.assert_allclose(found["above"].point, (0.05, 0.010, 0.05))
    with pytest.raises(InputError, match="fiducial far at 50 500 50 mm lies 490 mm outside the body"):
        attach(slab, places, 0.003)


@pytest.mark.parametrize(
    "text",
    [
        "",
        'SystemCall "touch owned";\n',
        "$MeshFormat\n4.1 0 8\n$EndMeshFormat\n",
        "$MeshFormat\n4.1 0 8\n$EndMeshFormat\n$Nodes\n1 -5 1 9999999999\n",
        "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n1\n1 0 0 0\n$EndNodes\n$Elements\n1\n1 4 2 1 1 1 2 3 9\n$EndElements\n",
        "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n1\n1 0 0\n",
    ],
)
def test_hostile_mesh_files(text: str, tmp_path: Path) -> None:
    """Whatever gmsh does with them happens in a child process; here it is one readable error."""
    (tmp_path / "bad.msh").write_text(text, encoding="utf-8")
    scene = Scene.read(ROOT / "examples/scenes/slab.toml")
    broken = dataclasses.replace(scene, geometry=tmp_path / "bad.msh", levels=(Level(),))
    with pytest.raises(InputError, match=r"bad\.msh"):
        level_mesh(broken, broken.levels[0])
    assert [p.name for p in tmp_path.iterdir()] == ["bad.msh"]


def test_mutated_mesh_files(tmp_path: Path) -> None:
    """A good file with a few bytes changed is read as a sound mesh or refused in words."""
    rng = np.random.default_rng(7)
    good = _gmsh_text(POINTS, CELLS).encode()
    scene = Scene.read(ROOT / "examples/scenes/slab.toml")
    scene = dataclasses.replace(scene, patches={}, grasps={}, places={}, levels=(Level(),))
    path = tmp_path / "some.msh"
    sound = 0
    for _ in range(25):
        content = bytearray(good)
        for place in rng.integers(len("$MeshFormat"), len(good), size=3):
            content[place] = rng.choice(list(b"0123456789-. $e\n\xff"))
        path.write_bytes(content)
        try:
            mesh = level_mesh(dataclasses.replace(scene, geometry=path), scene.levels[0])
        except InputError as error:
            assert "some.msh" in str(error)  # noqa: PT017
        else:
            assert mesh.volume > 0
            assert np.isfinite(mesh.points).all()
            sound += 1
    assert sound < 25, "the mutations must bite"


def _gmsh_text(points: np.ndarray, cells: np.ndarray) -> str:
    nodes = "\n".join(f"{i} {x:.6f} {y:.6f} {z:.6f}" for i, (x, y, z) in enumerate(points, 1))
    elements = "\n".join(f"{i} 4 2 1 1 {' '.join(str(n + 1) for n in cell)}" for i, cell in enumerate(cells, 1))
    head = "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n"
    return f"{head}$Nodes\n{len(points)}\n{nodes}\n$EndNodes\n$Elements\n{len(cells)}\n{elements}\n$EndElements\n"
