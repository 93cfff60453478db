"""The exploration study from beginning to end: stopped, it goes on."""

import json
from pathlib import Path
from typing import Any

import pytest
from unit.test_exploration_study import without_time

from bcid.base.run_folder import sealed
from validation.engine.work import Workers
from validation.exploration.exploration_study import run_study
from validation.exploration.exploration_trials import (
    ANCHORS,
    GRASPS,
    ExplorationExtent,
)


def test_a_study_that_was_stopped_goes_on(tmp_path: Path, coarse_scene: Path) -> None:
    """Trials that are there are not made again, and the table counts them all."""

    extent = ExplorationExtent(1, (1e-3,), ("gravity",), (), GRASPS[:1], ("information", "fixed"))

    def run() -> dict[str, Any]:
        run_study(tmp_path / "study", extent, 0, Workers(), scene_file=coarse_scene)
        found: dict[str, Any] = json.loads((tmp_path / "study/trials.json").read_text(encoding="utf-8"))
        return found

    whole = run()
    files = sorted((tmp_path / "study/results").glob("*.json"))
    assert len(files) == whole["trials"] == 10
    kept = [file.read_text(encoding="utf-8") for file in files]
    record = json.loads((tmp_path / "study/run.json").read_text(encoding="utf-8"))
    (tmp_path / "study/run.json").write_text(json.dumps(sealed(record | {"state": "running"})), encoding="utf-8")
    files[0].unlink()
    again = run()
    assert [file.read_text(encoding="utf-8") for file in files[1:]] == kept[1:]
    assert without_time(json.loads(files[0].read_text(encoding="utf-8"))) == without_time(json.loads(kept[0]))
    assert again["calibration"] == whole["calibration"]
    assert sum(row["right"] for row in whole["rows"]) > 3
    heavy = next(row for row in whole["hidden"] if row["hidden"] == "gravity")
    assert (heavy["trials"], heavy["right"], heavy["told_by"]) == (1, 1, 1)
    assert len(whole["forces"]) == len(ANCHORS)
    for row in whole["forces"]:
        assert row["with"]["bits"] > row["without"]["bits"]
        # The body is stiffer than its scene by a fifth.
        assert row["with"]["stiffness"] == pytest.approx(1.2, abs=3 * row["with"]["stderr"])
        assert row["without"]["stiffness"] is None
