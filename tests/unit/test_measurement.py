"""The measurement folder: round trips, and one readable message for whatever is wrong."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from bcid import Measurement, Scene
from bcid.base.errors import InputError
from bcid.scene.uncertainty import Uncertainty

ROOT = Path(__file__).resolve().parents[2]
SHIPPED = sorted((ROOT / "examples/measurements").glob("slab-*"))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    target = tmp_path / "seen"
    shutil.copytree(ROOT / "examples/measurements/slab-12-semicircle", target)
    return target


def edit(path: Path, line: int, change: str) -> None:
    """Replace a line (counted from 1) of a file."""
    lines = path.read_text(encoding="utf-8").splitlines()
    lines[line - 1] = change
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


@pytest.mark.parametrize("path", SHIPPED, ids=lambda p: p.name)
def test_round_trips(path: Path, tmp_path: Path) -> None:
    measurement = Measurement.read(path)
    measurement.write(tmp_path / "again")
    measurement.to_netcdf(tmp_path / "again.nc")
    for copy in (Measurement.read(tmp_path / "again"), Measurement.read(tmp_path / "again.nc")):
        assert copy.fingerprint() == measurement.fingerprint()
        assert copy.units == measurement.units
        assert copy.noise_sigma == measurement.noise_sigma


def test_optional_files_round_trip(folder: Path, tmp_path: Path) -> None:
    head = "action,step,time"
    (folder / "wrench.csv").write_text(
        f"{head},fx,fy,fz,tx,ty,tz\n1,0,0,0,0,0,0,0,0\n1,1,1,1,2,3,4,5,6\n", encoding="utf-8"
    )
    (folder / "loads.csv").write_text(f"{head},place,fx,fy,fz\n1,1,1,tip,0,-0.5,0\n", encoding="utf-8")
    edit(folder / "fiducials.csv", 4, "1,0,0,3,,,")
    measurement = Measurement.read(folder)
    assert measurement.data["wrench"].values[1] == pytest.approx([1, 2, 3, 4e-3, 5e-3, 6e-3])
    np.testing.assert_allclose(measurement.actions[0].loads["tip"][1], [0, -0.5, 0])
    assert np.isnan(measurement.positions[0, 2]).all()
    measurement.write(tmp_path / "again")
    assert Measurement.read(tmp_path / "again").fingerprint() == measurement.fingerprint()


FRAME = """format = "bcid-frame/1"
centre = [50, 10, 50]
covariance = [
  [1e-6, 0, 0, 0, 0, 0, 0], [0, 1e-6, 0, 2e-5, 0, 0, 0], [0, 0, 1e-6, 0, 0, 0, 0],
  [0, 2e-5, 0, 1e-2, 0, 0, 0], [0, 0, 0, 0, 1e-2, 0, 0], [0, 0, 0, 0, 0, 1e-2, 0], [0, 0, 0, 0, 0, 0, 0],
]
"""


def test_the_error_of_the_frame_round_trips(folder: Path, tmp_path: Path) -> None:
    without = Measurement.read(folder)
    (folder / "frame.toml").write_text(FRAME, encoding="utf-8")
    measurement = Measurement.read(folder)
    error = measurement.frame_error
    assert error is not None
    assert error.centre == pytest.approx([0.05, 0.01, 0.05])
    assert error.covariance[3, 3] == pytest.approx(1e-8)
    assert error.covariance[1, 3] == pytest.approx(2e-8)
    assert error.rms(error.centre[None]) == pytest.approx(1e-4)
    assert measurement.fingerprint() != without.fingerprint()
    measurement.write(tmp_path / "again")
    measurement.to_netcdf(tmp_path / "again.nc")
    for copy in (tmp_path / "again", tmp_path / "again.nc"):
        assert Measurement.read(copy).fingerprint() == measurement.fingerprint()


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("[50, 10, 50]", "[50, 10]", "centre: expected 3 finite numbers"),
        ("bcid-frame/1", "bcid-scene/1", 'expected "bcid-frame/1"'),
        ("2e-5, 0, 0, 0], [0, 0, 1e-6", "9e-5, 0, 0, 0], [0, 0, 1e-6", "symmetric matrix"),
        ("[1e-6,", "[-1e-6,", "without negative eigenvalues"),
        ("centre", "center", "did you mean 'centre'"),
        ("[50, 10, 50]", "[50, nan, 50]", "centre: expected 3 finite numbers"),
        ("[50, 10, 50]", "[50,", "not a TOML file"),
    ],
)
def test_a_bad_error_of_the_frame_is_refused(folder: Path, old: str, new: str, words: str) -> None:
    assert old in FRAME
    (folder / "frame.toml").write_text(FRAME.replace(old, new), encoding="utf-8")
    with pytest.raises(InputError, match=words):
        Measurement.read(folder)


def test_a_bad_error_of_the_frame_in_netcdf_is_refused(folder: Path, tmp_path: Path) -> None:
    (folder / "frame.toml").write_text(FRAME, encoding="utf-8")
    Measurement.read(folder).to_netcdf(tmp_path / "good.nc")
    with xr.open_dataset(tmp_path / "good.nc", engine="scipy") as opened:
        data = opened.load()
    data.attrs["frame_covariance"] = -data.attrs["frame_covariance"]
    data.to_netcdf(tmp_path / "bad.nc", engine="scipy")
    with pytest.raises(InputError, match="without negative eigenvalues"):
        Measurement.read(tmp_path / "bad.nc")


def test_read_sigma_below_any_instrument_is_refused_with_its_line(folder: Path) -> None:
    """Its square is zero: divided by it, whatever is compared would be nothing or infinite."""
    text = "action,step,time,fiducial,x,y,z,sigma_x,sigma_y,sigma_z\n1,0,0,1,15,10,12,1e-300,0.1,0.1\n"
    (folder / "fiducials.csv").write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=r"fiducials.csv:2: sigma_x: expected a positive number of at least 1e-15 m"):
        Measurement.read(folder)


def test_own_sigma_and_spreadsheet_habits(folder: Path) -> None:
    """Columns in another order, a byte order mark, blank lines and Windows line ends are no mistakes."""
    text = "\ufefffiducial,sigma_x,sigma_y,sigma_z,action,step,time,x,y,z\r\n1,0.1,0.2,0.4,1,0,0,15,10,12\r\n"
    text += "\r\n1,,,,1,1,1,15,10,12\r\n"
    (folder / "fiducials.csv").write_text(text, encoding="utf-8")
    lines = (folder / "grasps.csv").read_text(encoding="utf-8").splitlines()[:3]
    (folder / "grasps.csv").write_text("\n".join(lines), encoding="utf-8")
    sigma = Measurement.read(folder).sigma()
    np.testing.assert_allclose(sigma[0, 0], [1e-4, 2e-4, 4e-4])
    np.testing.assert_allclose(sigma[1, 0], 3e-4)


def test_an_action_without_grasp(folder: Path) -> None:
    (folder / "grasps.csv").write_text("action,step,time,grasp,x,y,z,qw,qx,qy,qz\n", encoding="utf-8")
    action = Measurement.read(folder).actions[0]
    assert action.grasp == ""
    assert not action.translation.any()


HEAD = "action,step,time,fiducial,x,y,z"


@pytest.mark.parametrize(
    ("file", "line", "change", "said"),
    [
        (
            "fiducials.csv",
            1,
            "action,step,time,fiducial,sigma_x,sigma_y,sigma_z",
            "fiducials.csv:1: column x, y, z is missing",
        ),
        ("fiducials.csv", 1, HEAD + ",w", "fiducials.csv:1: unknown column 'w'"),
        ("fiducials.csv", 1, "action,step,time,fiducial,x,y,y", "column y stands twice"),
        ("fiducials.csv", 3, "1,0,0,2,abc,10,12", "fiducials.csv:3: x: expected a finite number, found 'abc'"),
        ("fiducials.csv", 3, "1,0,0,2,nan,10,12", "fiducials.csv:3: x: expected a finite number, found 'nan'; leave"),
        ("fiducials.csv", 3, "1,0,0,2,1_5,10,12", "found '1_5'"),
        ("fiducials.csv", 3, "1,0,0,2,inf,10,12", "found 'inf'"),
        (
            "fiducials.csv",
            3,
            "1,0,0,1,15,10,12",
            "fiducials.csv:3: a second row for action 1, step 0, fiducial 1; .* line 2",
        ),
        ("fiducials.csv", 3, "1,0,0,2,15,10", "fiducials.csv:3: has 6 values, the header names 7"),
        ("fiducials.csv", 3, "1,x,0,2,15,10,12", "step: expected a whole number from 0, found 'x'"),
        ("fiducials.csv", 3, "1,-1,0,2,15,10,12", "step: expected a whole number"),
        ("fiducials.csv", 3, "1,0,5,2,15,10,12", "time: step 0 of action 1 is at 0 s elsewhere, here at 5 s"),
        ("fiducials.csv", 3, ",0,0,2,15,10,12", "action: expected a short name"),
        ("fiducials.csv", 3, "1,0,0,,15,10,12", "fiducial: its name is empty"),
        ("fiducials.csv", 30, "1,0,0,99,15,10,12", "step 0 of action 1 stands after step 1: sort"),
        ("grasps.csv", 2, "1,0,0,II,1,0,0,1,0,0,0", "step 0 of action 1 must be the rest pose"),
        ("grasps.csv", 3, "1,1,1,II,1,0,0,2,0,0,0", "grasps.csv:3: .* unit quaternion, found one of length 2"),
        ("grasps.csv", 3, "1,1,1,II,1,0,0,0,0,0,0", "unit quaternion, found one of length 0"),
        ("grasps.csv", 3, "1,1,1,,1,0,0,1,0,0,0", "grasp: its name is empty"),
        ("grasps.csv", 3, "1,1,1,III,1,0,0,1,0,0,0", "uses grasps II, III"),
        ("grasps.csv", 3, "", "no pose of the gripper for step 1"),
        ("grasps.csv", 3, "2,1,1,II,1,0,0,1,0,0,0", "action 2 starts at step 1"),
        ("measurement.toml", 1, 'format = "x"', "format: expected"),
        ("measurement.toml", 2, 'length_unit = "kg"', "length_unit: unit 'kg' cannot be used"),
        ("measurement.toml", 2, "", 'length_unit: is missing; write length_unit = "mm"'),
        ("measurement.toml", 5, "noise_sigma = -1", "noise_sigma: expected a positive number"),
        ("measurement.toml", 5, "noise_sigma = 1e-300", "noise_sigma: expected a positive number from 1e-12"),
        ("measurement.toml", 5, "noise_sigma = nan", "noise_sigma: expected a positive number"),
        ("measurement.toml", 5, "noise_sigma = true", "noise_sigma: expected a positive number"),
        ("measurement.toml", 5, "noise_sgma = 0.3", "did you mean 'noise_sigma'"),
        ("measurement.toml", 5, "[", "not a TOML file"),
    ],
)
def test_every_mistake_is_named(folder: Path, file: str, line: int, change: str, said: str) -> None:
    edit(folder / file, line, change)
    with pytest.raises(InputError, match=said):
        Measurement.read(folder)


@pytest.mark.parametrize("name", ["measurement.toml", "fiducials.csv", "grasps.csv"])
def test_missing_files(folder: Path, name: str) -> None:
    (folder / name).unlink()
    with pytest.raises(InputError, match=f"{name}: is missing"):
        Measurement.read(folder)


def test_empty_measurements(folder: Path) -> None:
    (folder / "fiducials.csv").write_text(HEAD + "\n", encoding="utf-8")
    with pytest.raises(InputError, match="is empty"):
        Measurement.read(folder)
    (folder / "fiducials.csv").write_text(HEAD + "\n1,0,0,1,,,\n", encoding="utf-8")
    with pytest.raises(InputError, match="no fiducial was ever seen"):
        Measurement.read(folder)
    (folder / "fiducials.csv").write_bytes(b"\xff\xfe\x00garbage")
    with pytest.raises(InputError, match="cannot be read as text"):
        Measurement.read(folder)


def test_all_mistakes_at_once(folder: Path) -> None:
    edit(folder / "fiducials.csv", 3, "1,0,0,2,abc,10,12")
    edit(folder / "fiducials.csv", 9, "1,0,0,8,15,10,z")
    edit(folder / "grasps.csv", 4, "1,2,2,II,one,0,0,1,0,0,0")
    edit(folder / "measurement.toml", 3, 'time_unit = "mm"')
    with pytest.raises(InputError) as error:
        Measurement.read(folder)
    assert all(
        place in str(error.value) for place in ("fiducials.csv:3", "fiducials.csv:9", "grasps.csv:4", "time_unit")
    )


@pytest.fixture(scope="module")
def slab() -> Scene:
    return Scene.read(ROOT / "examples/scenes/slab.toml")


def test_names_must_be_the_scenes(folder: Path, slab: Scene) -> None:
    edit(folder / "fiducials.csv", 3, "1,0,0,two,35,10,12")
    text = (folder / "grasps.csv").read_text(encoding="utf-8").replace(",II,", ",IV,")
    (folder / "grasps.csv").write_text(text, encoding="utf-8")
    (folder / "loads.csv").write_text("action,step,time,place,fx,fy,fz\n1,1,1,moon,0,1,0\n", encoding="utf-8")
    with pytest.raises(InputError) as error:
        Measurement.read(folder).check(slab)
    said = str(error.value)
    assert "fiducial 'two' is not in the scene" in said
    assert "grasp 'IV' is not in the scene" in said
    assert "place 'moon' is not in the scene" in said


def test_the_wrong_length_unit_is_noticed(folder: Path, slab: Scene) -> None:
    edit(folder / "measurement.toml", 2, 'length_unit = "m"')
    with pytest.raises(InputError, match="check length_unit"):
        Measurement.read(folder).check(slab)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda d: d.drop_vars("grasp"), "variable 'grasp' is missing"),
        (lambda d: d.assign(translation=d["translation"] * np.nan), "not finite"),
        (lambda d: d.assign(rotation=d["rotation"] * 0), "unit quaternion"),
        (lambda d: d.isel(frame=slice(None, None, -1)), "steps must rise from 0"),
        (lambda d: d.isel(frame=slice(1, None)), "steps must rise from 0"),
        (lambda d: d.assign(position=d["position"].mean("axis")), "has dimensions"),
        (lambda d: d.assign(position=d["position"] * np.nan), "no fiducial was ever seen"),
        (lambda d: d.assign_coords(time=-d["time"]), "times must be finite"),
        (lambda d: d.assign_attrs(noise_sigma=-1.0), "noise_sigma: expected a positive"),
        (lambda d: d.assign_attrs(length_unit="furlong"), "not known"),
        (lambda d: d.assign_attrs(format="x"), "expected format"),
    ],
)
def test_netcdf_is_checked_like_a_folder(folder: Path, tmp_path: Path, change: object, said: str) -> None:
    Measurement.read(folder).to_netcdf(tmp_path / "good.nc")
    with xr.open_dataset(tmp_path / "good.nc", engine="scipy") as data:
        turned = data.transpose("axis", ...).load()
        broken = change(data.load())  # type: ignore[operator]
    turned.to_netcdf(tmp_path / "turned.nc", engine="scipy")
    assert Measurement.read(tmp_path / "turned.nc").fingerprint() == Measurement.read(folder).fingerprint()
    broken.to_netcdf(tmp_path / "broken.nc", engine="scipy")
    with pytest.raises(InputError, match=said):
        Measurement.read(tmp_path / "broken.nc")


def test_nothing_is_overwritten(folder: Path) -> None:
    with pytest.raises(InputError, match="exists already"):
        Measurement.read(folder).write(folder)


@pytest.mark.parametrize("content", [b"", b"CDF\x01", b"CDF\x01\x00\x00\x00\x00" + b"\xff" * 60, b"no netcdf"])
def test_damaged_netcdf(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "bad.nc").write_bytes(content)
    with pytest.raises(InputError, match="not a NetCDF measurement"):
        Measurement.read(tmp_path / "bad.nc")


def scaled(folder: Path, lines: str) -> Measurement:
    file = folder / "measurement.toml"
    file.write_text(file.read_text(encoding="utf-8") + lines, encoding="utf-8")
    return Measurement.read(folder)


def test_the_length_of_a_pixel_round_trips(folder: Path, tmp_path: Path) -> None:
    plain = Measurement.read(folder)
    measurement = scaled(folder, "scale_sigma = 0.02\nscale_of_gripper = true\n")
    assert measurement.fingerprint() != plain.fingerprint()
    measurement.write(tmp_path / "again")
    measurement.to_netcdf(tmp_path / "again.nc")
    for copy in (Measurement.read(tmp_path / "again"), Measurement.read(tmp_path / "again.nc")):
        assert (copy.scale_sigma, copy.scale_of_gripper) == (0.02, True)
        assert copy.fingerprint() == measurement.fingerprint()


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("scale_sigma = -0.02", "scale_sigma: expected a number above 0 and up to 0.3"),
        ('scale_sigma = "2 %"', "scale_sigma: expected a number above 0"),
        ("scale_of_gripper = 1", "scale_of_gripper: expected true or false, found 1"),
    ],
)
def test_a_bad_length_of_a_pixel_is_refused(folder: Path, line: str, said: str) -> None:
    with pytest.raises(InputError, match=said):
        scaled(folder, line + "\n")


LOOSE = 'format = "bcid-frame/1"\ncentre = [0, 0, 0]\ncovariance = [\n'
LOOSE += "".join(f"[{', '.join('1e-4' if i == j else '0' for j in range(7))}],\n" for i in range(7)) + "]\n"


@pytest.mark.parametrize(
    ("known", "lines", "frame", "said"),
    [
        (Uncertainty(scale=0.0), "scale_sigma = 0.02\n", "", "says scale = 0"),
        (Uncertainty(scale_of_gripper=False), "scale_of_gripper = true\n", "", "scale_of_gripper = false"),
        (Uncertainty(), "scale_sigma = 0.02\n", LOOSE, "the scale is stated twice"),
        (Uncertainty(scale=0.02), "", LOOSE, "the scale is stated twice"),
    ],
)
def test_what_contradicts_itself_about_pixels_is_refused(
    folder: Path, slab: Scene, known: Uncertainty, lines: str, frame: str, said: str
) -> None:
    if frame:
        (folder / "frame.toml").write_text(frame, encoding="utf-8")
    measurement = scaled(folder, lines)
    with pytest.raises(InputError, match=said):
        measurement.check(replace(slab, uncertainty=known))


def test_a_scale_that_is_stated_once_is_no_contradiction(folder: Path, slab: Scene) -> None:
    scaled(folder, "scale_sigma = 0.02\n").check(replace(slab, uncertainty=Uncertainty(scale=0.01)))
    (folder / "frame.toml").write_text(LOOSE, encoding="utf-8")
    file = folder / "measurement.toml"
    file.write_text(file.read_text(encoding="utf-8").replace("scale_sigma = 0.02\n", ""), encoding="utf-8")
    Measurement.read(folder).check(slab)
