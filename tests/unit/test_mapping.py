"""Foreign recordings: wide and long tables, C3D files, alignment, and what is said when the mapping is wrong."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bcid import Measurement
from bcid.base.errors import InputError

HEAD = 'format = "bcid-mapping/1"\nlength_unit = "mm"\ntime_unit = "ms"\nforce_unit = "N"\n'
WIDE = (
    HEAD
    + """file = "wide.csv"
delimiter = ";"
grasp = "II"
noise_sigma = 0.1
[columns]
time = "t"
action = "trial"
translation = ["gx", "gy", "gz"]
[fiducials]
a = ["ax", "ay", "az"]
b = ["bx", "by", "bz"]
"""
)
ROWS = "trial;t;ax;ay;az;bx;by;bz;gx;gy;gz\n" + "".join(
    f"{trial};{10 * i};{i};0;0;;;;{i};0;0\n" for trial in (1, 2) for i in range(5)
)


def write(tmp_path: Path, mapping: str, table: str = ROWS, name: str = "wide.csv") -> Path:
    (tmp_path / name).write_text(table, encoding="utf-8")
    path = tmp_path / "mapping.toml"
    path.write_text(mapping, encoding="utf-8")
    return path


def test_wide_tables(tmp_path: Path) -> None:
    seen = Measurement.read(write(tmp_path, WIDE))
    assert seen.fiducial_names == ["a", "b"]
    assert seen.action_names == ["1", "2"]
    np.testing.assert_allclose(seen.positions[:5, 0, 0], np.arange(5) * 1e-3)
    assert np.isnan(seen.positions[:, 1]).all()
    np.testing.assert_allclose(seen.data["time"].values[:5], np.arange(5) * 0.01)
    np.testing.assert_allclose(seen.actions[1].translation[:, 0], np.arange(5) * 1e-3)
    assert seen.actions[0].grasp == "II"
    assert seen.noise_sigma == pytest.approx(1e-4)


def test_frames_are_chosen_per_action(tmp_path: Path) -> None:
    frames = "[frames]\nfirst = 1\nlast = 3\nevery = 2\n"
    with pytest.raises(InputError, match="at step 0 the gripper must be at rest"):
        Measurement.read(write(tmp_path, WIDE + frames))
    seen = Measurement.read(write(tmp_path, WIDE.replace('translation = ["gx", "gy", "gz"]\n', "") + frames))
    assert list(seen.data["step"].values) == [0, 1, 0, 1]
    np.testing.assert_allclose(seen.data["time"].values, [0, 0.02, 0, 0.02])


def test_long_tables(tmp_path: Path) -> None:
    mapping = HEAD + 'file = "long.csv"\n[columns]\nfiducial = "m"\nstep = "k"\nposition = ["X", "Y", "Z"]\n'
    table = "k,m,X,Y,Z\n0,p,1,2,3\n0,q,4,5,6\n1,q,7,8,9\n"
    seen = Measurement.read(write(tmp_path, mapping, table, "long.csv"))
    assert seen.fiducial_names == ["p", "q"]
    np.testing.assert_allclose(seen.positions[1, 1], [7e-3, 8e-3, 9e-3])
    assert np.isnan(seen.positions[1, 0]).all()
    with pytest.raises(InputError, match=r"no marker 'r' .*known: p, q"):
        Measurement.read(write(tmp_path, mapping + '[fiducials]\nm1 = "r"\n', table, "long.csv"))
    wide = HEAD + 'file = "w.csv"\n[columns]\nstep = "k"\n[fiducials]\na = ["x", "y", "z"]\n'
    with pytest.raises(InputError, match="steps of action 1 do not rise"):
        Measurement.read(write(tmp_path, wide, "k,x,y,z\n0,1,2,3\n2,1,2,3\n1,1,2,3\n", "w.csv"))


def test_alignment_undoes_a_rigid_motion(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    body = rng.random((4, 3)) * 100
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    turn *= np.sign(np.linalg.det(turn))
    camera = body @ turn.T + [5, 6, 7]
    names = "abcd"
    header = ",".join(f"{n}{x}" for n in names for x in "xyz")
    row = ",".join(f"{v:.12f}" for v in camera.ravel())
    mapping = HEAD + 'file = "cam.csv"\n[fiducials]\n' + 'a = ["ax", "ay", "az"]\n[reference]\n'
    mapping += "".join(f'{n} = ["{n}x", "{n}y", "{n}z"]\n' for n in "bcd") + "[align]\n"
    mapping += "".join(f"{n} = {[float(v) for v in p]}\n" for n, p in zip(names, body, strict=True))
    seen = Measurement.read(write(tmp_path, mapping, f"{header}\n{row}\n", "cam.csv"))
    assert seen.fiducial_names == ["a"]
    np.testing.assert_allclose(seen.positions[0, 0], body[0] * 1e-3, atol=1e-12)


def test_c3d_files(tmp_path: Path) -> None:
    """Written by the reference library, read back; a point that was not seen is a gap, not a zero."""
    ezc3d = pytest.importorskip("ezc3d")
    file = ezc3d.c3d()
    file["parameters"]["POINT"]["RATE"]["value"] = [100]
    file["parameters"]["POINT"]["LABELS"]["value"] = ["Tip - 1", "Tip - 2"]
    file["parameters"]["POINT"]["UNITS"]["value"] = ["mm"]
    points = np.ones((4, 2, 6))
    points[:3] = np.arange(36).reshape(3, 2, 6)
    points[:3, 1, 2] = np.nan
    file["data"]["points"] = points
    file.write(str(tmp_path / "moved.c3d"))
    mapping = HEAD + 'file = "moved.c3d"\n[fiducials]\ntip1 = "Tip - 1"\ntip2 = "Tip - 2"\n'
    path = tmp_path / "mapping.toml"
    path.write_text(mapping, encoding="utf-8")
    seen = Measurement.read(path)
    np.testing.assert_allclose(seen.positions[:, 0], points[:3, 0].T * 1e-3, rtol=1e-6)
    assert np.isnan(seen.positions[2, 1]).all()
    np.testing.assert_allclose(seen.data["time"].values, np.arange(6) * 0.01)
    path.write_text(mapping.replace("Tip - 2", "Tipp - 2").replace('"mm"', '"m"'), encoding="utf-8")
    with pytest.raises(InputError) as error:
        Measurement.read(path)
    assert "did you mean 'Tip - 2'" in str(error.value)
    assert "states 'mm'" in str(error.value)
    (tmp_path / "moved.c3d").write_bytes(b"\x02P" + b"\x00" * 100)
    with pytest.raises(InputError, match="not a readable C3D file"):
        Measurement.read(path)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("bcid-mapping/1", "x", "format: expected"),
        ("wide.csv", "none.csv", "file: expected the name"),
        ('"mm"', '"N"', "length_unit"),
        ('grasp = "II"', "grsp = 1", "did you mean 'grasp'"),
        ("noise_sigma = 0.1", "noise_sigma = 0", "noise_sigma: expected a positive"),
        ('";"', '";;"', "delimiter: expected one character"),
        ('";"', '","', "has no column|holds no rows|values"),
        ('["ax", "ay", "az"]', '["ax", "ay"]', "fiducials.a: expected three columns"),
        ('["ax", "ay", "az"]', '["ax", "ay", "aq"]', "has no column 'aq'"),
        ('time = "t"', 'tim = "t"', "columns.tim: unknown key"),
        ("[fiducials]", "[frames]\nevery = 0\n[fiducials]", "frames.every"),
        ("[fiducials]", "[frames]\nfirst = 99\n[fiducials]", "no frame"),
        ("[fiducials]", "[align]\na = [0, 0, 0]\n[fiducials]", "at least three markers"),
    ],
)
def test_mistakes_are_named(tmp_path: Path, old: str, new: str, said: str) -> None:
    assert old in WIDE
    with pytest.raises(InputError, match=said):
        Measurement.read(write(tmp_path, WIDE.replace(old, new)))


def test_text_in_a_number(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"wide\.csv:3: ax: expected a finite number, found 'far'"):
        Measurement.read(write(tmp_path, WIDE, ROWS.replace("1;10;1;", "1;10;far;")))


PLACES = {
    "a": (0.0, 0.0, 0.0),
    "b": (60.0, 5.0, 0.0),
    "c": (10.0, 50.0, 3.0),
    "d": (40.0, 30.0, 45.0),
    "e": (5.0, 20.0, 70.0),
}


def aligned(tmp_path: Path, seen: dict[str, tuple[float, float, float]], scale: float = 1.0) -> Measurement:
    """Read markers that are seen at some places, `scale` times as long as they should, in a turned frame."""
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    rows = [
        f"0,{name},{','.join(str(v) for v in scale * (turn @ place) + [5.0, 6.0, 7.0])}" for name, place in seen.items()
    ]
    mapping = HEAD + 'file = "cam.csv"\n[columns]\nfiducial = "m"\nstep = "k"\nposition = ["x", "y", "z"]\n[align]\n'
    mapping += "".join(f"{name} = {list(place)}\n" for name, place in PLACES.items())
    return Measurement.read(write(tmp_path, mapping, "k,m,x,y,z\n" + "\n".join(rows) + "\n", "cam.csv"))


def test_what_cannot_be_aligned_is_refused_by_its_cause(tmp_path: Path) -> None:
    assert aligned(tmp_path, PLACES).remarks == ()
    off = PLACES | {"e": (8.0, 22.0, 66.0), "b": (58.0, 6.0, 2.0)}
    assert aligned(tmp_path, off).remarks == ()
    with pytest.raises(InputError, match="markers b and d look swapped"):
        aligned(tmp_path, PLACES | {"b": PLACES["d"], "d": PLACES["b"]})
    with pytest.raises(InputError, match=r"places of \[align\] look 1000 times too large: they are in length_unit"):
        aligned(tmp_path, PLACES, 1e-3)
    with pytest.raises(InputError, match="another handedness"):
        aligned(tmp_path, {name: (x, y, -z) for name, (x, y, z) in PLACES.items()})
    with pytest.raises(InputError, match="marker c is absurdly far away"):
        aligned(tmp_path, PLACES | {"c": (1e200, 0.0, 0.0)})
    rng = np.random.default_rng(0)
    with pytest.raises(InputError, match="the rigid motion misses its markers by"):
        aligned(tmp_path, {name: tuple(map(float, 60 * rng.random(3))) for name in PLACES})


def test_a_poor_alignment_is_said(tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    seen = {name: tuple(float(v) for v in np.array(place) + rng.normal(0, 9, 3)) for name, place in PLACES.items()}
    found = aligned(tmp_path, seen)
    (remark,) = found.remarks
    assert remark.startswith("align: the rigid motion misses its markers by")
    assert found.aligned is not None
    assert f"misses its markers by {found.aligned * 1e3:.3g} (RMS distance)" in remark


def test_coordinates_and_forces_that_were_not_measured(tmp_path: Path) -> None:
    mapping = WIDE.replace('["ax", "ay", "az"]', '["ax", "ay", ""]').replace('["bx", "by", "bz"]', '["", "by", "bz"]')
    mapping = mapping.replace("noise_sigma = 0.1", "noise_sigma = [0.1, 0.2, 3]")
    mapping = mapping.replace("[fiducials]", 'wrench = ["", "", "f", "", "", ""]\n[fiducials]')
    table = ROWS.replace("trial;t", "f;trial;t").replace("\n1;", "\n3;1;").replace("\n2;", "\n4;2;")
    seen = Measurement.read(write(tmp_path, mapping, table))
    assert np.isfinite(seen.positions).any(axis=0).tolist() == [[True, True, False], [False, False, False]]
    assert np.isfinite(seen.wrenches).all(axis=0).tolist() == [False, False, True, False, False, False]
    sigma = seen.sigma()
    assert sigma is not None
    np.testing.assert_allclose(sigma[3, 0], [1e-4, 2e-4, 3e-3])
    for written, said in (
        ('["", "", ""]', r'or \["x", "y", ""\] where z was not measured'),
        ("[0.1, 0.2]", "expected one number, or three for x, y and z"),
        ("[0.1, 0.2, 0]", "expected a positive number"),
    ):
        old = '["ax", "ay", ""]' if '"' in written else "[0.1, 0.2, 3]"
        with pytest.raises(InputError, match=said):
            Measurement.read(write(tmp_path, mapping.replace(old, written), table))


def test_an_image_is_aligned_in_its_plane(tmp_path: Path) -> None:
    """An image whose y axis is the z axis of the body."""
    places = {"a": (10.0, 0.0, 5.0), "b": (40.0, 0.0, 5.0), "c": (10.0, 0.0, 60.0), "d": (25.0, 0.0, 20.0)}
    mapping = HEAD + 'file = "cam.csv"\n[columns]\nfiducial = "m"\nstep = "k"\nposition = ["x", "y", ""]\n[align]\n'
    table = "k,m,x,y\n" + "".join(f"0,{name},{x + 3},{z - 2}\n" for name, (x, _, z) in places.items())
    mapping += "".join(f"{name} = {list(place)}\n" for name, place in places.items())
    seen = Measurement.read(write(tmp_path, mapping, table, "cam.csv"))
    assert np.isnan(seen.positions[..., 1]).all()
    there = np.array([places[name] for name in seen.fiducial_names])
    np.testing.assert_allclose(seen.positions[0][:, [0, 2]], there[:, [0, 2]] * 1e-3, atol=1e-9)
    tilted = {name: [x, 0.4 * z, 0.9 * z] for name, (x, _, z) in places.items()}
    for name, place in places.items():
        mapping = mapping.replace(f"{name} = {list(place)}", f"{name} = {tilted[name]}")
    with pytest.raises(InputError, match="turn the scene so that two of its axes lie in the image"):
        Measurement.read(write(tmp_path, mapping, table, "cam.csv"))


GRIPPER = (
    HEAD
    + 'file = "jaw.csv"\ngrasp = "II"\ngrasp_centre = [90, 5, 50]\n[fiducials]\na = ["ax", "ay", "az"]\n[gripper]\n'
    + "".join(f'{n} = ["{n}x", "{n}y", "{n}z"]\n' for n in ("g1", "g2", "g3", "g4"))
)
ON_JAW = np.array([[95.0, 15.0, 45.0], [95.0, 15.0, 55.0], [105.0, 15.0, 50.0], [100.0, 25.0, 50.0]])


def jaw(rotations: np.ndarray, translations: np.ndarray, noise: float = 0.0, lost: tuple[int, ...] = ()) -> str:
    """A table of a marker on the body and of markers on a jaw that moves about (90, 5, 50) mm."""
    rng, centre = np.random.default_rng(2), np.array([90.0, 5.0, 50.0])
    lines = ["ax,ay,az," + ",".join(f"g{k}{x}" for k in range(1, 5) for x in "xyz")]
    for turn, shift in zip(rotations, translations, strict=True):
        seen = (ON_JAW - centre) @ from_vector_matrix(turn).T + centre + shift + rng.normal(0, noise, (4, 3))
        cells = [f"{v:.12f}" for v in seen.ravel()]
        lines.append(
            ",".join(["10", "10", "10", *("" if i // 3 in lost and len(lines) > 1 else c for i, c in enumerate(cells))])
        )
    return "\n".join(lines) + "\n"


def from_vector_matrix(degrees: np.ndarray) -> np.ndarray:
    return np.asarray(Rotation.from_rotvec(degrees, degrees=True).as_matrix())


def test_markers_on_the_gripper_tell_its_motion(tmp_path: Path) -> None:
    turns = np.linspace(0, 1, 5)[:, None] * np.array([4.0, -10.0, 7.0])
    shifts = np.linspace(0, 1, 5)[:, None] * np.array([8.0, 3.0, -2.0])
    seen = Measurement.read(write(tmp_path, GRIPPER, jaw(turns, shifts), "jaw.csv"))
    assert seen.fiducial_names == ["a"]
    (action,) = seen.actions
    assert action.grasp == "II"
    np.testing.assert_allclose(action.translation, shifts * 1e-3, atol=1e-12)
    expected = Rotation.from_rotvec(turns, degrees=True).as_quat(scalar_first=True)
    np.testing.assert_allclose(action.rotation, expected, atol=1e-12)
    # One marker may be hidden, and noise is averaged.
    hidden = Measurement.read(write(tmp_path, GRIPPER, jaw(turns, shifts, 0.02, (3,)), "jaw.csv")).actions[0]
    np.testing.assert_allclose(hidden.translation, shifts * 1e-3, atol=1e-4)


def test_what_is_no_gripper_is_refused(tmp_path: Path) -> None:
    still = np.zeros((4, 3))
    moving = still + np.linspace(0, 5, 4)[:, None]
    for mapping, table, said in (
        (GRIPPER, jaw(still, moving, 3.0), "its markers do not move as one rigid body: they are off by"),
        (GRIPPER, jaw(still, moving, lost=(1, 2)), r"fewer than 3 of its markers are seen, .* in step 1 of action 1"),
        (GRIPPER.replace('grasp = "II"\n', ""), jaw(still, moving), "gripper: whose is it"),
        (GRIPPER.replace("grasp_centre = [90, 5, 50]\n", ""), jaw(still, moving), "grasp_centre: is missing"),
        (GRIPPER.split("g3 =")[0], jaw(still, moving), "name at least three markers"),
        (
            GRIPPER.replace("[fid", '[columns]\ntranslation = ["ax", "ay", "az"]\n[fid'),
            jaw(still, moving),
            "leave columns",
        ),
    ):
        with pytest.raises(InputError, match=said):
            Measurement.read(write(tmp_path, mapping, table, "jaw.csv"))


PULLED = (
    HEAD.replace('"ms"', '"s"')
    + 'file = "cam.csv"\ngrasp = "II"\n[columns]\ntime = "t"\ntranslation = ["gx", "gy", "gz"]\n[fiducials]\n'
    + 'a = ["ax", "ay", "az"]\n[force]\nfile = "machine.csv"\nwrench = ["", "F", "", "", "", ""]\n'
)


def machine(folder: Path, mapping: str, way: np.ndarray, late: float) -> Measurement:
    """A gripper that goes `way` (mm) along y, seen at 0, 1, ... s; the machine's clock is `late`, its force 2 way + way^2 / 10."""
    times = np.arange(len(way), dtype=float)
    rows = [f"{t},{10 + w / 2},10,10,0,{w},0" for t, w in zip(times, way, strict=True)]
    (folder / "cam.csv").write_text("t,ax,ay,az,gx,gy,gz\n" + "\n".join(rows) + "\n", encoding="utf-8")
    clock = np.linspace(0, times[-1], 400)
    gone = np.interp(clock, times, way)
    lines = [f"{t + late:.9f},{5 + w:.9f},{2 * w + w**2 / 10:.9f}" for t, w in zip(clock, gone, strict=True)]
    (folder / "machine.csv").write_text("s,x,F\n" + "\n".join(lines) + "\n", encoding="utf-8")
    path = folder / "mapping.toml"
    path.write_text(mapping, encoding="utf-8")
    return Measurement.read(path)


