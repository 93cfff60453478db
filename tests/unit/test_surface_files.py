"""Clouds and depth images, a file a step, as the points of a surface."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bcid.base.errors import InputError
from bcid.measurement import Measurement
from bcid.measurement.surface_files import MOST_POINTS

cv2 = pytest.importorskip("cv2")
meshio = pytest.importorskip("meshio")

HEAD = 'format = "bcid-measurement/1"\nlength_unit = "mm"\ntime_unit = "s"\nforce_unit = "N"\n'
PCD = """# .PCD v0.7
VERSION 0.7
FIELDS intensity x y z
SIZE 4 4 4 4
TYPE F F F F
COUNT 1 1 1 1
WIDTH {n}
HEIGHT 1
POINTS {n}
DATA {kind}
"""


def save_ply(file: Path, points: np.ndarray) -> None:
    meshio.Mesh(points, [("vertex", np.arange(len(points))[:, None])]).write(file)


def save_pcd(file: Path, points: np.ndarray, kind: str) -> None:
    table = np.column_stack([np.zeros(len(points)), points]).astype("<f4")
    head = PCD.format(n=len(points), kind=kind).encode()
    rows = "\n".join(" ".join(f"{v:.9g}" for v in row) for row in table).encode()
    file.write_bytes(head + (table.tobytes() if kind == "binary" else rows))


def save_text(file: Path, points: np.ndarray) -> None:
    np.savetxt(file, np.column_stack([points, np.ones(len(points))]), delimiter=",", header="x,y,z,red", comments="")


SAVE: dict[str, Callable[[Path, np.ndarray], None]] = {
    "ply": save_ply,
    "npy": np.save,
    "csv": save_text,
    "pcd": lambda file, points: save_pcd(file, points, "binary"),
}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A measurement of two steps without fiducials, but for the points."""
    (tmp_path / "measurement.toml").write_text(HEAD)
    poses = "action,step,time,grasp,x,y,z,qw,qx,qy,qz\na,0,0,I,0,0,0,1,0,0,0\na,1,1,I,1,0,0,1,0,0,0\n"
    (tmp_path / "grasps.csv").write_text(poses)
    return tmp_path


@pytest.mark.parametrize("kind", list(SAVE))
def test_clouds_of_every_kind_are_read(folder: Path, kind: str) -> None:
    (folder / "measurement.toml").write_text(
        HEAD + f'[surface]\nclouds = "c/{{action}}_{{step}}.{kind}"\nunit = "m"\nsigma = 0.5\n'
    )
    (folder / "c").mkdir()
    points = np.random.default_rng(1).uniform(0, 0.1, (2, 30, 3))
    for step in range(2):
        SAVE[kind](folder / "c" / f"a_{step:03d}.{kind}", points[step])
    cloud = Measurement.read(folder).cloud
    assert cloud is not None
    assert cloud.frames == (("a", 0), ("a", 1))
    assert cloud.points == pytest.approx(points.reshape(-1, 3), abs=1e-7)
    assert cloud.sigma == pytest.approx(0.5e-3)
    assert cloud.camera is None


def test_clouds_as_text_of_the_point_cloud_library_and_a_box(folder: Path) -> None:
    box = "box = [[0, 20, 0], [50, 100, 100]]\n"
    (folder / "measurement.toml").write_text(HEAD + f'[surface]\nclouds = "{{step}}.pcd"\nunit = "m"\n{box}')
    points = np.random.default_rng(1).uniform(0, 0.1, (30, 3))
    save_pcd(folder / "0.pcd", points, "ascii")
    cloud = Measurement.read(folder).cloud
    assert cloud is not None
    assert cloud.points == pytest.approx(points[(points[:, 0] <= 0.05) & (points[:, 1] >= 0.02)], abs=1e-7)


