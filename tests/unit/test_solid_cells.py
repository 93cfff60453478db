"""Hexahedra, wedges, pyramids and higher orders as tetrahedra: the same volume, no gaps, groups that stay on the boundary."""

from pathlib import Path

import meshio
import numpy as np
import pytest

from bcid.base.errors import InputError
from bcid.forms.mesh import BodyMesh, checked, level_mesh
from bcid.forms.mesh.solid_cells import _FACES, Block, as_simplices, as_tetrahedra
from validation.reliability.scanned import WHOLE, scene_of

SIZE = np.array([60.0, 40.0, 20.0])


def bricks(seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """A box of 4 x 3 x 2 hexahedra, its inner nodes moved a little, its nodes numbered at random."""
    rng = np.random.default_rng(seed)
    counts = np.array([4, 3, 2])
    grid = np.stack(np.meshgrid(*(np.arange(n + 1) for n in counts), indexing="ij"), axis=-1).reshape(-1, 3)
    inner = ((grid > 0) & (grid < counts)).all(axis=1)
    points = (grid + 0.15 * inner[:, None] * rng.uniform(-1, 1, grid.shape)) * SIZE / counts
    index = np.arange(len(grid)).reshape(*(counts + 1))
    corner = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)]
    cells = [index[tuple(slice(o, o + n) for o, n in zip(at, counts, strict=True))].ravel() for at in corner]
    renumbered = rng.permutation(len(grid))
    shuffled = np.empty_like(points)
    shuffled[renumbered] = points
    return shuffled, renumbered[np.stack(cells, axis=1)]


POINTS, HEXAHEDRA = bricks()
WEDGES = np.vstack([HEXAHEDRA[:, [0, 1, 3, 4, 5, 7]], HEXAHEDRA[:, [1, 2, 3, 5, 6, 7]]])
CENTRED = np.vstack([POINTS, POINTS[HEXAHEDRA].mean(axis=1)])
APEX = len(POINTS) + np.arange(len(HEXAHEDRA))


def pyramids(which: np.ndarray) -> np.ndarray:
    """Six of each hexahedron, with the apex in its middle."""
    return np.vstack([np.c_[HEXAHEDRA[which][:, face[::-1]], APEX[which]] for face in _FACES[8]])


EVEN = np.arange(len(HEXAHEDRA)) % 2 == 0
# Columns along z: the triangles of wedges are above each other.
PAIRS = np.arange(len(HEXAHEDRA)) // 2 % 2 == 0
ALL = np.ones(len(HEXAHEDRA), dtype=bool)


@pytest.mark.parametrize(
    ("cells", "count", "said"),
    [
        ([("hexahedron", HEXAHEDRA)], 144, ["24 hexahedra are cut into 144 tetrahedra"]),
        ([("hexahedron", HEXAHEDRA[:, [4, 5, 6, 7, 0, 1, 2, 3]])], 144, ["24 hexahedra"]),
        ([("wedge", WEDGES)], 144, ["48 wedges are cut into 144 tetrahedra"]),
        ([("pyramid", pyramids(ALL))], 288, ["144 pyramids are cut into 288 tetrahedra"]),
        ([("hexahedron", HEXAHEDRA[EVEN]), ("pyramid", pyramids(~EVEN))], 216, ["12 hexahedra", "72 pyramids"]),
        (
            [("wedge", np.vstack([WEDGES[:24][PAIRS], WEDGES[24:][PAIRS]])), ("hexahedron", HEXAHEDRA[~PAIRS])],
            144,
            ["wedges"],
        ),
    ],
)
def test_volume_is_kept_and_neighbours_agree(
    tmp_path: Path, cells: list[tuple[str, np.ndarray]], count: int, said: list[str]
) -> None:
    meshio.write(tmp_path / "m.vtu", meshio.Mesh(CENTRED, cells))
    scene = scene_of(
        tmp_path / "m.vtu", sizes=(0, 1), refined=True, patches='top = { normal = [0, 0, 1], within = "1 deg" }'
    )
    mesh = level_mesh(scene, scene.levels[0])
    # Reading checks that no face is shared by more than two, and that the boundary is closed: were two diagonals of a face to
    # differ, both would be boundary, and its area larger.
    assert len(mesh.cells) == count
    assert mesh.volume == pytest.approx(SIZE.prod() * 1e-9, rel=1e-9)
    assert mesh.area(mesh.boundary) == pytest.approx(8800e-6, rel=1e-9)
    assert mesh.area(mesh.select(scene.patches["top"], "top")) == pytest.approx(2400e-6, rel=1e-9)
    assert all(word in "; ".join(mesh.notes) for word in said)
    checked(mesh, tmp_path / "m.vtu")


