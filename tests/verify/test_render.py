"""Rendered pictures show each bead where the camera's formulas say it is, and the truth about what is hidden is right."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from bcid.base.errors import InputError
from bcid.vision.camera import Camera, Cameras
from validation.rendering.appearance import Appearance
from validation.rendering.instruments import instruments
from validation.rendering.renderer import Renderer
from validation.rendering.rig import Pose, looking_at, stereo_rig
from validation.rendering.shot import Gripper, Rod

pytest.importorskip("cv2")
pytest.importorskip("pyvista")

Array = NDArray[np.float64]
Triangles = NDArray[np.int64]

SIZE = (640, 512)
# Light from everywhere, so that a bead is as dark on all sides; body and background are equally bright.
FLAT = Appearance(
    ambient=1, strength=0, specular=0, noise=0, texture=0, bead=0.1, body=0.8, background=0.8, diameter=2e-3
)
# Moves the corners of the image by more than 10 px; the small image has few pixels per radian.
STRONG = (-0.35, 0.15, 1e-3, -1e-3, 0.0)
NO_TURN = np.array([1.0, 0, 0, 0])
UP = np.array([0, 1.0, 0])


def slab(count: int = 10) -> tuple[Array, Triangles]:
    """Surface of the benchmark slab, m."""
    a, b = np.meshgrid(np.arange(count + 1), np.arange(count + 1), indexing="ij")
    grid = np.column_stack([a.ravel(), np.zeros(a.size), b.ravel()]) * 0.1 / count
    node = np.arange(a.size).reshape(a.shape)
    p, q, r, s = (node[i : i + count, j : j + count].ravel() for i, j in ((0, 0), (0, 1), (1, 1), (1, 0)))
    top = np.concatenate([np.column_stack([p, q, r]), np.column_stack([p, r, s])])
    edge = np.concatenate([node[:, 0], node[-1, 1:], node[-2::-1, -1], node[0, -2:0:-1]])
    following, below = np.roll(edge, -1), a.size
    upper, lower = [edge, following, edge + below], [following, following + below, edge + below]
    faces = [top, top[:, ::-1] + below, np.column_stack(upper), np.column_stack(lower)]
    return np.concatenate([grid + 0.01 * UP, grid]), np.concatenate(faces)


def fiducials() -> Array:
    """Where beads are glued, m."""
    return np.array([[x, 10, z] for z in (12.5, 37.5, 62.5, 87.5) for x in (15, 35, 55, 75)]) * 1e-3


def ups(count: int) -> Array:
    return np.tile(UP, (count, 1))


@pytest.fixture(scope="module")
def rig() -> tuple[Cameras, Pose]:
    return stereo_rig(size=SIZE, distortion=STRONG)


def centroid(picture: NDArray[np.uint8], near: Array, reach: int) -> Array:
    """Middle (u, v) of what is darker than the surroundings in a square around a pixel."""
    u, v = np.rint(near).astype(int)
    part = picture[v - reach : v + reach + 1, u - reach : u + reach + 1].astype(float)
    dark = np.median(picture) - part
    along = np.arange(-reach, reach + 1)
    return np.array([u + (dark.sum(axis=0) @ along) / dark.sum(), v + (dark.sum(axis=1) @ along) / dark.sum()])


def spread(cameras: Cameras, pose: Pose) -> Array:
    """Points of the plane y = 10 mm all over both images; some are only in one."""
    grid = np.stack(np.meshgrid(np.linspace(-0.1, 0.2, 16), 0.01, np.linspace(-0.1, 0.2, 16)), axis=-1).reshape(-1, 3)
    pixels = np.stack(cameras.project(grid @ pose[0].T + pose[1]))
    return grid[inside(pixels).any(axis=0)]


def inside(pixels: Array) -> NDArray[np.bool_]:
    """Which pixels (..., 2) are not at the border of the image."""
    return np.asarray(((pixels > 15) & (pixels < np.array(SIZE) - 16)).all(axis=-1))


def test_a_bead_is_seen_where_it_is(rig: tuple[Cameras, Pose]) -> None:
    cameras, pose = rig
    corner = np.array([[0.0, 0.0]])
    ray = np.append(cameras.left.undistort(corner), [[1.0]], axis=1)
    assert np.linalg.norm(replace(cameras.left, distortion=np.zeros(0)).project(ray) - corner) > 10
    points, triangles = slab()
    # A sheet wider than the pictures: the beads are all before the same grey.
    sheet = (points - [0.05, 0, 0.05]) * [6, 1, 6] + [0.05, 0, 0.05]
    surface = spread(cameras, pose)
    beads, normals = FLAT.centres(surface, ups(len(surface))), ups(len(surface))
    with Renderer(cameras, pose, FLAT) as renderer:
        stereo = renderer.frame(sheet, triangles, beads, normals)
    expected = cameras.project(beads @ pose[0].T + pose[1])
    for side, picture in enumerate((stereo.left, stereo.right)):
        np.testing.assert_allclose(stereo.pixels[side], expected[side], atol=1e-9)
        here = inside(expected[side])
        assert stereo.visible[side, here].all()
        pixels = expected[side][here]
        assert np.ptp(pixels, axis=0) == pytest.approx(np.array(SIZE) - 30, abs=60)
        off = np.array([centroid(picture, p, 7) - p for p in pixels])
        assert np.abs(off).max() < 0.02
        assert np.abs(off.mean(axis=0)).max() < 0.002


def test_the_body_is_seen_where_it_is(rig: tuple[Cameras, Pose]) -> None:
    """A body of the shape of a small ball, drawn by VTK and bent like the lens, has its middle where its centre is."""
    import pyvista as pv

    cameras, pose = rig
    ball = pv.Icosphere(radius=0.003, nsub=4)
    triangles = np.array(ball.faces.reshape(-1, 4)[:, 1:], dtype=np.int64)
    look = replace(FLAT, body=0.1)
    # The only bead is out of the way, behind the body.
    offs = []
    with Renderer(cameras, pose, look) as renderer:
        for place in spread(cameras, pose)[::15]:
            stereo = renderer.frame(ball.points + place, triangles, place[None] - [0, 0.001, 0], ups(1))
            projected = cameras.project(place[None] @ pose[0].T + pose[1])
            for picture, pixel in zip((stereo.left, stereo.right), projected, strict=True):
                if inside(pixel[0]):
                    offs.append(centroid(picture, pixel[0], 15) - pixel[0])
            assert not stereo.visible.any()
    assert len(offs) > 8
    # A ball this large is an ellipse whose middle is up to 0.03 px beside the image of its centre.
    assert np.abs(offs).max() < 0.06
    assert np.abs(np.mean(offs, axis=0)).max() < 0.02


def test_what_is_hidden_is_known(rig: tuple[Cameras, Pose]) -> None:
    cameras, pose = rig
    points, triangles = slab()
    look = Appearance()
    surface = np.concatenate([fiducials(), [[0.05, 0, 0.05], [0.95, 0.01, 0.05]]])
    normals = np.concatenate([ups(16), -ups(1), ups(1)])
    beads = look.centres(surface, normals)
    box = Gripper(np.zeros(3), NO_TURN, np.array([0.07, -0.004, 0.03]), np.array([0.12, 0.014, 0.045]))
    # Two rods that the left camera sees where the first bead is: before it, and behind it.
    eye = -pose[0].T @ pose[1]
    between, beyond = (beads[0] + part * (eye - beads[0]) for part in (0.3, -0.2))
    along = np.array([0, 0, 0.01])
    rod = Rod(between - along, between + along, 2e-3)
    deep = Rod(beyond - along, beyond + along, 2e-3)
    table = box._replace(lower=np.array([-1, -0.04, -1]), upper=np.array([1, -0.03, 1]))
    away = box._replace(translation=np.array([0.1, 0, 0]))
    with Renderer(cameras, pose, look) as renderer:
        plain = renderer.frame(points, triangles, beads, normals).visible
        held = renderer.frame(points, triangles, beads, normals, box).visible
        moved = renderer.frame(points, triangles, beads, normals, away).visible
        barred = renderer.frame(points, triangles, beads, normals, None, [rod]).visible
        below = renderer.frame(points, triangles, beads, normals, table, [deep]).visible
    # 16 is under the body, 17 is out of the picture.
    np.testing.assert_array_equal(plain, np.tile([*[True] * 16, False, False], (2, 1)))
    assert np.flatnonzero(plain[0] & ~held[0]).tolist() == np.flatnonzero(plain[1] & ~held[1]).tolist() == [7]
    np.testing.assert_array_equal(moved, plain)
    assert np.argwhere(plain & ~barred).tolist() == [[0, 0]]
    np.testing.assert_array_equal(below, plain)


@pytest.mark.parametrize(("part", "seen"), [(0.3, True), (0.5, False)])
def test_a_bead_that_is_half_hidden_counts_as_hidden(part: float, seen: bool) -> None:
    """A wall's edge goes past a bead seen from straight above, so that a known part of its diameter is behind."""
    pose = looking_at(np.array([0.05, 0, 0.05]), np.array([0.05, 0.3, 0.05]), np.array([1.0, 0, 0]))
    camera = Camera(np.array([[1200, 0, 319.5], [0, 1200, 255.5], [0, 0, 1]]), np.zeros(0), SIZE)
    cameras = Cameras(camera, camera, np.eye(3), np.array([-0.01, 0, 0]))
    look = Appearance(diameter=2e-3)
    bead = look.centres(np.array([[0.05, 0.01, 0.05]]), ups(1))
    # The edge just above the bead: the ray to it is nearly vertical.
    edge = 0.05 - look.radius + part * look.diameter
    box = Gripper(np.zeros(3), NO_TURN, np.array([0.02, 0.0121, 0.02]), np.array([edge, 0.0122, 0.08]))
    with Renderer(cameras, pose, look) as renderer:
        assert renderer.frame(*slab(), bead, ups(1), box).visible[0, 0] == seen


