"""A label of a NIfTI image becomes a body: its volume, its place in the frame of the affine, what it touches, what is refused."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bcid.base.errors import InputError
from bcid.forms.mesh import level_mesh
from bcid.forms.mesh.body_mesh import volumes
from bcid.forms.mesh.label_image import surface_of_label
from bcid.forms.mesh.mend import mended
from bcid.forms.mesh.parts_of_surface import enclosed
from bcid.forms.mesh.shares import share
from bcid.scene import Scene
from validation.reliability.scanned import image, scene_of

SHAPE, SPACING, AXES = np.array([50, 40, 60]), np.array([1.5, 1.5, 2.0]), np.array([30.0, 20.0, 40.0])
MIDDLE = (SHAPE - 1) / 2
VOXELS = np.stack(np.meshgrid(*map(np.arange, SHAPE), indexing="ij"), axis=-1)
INSIDE = ((((VOXELS - MIDDLE) * SPACING) / AXES) ** 2).sum(axis=-1) < 1
TRUE = 4 / 3 * np.pi * AXES.prod()
# The body is 2; 3 lies beyond a plane across the last axis, and touches it.
LABELS = np.where(INSIDE, 2, np.where(VOXELS[..., 2] > 45, 3, 0)).astype(np.uint8)


def oblique(mirrored: bool = False) -> np.ndarray:
    """Voxels to mm: turned about all axes, and moved."""
    affine = np.eye(4)
    affine[:3, :3] = Rotation.from_euler("xyz", [20, 30, 40], degrees=True).as_matrix() @ np.diag(SPACING)
    affine[:3, 3] = [10, -20, 300]
    return affine @ np.diag([-1.0 if mirrored else 1.0, 1, 1, 1])


@pytest.mark.parametrize(("name", "mirrored"), [("e.nii.gz", False), ("e.nii", True)])
def test_an_ellipsoid_has_its_volume_and_place(tmp_path: Path, name: str, mirrored: bool) -> None:
    affine = oblique(mirrored)
    scene = scene_of(
        image(tmp_path / name, LABELS, affine),
        more="label = 2",
        sizes=(5.0,),
        patches='liver = { painted = "label", value = 3 }',
    )
    assert scene.length_unit == 1e-3
    mesh = level_mesh(scene, scene.levels[0])
    assert mesh.volume * 1e9 == pytest.approx(TRUE, rel=0.015)
    assert not mesh.notes
    weights = volumes(mesh.points, mesh.cells)
    middle = np.average(mesh.points[mesh.cells].mean(axis=1), axis=0, weights=weights) * 1e3
    np.testing.assert_allclose(middle, affine[:3, :3] @ MIDDLE + affine[:3, 3], atol=0.1)
    # Every node is on the ellipsoid, in the frame of the voxels, to within half a voxel.
    back = (
        np.linalg.inv(affine)
        @ np.c_[mesh.points[np.unique(mesh.boundary)] * 1e3, np.ones(len(np.unique(mesh.boundary)))].T
    ).T
    radius = np.linalg.norm((back[:, :3] - MIDDLE) * SPACING / AXES, axis=1)
    assert abs(radius - 1).max() * AXES.min() < 0.75
    # The part beyond the plane: z > 45.5 voxels, a cap of the ellipsoid.
    cut = (45.5 - MIDDLE[2]) * SPACING[2] / AXES[2]
    low, high = cap_area(cut - 0.05), cap_area(cut + 0.05)
    assert high < mesh.area(mesh.select(scene.patches["liver"], "liver")) * 1e6 < low


def cap_area(cut: float) -> float:
    """Area of the ellipsoid beyond a part of its last axis, mm^2, by quadrature."""
    z = np.linspace(cut, 1, 400)
    turn = np.linspace(0, 2 * np.pi, 200)
    z, turn = np.meshgrid(z, turn, indexing="ij")
    around = np.sqrt(np.maximum(1 - z**2, 0))
    points = np.stack([AXES[0] * around * np.cos(turn), AXES[1] * around * np.sin(turn), AXES[2] * z], axis=-1)
    along, across = points[1:, :-1] - points[:-1, :-1], points[:-1, 1:] - points[:-1, :-1]
    return float(np.linalg.norm(np.cross(along, across), axis=-1).sum())


def test_the_surface_keeps_the_volume_of_the_voxels(tmp_path: Path) -> None:
    surface = mended(surface_of_label(image(tmp_path / "e.nii", LABELS, oblique()), 2))
    assert enclosed(surface) == pytest.approx(INSIDE.sum() * SPACING.prod(), rel=0.001)


def test_a_label_at_the_border_of_the_image_is_closed_there(tmp_path: Path) -> None:
    cut = LABELS[:25]
    surface = mended(surface_of_label(image(tmp_path / "cut.nii", cut, oblique()), 2))
    assert enclosed(surface) == pytest.approx((cut == 2).sum() * SPACING.prod(), rel=0.01)


def test_specks_and_small_cavities_are_said(tmp_path: Path) -> None:
    labels = LABELS.copy()
    labels[:2, :2, :2] = 2
    labels[25, 20, 30] = 0
    notes = surface_of_label(image(tmp_path / "specks.nii", labels, oblique()), 2).notes
    assert notes == (
        "1 speck(s) of the label, together 8 voxels, were left out",
        "1 cavity or cavities of together 1 voxels were filled",
    )


def two(labels: np.ndarray) -> np.ndarray:
    labels = labels.copy()
    labels[:8, :8, :8] = 2
    return labels


@pytest.mark.parametrize(
    ("labels", "label", "said"),
    [
        (LABELS, 5, "label 5 is not in the image; it has 0 ("),
        (two(LABELS), 2, "the label has 2 pieces (of 22272, 512 voxels): a scene has one body"),
        (LABELS * np.float32(1.3), 2, "values that are no whole numbers"),
        (np.stack([LABELS, LABELS], axis=-1), 2, "has 4 dimensions"),
    ],
)
def test_images_without_the_body_are_refused(tmp_path: Path, labels: np.ndarray, label: int, said: str) -> None:
    with pytest.raises(InputError) as caught:
        surface_of_label(image(tmp_path / "bad.nii", labels, oblique()), label)
    assert said in str(caught.value)


def test_damaged_images_are_refused(tmp_path: Path) -> None:
    path = image(tmp_path / "e.nii", LABELS, oblique())
    content = path.read_bytes()
    headless = bytearray(content)
    headless[252:256] = bytes(4)
    for changed, said in ((content[: len(content) // 2], "truncated"), (bytes(headless), "states no frame")):
        path.write_bytes(changed)
        with pytest.raises(InputError, match=said):
            surface_of_label(path, 2)
    path.write_bytes(b"junk" * 200)
    with pytest.raises(InputError, match=r"geometry\.file: 'e\.nii' is no NIfTI image"):
        scene_of(path, more="label = 2")


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ("", "geometry.label: is missing"),
        ("label = 0", "geometry.label: expected the number"),
        ("label = 2.0", "geometry.label: expected the number"),
        ('label = 2\nlength_unit = "cm"', "geometry.length_unit: 'cm', but e.nii states a unit of 0.001 m"),
    ],
)
def test_what_a_scene_must_say_of_an_image(tmp_path: Path, more: str, said: str) -> None:
    with pytest.raises(InputError) as caught:
        scene_of(image(tmp_path / "e.nii", LABELS, oblique()), more=more)
    assert said in str(caught.value)


def test_an_image_without_a_unit_leaves_it_to_the_scene(tmp_path: Path) -> None:
    path = image(tmp_path / "e.nii", LABELS, oblique(), lambda header: header.set_xyzt_units("unknown"))
    with pytest.raises(InputError, match=r"geometry\.length_unit: is missing"):
        scene_of(path, more="label = 2")
    assert scene_of(path, more='label = 2\nlength_unit = "mm"').length_unit == 1e-3


def test_only_images_have_labels(tmp_path: Path) -> None:
    (tmp_path / "s.stl").write_bytes(b"")
    with pytest.raises(InputError, match="only a label image"):
        scene_of(tmp_path / "s.stl", more='label = 2\nlength_unit = "mm"')


CORE = ((((VOXELS - MIDDLE - [4, 0, 5]) * SPACING) / 12.0) ** 2).sum(axis=-1) < 1
NESTED = np.where(CORE, 4, LABELS).astype(np.uint8)


def nested(folder: Path, region: str) -> Scene:
    """The ellipsoid with a ball in it that has a label of its own, as a region."""
    folder.mkdir(exist_ok=True)
    return scene_of(
        image(folder / "nested.nii.gz", NESTED, oblique()),
        more="label = 2",
        sizes=(6.0,),
        patches=f'liver = {{ painted = "label", value = 3 }}\n[regions]\ncore = {region}',
    )


def test_a_label_inside_of_a_body_is_a_region_of_it(tmp_path: Path) -> None:
    """It belongs to the body, as large as it is and where it is in the frame of the scanner."""
    scene = nested(tmp_path, "{ label = 4 }")
    mesh = level_mesh(scene, scene.levels[0])
    assert mesh.volume * 1e9 == pytest.approx(TRUE, rel=0.03)
    weights = volumes(mesh.points, mesh.cells) * share(mesh, scene.regions["core"], "core")
    assert weights.sum() * 1e9 == pytest.approx(CORE.sum() * SPACING.prod(), rel=0.03)
    middle = np.average(mesh.points[mesh.cells].mean(axis=1), axis=0, weights=weights) * 1e3
    np.testing.assert_allclose(middle, oblique()[:3, :3] @ np.add(MIDDLE, [4, 0, 5]) + oblique()[:3, 3], atol=0.6)
    # Without the region its voxels are a cavity, which changes the body.
    hollow = scene_of(image(tmp_path / "alone.nii.gz", NESTED, oblique()), more="label = 2", sizes=(6.0,))
    assert level_mesh(hollow, hollow.levels[0]).volume < 0.98 * mesh.volume


@pytest.mark.parametrize(
    ("region", "text"),
    [
        ("{ label = 2 }", "is the label of the body itself"),
        ("{ label = 0 }", "expected the number that it has in the image"),
        ('{ label = "4" }', "expected the number that it has in the image"),
    ],
)
def test_a_label_that_is_no_region_is_refused(tmp_path: Path, region: str, text: str) -> None:
    with pytest.raises(InputError, match=text):
        nested(tmp_path, region)


def test_a_label_that_the_image_lacks_is_refused(tmp_path: Path) -> None:
    scene = nested(tmp_path, "{ label = 9 }")
    with pytest.raises(InputError, match=r"label 9 is not in the image; it has .*: choose one of them in \[regions\]"):
        level_mesh(scene, scene.levels[0])
