"""`bcid import`: what is in a file, a mapping that reads it, and a picture; nothing is left of what fails."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from bcid import Measurement, Scene
from bcid.app.cli import main
from bcid.base.errors import InputError
from bcid.measurement.inspection import import_file
from validation.reliability import foreign_files as made

PROJECT = Path(__file__).resolve().parents[2]
SLAB = PROJECT / "examples/scenes/slab.toml"
EXAMPLES = re.findall(r"```toml\n(.*?)```", (PROJECT / "docs/formats.md").read_text(encoding="utf-8"), re.DOTALL)


@pytest.mark.parametrize(
    ("write", "scale"),
    [(made.trc, 1e-3), (made.motive, 1e-3), (made.nexus, 1e-3), (made.qualisys, 1e-3), (made.deeplabcut, 1e-3),
     (made.anipose, 1e-3), (made.c3d, 1e-3), (made.deeplabcut_hdf5, 1e-3), (made.mat, 1e-3), (made.mat73, 1e-3)],
)  # fmt: skip
def test_a_mapping_reads_what_was_found(tmp_path: Path, write: Callable[[Path], Path], scale: float) -> None:
    found = import_file(write(tmp_path))
    assert "tip 100%, " in found.text
    assert "mid 80%" in found.text
    seen = Measurement.read(found.mapping)
    assert seen.fiducial_names == list(made.LABELS)
    np.testing.assert_allclose(seen.positions, made.XYZ * scale, atol=1e-12)
    assert not list(tmp_path.glob(".*"))


def test_tables(tmp_path: Path) -> None:
    """Wide with decimal commas, units in the names and a wrench; long; and one in HDF5."""
    head = "Time [s];trial;tip x [cm];tip y [cm];tip z [cm];Fx;Fy;Fz;Tx;Ty;Tz;qx;qy;qz"
    made.write(tmp_path / "wide.csv", [head, "0,0;a;1,5;2;3;1;0;0;0;0;0;0;0;0", "0,1;a;2,5;2;3;2;0;0;0;0;0;0;0;0"])
    wide = import_file(tmp_path / "wide.csv")
    assert "2 frames, 10 Hz" in wide.text
    seen = Measurement.read(wide.mapping)
    np.testing.assert_allclose(seen.positions[:, 0], [[0.015, 0.02, 0.03], [0.025, 0.02, 0.03]])
    np.testing.assert_allclose(seen.data["wrench"].values[:, 0], [1, 2])
    assert seen.action_names == ["a"]
    made.write(tmp_path / "long.csv", ["frame,marker,x,y,z", "0,p,1,2,3", "0,q,4,5,6", "1,q,7,8,9"])
    long = Measurement.read(import_file(tmp_path / "long.csv").mapping)
    assert long.fiducial_names == ["p", "q"]
    assert np.isnan(long.positions[1, 0]).all()
    made.write(tmp_path / "behind.csv", ["t_s,state,tip_x_mm,tip_y_mm,tip_z_mm", "0.5,rest,1,2,3", "0.6,pulled,4,5,6"])
    behind = import_file(tmp_path / "behind.csv")
    assert "2 frames, 10 Hz" in behind.text
    assert "mm, as the file states" in behind.text
    assert Measurement.read(behind.mapping).fiducial_names == ["tip"]
    made.write(
        tmp_path / "states.csv", ["state,point,u_px,X_mm,Y_mm,Z_mm", "0,1,9,1,2,3", "0,2,9,4,5,6", "1,1,9,1,2,4"]
    )
    np.testing.assert_allclose(Measurement.read(import_file(tmp_path / "states.csv").mapping).positions[1, 0, 2], 4e-3)


def test_points_without_names(tmp_path: Path) -> None:
    """The mapping and the scene's table name the same points, and those are where the scene says."""
    pattern = made.vic3d(tmp_path)
    found = import_file(tmp_path / pattern, tmp_path / "dense.toml")
    assert found.fiducials == tmp_path / "dense-fiducials.toml"
    table = tomllib.loads(found.fiducials.read_text(encoding="utf-8"))["fiducials"]
    seen = Measurement.read(found.mapping)
    assert list(table) == seen.fiducial_names
    places = np.array([[float(v) for v in text.split()[:3]] for text in table.values()])
    np.testing.assert_allclose(places, made.REST)
    assert 'Points3D"' in import_file(made.duodic(tmp_path)).mapping.read_text(encoding="utf-8")
    np.testing.assert_allclose(Measurement.read(tmp_path / "DuoDIC.toml").positions, (made.REST + made.MOVED) * 1e-3)
    made.ncorr(tmp_path)
    flat = Measurement.read(import_file(tmp_path / "ncorr.mat").mapping)
    # The fourth is outside the region of interest.
    assert flat.fiducial_names == ["1", "2", "3", "5", "6"]
    np.testing.assert_allclose(flat.positions[-1, 4, :2], (np.array([10.0, 5.0]) + made.MOVED[-1, 5, :2]) * 1e-3)