def test_pictures_repeat_and_noise_is_as_stated() -> None:
    cameras, pose = stereo_rig(size=(320, 256))
    points, triangles = slab()
    look = Appearance(noise=3.0, decoys=3)

    def pictures(seed: int, look: Appearance) -> NDArray[np.uint8]:
        with Renderer(cameras, pose, look, seed) as renderer:
            frames = [renderer.frame(points, triangles, look.centres(fiducials(), ups(16)), ups(16)) for _ in range(2)]
        return np.array([[stereo.left, stereo.right] for stereo in frames])

    first = pictures(1, look)
    np.testing.assert_array_equal(first, pictures(1, look))
    assert (first != pictures(2, look)).mean() > 0.5
    noise = first - pictures(1, replace(look, noise=0.0)).astype(float)
    # Rounding to whole grey levels adds 1/12 twice.
    assert noise.std() == pytest.approx(np.sqrt(9 + 2 / 12), rel=0.02)
    assert abs(noise.mean()) < 0.02
    assert abs(np.corrcoef(noise[0].ravel(), noise[1].ravel())[0, 1]) < 0.01


def test_decoys_are_dark_dots_beside_the_body(rig: tuple[Cameras, Pose]) -> None:
    cameras, pose = rig
    points, triangles = slab()
    beads = FLAT.centres(fiducials(), ups(16))
    box = Gripper(np.zeros(3), NO_TURN, np.array([0.08, -0.004, 0.04]), np.array([0.12, 0.014, 0.06]))

    def dark(decoys: int, gripper: Gripper | None) -> int:
        import cv2

        with Renderer(cameras, pose, replace(FLAT, decoys=decoys), 3) as renderer:
            picture = renderer.frame(points, triangles, beads, ups(16), gripper).left
        return int(cv2.connectedComponents((picture < 80).astype(np.uint8))[0]) - 1

    assert dark(0, None) == 16
    assert dark(6, None) == 22
    # Two of six are on the gripper, which need not be in the picture as a whole.
    assert dark(0, box) < dark(6, box) <= 22


