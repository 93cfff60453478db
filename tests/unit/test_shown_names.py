"""Names of others are harmless on a terminal, in text files and in spreadsheets."""

from __future__ import annotations

import csv
import io
import os
from pathlib import Path

import pytest
import runs

from bcid.app.cli import main
from bcid.base.csv_text import csv_text
from bcid.base.errors import InputError
from bcid.base.progress import Lines
from bcid.base.visible import visible
from bcid.report.found import Found
from bcid.report.provenance import facts

ESCAPE = "\x1b]0;title\x07\x1b[31m\u202e\u2066\x9b2J\r"


def test_visible_controls_are_escapes() -> None:
    assert visible("a\x1b[31m\u202eb\udcff\n\tc") == "a\\x1b[31m\\u202eb\\udcff\n\tc"
    assert visible("Ä 🦴 ±") == "Ä 🦴 ±"


def test_error_control_characters_are_shown() -> None:
    assert str(InputError(f"label {ESCAPE}")).isprintable()


def test_lines_control_characters_are_shown() -> None:
    stream = io.StringIO()
    Lines(stream).say(ESCAPE)
    assert stream.getvalue().rstrip("\n").isprintable()


def test_write_text_summary_shows_control_characters(tmp_path: Path) -> None:
    run = runs.started(tmp_path / "run")
    assert run.write_text("summary.txt", ESCAPE).read_text().isprintable()


@pytest.mark.parametrize("name", [f"no {ESCAPE} run", os.fsdecode(b"no\xff")])
def test_command_escape_in_a_name_is_shown(name: str, capfd: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert main(["report", name, "-o", str(tmp_path / "a.html")]) == 2
    assert capfd.readouterr().err.rstrip("\n").isprintable()


def test_parser_escape_in_an_argument_is_shown(capfd: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["report", "run", f"--{ESCAPE}"])
    said = capfd.readouterr().err
    assert all(line.isprintable() for line in said.split("\n"))


@pytest.mark.parametrize("name", ["=1+1", "+a", "-a", "@a", "\t=a", "\ra", " =a"])
def test_csv_text_formula_begins_with_an_apostrophe(name: str) -> None:
    rows = list(csv.reader(io.StringIO(csv_text([[name], [name, -1.5, "-1"]]), newline="")))
    assert rows == [[f"'{name}"], [f"'{name}", "-1.5", "-1"]]


def test_figure_formula_in_provenance_is_text(tmp_path: Path) -> None:
    record = runs.started(tmp_path / "other")
    record.record["names"] = {"scene": "=cmd|' /C calc'!A0", "measurement": "@x"}
    record.finish({})
    text = csv_text(facts(Found.read(record.path)))
    assert "'=cmd" in text
    assert "'@x" in text
