"""`bcid figure`: files for papers and for ParaView, whole or not at all."""

from __future__ import annotations

import csv
import resource
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import runs

from bcid.app import cli
from bcid.base.errors import InputError, MachineError
from bcid.report.export import write_figures
from bcid.report.found import Found
from bcid.report.paraview import paraview_files


def frame_of(path: Path, frame: int) -> Any:
    """One frame of a VTKHDF file, by VTK's own reader."""
    from pyvista import wrap
    from vtkmodules.vtkIOHDF import vtkHDFReader

    reader = vtkHDFReader()
    reader.SetFileName(str(path))
    reader.UpdateInformation()
    assert frame < reader.GetNumberOfSteps()
    reader.SetStep(frame)
    reader.Update()
    return wrap(reader.GetOutputDataObject(0))


def test_what_the_gripper_felt_is_drawn_where_it_was_measured() -> None:
    pytest.importorskip("matplotlib")
    from bcid.report.time_charts import felt, force_chart, torque_chart

    plain = runs.positions()
    frames = plain.sizes["frame"]
    dims, course = ("frame", "component"), np.outer(np.arange(frames), [2.0, 0.5, 0.0, 0.1, 0.0, 0.0])
    # As a diagnosis holds them, and as an identification does.
    for name in ("wrench_predicted", "wrench"):
        found = plain.assign({"wrench_measured": (dims, course + 0.25), name: (dims, course)})
        assert felt(found)
        (axes,) = force_chart(found).axes
        marks, line = axes.lines[0], axes.lines[1]
        assert np.allclose(marks.get_ydata(), course[:, 0] + 0.25)
        assert np.allclose(line.get_ydata(), course[: len(line.get_ydata()), 0])
        assert torque_chart(found).axes[0].get_ylabel() == "torque (N mm)"
        assert np.allclose(torque_chart(found).axes[0].lines[0].get_ydata(), 100 * np.arange(frames) + 250)
    assert not felt(plain)
    assert not felt(plain.assign(wrench_measured=(dims, np.full((frames, 6), np.nan))))


def test_everything_is_written(tmp_path: Path) -> None:
    pv = pytest.importorskip("pyvista")
    target = tmp_path / "figures"
    files = write_figures(runs.explained(tmp_path / "run"), target, ["svg", "pdf"])
    names = {str(file.relative_to(target)) for file in files}
    for name in (
        "body",
        "patches",
        "residual-action",
        "residual-step",
        "residual-fiducial",
        "residual-map",
        "ranking",
        "models",
    ):
        assert {f"{name}.svg", f"{name}.pdf"} <= names
    assert {"ranking.csv", "ranking.tex", "models.csv", "sets.csv", "tests.csv", "provenance.csv"} <= names
    assert not {name for name in names if name.endswith(".png")}
    assert sorted(p for p in target.rglob("*") if p.is_file()) == sorted(files)
    rows = list(csv.DictReader((target / "models.csv").open(encoding="utf-8")))
    assert [float(row["error (mm)"]) for row in rows] == [1.42, 0.21]
    surface = pv.read(target / "paraview" / "patches.vtp")
    assert surface.cell_data["anchored"].sum() == (surface.cell_data["place"] == 1).sum() == 8
    assert abs(frame_of(target / "paraview/body.vtkhdf", 3).point_data["displacement"]).max() == pytest.approx(20.0)
    assert np.isfinite(frame_of(target / "paraview/fiducials.vtkhdf", 0).point_data["residual"]).all()


def test_files_are_not_replaced_unasked(tmp_path: Path) -> None:
    folder, target = runs.explored(tmp_path / "run"), tmp_path / "figures"
    target.mkdir()
    (target / "mine.txt").write_text("mine", encoding="utf-8")
    files = write_figures(folder, target, ["svg"])
    before = {file: file.read_bytes() for file in files}
    (target / "bits.svg").write_text("edited", encoding="utf-8")
    with pytest.raises(InputError, match=r"bits.svg.*there already"):
        write_figures(folder, target, ["svg"])
    assert (target / "bits.svg").read_text(encoding="utf-8") == "edited"
    write_figures(folder, target, ["svg"], overwrite=True)
    assert {file: file.read_bytes() for file in files} == before
    assert (target / "mine.txt").exists()


def _fails(*_: object) -> None:
    raise ValueError("too many")


def test_an_error_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder, target = runs.explored(tmp_path / "run"), tmp_path / "figures"
    monkeypatch.setattr("bcid.report.exploration_picture.draw_sets", _fails)
    with pytest.raises(InputError, match="figure 'sets' cannot be made"):
        write_figures(folder, target, ["png"])
    assert sorted(path.name for path in tmp_path.iterdir()) == ["run"]