@pytest.mark.parametrize("keys", ['way = "x"', 'time = "s"\noffset = 37.25', 'time = "s"\nway = "x"'])
def test_forces_of_another_clock_come_to_their_frames(tmp_path: Path, keys: str) -> None:
    way = np.concatenate([[0.0], np.cumsum([1.0, 0.5, 2.0, 0.2, 1.0, 3.0, 0.7])])
    seen = machine(tmp_path, PULLED + keys, way, 37.25)
    np.testing.assert_allclose(seen.wrenches[:, 1], 2 * way + way**2 / 10, atol=2e-2)
    assert np.isnan(seen.wrenches[:, [0, 2, 3, 4, 5]]).all()


def test_a_gripper_that_goes_back_needs_both_clocks(tmp_path: Path) -> None:
    way = np.array([0.0, 1.0, 2.5, 4.0, 3.0, 1.5, 2.0, 5.0, 1.0, 0.0])
    seen = machine(tmp_path, PULLED + 'time = "s"\nway = "x"', way, -2.5)
    np.testing.assert_allclose(seen.wrenches[:, 1], 2 * way + way**2 / 10, atol=0.2)
    with pytest.raises(InputError, match="the gripper goes back, and comes twice to a place: give"):
        machine(tmp_path, PULLED + 'way = "x"', way, -2.5)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('way = "x"', 'way = "y"', r"machine\.csv:1: has no column 'y'"),
        ('way = "x"', "", "force: name its column of time, or of the way of the gripper"),
        ('way = "x"', 'way = "x"\nshift = 1', r"force\.shift: unknown key"),
        ('"", "F", "", "", "", ""', '"F"', "force.wrench: expected six columns"),
        ('time = "t"\n', "", "force.time: the frames of the images have no times"),
        ("machine.csv", "machines.csv", "machines.csv"),
        ('way = "x"', 'way = "x"\noffset = 1', r"force\.offset: is one of clocks; give force\.time too"),
        ('translation = ["gx", "gy", "gz"]\n', "", "the gripper's motion is not known"),
    ],
)
def test_what_is_wrong_with_forces_of_a_file_is_said(tmp_path: Path, old: str, new: str, said: str) -> None:
    mapping = PULLED + 'time = "s"\nway = "x"' if old.startswith("time") else PULLED + 'way = "x"'
    assert old in mapping
    with pytest.raises(InputError, match=said):
        machine(tmp_path, mapping.replace(old, new), np.arange(5.0), 1.0)