@pytest.mark.parametrize("kind", ["png", "npy"])
def test_depth_images_are_seen_from_where_the_camera_is(folder: Path, kind: str) -> None:
    """A tilted plane, whose points are known without the camera's own formula: on it, and on the pixels' rays."""
    turn, place = Rotation.from_euler("xyz", [170, 12, 5], degrees=True), np.array([40.0, 300.0, 60.0])
    quaternion = ", ".join(f"{v:.16g}" for v in turn.as_quat(scalar_first=True))
    camera = f"[surface.camera]\nfx = 200\nfy = 210\ncx = 31.5\ncy = 23.5\nposition = [40, 300, 60]\nrotation = [{quaternion}]\n"
    (folder / "measurement.toml").write_text(HEAD + f'[surface]\ndepth = "{{step}}.{kind}"\nunit = "mm"\n{camera}')
    v, u = np.mgrid[0:48, 0:64]
    rays = np.stack([(u - 31.5) / 200, (v - 23.5) / 210, np.ones(u.shape)], axis=-1)
    normal = np.array([0.1, -0.2, 1.0])
    depth = 280.0 / (rays @ normal)
    depth[:5] = 0.0
    if kind == "png":
        assert cv2.imwrite(str(folder / "0.png"), np.round(depth).astype(np.uint16))
    else:
        np.save(folder / "0.npy", depth)
    cloud = Measurement.read(folder).cloud
    assert cloud is not None
    assert len(cloud.points) == 43 * 64
    assert cloud.camera == pytest.approx(place * 1e-3)
    seen = turn.inv().apply(1e3 * cloud.points - place)
    assert seen @ normal == pytest.approx(280.0, abs=0.8 if kind == "png" else 1e-9)
    assert seen[:, :2] / seen[:, 2:] == pytest.approx(rays[5:].reshape(-1, 3)[:, :2])


def test_of_a_dense_cloud_points_are_taken_evenly(folder: Path) -> None:
    (folder / "measurement.toml").write_text(HEAD + '[surface]\nclouds = "{step}.npy"\n')
    np.save(folder / "0.npy", np.column_stack([np.arange(3 * MOST_POINTS), *np.zeros((2, 3 * MOST_POINTS))]))
    cloud = Measurement.read(folder).cloud
    assert cloud is not None
    assert np.diff(1e3 * cloud.points[:, 0]) == pytest.approx(3.0)


@pytest.mark.parametrize(
    ("table", "files", "message"),
    [
        ('[surface]\nclouds = "{step}.ply"\n', {}, "holds no file"),
        ('[surface]\nclouds = "{step}.ply"\n', {"7.ply": b"ply"}, "step 7 of action 'a', whose time no table tells"),
        ('[surface]\nclouds = "{step}.ply"\n', {"0.ply": b"nonsense"}, "a file of the surface cannot be read"),
        ('[surface]\nclouds = "{step}.stl"\n', {}, "expected one of .ply"),
        ('[surface]\nclouds = "../{step}.ply"\n', {}, "expected a path in this folder"),
        ('[surface]\ndepth = "{step}.png"\n', {}, "surface.camera.fx: is needed for depth images"),
        ('[surface]\nclouds = "{step}.ply"\nunit = "kg"\n', {}, "unit"),
        ('[surface]\nclouds = "{step}.ply"\nbox = [[0, 0, 0], [0, 1, 1]]\n', {}, "two corners, the lower first"),
        ('[surface]\nclouds = "{step}.ply"\ncloud = 1\n', {}, "surface.cloud: unknown key"),
        ("[surface]\nsigma = 1\n", {}, "expected clouds ="),
        ("surface = 3\n", {}, "expected a table"),
        ("", {}, "fiducials.csv.*is missing"),
    ],
)
def test_what_is_wrong_is_said_in_words(folder: Path, table: str, files: dict[str, bytes], message: str) -> None:
    (folder / "measurement.toml").write_text(HEAD + table)
    for name, content in files.items():
        (folder / name).write_bytes(content)
    with pytest.raises(InputError, match=message):
        Measurement.read(folder)