@contextmanager
def short_files(longest: int) -> Iterator[None]:
    """Writes fail behind so many bytes of a file, as on a full disk: in the midst of what a library writes."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    before = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (longest, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        signal.signal(signal.SIGXFSZ, before)


@pytest.mark.parametrize("kind", ["pdf", "png", "svg"])
def test_write_figures_where_writing_ends_in_the_midst_of_a_file_is_a_fault_of_the_machine(
    tmp_path: Path, kind: str
) -> None:
    folder, target = runs.explored(tmp_path / "run"), tmp_path / "figures"
    with short_files(3000), pytest.raises(MachineError, match=r"figures: cannot be written: File too large"):
        write_figures(folder, target, [kind])
    assert sorted(path.name for path in tmp_path.iterdir()) == ["run"]


def test_refusals(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = str(runs.explored(tmp_path / "run"))
    running = runs.started(tmp_path / "running")
    (tmp_path / "file").write_text("", encoding="utf-8")
    for arguments, code, word in (
        ([folder, "-o", str(tmp_path / "f"), "--format", "jpg"], 2, "known: png, svg, pdf"),
        ([folder, "-o", str(tmp_path / "f"), "--format", ","], 2, "names no format"),
        ([folder, "-o", str(tmp_path / "file")], 2, "is a file"),
        ([str(tmp_path), "-o", str(tmp_path / "f")], 2, "is not a run folder"),
        ([str(running.path), "-o", str(tmp_path / "f")], 2, "has nothing to draw (bcid explain, running)"),
        ([folder, "-o", "/proc/sys/figures"], 3, "cannot be written"),
    ):
        assert cli.main(["figure", *arguments]) == code
        error = capsys.readouterr().err
        assert word in error
        assert "Traceback" not in error
    running.release()
    assert not (tmp_path / "f").exists()


def test_fields_for_paraview_by_frame(tmp_path: Path) -> None:
    """VTK's reader gives back every frame, also where fiducials are hidden, one of them or all."""
    pytest.importorskip("pyvista")
    found = Found.read(runs.explained(tmp_path / "run"))
    assert found.body is not None
    assert found.positions is not None
    hidden = found.positions.copy(deep=True)
    hidden["measured"].values[1, 0] = np.nan
    hidden["measured"].values[2] = np.nan
    fields = tmp_path / "fields"
    fields.mkdir()
    for name, content in paraview_files(found.body, hidden, ["3"]).items():
        (fields / name).write_bytes(content)
    file = fields / "body.vtkhdf"
    cells = found.body["cells"].values[:, :4]
    for frame in range(found.body.sizes["frame"]):
        solid = frame_of(file, frame)
        np.testing.assert_allclose(solid.points, found.body["points"].values * 1e3)
        np.testing.assert_array_equal(solid.cell_connectivity.reshape(-1, 4), cells)
        moved = found.body["displacement"].values[frame] * 1e3
        np.testing.assert_allclose(solid.point_data["displacement"], moved)
        gone = {1: [0], 2: range(hidden.sizes["fiducial"])}.get(frame, [])
        predicted = np.delete(hidden["predicted"].values[frame], gone, axis=0) * 1e3
        points = frame_of(tmp_path / "fields/fiducials.vtkhdf", frame)
        assert points.n_points == points.n_cells == len(predicted)
        if len(predicted):
            np.testing.assert_allclose(points.points, predicted)
            residual = np.delete(hidden["measured"].values[frame], gone, axis=0) * 1e3 - predicted
            np.testing.assert_allclose(points.point_data["residual"], residual)
    assert sorted(p.name for p in (tmp_path / "fields").iterdir()) == ["body.vtkhdf", "fiducials.vtkhdf", "patches.vtp"]


@pytest.mark.parametrize(
    ("command", "name"), [("report", "jinja2"), ("report", "matplotlib"), ("figure", "matplotlib")]
)
def test_command_without_a_package_of_its_extra_names_it(tmp_path: Path, command: str, name: str) -> None:
    arguments = [command, str(runs.explored(tmp_path / "run")), "-o", str(tmp_path / "made")]
    code = f"import sys; sys.modules[{name!r}] = None; from bcid.app.cli import main; sys.exit(main({arguments!r}))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, "Traceback" in done.stderr) == (3, False)
    assert f"{name} is not installed: pip install 'bcid[report]'" in done.stderr


def test_what_is_not_installed_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("pyvista")
    monkeypatch.setitem(sys.modules, "h5py", None)
    run, target = runs.explained(tmp_path / "run"), tmp_path / "figures"
    assert cli.main(["figure", str(run), "-o", str(target), "--format", "svg", "--quiet"]) == 3
    assert "h5py is not installed: pip install 'bcid[report]'" in capsys.readouterr().err
    assert not target.exists()