@pytest.mark.parametrize(("share", "seed"), [(0.2, 0), (0.05, 1), (0.4, 2)])
def test_instruments_hide_the_wanted_share(share: float, seed: int) -> None:
    cameras, pose = stereo_rig(size=(160, 128))
    points, triangles = slab(4)
    look = Appearance(noise=0, blur=0, texture=0, supersampling=6)
    pull = np.linspace(0, 0.015, 20)[:, None, None] * np.array([1.0, 0.3, 0])
    beads = look.centres(fiducials(), ups(16)) + pull
    rods = instruments(share, beads, cameras, pose, seed)
    assert len(rods) == 20
    tips = np.array([[rod.start for rod in frame] for frame in rods])
    assert np.linalg.norm(np.diff(tips, axis=0), axis=-1).max() < 0.03
    with Renderer(cameras, pose, look) as renderer:
        frames = [renderer.frame(points + pull[i], triangles, beads[i], ups(16), None, rods[i]) for i in range(20)]
    hidden = 1 - np.mean([frame.visible.all(axis=0) for frame in frames])
    assert hidden == pytest.approx(share, abs=0.04)


def test_no_share_needs_no_instruments(rig: tuple[Cameras, Pose]) -> None:
    assert instruments(0, fiducials()[None], *rig) == [[]]