def test_a_hexahedron_that_is_drawn_together_is_a_wedge() -> None:
    """As Abaqus and others write them: nodes 2 and 3, 6 and 7 are the same."""
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [0, 1, 1]], dtype=float)
    cells, _ = as_tetrahedra(corners, [Block(3, np.array([[0, 1, 2, 2, 3, 4, 5, 5]]), 8)])
    assert len(cells) == 3
    assert checked(BodyMesh(corners, cells), Path("m.inp")).volume == pytest.approx(0.5)


def test_cells_without_an_inside_are_refused(tmp_path: Path) -> None:
    bad = HEXAHEDRA.copy()
    bad[3] = bad[3][[0, 1, 6, 3, 4, 5, 2, 7]]
    meshio.write(tmp_path / "m.vtu", meshio.Mesh(POINTS, [("hexahedron", bad)]))
    scene = scene_of(tmp_path / "m.vtu", sizes=(0,), refined=True)
    with pytest.raises(
        InputError, match=r"1 of 24 hexahedra are turned inside out or have no inside, the first is number 3"
    ):
        level_mesh(scene, scene.levels[0])


def test_groups_of_quadrilaterals_are_cut_as_the_cells_are() -> None:
    cells, _ = as_tetrahedra(POINTS, [Block(3, HEXAHEDRA, 8)])
    low = POINTS[HEXAHEDRA][:, :4, 2].max(axis=1) < 1e-9
    quads = HEXAHEDRA[low][:, [0, 3, 2, 1]]
    group = as_simplices([Block(2, quads, 4), Block(1, quads[:, :2], 2)])
    assert group is not None
    mesh = BodyMesh(POINTS, cells, {"floor": group})
    boundary = {tuple(row) for row in np.sort(mesh.boundary, axis=1)}
    assert len(group) == 24
    assert all(tuple(row) in boundary for row in np.sort(group, axis=1))
    assert mesh.area(group) == pytest.approx(2400.0)


def test_higher_orders_are_taken_by_their_corners(tmp_path: Path) -> None:
    import gmsh

    gmsh.initialize(interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.model.occ.addBox(0, 0, 0, *SIZE)
        gmsh.model.occ.synchronize()
        gmsh.option.setNumber("Mesh.MeshSizeMax", 20)
        gmsh.model.addPhysicalGroup(2, [1], name="side")
        gmsh.model.addPhysicalGroup(3, [1], name="body")
        gmsh.model.mesh.generate(3)
        gmsh.model.mesh.setOrder(2)
        gmsh.write(str(tmp_path / "m.msh"))
    finally:
        gmsh.finalize()
    read = meshio.read(tmp_path / "m.msh")
    meshio.write(tmp_path / "m.vtu", meshio.Mesh(read.points, [("tetra10", read.cells_dict["tetra10"])]))
    for name, patch in (("m.msh", 'side = "side"'), ("m.vtu", 'side = { normal = [-1, 0, 0], within = "1 deg" }')):
        scene = scene_of(tmp_path / name, sizes=(0,), refined=True, patches=patch)
        mesh = level_mesh(scene, scene.levels[0])
        assert mesh.volume == pytest.approx(48e-6, rel=1e-9)
        assert mesh.area(mesh.select(scene.patches["side"], "side")) == pytest.approx(800e-6, rel=1e-9)
        assert mesh.notes == (
            "elements of second or higher order are taken by their corners: curved edges become straight",
        )


def test_point_data_of_a_mesh_file_paint_its_boundary(tmp_path: Path) -> None:
    """The same on every refinement, as near as facets can follow it."""
    painted = (CENTRED[:, 0] > 29).astype(float)
    meshio.write(tmp_path / "m.vtu", meshio.Mesh(CENTRED, [("hexahedron", HEXAHEDRA)], point_data={"side": painted}))
    text = 'right = { painted = "side", value = 1, box = ["0 -1 19.9 mm", "99 99 20.1 mm"] }'
    scene = scene_of(tmp_path / "m.vtu", sizes=(0, 2), refined=True, patches=text)
    areas = [
        m.area(m.select(scene.patches["right"], "right")) * 1e6 for m in (level_mesh(scene, n) for n in scene.levels)
    ]
    # Half of the cells that lie between painted and bare nodes: from x = 22.5 on, on a top of 60 x 40.
    assert areas == pytest.approx([37.5 * 40] * 2, rel=0.06)


def test_cells_of_unknown_shape_are_refused(tmp_path: Path) -> None:
    meshio.write(tmp_path / "m.vtk", meshio.Mesh(POINTS, [("triangle", HEXAHEDRA[:, :3])]))
    scene = scene_of(tmp_path / "m.vtk", sizes=(0,), refined=True, patches=WHOLE)
    with pytest.raises(
        InputError, match=r"holds triangles and no tetrahedra.*a surface is meshed when it is an STL, PLY or OBJ"
    ):
        level_mesh(scene, scene.levels[0])
