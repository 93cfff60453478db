"""Scanned surfaces become meshes: the right volume, places on every level, what is mended and what is refused."""

from pathlib import Path

import numpy as np
import pytest

from bcid.base.errors import InputError
from bcid.forms.mesh import BodyMesh, level_mesh
from bcid.forms.mesh.mend import mended
from bcid.forms.mesh.parts_of_surface import enclosed
from bcid.forms.mesh.surface_file import read_surface
from validation.reliability.scanned import box, save, scene_of, sphere, volume

SPHERE = sphere()
ENCLOSED = volume(*SPHERE)
CAP = (SPHERE[0][:, 2] > 15).astype(np.int32)


def meshes(path: Path, **more: object) -> list[BodyMesh]:
    scene = scene_of(path, **more)
    return [level_mesh(scene, level) for level in scene.levels]


def areas(path: Path, patches: str, sizes: tuple[float, ...]) -> dict[str, list[float]]:
    """Areas of patches on every level, mm^2."""
    scene = scene_of(path, patches=patches, sizes=sizes)
    made = [level_mesh(scene, level) for level in scene.levels]
    return {name: [m.area(m.select(region, name)) * 1e6 for m in made] for name, region in scene.patches.items()}


def refusal(path: Path, **more: object) -> str:
    """What is said of a scene on a file."""
    with pytest.raises(InputError) as caught:
        meshes(path, **more)
    text = str(caught.value)
    assert path.name in text
    return text


def unmendable(path: Path) -> str:
    """What is said of a file where it is read, without a process of its own, which takes a second."""
    with pytest.raises(InputError) as caught:
        mended(read_surface(path))
    return str(caught.value)


@pytest.mark.parametrize("name", ["s.ascii.stl", "S.STL", "s.ply", "s.obj"])
def test_a_sphere_has_its_volume_in_every_format(tmp_path: Path, name: str) -> None:
    """Nodes lie on the surface: chords of length h take off about h^2 / (8 r) all around."""
    size = 12.0 if name != "s.ply" else 6.0
    (mesh,) = meshes(save(tmp_path / name, *SPHERE), sizes=(size,))
    lost = 1 - mesh.volume * 1e9 / ENCLOSED
    assert 0 < lost < 3 * size**2 / (8 * 30**2) * 1.5
    assert np.linalg.norm(mesh.points[mesh.boundary].reshape(-1, 3), axis=1) == pytest.approx(0.03, rel=0.02)


def test_a_box_keeps_edges_and_volume_and_the_ladder_gets_finer(tmp_path: Path) -> None:
    made = meshes(save(tmp_path / "b.stl", *box()), sizes=(20, 10, 5))
    assert [mesh.volume for mesh in made] == pytest.approx([48e-6] * 3, rel=1e-9)
    assert [mesh.area(mesh.boundary) for mesh in made] == pytest.approx([88e-4] * 3, rel=1e-9)
    counts = [len(mesh.cells) for mesh in made]
    assert counts[2] > 3 * counts[1] > 9 * counts[0] / 2
    assert not made[0].notes


def test_normals_spheres_and_boxes_choose_the_same_on_every_level(tmp_path: Path) -> None:
    """Of a sphere: a cap of half angle 40 deg, and what a ball of 15 mm around the pole takes."""
    text = 'up = { normal = [0, 0, 2], within = "40 deg" }\nball = { sphere = { centre = "0 0 30 mm", radius = "15 mm" } }\n'
    text += 'both = { normal = [0, 0, 1], within = "40 deg", box = ["0 -1 -1 m", "1 1 1 m"] }'
    found = areas(save(tmp_path / "s.stl", *SPHERE), text, (10, 4))
    assert found["up"] == pytest.approx([2 * np.pi * 30**2 * (1 - np.cos(np.radians(40)))] * 2, rel=0.12)
    assert found["up"][1] == pytest.approx(2 * np.pi * 30**2 * (1 - np.cos(np.radians(40))), rel=0.04)
    assert found["ball"] == pytest.approx([np.pi * 15**2] * 2, rel=0.2)
    assert found["ball"][1] == pytest.approx(np.pi * 15**2, rel=0.05)
    # Facets that lie wholly in the half are a little less than it.
    assert 0.3 < found["both"][1] / found["up"][1] < 0.5


def test_normals_look_outward(tmp_path: Path) -> None:
    found = areas(save(tmp_path / "b.stl", *box()), 'low = { normal = [0, 0, -1], within = "5 deg" }', (20, 10))
    assert found["low"] == pytest.approx([2400.0] * 2)


