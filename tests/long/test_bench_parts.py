"""All parts of the benchmark, reduced: their tables, that codes agree and both searches find the same. No times are asserted."""

from __future__ import annotations

from pathlib import Path

import pytest
from examples.bench_command import met, quick


def test_quick_trajectory_and_toggles(tmp_path: Path) -> None:
    result, said = quick("trajectory", "toggles", cwd=tmp_path)
    assert result["format"] == "bcid-bench/1"
    assert result["quick"] is True
    assert list(result["parts"]) == ["trajectory", "toggles"]
    for part in result["parts"].values():
        for table in part["tables"]:
            assert table["rows"]
            assert all(len(row) == len(table["columns"]) for row in table["rows"])
        assert all(goal["met"] in (True, False) for goal in part["goals"])
    assert "=== trajectory" in said
    assert "goals met" in said

    small = result["parts"]["trajectory"]["data"]["small"]
    assert set(small) == {"DOLFINx, tutorial", "DOLFINx, fast", "bcid"}
    for record in small.values():
        assert record["error"] <= 1e-9
        assert record["steps"] == 40
        assert min(record[key] for key in ("setup_s", "wall_s", "cpu_s", "rss_mb")) > 0
    assert met(result, "trajectory", "agree")
    for words in ("same best neighbour", "misfits agree", "stopped was worse"):
        assert met(result, "toggles", words)
    assert (tmp_path / "out/trajectory.png").stat().st_size > 10_000


def test_quick_identification(tmp_path: Path) -> None:
    result, _ = quick("identification", cwd=tmp_path)
    found = result["parts"]["identification"]["data"]["slab-12-semicircle"]
    assert found["bcid"]["answer"] == "1,2"
    assert met(result, "identification", "the same answer")
    assert met(result, "identification", "were made")
    stages = found["readings"]["in stages"]["stages"]
    assert [stage["level"] for stage in stages] == [0, 1]
    assert all(len(stage["visited"]) >= 9 for stage in stages)


def test_quick_explain(tmp_path: Path) -> None:
    result, _ = quick("explain", cwd=tmp_path)
    data = result["parts"]["explain"]["data"]
    found, spent, ranking = data["found"]["slab-34-heavy"], data["spent"], data["ranking"]
    assert (found["verdict"], found["anchored"]) == ("gravity", ["3", "4"])
    assert sum(spent.values()) == pytest.approx(1)
    # Names of functions are what they are told by: none of these kinds of work takes no time.
    assert min(spent.values()) > 0.005
    assert ranking["all"]["effects"] > ranking["plain"]["effects"] > 5
    assert 0 < ranking["plain"]["cpu_s"] < ranking["all"]["cpu_s"]


def test_quick_explore(tmp_path: Path) -> None:
    part = quick("explore", cwd=tmp_path)[0]["parts"]["explore"]
    command, pulls = part["data"]["command"], part["data"]["pulls"]
    assert (command["reason"], command["pulls"]) == ("budget", 0)
    assert 0 < command["evaluations"]["0"] < 256
    assert (pulls["ranks"], pulls["sets"], pulls["all_sets"], pulls["predictions"]) == (2, 4, 256, 24)
    assert [goal["met"] for goal in part["goals"]] == [None, None]


def test_quick_growth(tmp_path: Path) -> None:
    result, _ = quick("growth", cwd=tmp_path)
    found = result["parts"]["growth"]["data"]["mesh"]["found"]
    assert [record["unknowns"] for record in found] == [1014, 3969]
    assert all(record["factor_nonzeros"] > record["unknowns"] for record in found)
    assert met(result, "growth", "same answer")
    assert (tmp_path / "out/growth-mesh.png").stat().st_size > 10_000
