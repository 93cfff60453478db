"""`bcid figure`: files for papers and for ParaView, whole or not at all."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest
import runs

from bcid import cli
from bcid.errors import InputError
from bcid.report.export import write_figures


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
        "ladder",
    ):
        assert {f"{name}.svg", f"{name}.pdf"} <= names
    assert {"ranking.csv", "ranking.tex", "ladder.csv", "sets.csv", "tests.csv", "provenance.csv"} <= names
    assert not {name for name in names if name.endswith(".png")}
    assert sorted(p for p in target.rglob("*") if p.is_file()) == sorted(files)
    rows = list(csv.DictReader((target / "ladder.csv").open(encoding="utf-8")))
    assert [float(row["error (mm)"]) for row in rows] == [1.42, 0.21]
    surface = pv.read(target / "paraview" / "patches.vtp")
    assert surface.cell_data["anchored"].sum() == (surface.cell_data["place"] == 1).sum() == 8
    moved = pv.read(target / "paraview" / "body_0003.vtu")
    assert abs(moved.point_data["displacement"]).max() == pytest.approx(20.0)


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


def test_an_error_leaves_nothing(tmp_path: Path) -> None:
    folder, target = runs.explored(tmp_path / "run"), tmp_path / "figures"
    runs.rewrite(folder, "exploration.json", '{"steps": [{"number": 1}]}')
    with pytest.raises(InputError, match="figure 'sets' cannot be made"):
        write_figures(folder, target, ["png"])
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