def test_paint_chooses_the_same_on_every_level(tmp_path: Path) -> None:
    """A cap that is painted down to z = 15 mm; triangles of the file at the border are painted by halves."""
    red = np.where(CAP, 255, 0).astype(np.uint8)
    none = np.zeros_like(red)
    fields = {"attachment": CAP, "red": red, "green": none, "blue": none}
    text = 'cap = { painted = "attachment", value = 1 }\nred = { painted = "colour", value = [250, 5, 0] }'
    found = areas(save(tmp_path / "s.ply", *SPHERE, **fields), text, (10, 4))
    assert found["cap"] == found["red"]
    cap = 2 * np.pi * 30 * 15
    assert found["cap"] == pytest.approx([cap] * 2, rel=0.08)
    assert found["cap"][1] == pytest.approx(cap, rel=0.04)


def test_vertex_colours_of_an_obj(tmp_path: Path) -> None:
    path = save(tmp_path / "s.obj", *SPHERE, rgb=np.where(CAP[:, None], [1.0, 0, 0], [0, 0, 1.0]))
    found = areas(path, 'cap = { painted = "colour", value = [255, 0, 0] }', (6,))
    assert found["cap"] == pytest.approx([2 * np.pi * 30 * 15], rel=0.08)


@pytest.mark.parametrize(
    ("patch", "said"),
    [
        ('{ painted = "attachmnt", value = 1 }', "no painted field 'attachmnt'; did you mean 'attachment'"),
        (
            '{ painted = "attachment", value = 7 }',
            "nothing is painted with 7 in field 'attachment'; it has the values 0, 1",
        ),
        ('{ painted = "attachment", value = [1, 0, 0] }', "has 1 component(s): write a number"),
        ('{ sphere = { centre = "0 0 90 mm", radius = "5 mm" } }', "has its middle in the sphere; the body spans"),
        (
            '{ normal = [0, 0, 1], within = "30 deg", sphere = { centre = "0 0 -30 mm", radius = "5 mm" } }',
            "looks in the",
        ),
    ],
)
def test_places_that_choose_nothing(tmp_path: Path, patch: str, said: str) -> None:
    path = save(tmp_path / "s.ply", *SPHERE, attachment=CAP)
    assert said in refusal(path, patches=f"cap = {patch}")


@pytest.mark.parametrize(
    ("patch", "said"),
    [
        ("{ normal = [0, 0, 1] }", "'normal' and 'within' go together"),
        ('{ normal = [0, 0, 0], within = "30 deg" }', "not all zero"),
        ('{ normal = [0, 0, 1], within = "30 mm" }', "patches.cap.within"),
        ('{ normal = [0, 0, 1], within = "200 deg" }', "below 180 deg"),
        ('{ painted = "attachment" }', "'painted' and 'value' go together"),
        ('{ painted = "attachment", value = "red" }', "three of a colour from 0 to 255"),
        ('{ sphere = { centre = "0 0 0 mm" } }', "sphere: expected { centre"),
        ('{ sphere = { centre = "0 0 0 mm", radius = "-1 mm" } }', "must be positive"),
        ("{ ball = 1 }", "a table with on, box, plane, sphere, normal and/or painted"),
    ],
)
def test_places_that_are_written_wrongly(tmp_path: Path, patch: str, said: str) -> None:
    path = save(tmp_path / "s.ply", *SPHERE)
    with pytest.raises(InputError) as caught:
        scene_of(path, patches=f"cap = {patch}")
    assert said in str(caught.value)
    assert "scene.toml" in str(caught.value)


def notes(path: Path) -> str:
    surface = mended(read_surface(path))
    assert enclosed(surface) == pytest.approx(ENCLOSED, rel=1e-3)
    return "; ".join(surface.notes)


def test_what_is_mended_is_said(tmp_path: Path) -> None:
    points, triangles = SPHERE
    assert notes(save(tmp_path / "sound.ply", points, triangles)) == ""
    turned = triangles.copy()
    turned[::3] = turned[::3, ::-1]
    assert (
        notes(save(tmp_path / "turned.ply", points, turned))
        == "1707 of 5120 triangles looked the wrong way and were turned"
    )
    assert "5120 of 5120 triangles" in notes(save(tmp_path / "inside.stl", points, triangles[:, ::-1]))
    assert "1 hole(s) were closed" in notes(save(tmp_path / "hole.ply", points, triangles[1:]))
    soup = np.arange(3 * len(triangles)).reshape(-1, 3)
    assert "12798 points stood at the place of others" in notes(
        save(tmp_path / "soup.ply", points[triangles.ravel()], soup)
    )
    twice = np.vstack([triangles, triangles[:5], [[0, 0, 1]]])
    said = notes(save(tmp_path / "twice.ply", points, twice))
    assert "5 triangles that stood there twice" in said
    assert "1 triangles without area" in said
    bit = np.vstack([points, points[:12] * 0.01 + [40, 0, 0], sphere(1.0, 1, (40, 0, 0))[0]])
    extra = sphere(1.0, 1)[1] + len(points) + 12
    assert "1 loose bit(s)" in notes(save(tmp_path / "bit.ply", bit, np.vstack([triangles, extra])))


