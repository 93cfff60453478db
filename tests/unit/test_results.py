"""Records of results: written as JSON, read back, converted, and read from format/1."""

from __future__ import annotations

import json
import zipfile
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import pytest
import runs

import bcid
from bcid.api.results import DiagnosisResult, ExploreResult, IdentifyResult, ProposeResult
from bcid.base.errors import InputError
from bcid.base.run_folder import RunFolder
from bcid.report.page import write_report
from bcid.results.diagnosis_record import DiagnosisRecord, DiscrepancyRecord
from bcid.results.exploration_record import ExplorationRecord
from bcid.results.identification_record import IdentificationRecord
from bcid.results.proposal_record import ProposalRecord
from bcid.results.record import FileRecord
from bcid.results.run_documents import RECORDS, read_record

FORCE = {"position": [10.0, 20.0, 30.0], "force": [0.0, -0.1, 0.0], "stderr": 0.01}
DISCREPANCY = {
    "explained_fraction": 0.99,
    "rms": 0.22,
    "steady": [FORCE],
    "growing": {"1": [FORCE, FORCE]},
    "together": {"steady": FORCE, "growing": {"1": FORCE}},
    "length_unit": "mm",
}
PROPOSAL = {
    "proposed": [],
    "complete": False,
    "discrepancy_probability": 0.9,
    "explained_fraction": 0.0,
    "scored": 7,
    "law_form": {"first_squared": {"value": 0.1, "stderr": 0.2, "allowed": 0.3}},
    "path": [
        {
            "beside": "neo_hooke",
            "selected": "spring",
            "rms": 0.3,
            "candidates": [{"family": "spring", "expected_rms": 0.31, "log_evidence": None}],
        }
    ],
    "length_unit": "mm",
}
CONTENTS: dict[type[FileRecord], dict[str, Any]] = {
    DiagnosisRecord: runs.diagnosis(),
    IdentificationRecord: runs.identification(),
    ExplorationRecord: runs.exploration(),
    DiscrepancyRecord: DISCREPANCY,
    ProposalRecord: PROPOSAL,
}


@pytest.fixture(params=RECORDS, ids=lambda kind: kind.__name__)
def kind(request: pytest.FixtureRequest) -> type[FileRecord]:
    found: type[FileRecord] = request.param
    return found


def test_record_written_and_read_is_the_same(kind: type[FileRecord]) -> None:
    record = kind.from_json(CONTENTS[kind])
    text = json.dumps(record.to_json(), allow_nan=False)
    assert kind.from_json(json.loads(text)) == record
    assert set(json.loads(text)) == {f.name for f in fields(kind)}


def test_record_converted_there_and_back_is_the_same(kind: type[FileRecord]) -> None:
    record = kind.from_json(CONTENTS[kind])
    again = record.converted("m").converted("mm")
    assert json.loads(json.dumps(again.to_json()), parse_float=lambda text: round(float(text), 9)) == json.loads(
        json.dumps(record.to_json()), parse_float=lambda text: round(float(text), 9)
    )
    assert record.converted("mm") is record
    with pytest.raises(InputError, match="furlong"):
        record.converted("furlong")


def test_record_lengths_at_every_depth_are_converted() -> None:
    found = DiscrepancyRecord.from_json(DISCREPANCY | {"length_unit": "cm"}).converted("mm")
    assert (found.length_unit, found.rms) == ("mm", pytest.approx(2.2))
    assert found.growing["1"][1].position == pytest.approx((100.0, 200.0, 300.0))
    assert found.together.growing["1"].force == (0.0, -0.1, 0.0)
    other = DiagnosisRecord.from_json(runs.diagnosis()).converted("m")
    assert other.ranking[0].fitted_rms == pytest.approx(0.21e-3)
    assert other.ranking[0].parameters["weight"].value == 1257.6, "an amount keeps its own unit"
    assert replace(other, contributions={"gravity": 1e-3}).converted("mm").contributions == {"gravity": 1.0}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"rms": "1"}, "rms: expected a number, found '1'"),
        ({"rms": True}, "rms: expected a number, found True"),
        ({"verdict": None}, "verdict: expected a text, found None"),
        ({"noise_stated": 1}, "noise_stated: expected true or false, found 1"),
        ({"anchored": "left"}, "anchored: expected a list, found 'left'"),
        ({"model_sequence": [{"model": "neo_hooke"}]}, r"model_sequence\[0\].anchored: is missing"),
        ({"residual_by": {"action": {"1": "x"}}}, "residual_by.action.1: expected a number"),
        ({"posterior": []}, "posterior: expected a table"),
        ({"length_unit": "furlong"}, "furlong"),
    ],
)
def test_record_of_other_content_is_refused_by_the_key(change: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=words):
        DiagnosisRecord.from_json(runs.diagnosis() | change)