def test_the_rig_sees_the_whole_slab_and_a_pull() -> None:
    cameras, pose = stereo_rig()
    assert cameras.angle == pytest.approx(30)
    corners = np.array([[x, y, z] for x in (0, 0.13) for y in (0, 0.01) for z in (0, 0.1)])
    for pixels in cameras.project(corners @ pose[0].T + pose[1]):
        assert ((pixels > 0) & (pixels < [1279, 1023])).all()
    eye = -pose[0].T @ pose[1]
    assert np.linalg.norm(eye - [0.061, 0.005, 0.05]) == pytest.approx(0.3)
    assert np.cross(pose[0][0], pose[0][1]) == pytest.approx(pose[0][2])


def test_bad_input_is_an_input_error(rig: tuple[Cameras, Pose]) -> None:
    cameras, pose = rig
    points, triangles = slab(2)
    beads, normals = fiducials(), ups(16)
    with Renderer(cameras, pose, FLAT) as renderer:
        with pytest.raises(InputError, match="triangles: nodes 0 to 99"):
            renderer.frame(points, np.array([[0, 1, 99]]), beads, normals)
        with pytest.raises(InputError, match="points: 1 of 18 rows are not finite, the first is row 3"):
            renderer.frame(np.where(np.arange(18)[:, None] == 3, np.nan, points), triangles, beads, normals)
        with pytest.raises(InputError, match="normals: 2 for 16 beads"):
            renderer.frame(points, triangles, beads, normals[:2])
        with pytest.raises(InputError, match="rod 0"):
            renderer.frame(points, triangles, beads, normals, None, [Rod(UP, UP, -1.0)])
        with pytest.raises(InputError, match="unit quaternion"):
            renderer.frame(points, triangles, beads, normals, Gripper(UP, 2 * NO_TURN, UP, UP + 1))
    blind = replace(cameras, left=replace(cameras.left, size=(0, 0)))
    with pytest.raises(InputError, match="left camera has images of 0 x 0 px"):
        Renderer(blind, pose)
    with pytest.raises(InputError, match="not a 3 x 3 rotation"):
        Renderer(cameras, (2 * np.eye(3), np.zeros(3)))
    with pytest.raises(InputError, match="diameter"):
        Appearance(diameter=-1e-3)
    with pytest.raises(InputError, match="on one line"):
        looking_at(np.zeros(3), UP, UP)
    with pytest.raises(InputError, match="share"):
        instruments(1.5, fiducials()[None], *rig)
