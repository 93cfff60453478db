"""The report of runs of every kind and state, from small run folders made by hand."""

from __future__ import annotations

import html
import json
import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import runs

from bcid.app import cli
from bcid.base.errors import InputError
from bcid.base.run_folder import RunFolder
from bcid.base.units import significance, uncertain
from bcid.report import gallery
from bcid.report.body_view import view_data
from bcid.report.found import Found
from bcid.report.page import MARK, write_report
from bcid.report.residual import residuals_of, rms
from bcid.report.table import Cell, Column, Table, aligned
from bcid.report.table import text as text_column
from bcid.report.tables import sensitivity_table, tables
from bcid.report.text import amount
from bcid.results.common_rows import ParameterRow
from bcid.results.diagnosis_record import DiagnosisRecord

FEW = ("body", "models", "sets", "calibration")


@pytest.fixture
def every_figure() -> None:
    """Asks for all figures of a run."""


@pytest.fixture(autouse=True)
def plain_pictures(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Pictures without VTK, which takes seconds, and few figures unless a test asks for all."""
    from matplotlib.figure import Figure

    for name in ("residual_figure", "body_figure", "discrepancy_figure"):
        monkeypatch.setattr(gallery, name, lambda *_: Figure(figsize=(2, 1)))
    if "every_figure" not in request.fixturenames:
        every = gallery.drawings
        monkeypatch.setattr(gallery, "drawings", lambda found: [d for d in every(found) if d.name in FEW])


def words(source: str) -> str:
    """What a page says, without its scripts and styles."""
    bare = re.sub(r"(?s)<(script|style)\b.*?</\1>", "", source)
    return " ".join(html.unescape(re.sub(r"<[^>]*>", " ", bare)).split())


def said(tmp_path: Path, *folders: Path) -> str:
    return words(write_report(folders, tmp_path / "report.html").path.read_text(encoding="utf-8"))


@pytest.mark.usefixtures("every_figure")
def test_explained(tmp_path: Path) -> None:
    """Everything, in the order in which a reader asks."""
    text = said(tmp_path, runs.explained(tmp_path / "run"))
    verdict = "Missing in the plain model: gravity. The error falls from 1.42 to 0.21 mm (noise 0.2 mm)."
    wanted = [
        verdict,
        "The body",
        "Residuals",
        "Missing effects",
        "The models in turn",
        "Anchor sets",
        "What was run",
    ]
    places = [text.index(word) for word in wanted]
    assert places == sorted(places)
    assert "1257.6 ± 9.4 N/m³" in text
    for fact in ("64babdf4", "ccf20348", "slab.toml", "pulled", "numpy", "soft anchor", "nothing of it is seen"):
        assert fact in text
    assert "posterior by pull: bcid explore makes it" in text


def test_identified(tmp_path: Path) -> None:
    text = said(tmp_path, runs.identified(tmp_path / "run"))
    assert "The slab is held at patch left, with probability 98 %; the model misses the measurement by 0.21 mm" in text
    assert "a sequence of models and missing effects: bcid diagnose RUN makes them" in text
    assert "Missing effects" not in text


def test_a_set_that_explains_nothing(tmp_path: Path) -> None:
    folder = runs.identified(tmp_path / "run")
    runs.rewrite(folder, "identification.json", json.dumps(runs.identification() | {"rms": 1.4, "adequate": False}))
    assert "No set of anchors explains this measurement" in said(tmp_path, folder)
    # A residual of three times the noise may be explained by what the scene has slightly wrong.
    told = {"rms": 0.6, "discrepancy_probability": 0.12, "outliers": ["6", "11"]}
    runs.rewrite(folder, "identification.json", json.dumps(runs.identification() | told))
    text = said(tmp_path, folder)
    assert "The slab is held at patch left" in text
    assert "something is missing 12 %" in text
    assert "Fiducial(s) 6, 11 do not go with the body" in text


def test_lengths_of_a_measurement_in_metres_are_shown_in_mm(tmp_path: Path) -> None:
    folder = runs.explained(tmp_path / "run")
    factor = 1e-3
    written = runs.diagnosis() | {"length_unit": "m"}
    for key in ("rms", "noise_rms", "held_out_rms"):
        written[key] *= factor
    written["model_sequence"] = [
        r | {k: r[k] * factor for k in ("rms", "held_out_rms")} for r in written["model_sequence"]
    ]
    keys = ("expected_rms", "fitted_rms", "held_out_rms")
    written["ranking"] = [r | {k: r[k] and r[k] * factor for k in keys} for r in written["ranking"]]
    shown = said(tmp_path, runs.explained(tmp_path / "other"))
    runs.rewrite(folder, "diagnosis.json", json.dumps(written))
    text = said(tmp_path, folder)
    assert "falls from 1.42 to 0.21 mm (noise 0.2 mm)" in text
    assert "falls from 1.42 to 0.21 mm (noise 0.2 mm)" in shown


def test_what_is_odd_and_an_unknown_noise_stand_in_the_report(tmp_path: Path) -> None:
    folder = runs.explained(tmp_path / "run")
    more = {"remarks": ["markers 3 and 7 look swapped"], "noise_stated": False}
    runs.rewrite(folder, "diagnosis.json", json.dumps(runs.diagnosis() | more))
    text = said(tmp_path, folder)
    assert "Look at this first: markers 3 and 7 look swapped." in text
    assert "No noise is known" in text
    folder = runs.identified(tmp_path / "identified")
    runs.rewrite(folder, "identification.json", json.dumps(runs.identification() | {"noise_rms": None}))
    assert "No noise is known: whether a set explains this measurement cannot be told" in said(tmp_path, folder)


def test_report_of_an_answer_shows_on_what_it_depends_and_what_to_do(tmp_path: Path) -> None:
    text = said(tmp_path, runs.explained(tmp_path / "run"))
    assert "How far the answer holds" in text
    assert "of the 0.8 bits that are open" in text
    found = Found.read(tmp_path / "run")
    made: dict[str, Any] = {name: make() for name, _, make in tables(found)}
    assert made["scene-sensitivity"].strong == {1}
    row = ["Poisson's ratio", "+2", "gravity", "97 %", "no patch", "96 %", "yes"]
    assert made["scene-sensitivity"].rows[1] == row
    # Both signs in one row where the answer depends on neither.
    both = [runs.answer_at(-2.0, ["left"]), runs.answer_at(2.0, ["left"]) | {"verdict_probability": 0.96}]
    joined = sensitivity_table(DiagnosisRecord.from_json(runs.diagnosis() | {"scene_sensitivity": both}))
    assert joined is not None
    assert joined.rows == [["Poisson's ratio", "±2", "gravity", "96 %", "patch left", "96 %", ""]]
    assert made["next-steps"].rows == [["measure: Poisson's ratio", "0.42"]]
    # A run of an earlier version has neither.
    old = runs.diagnosis() | {"scene_sensitivity": [], "next_steps": []}
    runs.rewrite(tmp_path / "run", "diagnosis.json", json.dumps(old))
    assert "How far the answer holds" not in said(tmp_path, tmp_path / "run")


@pytest.mark.parametrize(
    ("more", "sentence"),
    [
        (
            {"verdict": "none", "model_sequence": [runs.rung("neo_hooke", 0.2, True)]},
            "The plain model misses the measurement by 0.2 mm",
        ),
        ({"verdict": "none", "adequate": None}, "The neo-Hookean + gravity model misses the measurement by 0.21 mm"),
        ({"verdict": "unknown"}, "None of the known effects explains this measurement"),
        (
            {"verdict": "unknown", "change_point": {"action": "lift", "step": 5, "probability": 0.97}},
            "It is not there from the start (97 %, if it is unknown), and shows by step 5 of action lift",
        ),
        ({"verdict": "unknown", "ranking": []}, "model is not adequate: it misses the measurement by 0.21 mm"),
        (
            {"model_sequence": [runs.rung("neo_hooke", 1.42, False)]},
            "Missing in the plain model: gravity. The error falls from 1.42 to 0.21 mm",
        ),
        (
            {"adequate": False, "p_value": 0.002},
            "With that the model is not adequate either (p = 0.002): something else may act besides, or instead.",
        ),
        ({"verdict": "gravity+time_lag"}, "Missing in the plain model: gravity and time lag"),
    ],
)
def test_verdicts(tmp_path: Path, more: dict[str, Any], sentence: str) -> None:
    folder = runs.explained(tmp_path / "run")
    runs.rewrite(folder, "diagnosis.json", json.dumps(runs.diagnosis() | more))
    assert sentence in said(tmp_path, folder)


@pytest.mark.parametrize("asked", ["none", "time_lag"])
def test_what_a_scene_states_is_not_what_is_named(tmp_path: Path, asked: str) -> None:
    """Gravity is the scene's own there, and what is named was not added to the model that is not adequate."""
    folder = runs.explained(tmp_path / "run")
    runs.rewrite(folder, "diagnosis.json", json.dumps(runs.diagnosis() | {"verdict": asked, "adequate": False}))
    assert "With that the model is not adequate" not in said(tmp_path, folder)


def test_explored(tmp_path: Path) -> None:
    text = said(tmp_path, runs.explored(tmp_path / "run"))
    assert "Anchored: {left}, probability 98 %, after 2 pulls." in text
    assert "Posterior by pull" in text
    assert "the body in 3-D and residuals: give a pull of steps/" in text


def test_calibrated_tracked_and_other_runs(tmp_path: Path) -> None:
    """A run without a body gets what it has."""
    calibrated = runs.started(tmp_path / "calibrate", "calibrate")
    found = {"verdict": "good", "error": 0.1, "baseline": {"value": 0.16}, "angle": {"value": 20.0}, "pairs": []}
    calibrated.write_json("calibration.json", found)
    calibrated.finish({})
    tracked = runs.started(tmp_path / "track", "track")
    tracked.write_json("tracking.json", {"beads": 16, "frames": 20, "seen": 0.95, "sigma": 2e-5, "warnings": ["far"]})
    tracked.finish({})
    study = runs.started(tmp_path / "study", "study")
    study.write_text("table.txt", "goal reached\nnamed 88 %\n")
    study.finish({})
    text = said(tmp_path, calibrated.path, tracked.path, study.path)
    for sentence in (
        "Calibration of two cameras: good. error 0.100 px baseline 160.00 mm",
        "16 beads were followed through 20 pairs of images: 95.0 % of their positions are known.",
        "goal reached",
        "named 88 %",
        "a study is told by its table",
        "figure 'calibration': cannot be shown",
    ):
        assert sentence in text


def test_running_and_failed_runs(tmp_path: Path) -> None:
    running, failed = runs.started(tmp_path / "running"), runs.started(tmp_path / "failed")
    failed.fail("the mesh is broken")
    text = said(tmp_path, running.path, failed.path)
    assert "This run is not finished, or was killed." in text
    assert "This run ended early: the mesh is broken." in text
    running.release()


def test_several_runs_have_contents(tmp_path: Path) -> None:
    folders = [runs.explained(tmp_path / "one"), runs.explored(tmp_path / "two"), runs.explained(tmp_path / "three")]
    source = write_report(folders, tmp_path / "report.html").path.read_text(encoding="utf-8")
    assert re.findall(r'<a href="#(run-\d)">(\w+)</a>', source) == [
        ("run-1", "one"),
        ("run-2", "two"),
        ("run-3", "three"),
    ]
    ids = re.findall(r'\sid="([^"]+)"', re.sub(r"(?s)<script[^>]*>.*?</script>", "", source))
    assert len(ids) == len(set(ids))
    assert {"run-1", "run-2", "run-3"} <= set(ids)


@pytest.mark.usefixtures("every_figure")
def test_the_same_bytes(tmp_path: Path) -> None:
    folder = runs.explained(tmp_path / "run")
    one, two = (write_report([folder], tmp_path / name).path.read_bytes() for name in ("one.html", "two.html"))
    assert one == two
    assert one.startswith(MARK.encode())


def test_only_reports_are_overwritten(tmp_path: Path) -> None:
    folder, target = runs.explored(tmp_path / "run"), tmp_path / "report.html"
    write_report([folder], target)
    write_report([folder], target)
    target.write_text("my thesis", encoding="utf-8")
    with pytest.raises(InputError, match="is not a report of bcid"):
        write_report([folder], target)
    assert target.read_text(encoding="utf-8") == "my thesis"
    with pytest.raises(InputError, match="is a folder"):
        write_report([folder], tmp_path)


# -- damage
# ------------------------------------------------------------------------------------------------------------------------


def damaged_json(folder: Path) -> None:
    runs.rewrite(folder, "diagnosis.json", '{"adequate": tr')


def not_a_table(folder: Path) -> None:
    runs.rewrite(folder, "diagnosis.json", "[1, 2]")


def deep_json(folder: Path) -> None:
    runs.rewrite(folder, "diagnosis.json", "[" * 100_000)


def damaged_body(folder: Path) -> None:
    (folder / "body.nc").write_bytes((folder / "body.nc").read_bytes()[:400])


def truncated_body(folder: Path) -> None:
    damaged_body(folder)
    runs.seal(folder, "body.nc")


def other_frames(folder: Path) -> None:
    RunFolder(folder, {}).write_dataset("residuals.nc", runs.positions().isel(frame=slice(0, 3)))
    runs.seal(folder, "residuals.nc")


def no_triangles(folder: Path) -> None:
    RunFolder(folder, {}).write_dataset("body.nc", runs.body().drop_vars("triangles"))
    runs.seal(folder, "body.nc")


def far_nodes(folder: Path) -> None:
    data = runs.body()
    data["points"][:] = np.nan
    RunFolder(folder, {}).write_dataset("body.nc", data)
    runs.seal(folder, "body.nc")


def lacking_keys(folder: Path) -> None:
    runs.rewrite(folder, "diagnosis.json", json.dumps({"verdict": "gravity", "ranking": [{}]}))


def other_types(folder: Path) -> None:
    found = runs.diagnosis() | {"rms": "1", "model_sequence": 3, "ranking": {"a": 1}, "anchored": None, "tests": None}
    runs.rewrite(folder, "diagnosis.json", json.dumps(found))


def infinite(folder: Path) -> None:
    text = json.dumps(runs.diagnosis()).replace("1.42", "Infinity").replace("0.24", "NaN")
    runs.rewrite(folder, "diagnosis.json", text)


DAMAGES = [
    damaged_json, not_a_table, deep_json, damaged_body, truncated_body, other_frames, no_triangles, far_nodes,
    lacking_keys, other_types, infinite,
]  # fmt: skip


@pytest.mark.usefixtures("every_figure")
@pytest.mark.parametrize("damage", DAMAGES)
def test_damage_is_named_and_the_rest_is_shown(tmp_path: Path, damage: Callable[[Path], None]) -> None:
    """Beside a run that is whole, through the command line: no traceback, the file named, exit code 0."""
    whole, broken = runs.explored(tmp_path / "whole"), runs.explained(tmp_path / "broken")
    damage(broken)
    target = tmp_path / "report.html"
    assert cli.main(["report", str(broken), str(whole), "-o", str(target)]) == 0
    text = words(target.read_text(encoding="utf-8"))
    assert "Anchored: {left}" in text
    assert "What was run" in text
    troubles = write_report([broken], target).troubles[broken]
    assert troubles
    text = words(target.read_text(encoding="utf-8"))
    assert all(" ".join(trouble.split()) in text for trouble in troubles)


def test_a_folder_that_is_no_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    whole, target = runs.explored(tmp_path / "whole"), tmp_path / "report.html"
    assert cli.main(["report", str(tmp_path / "none"), "-o", str(target)]) == 2
    assert "is not a run folder (it has no run.json)" in capsys.readouterr().err
    assert not target.exists()
    (tmp_path / "bad").mkdir()
    (tmp_path / "bad" / "run.json").write_text('{"format": "bcid-run/2"}', encoding="utf-8")
    assert cli.main(["report", str(tmp_path / "bad"), str(whole), "-o", str(target)]) == 0
    assert "is damaged: command, state" in capsys.readouterr().err
    assert "This run cannot be read." in words(target.read_text(encoding="utf-8"))


@pytest.mark.skipif(os.geteuid() == 0 and not Path("/proc/sys").is_dir(), reason="needs a place that cannot be written")
def test_a_place_that_cannot_be_written(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = runs.explored(tmp_path / "run")
    assert cli.main(["report", str(folder), "-o", "/proc/sys/report.html"]) == 3
    error = capsys.readouterr().err
    assert "cannot be written" in error
    assert "Traceback" not in error


# -- without the solver
# ------------------------------------------------------------------------------------------------------------------------


def test_made_without_the_solver(tmp_path: Path) -> None:
    """Report and figures of a run where DOLFINx, PETSc, MPI and Gmsh cannot be imported."""
    folder = runs.explained(tmp_path / "run")
    code = (
        "import sys\n"
        "class Refuse:\n"
        "    def find_spec(self, name, path=None, target=None):\n"
        "        if name.split('.')[0] in ('dolfinx', 'petsc4py', 'mpi4py', 'gmsh', 'ufl', 'basix'):\n"
        "            raise ImportError(f'{name} must not be imported')\n"
        "sys.meta_path.insert(0, Refuse())\n"
        "from bcid.app.cli import main\n"
        f"run = {str(folder)!r}\n"
        "sys.exit(main(['report', run, '-o', 'r.html']) or main(['figure', run, '-o', 'f', '--format', 'svg']))"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=tmp_path, check=False)
    assert result.returncode == 0, result.stderr
    assert result.stdout.startswith("r.html: 1 run, ")
    source = (tmp_path / "r.html").read_text(encoding="utf-8")
    assert 'class="doubt"' not in source
    assert "data:image/png;base64," in source
    assert {"body.svg", "models.csv", "models.tex"} <= {path.name for path in (tmp_path / "f").iterdir()}


# -- the parts
# ------------------------------------------------------------------------------------------------------------------------


def test_residuals(tmp_path: Path) -> None:
    data = runs.positions()
    residual = residuals_of(Found.read(runs.explained(tmp_path / "run")))
    assert list(residual.models) == ["neo-Hookean", "neo-Hookean + gravity"]
    last = (data["measured"] - data["predicted"]).values * 1e3
    assert residual.by("action", residual.last) == pytest.approx({"1": rms(last[:4]), "2": rms(last[4:])})
    assert residual.by("fiducial", residual.last)["b"] == pytest.approx(np.sqrt(np.nanmean(last[:, 1] ** 2)))
    steps = residual.by("step", "neo-Hookean")
    assert list(steps) == ["0", "1", "2", "3"]
    first = (data["measured"] - data["predicted_first"]).values[[1, 5]] * 1e3
    assert steps["1"] == pytest.approx(np.sqrt(np.nanmean(first**2)))
    assert np.isnan(rms(np.array([np.nan])))


def test_the_view_holds_what_the_run_does(tmp_path: Path) -> None:
    import base64

    found = Found.read(runs.explained(tmp_path / "run"))
    data = view_data(found)
    assert data is not None
    moves = data["displacement"]
    numbers = np.frombuffer(base64.b64decode(moves["numbers"]), "<u2").reshape(8, -1, 3)
    shown = np.array(moves["low"]) + np.array(moves["step"]) * numbers
    assert found.body is not None
    nodes = np.unique(found.body["triangles"].values)
    assert shown == pytest.approx(found.body["displacement"].values[:, nodes] * 1e3, abs=1e-3)
    assert data["start"] == 7
    assert [place.get("chance") for place in data["places"]] == [None, "99 %", "3 %", None]
    assert [place.get("anchored") for place in data["places"]] == [None, True, False, None]


def test_more_frames_than_fit_are_thinned(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The ends of actions are kept."""
    monkeypatch.setattr("bcid.report.body_view._BUDGET", 10)
    data = view_data(Found.read(runs.explained(tmp_path / "run")))
    assert data is not None
    assert data["displacement"]["frames"] == [0, 3, 4, 7]
    monkeypatch.setattr("bcid.report.body_view._NODES", 10)
    assert view_data(Found.read(tmp_path / "run")) is None


def test_tables() -> None:
    rows = [("=a_1 & b", 1.42), (Cell("±", "-2"), Cell("12", 12.0)), ("", Cell("≥ 0.2", None))]
    columns = [text_column("name"), Column("error (mm)", "error")]
    table = Table("100 %", columns, [dict(zip(("name", "error"), row, strict=True)) for row in rows])
    assert table.csv() == "name,error (mm)\n'=a_1 & b,1.42\n-2,12.0\n,\n"
    assert r"=a\_1 \& b & 1.42 \\" in table.latex()
    assert r"$\pm$ & 12\phantom{.}\phantom{0}\phantom{0} \\" in table.latex()
    assert "% 100 \\%\n" in table.latex()
    assert aligned(["1.42", "12", "0.202", ""]) == ["1.42\u2007", "12\u2008\u2007\u2007\u2007", "0.202", ""]


def test_numbers() -> None:
    assert [significance(p) for p in (0, 4.2e-8, 0.58, 1.0, float("nan"))] == ["< 0.0001", "< 0.0001", "0.58", "1", ""]
    assert uncertain(1257.588, 9.41) == "1257.6 ± 9.4"
    assert uncertain(-0.0016636, 1.9e-5) == "−0.001664 ± 0.000019"
    assert uncertain(3.0) == "3"
    assert amount("tx", ParameterRow(value=7.2e-5, stderr=1e-5, unit="m")) == "tx = 0.072 ± 0.010 mm"
    assert amount("gx", ParameterRow(value=None, stderr=None, unit="1")) == "gx cannot be told"