PIXELS = '[pixels]\nlength = "0.5 mm"\nuncertainty = 0.02\n'


def test_pixels_have_a_length_and_the_gripper_goes_its_way_in_mm(tmp_path: Path) -> None:
    seen = Measurement.read(write(tmp_path, WIDE + PIXELS))
    np.testing.assert_allclose(seen.positions[:5, 0, 0], 0.5e-3 * np.arange(5))
    np.testing.assert_allclose(seen.actions[1].translation[:, 0], np.arange(5) * 1e-3)
    assert (seen.scale_sigma, seen.scale_of_gripper) == (0.02, False)
    assert seen.noise_sigma == pytest.approx(1e-4)
    plain = Measurement.read(write(tmp_path, WIDE))
    assert (plain.scale_sigma, plain.scale_of_gripper) == (None, False)


def test_a_gripper_that_pictures_show_has_the_factor_of_their_pixels(tmp_path: Path) -> None:
    jaw = {"j": (0, 0), "k": (10, 0), "l": (0, 10)}
    names = [f"{name}{axis}" for name in jaw for axis in "xyz"]
    table = ",".join(["ax", "ay", "az", *names]) + "\n"
    for i in range(3):
        cells = [i, 5, 0, *(v for x, y in jaw.values() for v in (x + 2 * i, y, 0))]
        table += ",".join(map(str, cells)) + "\n"
    markers = "".join(f'{name} = ["{name}x", "{name}y", "{name}z"]\n' for name in jaw)
    mapping = HEAD + 'file = "w.csv"\ngrasp = "II"\ngrasp_centre = [1, 2, 3]\n[fiducials]\na = ["ax", "ay", "az"]\n'
    seen = Measurement.read(write(tmp_path, mapping + f"[gripper]\n{markers}" + PIXELS, table, "w.csv"))
    np.testing.assert_allclose(seen.actions[0].translation[:, 0], [0, 1e-3, 2e-3], atol=1e-12)
    assert (seen.scale_sigma, seen.scale_of_gripper) == (0.02, True)


@pytest.mark.parametrize(
    ("pixels", "said"),
    [
        ("[pixels]\nuncertainty = 0.02\n", "pixels.length: is missing; write the length of a pixel"),
        ('[pixels]\nlength = "0 mm"\n', "pixels.length: '0 mm' must be positive"),
        ("[pixels]\nlength = 0.05\n", "pixels.length: "),
        (
            '[pixels]\nlength = "1 mm"\nuncertainty = 2\n',
            r"pixels.uncertainty: expected a number above 0 and up to 0.3",
        ),
        ('[pixels]\nlength = "1 mm"\nuncertain = 0.1\n', "pixels.uncertain: unknown key; did you mean 'uncertainty'"),
        ("pixels = 3\n", "pixels: expected a table"),
    ],
)
def test_pixels_that_say_too_little_are_refused(tmp_path: Path, pixels: str, said: str) -> None:
    mapping = pixels + WIDE if pixels.startswith("pixels") else WIDE + pixels
    with pytest.raises(InputError, match=said):
        Measurement.read(write(tmp_path, mapping))