def test_record_without_a_key_is_refused(kind: type[FileRecord]) -> None:
    content = dict(CONTENTS[kind])
    del content["rms" if "rms" in content else "scored"]
    with pytest.raises(InputError, match="is missing"):
        kind.from_json(content)
    with pytest.raises(InputError, match="expected a table"):
        kind.from_json([])


def test_record_keys_that_are_not_known_are_left_out(kind: type[FileRecord]) -> None:
    assert kind.from_json(CONTENTS[kind] | {"added_later": 1}) == kind.from_json(CONTENTS[kind])


def test_damaged_record_of_a_run_names_file_and_key(tmp_path: Path) -> None:
    folder = runs.identified(tmp_path / "run")
    runs.rewrite(folder, "identification.json", json.dumps(runs.identification() | {"patches": {"left": "x"}}))
    with pytest.raises(InputError, match=r"identification\.json: .*patches\.left: expected a number"):
        read_record(RunFolder.open(folder), IdentificationRecord)


@pytest.fixture(scope="module")
def format_one(tmp_path_factory: pytest.TempPathFactory, project: Path) -> Path:
    """Runs of version 0.2.0, which wrote format/1."""
    folder = tmp_path_factory.mktemp("format-1")
    with zipfile.ZipFile(project / "tests/data/format-1.zip") as packed:
        packed.extractall(folder)
    return folder


def test_runs_of_format_one_are_loaded(format_one: Path) -> None:
    identified = bcid.load(format_one / "identify")
    assert isinstance(identified, IdentifyResult)
    assert (identified.anchored, identified.adequate, identified.evaluated["failed"]) == (("3", "4"), True, 0)
    assert 2e-4 < identified.rms < 4e-4
    assert identified.discrepancy_probability is not None
    explained = bcid.load(format_one / "explain")
    assert isinstance(explained, DiagnosisResult)
    assert (explained.verdict, explained.model_sequence[0].rms > 1e-3) == ("gravity", True)
    assert explained.parameters["gravity.weight"].value == pytest.approx(1300, rel=0.1)
    assert explained.posterior is not None
    assert explained.posterior.effects["gravity"] > 0.9
    assert explained.input_uncertainties[0].estimate > 0
    explored = bcid.load(format_one / "explore")
    assert isinstance(explored, ExploreResult)
    assert explored.steps[0].amplitude == pytest.approx(8e-3)
    assert explored.steps[0].posterior[0].probability < 1
    assert explored.steps[0].options[0].expected_bits is not None
    proposed = bcid.load(format_one / "propose")
    assert isinstance(proposed, ProposeResult)
    assert proposed.proposal.scored > 100


@pytest.mark.parametrize("command", ["identify", "explain", "explore", "propose"])
def test_runs_of_format_one_are_shown(format_one: Path, tmp_path: Path, command: str) -> None:
    made = write_report([format_one / command], tmp_path / "report.html")
    assert not [text for texts in made.troubles.values() for text in texts]


def test_every_key_of_a_record_has_a_type_and_a_meaning(tmp_path: Path, project: Path, monkeypatch: Any) -> None:
    monkeypatch.syspath_prepend(str(project / "docs/_make"))
    from result_files import write_result_files

    write_result_files(project / "docs/_make/files_head.md", tmp_path / "files.md")
    lines = (tmp_path / "files.md").read_text(encoding="utf-8").split("## diagnosis.json")[1].splitlines()
    rows = [line.strip("| ").split(" | ") for line in lines if line.startswith("| `")]
    assert len(rows) > 150
    assert [row for row in rows if len(row) != 3 or not all(cell.strip("| ") for cell in row)] == []