def test_a_cavity_is_kept(tmp_path: Path) -> None:
    points, triangles = SPHERE
    both = np.vstack([points, points / 2]), np.vstack([triangles, triangles + len(points)])
    (mesh,) = meshes(save(tmp_path / "cavity.ply", *both), sizes=(6,))
    assert mesh.volume * 1e9 == pytest.approx(ENCLOSED * 7 / 8, rel=0.03)
    assert "1 cavity or cavities inside are kept" in mesh.notes


def with_dent(points: np.ndarray) -> np.ndarray:
    """A sphere with one node pushed out through the other side."""
    moved = points.copy()
    moved[np.argmax(points[:, 2])] = [3.0, 2.0, -45.0]
    return moved


POINTS, TRIANGLES = SPHERE
TWO = np.vstack([TRIANGLES, TRIANGLES + len(POINTS)])
STRIP = np.array([[i, (i + 1) % 12, 12 + i] for i in range(12)])


def moebius() -> tuple[np.ndarray, np.ndarray]:
    turn = np.linspace(0, 2 * np.pi, 40, endpoint=False)
    rim = [
        np.c_[
            (30 + s * np.cos(turn / 2)) * np.cos(turn), (30 + s * np.cos(turn / 2)) * np.sin(turn), s * np.sin(turn / 2)
        ]
        for s in (-5, 5)
    ]
    quads = [(i, i + 1, i + 41, i + 40) for i in range(39)] + [(39, 40, 0, 79)]
    return np.vstack(rim), np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])


@pytest.mark.parametrize(
    ("points", "triangles", "said"),
    [
        (
            POINTS,
            TRIANGLES[POINTS[TRIANGLES].mean(axis=1)[:, 2] < 20],
            ["is open: 1 hole(s) with 74 edges", "close it"],
        ),
        (POINTS, TRIANGLES[POINTS[TRIANGLES].mean(axis=1)[:, 2] < 0], ["is open: 1 hole(s)", "scan the body"]),
        (with_dent(POINTS), TRIANGLES, ["crosses itself:", "triangles go through others, the first at", "remesh"]),
        (POINTS, np.vstack([TRIANGLES, [[*TRIANGLES[0, :2], TRIANGLES[-1, 0]]]]), ["1 edges belong to more than two"]),
        (
            np.vstack([POINTS, POINTS + np.array([85, 0, 0])]),
            TWO,
            ["falls into 2 bodies (parts of the volume: 0.5, 0.5)", "keep one"],
        ),
        (*moebius(), ["has one side only"]),
        (POINTS, TRIANGLES[:0], ["holds 2562 points and no triangles", "no surface"]),
        (np.where(POINTS > 29.9, np.nan, POINTS), TRIANGLES, ["coordinates that are not finite"]),
        (POINTS * [1, 1, 0], TRIANGLES, ["in the unit of the file|same place|encloses no volume|crosses|without area"]),
    ],
)
def test_what_cannot_be_mended_is_refused(
    tmp_path: Path, points: np.ndarray, triangles: np.ndarray, said: list[str]
) -> None:
    text = unmendable(save(tmp_path / "bad.ply", points, triangles))
    assert all(any(one in text for one in word.split("|")) for word in said), text


@pytest.mark.parametrize("name", ["s.stl", "s.ascii.stl", "s.ply", "s.obj"])
def test_truncated_and_empty_files_are_refused(tmp_path: Path, name: str) -> None:
    path = save(tmp_path / name, *SPHERE)
    content = path.read_bytes()
    words = {
        "s.stl": "states 5120 triangles and holds",
        "s.ascii.stl": "is truncated",
        "s.ply": "is truncated",
        "s.obj": "no tri",
    }
    path.write_bytes(content[:20_000])
    assert words[name] in unmendable(path)
    path.write_bytes(b"")
    assert unmendable(path)
    path.write_bytes(bytes(range(256)) * 40)
    assert unmendable(path)
    if name == "s.stl":
        assert "cannot be meshed: states" in refusal(path)


def test_elements_without_number_are_refused(tmp_path: Path) -> None:
    assert "more than 5,000,000; choose larger elements" in refusal(save(tmp_path / "s.stl", *SPHERE), sizes=(10, 0.1))


def test_refinements_are_for_mesh_files(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"refinements: unknown key; .*element_size"):
        scene_of(save(tmp_path / "s.stl", *SPHERE), refined=True)
