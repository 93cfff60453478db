"""Changed run folders and the commands that take one, reduced; see docs/reliability.md."""

from __future__ import annotations

from pathlib import Path

import pytest

from validation.reliability.foreign_runs import cases, explained, trouble


@pytest.mark.parametrize(
    ("what", "command"),
    [
        ("model.json deleted", "compare"),
        ("run.json FIFO", "diagnose"),
        ("diagnosis.json link", "propose"),
        ("summary.txt sparse", "report"),
        ("body.nc FIFO", "figure"),
        ("triangles absurd", "figure"),
        ("cells absurd", "load"),
    ],
)
def test_command_changed_run_is_refused_or_told(tmp_path: Path, what: str, command: str) -> None:
    folder = explained(tmp_path / "run")
    dict(cases())[what](folder)
    assert trouble(folder, command) == ""
