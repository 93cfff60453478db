"""Meshes as arrays: what is refused, refinement, selection, and where fiducials are attached."""

import dataclasses
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI
from verify.problems import box

from bcid.base.errors import InputError
from bcid.forms.forward import check_geometry
from bcid.forms.mesh import BodyMesh, checked, level_mesh
from bcid.forms.mesh.body import Body
from bcid.forms.mesh.check import measures
from bcid.forms.mesh.closest import closest_on_triangles
from bcid.forms.observe import attach
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


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize(("face", "height", "outward"), [("y0", 0.0, -1.0), ("y1", 0.2, 1.0)])
def test_normals_at_nodes_of_a_curved_surface(face: str, height: float, outward: float, degree: int) -> None:
    """Of y = height + 0.3 x^2 they are along (-0.6 x, 1, 0), but for facets that are flat and lie on one side where it ends."""
    mesh = box((1.0, 0.2, 0.4), (16, 1, 4), lambda p: p + np.outer(0.3 * p[:, 0] ** 2, [0, 1, 0]))
    body = Body(MPI.COMM_SELF, mesh, degree)
    found = body.normals(Region((face,)), face).x.array.reshape(-1, 3)
    x, y, _ = body.nodes.T
    there = abs(y - height - 0.3 * x**2) < 1e-3
    expected = outward * np.column_stack([-0.6 * x, np.ones(len(x)), np.zeros(len(x))])[there]
    expected /= np.linalg.norm(expected, axis=1)[:, None]
    assert np.linalg.norm(found[there], axis=1) == pytest.approx(1.0)
    np.testing.assert_allclose(found[there], expected, atol=0.6 / 16 / 2 + 1e-3)
    assert not found[~there].any()


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


def _gmsh_text(points: np.ndarray, cells: np.ndarray) -> str:
    nodes = "\n".join(f"{i} {x:.6f} {y:.6f} {z:.6f}" for i, (x, y, z) in enumerate(points, 1))
    elements = "\n".join(f"{i} 4 2 1 1 {' '.join(str(n + 1) for n in cell)}" for i, cell in enumerate(cells, 1))
    head = "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n"
    return f"{head}$Nodes\n{len(points)}\n{nodes}\n$EndNodes\n$Elements\n{len(cells)}\n{elements}\n$EndElements\n"


def bound(folder: Path, mesh: BodyMesh, edit: Callable[[BodyMesh], BodyMesh] = lambda mesh: mesh, **more: Any) -> Scene:
    """A scene of the slab on a gmsh file (format 2.2, mm) that this mesh, edited, is written into."""
    mesh = edit(mesh)
    names = list(mesh.groups)
    lines = ["$MeshFormat", "2.2 0 8", "$EndMeshFormat", "$PhysicalNames", str(len(names) + 1), '3 99 "body"']
    lines += [f'2 {i} "{name}"' for i, name in enumerate(names, start=1)] + ["$EndPhysicalNames", "$Nodes"]
    lines += [str(len(mesh.points)), *(f"{i} {x} {y} {z}" for i, (x, y, z) in enumerate(mesh.points * 1e3, start=1))]
    entities = [(4, 99, row) for row in mesh.cells]
    entities += [(2, i, row) for i, name in enumerate(names, start=1) for row in mesh.groups[name]]
    lines += ["$EndNodes", "$Elements", str(len(entities))]
    for number, (kind, tag, row) in enumerate(entities, start=1):
        lines.append(" ".join(map(str, [number, kind, 2, tag, tag, *(row + 1)])))
    (folder / "m.msh").write_text("\n".join([*lines, "$EndElements"]) + "\n", encoding="utf-8")
    scene = Scene.read(ROOT / "examples/scenes/slab.toml")
    levels = (Level(1, None, 0),)
    return dataclasses.replace(scene, geometry=folder / "m.msh", levels=levels, source="scene.toml", **more)


@pytest.fixture(scope="module")
def finer() -> BodyMesh:
    scene = Scene.read(ROOT / "examples/scenes/slab.toml")
    return level_mesh(scene, Level(1, 0.01))


def inner(mesh: BodyMesh) -> np.ndarray:
    """Which cells have no node on the boundary."""
    return ~np.isin(mesh.cells, mesh.boundary).any(axis=1)


def without_cell(mesh: BodyMesh, number: int) -> BodyMesh:
    return dataclasses.replace(mesh, cells=np.delete(mesh.cells, number, axis=0))


def facing(mesh: BodyMesh, name: str) -> int:
    """A cell with a face in a group."""
    rows = {tuple(row) for row in np.sort(mesh.groups[name], axis=1)}
    return next(
        i
        for i, cell in enumerate(np.sort(mesh.cells, axis=1))
        if any(tuple(np.delete(cell, k)) in rows for k in range(4))
    )


def middle_of(mesh: BodyMesh, name: str) -> int:
    """A triangle of a group all of whose neighbours are in it."""
    group = np.sort(mesh.groups[name], axis=1)
    count = Counter(pair for row in group for pair in ((row[0], row[1]), (row[1], row[2]), (row[0], row[2])))
    return next(i for i, (a, b, c) in enumerate(group) if min(count[a, b], count[b, c], count[a, c]) == 2)


def turned_inward(mesh: BodyMesh) -> BodyMesh:
    """With a triangle of a patch replaced by a face inside the body."""
    boundary = {tuple(row) for row in np.sort(mesh.boundary, axis=1)}
    face = next(cell[:3] for cell in mesh.cells if tuple(np.sort(cell[:3])) not in boundary)
    return dataclasses.replace(mesh, groups=mesh.groups | {"patch_7": np.vstack([mesh.groups["patch_7"][1:], face])})


