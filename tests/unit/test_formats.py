"""Files of others: each format is read back exactly, by a mapping; damaged ones are refused in one message with a remedy."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bcid import Measurement
from bcid.base.errors import InputError
from bcid.measurement.inspection import import_file
from validation.reliability import foreign_files as made

HEAD = 'format = "bcid-mapping/1"\nlength_unit = "{unit}"\ntime_unit = "s"\nforce_unit = "N"\nfile = "{file}"\n'
CHOSEN = '[fiducials]\na = "tip"\nb = "mid"\nc = "base"\n'


def read(folder: Path, file: str, more: str = CHOSEN, unit: str = "mm") -> Measurement:
    path = folder / "mapping.toml"
    path.write_text(HEAD.format(file=file, unit=unit) + more, encoding="utf-8")
    return Measurement.read(path)


LABELLED: list[tuple[Callable[[Path], Path], str, float]] = [
    (made.trc, "mm", 1e-3),
    (made.motive, "m", 1e-3),
    (made.nexus, "mm", 1e-3),
    (made.qualisys, "mm", 1e-3),
    (made.c3d, "mm", 1e-3),
    (made.deeplabcut, "mm", 1e-3),
    (made.deeplabcut_hdf5, "mm", 1e-3),
    (made.anipose, "mm", 1e-3),
    (made.trc_commas, "mm", 1e-3),
    (made.nexus_sections, "mm", 1e-3),
]


@pytest.mark.parametrize(("write", "unit", "scale"), LABELLED)
def test_named_markers(tmp_path: Path, write: Callable[[Path], Path], unit: str, scale: float) -> None:
    path = write(tmp_path)
    names = ("Body:tip", "Body:mid", "Body:base") if write in (made.nexus, made.nexus_sections) else made.LABELS
    more = "rate = 50\n[fiducials]\n" + "".join(f'{n} = "{label}"\n' for n, label in zip("abc", names, strict=True))
    seen = read(tmp_path, path.name, more, unit)
    assert seen.fiducial_names == ["a", "b", "c"]
    np.testing.assert_allclose(seen.positions, made.XYZ * scale, rtol=0, atol=1e-12)
    np.testing.assert_allclose(seen.data["time"].values, made.TIMES, atol=1e-9)
    everything = read(tmp_path, path.name, "rate = 50\n[points]\nevery = 2\n", unit)
    assert everything.fiducial_names == [names[0], names[2]]


def test_a_file_that_states_another_unit(tmp_path: Path) -> None:
    made.motive(tmp_path)
    with pytest.raises(InputError, match=r"length_unit is 'mm', but motive\.csv states 'm'"):
        read(tmp_path, "motive.csv")
    made.trc(tmp_path)
    with pytest.raises(InputError, match=r"has no point 'tpi' \(fiducial a\); did you mean 'tip'"):
        read(tmp_path, "take.trc", '[fiducials]\na = "tpi"\n')


def test_the_quality_of_positions(tmp_path: Path) -> None:
    made.anipose(tmp_path)
    assert np.isfinite(read(tmp_path, "anipose.csv").positions[3:]).all()
    bounded = read(tmp_path, "anipose.csv", "[points]\nmost_error = 5\nleast_cameras = 2\n" + CHOSEN).positions
    assert np.isnan(bounded[3, 0]).all()
    assert np.isnan(bounded[4, 2]).all()
    assert np.isfinite(np.delete(bounded.reshape(15, 3), [9, 14, 7], axis=0)).all()
    plain = read(tmp_path, "anipose.csv", '[fiducials]\na = ["tip_x", "tip_y", "tip_z"]\n')
    np.testing.assert_allclose(plain.positions[:, 0], made.XYZ[:, 0] * 1e-3)


def test_the_pose_of_a_rigid_body_counts_from_rest(tmp_path: Path) -> None:
    """It turns by a right angle about z while its origin goes 40 mm along x; a centre beside the origin goes along."""
    made.motive(tmp_path)
    pose = 'grasp = "II"\n[columns]\npose = "Gripper"\n' + CHOSEN
    action = read(tmp_path, "motive.csv", pose, "m").actions[0]
    assert action.grasp == "II"
    np.testing.assert_allclose(action.translation[:, 0], 0.01 * np.arange(5), atol=1e-9)
    np.testing.assert_allclose(action.rotation[-1], [np.sqrt(0.5), 0, 0, np.sqrt(0.5)], atol=1e-8)
    beside = read(tmp_path, "motive.csv", "grasp_centre = [0.1, 0.5, 0.25]\n" + pose, "m").actions[0]
    # Of the offset (0.1, 0, 0) a right angle makes (0, 0.1, 0).
    np.testing.assert_allclose(beside.translation[-1], [0.04 - 0.1, 0.1, 0.0], atol=1e-8)
    later = read(tmp_path, "motive.csv", pose + "[frames]\nrest = 1\nfirst = 3\n", "m")
    np.testing.assert_allclose(later.actions[0].translation[:, 0], [0, 0.02, 0.03], atol=1e-9)
    np.testing.assert_allclose(later.data["time"].values, [0, 0.04, 0.06], atol=1e-9)
    made.qualisys_6d(tmp_path)
    with pytest.raises(InputError, match=r"no point 'tip'.*none is defined"):
        read(tmp_path, "bodies.tsv", pose)
    with pytest.raises(InputError, match=r"no rigid body 'Griper' \(columns.pose\); did you mean 'Gripper'"):
        read(tmp_path, "motive.csv", pose.replace('"Gripper"', '"Griper"'), "m")
    with pytest.raises(InputError, match=r"frames.rest: the frame of rest, 3, must not come after"):
        read(tmp_path, "motive.csv", pose + "[frames]\nrest = 3\n", "m")
    with pytest.raises(InputError, match=r"columns\.pose: whose is it"):
        read(tmp_path, "motive.csv", pose.replace('grasp = "II"\n', ""), "m")


def test_older_exports_of_motive(tmp_path: Path) -> None:
    """Measured markers win over solved ones of the same name; the second of a label has a number."""
    found = import_file(made.motive_old(tmp_path))
    assert found.unit == "cm"
    labels = [*(f"Gripper:{label}" for label in made.LABELS), "Gripper:tip (2)"]
    assert list(found.seen.points) == labels
    seen = Measurement.read(found.mapping).positions
    np.testing.assert_allclose(seen[:, :-1], made.XYZ * 1e-3, atol=1e-8)
    np.testing.assert_allclose(seen[:, -1], np.tile([0.07, 0.08, 0.09], (5, 1)))
    text = made.motive(tmp_path).read_text(encoding="utf-8")
    made.write(tmp_path / "local.csv", text.replace("Space,Global", "Space,Local").splitlines())
    assert "export them as Global" in import_file(tmp_path / "local.csv").text
    made.write(tmp_path / "short.csv", [line for line in text.splitlines() if not line.startswith(",Type")])
    with pytest.raises(InputError, match="its header has no line 'Type'"):
        import_file(tmp_path / "short.csv")


def test_sections_and_objects_of_vicon(tmp_path: Path) -> None:
    assert "the section Segments is not read" in import_file(made.nexus_sections(tmp_path)).text
    found = import_file(made.tracker(tmp_path), tmp_path / "objects.toml")
    assert found.unit == "mm"
    bodies = found.seen.bodies
    np.testing.assert_allclose(bodies["Gripper"][-1], [40, 500, 250, np.sqrt(0.5), 0, 0, np.sqrt(0.5)], atol=1e-8)
    np.testing.assert_array_equal(np.isnan(bodies["Base"]).all(axis=1), np.arange(5) == 2)
    np.testing.assert_allclose(found.seen.times, made.TIMES)
    text = made.tracker(tmp_path).read_text(encoding="utf-8").replace(",RW,", ",,")
    made.write(tmp_path / "angles.csv", text.splitlines())
    with pytest.raises(InputError, match=r"angles\.csv:4: names no columns RX, RY, RZ, RW, TX, TY, TZ"):
        import_file(tmp_path / "angles.csv")


def test_body_parts_of_several_animals(tmp_path: Path) -> None:
    names = ["left/paw", "right/paw", "single/wall"]
    more = "[fiducials]\n" + "".join(f'{n} = "{label}"\n' for n, label in zip("abc", names, strict=True))
    np.testing.assert_allclose(read(tmp_path, made.deeplabcut_animals(tmp_path).name, more).positions, made.XYZ * 1e-3)


def test_bodies_of_qualisys(tmp_path: Path) -> None:
    pose = import_file(made.qualisys_6d(tmp_path)).seen.bodies["Gripper"]
    np.testing.assert_allclose(pose[-1], [40, 500, 250, np.sqrt(0.5), 0, 0, np.sqrt(0.5)], atol=1e-8)


def test_an_absolute_pose_is_turned_by_align(tmp_path: Path) -> None:
    """The recording's x is the body's y: a gripper that goes along the one goes along the other."""
    places = {"a": (0.0, 0.0, 0.0), "b": (60.0, 5.0, 0.0), "c": (10.0, 50.0, 3.0), "d": (40.0, 30.0, 45.0)}
    seen = {name: (y + 7, -x, z) for name, (x, y, z) in places.items()}
    header = ["px", "py", "pz", "qw", "qx", "qy", "qz", *(f"{n}{a}" for n in places for a in "xyz")]
    rows = [
        ";".join(
            [f"{3 * i},5", "1", "2", "1", "0", "0", "0", *(str(v).replace(".", ",") for p in seen.values() for v in p)]
        )
        for i in range(3)
    ]
    made.write(tmp_path / "t.csv", [";".join(header), *rows])
    more = (
        'delimiter = ";"\ndecimal = ","\ngrasp = "II"\n[columns]\npose = '
        + str(header[:7]).replace("'", '"')
        + "\n[fiducials]\n"
    )
    more += "".join(f'{n} = ["{n}x", "{n}y", "{n}z"]\n' for n in places) + "[align]\n"
    more += "".join(f"{n} = {list(p)}\n" for n, p in places.items())
    found = read(tmp_path, "t.csv", more)
    np.testing.assert_allclose(found.actions[0].translation, np.outer([0, 3e-3, 6e-3], [0, 1, 0]), atol=1e-12)
    np.testing.assert_allclose(found.positions[0], np.array(list(places.values())) * 1e-3, atol=1e-12)


def test_wrenches_of_a_table(tmp_path: Path) -> None:
    made.write(tmp_path / "t.csv", ["x,y,z,fx,fy,fz,tx,ty,tz", "1,2,3,1,2,3,4,5,6", "1,2,3,,,,,,"])
    more = 'wrench_sigma = 0.5\n[columns]\nwrench = ["fx", "fy", "fz", "tx", "ty", "tz"]\n[fiducials]\na = ["x", "y", "z"]\n'
    found = read(tmp_path, "t.csv", more)
    np.testing.assert_allclose(found.data["wrench"].values[0], [1, 2, 3, 4e-3, 5e-3, 6e-3])
    assert np.isnan(found.data["wrench"].values[1]).all()
    assert found.wrench_sigma == 0.5
    found.write(tmp_path / "folder")
    again = Measurement.read(tmp_path / "folder")
    np.testing.assert_allclose(again.data["wrench"].values, found.data["wrench"].values)
    with pytest.raises(InputError, match=r"columns\.wrench: expected the names of 6 columns"):
        read(tmp_path, "t.csv", more.replace(', "tz"', ""))


ARRAYS = """grasp = "II"
[columns]
time = "trial/data/t"
pose = "trial/data/pose"
wrench = "trial/data/wrench"
[arrays]
positions = "trial/data/xyz"
order = "marker axis frame"
names = "trial/names"
"""


@pytest.mark.parametrize("write", [made.mat, made.mat73, made.hdf5])
def test_arrays_by_path(tmp_path: Path, write: Callable[[Path], Path]) -> None:
    pytest.importorskip("h5py")
    path = write(tmp_path)
    seen = read(tmp_path, path.name, ARRAYS + CHOSEN)
    np.testing.assert_allclose(seen.positions, made.XYZ * 1e-3, rtol=0, atol=1e-12)
    np.testing.assert_allclose(seen.data["time"].values, made.TIMES)
    np.testing.assert_allclose(seen.data["wrench"].values[:, :3], np.arange(30).reshape(5, 6)[:, :3])
    np.testing.assert_allclose(seen.actions[0].translation[:, 0], 0.01 * np.arange(5))


def test_paths_and_orders_that_are_wrong(tmp_path: Path) -> None:
    made.mat(tmp_path)
    numbered = read(tmp_path, "take.mat", ARRAYS.replace('names = "trial/names"\n', "") + "[fiducials]\na = 3\n")
    np.testing.assert_allclose(numbered.positions[:, 0], made.XYZ[:, 2] * 1e-3)
    with pytest.raises(InputError, match=r"no array 'trial/data/xxz'; did you mean 'trial/data/xyz'"):
        read(tmp_path, "take.mat", ARRAYS.replace("data/xyz", "data/xxz"))
    with pytest.raises(InputError, match=r"is 3 x 3 x 5 as frame x marker x axis; its axis must have 3"):
        read(tmp_path, "take.mat", ARRAYS.replace("marker axis frame", "frame marker axis"))
    with pytest.raises(InputError, match="arrays: name either the array of positions"):
        read(tmp_path, "take.mat", CHOSEN)


def test_tables_in_hdf5(tmp_path: Path) -> None:
    made.hdf5(tmp_path)
    more = 'table = "table"\n[columns]\ntime = "t"\n[fiducials]\na = ["tip_x", "tip_y", "tip_z"]\nb = ["mid_x", "mid_y", "mid_z"]\n'
    seen = read(tmp_path, "take.h5", more)
    np.testing.assert_array_equal(seen.positions, made.XYZ[:, :2] * 1e-3)
    with pytest.raises(InputError, match="has no table 'tabel'; did you mean 'table'"):
        read(tmp_path, "take.h5", more.replace('"table"', '"tabel"'))


def test_points_of_image_correlation(tmp_path: Path) -> None:
    expected = (made.REST + made.MOVED) * 1e-3
    made.multidic(tmp_path)
    seen = read(
        tmp_path, "DIC3DPPresults.mat", '[arrays]\npositions = "DIC3DPPresults/Points3D"\n[points]\nevery = 2\n'
    )
    assert seen.fiducial_names == ["1", "3", "5"]
    np.testing.assert_allclose(seen.positions, expected[:, ::2])
    made.ncorr(tmp_path)
    shown = "data_dic_save/displacements/plot_{}_ref_formatted"
    arrays = f'[arrays]\ndisplacements = ["{shown.format("u")}", "{shown.format("v")}"]\ngrid = 5.0\n'
    flat = read(tmp_path, "ncorr.mat", arrays).positions
    grid = np.array([[5.0 * x, 5.0 * y] for y in range(2) for x in range(3)])
    lost = np.zeros((5, 6), bool)
    lost[:, 3] = lost[2, 4] = True
    np.testing.assert_allclose(flat[~lost][:, :2], ((grid + made.MOVED[..., :2]) * 1e-3)[~lost], atol=1e-15)
    assert np.isnan(flat[..., 2]).all(), "no third coordinate was measured"
    assert np.isnan(flat[lost]).all()


@pytest.mark.parametrize("write", [made.vic3d, made.aramis, made.nodemap, made.matchid])
def test_a_file_for_each_frame(tmp_path: Path, write: Callable[[Path], str]) -> None:
    """Frames 8, 9, 10 are in the order of their numbers; points are told by their numbers or pixels."""
    pattern = write(tmp_path)
    expected = (made.REST + made.MOVED) * 1e-3
    if write is not made.aramis:
        expected[3, 5] = np.nan
    if write is made.vic3d:
        expected[0, 4] = np.nan
    seen = read(tmp_path, pattern, "rate = 2\n")
    assert seen.fiducial_names == ["1", "2", "3", "4", "5", "6"]
    np.testing.assert_allclose(seen.positions, expected, atol=1e-12)
    np.testing.assert_allclose(seen.data["time"].values, [0, 0.5, 1, 1.5, 2])


@pytest.mark.parametrize("kind", ["ros1", "ros2", "mcap"])
def test_bags(tmp_path: Path, kind: str) -> None:
    pytest.importorskip("rosbags")
    path = made.ros(tmp_path, kind)
    more = 'grasp = "II"\n[columns]\npose = "gripper"\nwrench = "/ft"\n[fiducials]\n'
    more += "".join(f'{n} = "/markers/body/{i}"\n' for i, n in enumerate("abc"))
    seen = read(tmp_path, path.name, more, "m")
    np.testing.assert_allclose(seen.positions, made.XYZ * 1e-3, atol=1e-12)
    np.testing.assert_allclose(seen.data["time"].values, made.TIMES, atol=1e-6)
    np.testing.assert_allclose(seen.actions[0].translation[:, 0], 0.01 * np.arange(5), atol=1e-9)
    np.testing.assert_allclose(seen.data["wrench"].values[:, 0], 2 * np.arange(5))
    if kind != "mcap":
        return
    with pytest.raises(InputError, match=r"no wrench '/fx' \(columns.wrench\); .*known: /ft"):
        read(tmp_path, path.name, more.replace('"/ft"', '"/fx"'), "m")


BROKEN: list[tuple[Callable[[Path], Any], str, str]] = [
    (made.trc, "cut", r"is it cut off|is the file cut off|it is cut off"),
    (made.trc, "line", "states 5 frames and holds 4: it is cut off; export it again"),
    (made.qualisys, "line", "states 5 frames and holds 4: it is cut off; export it again"),
    (made.trc, "word", r"take\.trc:\d+: expected a number or an empty cell, found 'far'"),
    (made.trc, "head", "ends within the header of a TRC file"),
    (made.motive, "cut", "is the file cut off"),
    (made.motive, "head", "ends within the header"),
    (made.nexus, "cut", "is the file cut off"),
    (made.nexus, "head", "has no section 'Trajectories'"),
    (made.qualisys, "cut", "cut off"),
    (made.deeplabcut, "cut", "is the file cut off"),
    (made.anipose, "cut", "is the file cut off"),
    (made.c3d, "half", "not a readable C3D file"),
    (made.mat73, "half", "is not a readable MAT file: .*Export or copy it again"),
    (made.hdf5, "half", "is not a readable HDF5 file: .*Export or copy it again"),
    (made.deeplabcut_hdf5, "half", "is not a readable HDF5 file of DeepLabCut: .*Export or copy it again"),
    (lambda folder: made.ros(folder, "ros1"), "half", "is not a readable ROS bag: .*Export or copy it again"),
]


@pytest.mark.parametrize(("write", "how", "said"), BROKEN)
def test_damaged_files_are_refused_with_a_remedy(
    tmp_path: Path, write: Callable[[Path], Path], how: str, said: str
) -> None:
    path = write(tmp_path)
    content = path.read_bytes()
    damage = {
        "cut": lambda: content.rstrip()[: -len(content.rstrip().splitlines()[-1]) // 2],
        "line": lambda: b"\n".join(content.splitlines()[:-1]),
        "half": lambda: content[: len(content) // 2],
        "word": lambda: content.replace(f"{made.XYZ[1, 0, 0]:.6f}".encode(), b"far"),
        "head": lambda: b"\n".join(content.splitlines()[:3]),
    }
    path.write_bytes(damage[how]())
    arrays = ARRAYS if path.suffix in (".mat", ".h5") and "dlc" not in path.name else ""
    with pytest.raises(InputError, match=said) as error:
        read(tmp_path, path.name, arrays + CHOSEN, "m" if write is made.motive else "mm")
    assert path.name in str(error.value)
    assert "Traceback" not in str(error.value)


@pytest.mark.parametrize(
    ("write", "more", "said"),
    [
        (made.trc, "[arrays]\npositions = 'x'\n", "arrays: is for MAT, HDF5 and NPZ files; this is a TRC"),
        (made.trc, "[columns]\naction = 'x'\n", "columns.action: is for tables with a header line; a TRC names"),
        (made.trc, "[points]\nevery = 0\n", "points.every: expected a whole number"),
        (made.trc, "[points]\nleast_score = 'x'\n", "points.least_score: expected a number"),
        (made.trc, "rate = -1\n", "rate: expected a positive number"),
        (made.trc, "decimal = ';'\n", "decimal: expected"),
        (made.trc, "grasp_centre = [1]\n", "grasp_centre: expected three numbers"),
        (made.mat, "[arrays]\npositions = 3\n", "arrays.positions: expected a path, or one for each axis"),
        (made.mat, "[arrays]\ndisplacements = 'a'\n", "needs arrays.rest, the rest positions, or arrays.grid"),
        (made.mat, "[arrays]\npositions = 'a'\norder = 'frame point'\n", "arrays.order: expected the words of"),
        (made.mat, "[arrays]\npositions = 'trial/names'\n", "trial/names holds text; expected numbers"),
        (made.mat, "[arrays]\npositions = 'trial/data/t'\n", "has 3 dimensions"),
        (made.mat, "[columns]\ntime='trial/data/pose'\n[arrays]\npositions='trial/data/xyz'\norder='marker axis frame'\n",
         "holds 35 times for 5 frames"),
    ],
)  # fmt: skip
def test_mistakes_in_a_mapping(tmp_path: Path, write: Callable[[Path], Path], more: str, said: str) -> None:
    with pytest.raises(InputError, match=said):
        read(tmp_path, write(tmp_path).name, more)


def test_files_of_no_format(tmp_path: Path) -> None:
    (tmp_path / "a.bin").write_bytes(b"\x00\x01" * 100)
    with pytest.raises(InputError, match=r"file: .*a\.bin: is binary and of no format that is known"):
        read(tmp_path, "a.bin")
    (tmp_path / "a.csv.gz").write_bytes(b"\x1f\x8b\x08\x00")
    with pytest.raises(InputError, match=r"a\.csv\.gz: is compressed, or a workbook; unpack it"):
        read(tmp_path, "a.csv.gz")
    (tmp_path / "folder").mkdir()
    with pytest.raises(InputError, match=r"is a folder without metadata\.yaml"):
        read(tmp_path, "folder")
    text = made.deeplabcut(tmp_path).read_text(encoding="utf-8").replace(",z", ",likelihood")
    (tmp_path / "flat.csv").write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match="triangulate it first"):
        read(tmp_path, "flat.csv")
    made.trc(tmp_path).rename(tmp_path / "take2.trc")
    made.trc(tmp_path)
    with pytest.raises(InputError, match="are 2 files, each a TRC; only image or volume correlation"):
        read(tmp_path, "take*.trc")
    nothing = made.trc(tmp_path).read_text(encoding="utf-8").splitlines()
    rows = [line if i < 6 else "\t".join([*line.split("\t")[:2], *[""] * 9]) for i, line in enumerate(nothing)]
    made.write(tmp_path / "take.trc", rows)
    with pytest.raises(InputError, match="no fiducial was seen in any of the chosen frames"):
        read(tmp_path, "take.trc")


def test_headers_that_lack_a_value(tmp_path: Path) -> None:
    text = made.qualisys(tmp_path).read_text(encoding="utf-8")
    made.write(tmp_path / "a.tsv", text.replace("FREQUENCY\t50", "FREQUENCY").splitlines())
    with pytest.raises(InputError, match=r"a\.tsv:4: FREQUENCY: expected a positive number, found ''"):
        read(tmp_path, "a.tsv")
    text = made.nexus(tmp_path).read_text(encoding="utf-8")
    made.write(tmp_path / "n.csv", text.replace("Trajectories\n50", "Trajectories\n").splitlines())
    with pytest.raises(InputError, match=r"n\.csv:9: rate of the trajectories: expected a positive number"):
        read(tmp_path, "n.csv")
    (tmp_path / "folder").mkdir()
    with pytest.raises(InputError, match="is a folder; expected a file"):
        read(tmp_path, "folder", '[columns]\nrest = ["a", "b", "c"]\ndisplacement = ["d", "e", "f"]\n')


@pytest.mark.timeout(20)
@pytest.mark.parametrize("text", ["[" * 60_000, "(" * 60_000, "x" + " " * 60_000 + "y", "," * 60_000])
def test_a_line_of_nothing_but_brackets_is_refused_at_once(tmp_path: Path, text: str) -> None:
    (tmp_path / "take.csv").write_text(f"{text}\n1,2\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"mapping\.toml: 1 problem"):
        read(tmp_path, "take.csv", "rate = 50\n")


def test_a_recording_without_markers_is_refused(tmp_path: Path) -> None:
    path = made.motive(tmp_path)
    # Columns of the rigid body alone, below the first line.
    first, *rest = path.read_text(encoding="utf-8").splitlines()
    path.write_text("\n".join([first, *(",".join(line.split(",")[:10]) for line in rest)]), encoding="utf-8")
    with pytest.raises(InputError, match=r"motive\.csv: holds no marker"):
        read(tmp_path, "motive.csv", "rate = 50\n", "m")


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("bodyparts,tip,tip,tip", "bodyparts,tip,tip", "its line 'bodyparts' names 8 columns, its numbers have 9"),
        ("coords,x,y,z", "coords,x,x,z", "tip has no column 'y'"),
    ],
)
def test_a_header_of_deeplabcut_that_is_damaged_is_refused(tmp_path: Path, old: str, new: str, said: str) -> None:
    path = made.deeplabcut(tmp_path)
    path.write_text(path.read_text(encoding="utf-8").replace(old, new), encoding="utf-8")
    with pytest.raises(InputError, match=said):
        read(tmp_path, "dlc.csv", "rate = 50\n")


def test_a_table_in_code_page_1252_is_read_as_one_in_utf_8(tmp_path: Path) -> None:
    text = "t,Höhe_x,Höhe_y,Höhe_z\n0,1,2,3\n1,1,2,4\n"
    columns = '[columns]\ntime = "t"\n[fiducials]\na = ["Höhe_x", "Höhe_y", "Höhe_z"]\n'
    for encoding in ("utf-8", "cp1252"):
        (tmp_path / "heights.csv").write_bytes(text.encode(encoding))
        seen = read(tmp_path, "heights.csv", columns).positions[:, 0]
        np.testing.assert_allclose(seen, [[1e-3, 2e-3, 3e-3], [1e-3, 2e-3, 4e-3]])


def test_a_table_of_arrays_without_rows_is_refused(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "empty.h5", "w") as file:
        for axis in "xyz":
            file[f"log/{axis}"] = np.zeros(0)
    with pytest.raises(InputError, match=r"empty\.h5: the table 'log' holds no rows"):
        read(tmp_path, "empty.h5", 'table = "log"\n[fiducials]\na = ["x", "y", "z"]\n')