def test_fiducials_and_grasp_of_a_scene(tmp_path: Path) -> None:
    scene = Scene.read(SLAB)
    names = list(scene.fiducials)
    header = [f"{name}_{a}" for name in [*names[:2], "other"] for a in "xyz"]
    made.write(tmp_path / "t.csv", [",".join(header), ",".join("1" for _ in header)])
    text = import_file(tmp_path / "t.csv", None, scene).mapping.read_text(encoding="utf-8")
    assert list(tomllib.loads(text)["fiducials"]) == names[:2]
    assert f'# {names[2]} = "?"' in text
    assert "# other = " in text
    assert all(grasp in text for grasp in scene.grasps)
    assert "\n# [align]" in text


def test_a_bag(tmp_path: Path) -> None:
    pytest.importorskip("rosbags")
    found = import_file(made.ros(tmp_path, "mcap"))
    assert "rigid bodies: gripper 100%" in found.text
    assert "forces: /ft 100%" in found.text
    assert "not read: /talk" in found.text
    seen = Measurement.read(found.mapping)
    np.testing.assert_allclose(seen.positions, made.XYZ * 1e-3, atol=1e-12)
    assert seen.data["wrench"].shape == (5, 6)


def test_the_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.chdir(tmp_path)
    made.trc(tmp_path)
    assert main(["import", "take.trc"]) == 0
    said = capsys.readouterr().out
    assert "take.trc: TRC\n  5 frames, 50 Hz, 0.08 s\n  lengths in mm, as the file states" in said
    assert (tmp_path / "take.png").stat().st_size > 20_000
    assert "wrote take.png" in said
    assert main(["import", "take.trc"]) == 2
    assert "take.toml: exists already; choose another name with -o" in capsys.readouterr().err
    monkeypatch.setenv("OMPI_COMM_WORLD_RANK", "1")
    assert main(["import", "take.trc", "-o", "two.toml"]) == 0
    assert not (tmp_path / "two.toml").exists()


def test_what_cannot_be_imported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "words.csv").write_text("a,b\n1,2\n", encoding="utf-8")
    (tmp_path / "cut.trc").write_text("PathFileType\t4\n", encoding="utf-8")
    (tmp_path / "empty.mat").write_bytes(b"MATLAB 5.0 MAT-file")
    for name, said in (
        ("none.csv", "no such file"),
        ("words.csv", "no columns of its first line are coordinates"),
        ("cut.trc", "ends within the header"),
        ("empty.mat", "not a readable MAT file"),
    ):
        assert main(["import", str(tmp_path / name)]) == 2
        err = capsys.readouterr().err
        assert said in err
        assert "Traceback" not in err
    with pytest.raises(InputError, match=r"a mapping is a TOML file"):
        import_file(tmp_path / "words.csv", tmp_path / "a.txt")
    assert {path.name for path in tmp_path.iterdir()} == {"words.csv", "cut.trc", "empty.mat"}


def test_a_file_without_positions_says_what_it_holds(tmp_path: Path) -> None:
    from scipy.io import savemat

    savemat(tmp_path / "a.mat", {"speed": np.zeros((4, 7))})
    with pytest.raises(InputError, match=r"no array looks like positions .* it holds speed \(4 x 7\)"):
        import_file(tmp_path / "a.mat")


WRITERS: dict[str, Callable[[Path], object]] = {
    "motive.csv": made.motive,
    "anipose.csv": made.anipose,
    "take.mat": made.mat,
    "take.h5": made.hdf5,
    "vic_*.csv": made.vic3d,
    "ncorr.mat": made.ncorr,
    "scan.h5": made.volume,
    "take_ros2": lambda folder: made.ros(folder, "ros2"),
}


@pytest.mark.parametrize("text", EXAMPLES, ids=lambda text: tomllib.loads(text)["file"])
def test_examples_of_the_page_on_formats(tmp_path: Path, text: str) -> None:
    told = tomllib.loads(text)
    WRITERS[told["file"]](tmp_path)
    (tmp_path / "mapping.toml").write_text(text, encoding="utf-8")
    seen = Measurement.read(tmp_path / "mapping.toml")
    assert np.isfinite(seen.positions).any()
    assert ("wrench" in seen.data) == ("wrench" in told.get("columns", {}))
    assert (seen.actions[0].translation != 0).any() == ("pose" in told.get("columns", {}) or "grasps" in told)


def test_the_page_has_an_example_of_each_kind() -> None:
    assert {tomllib.loads(text)["file"] for text in EXAMPLES} == set(WRITERS)