def with_hole(mesh: BodyMesh) -> BodyMesh:
    part = np.delete(mesh.groups["patch_7"], middle_of(mesh, "patch_7"), axis=0)
    return dataclasses.replace(mesh, groups=mesh.groups | {"patch_7": part})


def with_gap(mesh: BodyMesh) -> BodyMesh:
    """Without a triangle of patch 7 that has an edge in common with patch 8, and neighbours in both."""
    groups = {name: np.sort(mesh.groups[name], axis=1) for name in ("patch_7", "patch_8")}

    def edges(rows: np.ndarray) -> set[tuple[int, int]]:
        return {(int(row[i]), int(row[j])) for row in rows for i, j in ((0, 1), (1, 2), (0, 2))}

    shared = edges(groups["patch_7"]) & edges(groups["patch_8"])
    for number, row in enumerate(groups["patch_7"]):
        rest = np.delete(groups["patch_7"], number, axis=0)
        own = edges(row[None])
        if own & shared and own <= edges(rest) | edges(groups["patch_8"]):
            return dataclasses.replace(mesh, groups=mesh.groups | {"patch_7": rest})
    raise AssertionError("no such triangle")


@pytest.mark.parametrize(
    ("edit", "said"),
    [
        (with_gap, r"a triangle at \(.*\) mm is in no group of the scene, but all its neighbours are"),
        (turned_inward, r"'patch_7': 1 of its \d+ triangles are not on the boundary of the body"),
        (with_hole, r"'patch_7': a triangle is missing in it at \("),
        (
            lambda m: without_cell(m, facing(m, "patch_7")),
            r"'patch_7': 1 of its|touches itself|belong to no tetrahedron",
        ),
    ],
)
def test_damage_to_places_is_seen(
    tmp_path: Path, finer: BodyMesh, edit: Callable[[BodyMesh], BodyMesh], said: str
) -> None:
    sound = bound(tmp_path, finer)
    assert level_mesh(sound, sound.levels[0]).volume == pytest.approx(1e-4)
    scene = bound(tmp_path, finer, edit)
    with pytest.raises(InputError, match=said):
        level_mesh(scene, scene.levels[0])


def test_a_missing_tetrahedron_is_seen(finer: BodyMesh) -> None:
    mesh = finer.refined()
    number = int(np.flatnonzero(inner(mesh))[0])
    with pytest.raises(
        InputError, match=r"a tetrahedron is missing inside the body, at \(|touches itself along an edge"
    ):
        checked(without_cell(mesh, number), HERE)
    # A cavity that is larger is meant.
    far = np.linalg.norm(mesh.points[mesh.cells].mean(axis=1) - mesh.points[mesh.cells[number]].mean(axis=0), axis=1)
    one = mesh.cells[number]
    around = np.isin(mesh.cells, one).sum(axis=1) >= 3
    assert far[around].max() < 0.02
    if inner(mesh)[around].all():
        checked(dataclasses.replace(mesh, cells=mesh.cells[~around]), HERE)


@pytest.mark.parametrize("size", ["0.01 mm", "0.3 mm"])
def test_elements_without_number_are_refused_at_once(tmp_path: Path, size: str) -> None:
    """By the volume of the body, for a .geo before it is meshed; also where only a finer level asks for them."""
    scene = Scene.read(ROOT / "examples/scenes/slab.toml")
    fine = Level(1, float(size.split()[0]) * 1e-3)
    for levels in ((fine,), (Level(1, 0.05), fine)):
        with pytest.raises(InputError, match=r"tetrahedra, more than 5,000,000; choose larger elements"):
            level_mesh(dataclasses.replace(scene, levels=levels), levels[0])


def test_refinements_without_number_are_refused(tmp_path: Path, finer: BodyMesh) -> None:
    scene = dataclasses.replace(bound(tmp_path, finer.refined()), levels=(Level(1, None, 0), Level(1, None, 4)))
    with pytest.raises(InputError, match=r"levels\[1\]: 4 refinements in a body of 100 cm\^3 are about"):
        level_mesh(scene, scene.levels[0])


@pytest.mark.parametrize("scene", ["slab", "gallbladder"])
@pytest.mark.parametrize("factor", [1e3, 1e-3, 10.0, 0.1, 25.4])
def test_another_unit_of_length_is_seen(scene: str, factor: float) -> None:
    right = Scene.read(ROOT / f"examples/scenes/{scene}.toml")
    wrong = dataclasses.replace(right, length_unit=right.length_unit * factor)
    with pytest.raises(InputError, match=r"length_unit") as error:
        check_geometry(wrong)
    looks = f"{factor:.4g} times too large" if factor > 1 else f"{1 / factor:.4g} times too small"
    assert looks in str(error.value) or "tetrahedra" in str(error.value)


def test_the_centre_of_a_grasp_is_near_its_facets() -> None:
    scene = Scene.read(ROOT / "examples/scenes/slab.toml")
    grasp = dataclasses.replace(scene.grasps["I"], centre=(0.09, 0.01, 0.92))
    with pytest.raises(InputError, match=r"grasps\.I\.centre: lies \d+(\.\d+)? mm from the facets"):
        check_geometry(dataclasses.replace(scene, grasps=scene.grasps | {"I": grasp}))


def test_volume_and_areas_in_words(slab: BodyMesh) -> None:
    lines = measures(Scene.read(ROOT / "examples/scenes/slab.toml"), slab)
    assert lines[0] == "Body: volume 100 cm^3, boundary 240 cm^2."
    assert "7 25 cm^2" in lines[1]
    assert lines[2] == "  grasps: I 2 cm^2, II 2 cm^2, III 2 cm^2"
