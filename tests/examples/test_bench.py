"""The benchmark's reduced form: its table, that all codes agree, and that both searches find the same. No times are asserted."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from validation.bench.bench_plots import slope
from validation.bench.bench_table import BenchTable, Goal, Part, goals_table

ROOT = Path(__file__).resolve().parents[2]


def bench(*arguments: object, cwd: Path, **variables: str) -> subprocess.CompletedProcess[str]:
    environment = os.environ | {"PYTHONPATH": str(ROOT), "BCID_PROJECT": str(ROOT)} | variables
    command = [sys.executable, "-m", "validation", "bench", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, cwd=cwd, env=environment, timeout=590, check=False)


def quick(*parts: str, cwd: Path) -> tuple[dict, str]:
    """What the reduced form of some parts writes and prints."""
    done = bench(*parts, "--quick", "-o", "out", cwd=cwd)
    assert done.returncode == 0, done.stderr
    return json.loads((cwd / "out/bench.json").read_text(encoding="utf-8")), done.stdout


@pytest.mark.slow
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


@pytest.mark.slow
def test_quick_identification(tmp_path: Path) -> None:
    result, _ = quick("identification", cwd=tmp_path)
    found = result["parts"]["identification"]["data"]["slab-12-semicircle"]
    assert found["bcid"]["answer"] == "1,2"
    assert met(result, "identification", "the same answer")
    assert met(result, "identification", "were made")
    stages = found["readings"]["in stages"]["stages"]
    assert [stage["level"] for stage in stages] == [0, 1]
    assert all(len(stage["visited"]) >= 9 for stage in stages)


@pytest.mark.slow
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


@pytest.mark.slow
def test_quick_explore(tmp_path: Path) -> None:
    part = quick("explore", cwd=tmp_path)[0]["parts"]["explore"]
    command, pulls = part["data"]["command"], part["data"]["pulls"]
    assert (command["reason"], command["pulls"]) == ("budget", 0)
    assert 0 < command["evaluations"]["0"] < 256
    assert (pulls["ranks"], pulls["sets"], pulls["all_sets"], pulls["predictions"]) == (2, 4, 256, 24)
    assert [goal["met"] for goal in part["goals"]] == [None, None]


@pytest.mark.slow
def test_quick_growth(tmp_path: Path) -> None:
    result, _ = quick("growth", cwd=tmp_path)
    found = result["parts"]["growth"]["data"]["mesh"]["found"]
    assert [record["unknowns"] for record in found] == [1014, 3969]
    assert all(record["factor_nonzeros"] > record["unknowns"] for record in found)
    assert met(result, "growth", "same answer")
    assert (tmp_path / "out/growth-mesh.png").stat().st_size > 10_000


def met(result: dict, part: str, words: str) -> bool:
    """Whether the one goal of a part that has these words is met."""
    (goal,) = (goal for goal in result["parts"][part]["goals"] if words in goal["what"])
    return bool(goal["met"])


def test_mistakes(tmp_path: Path) -> None:
    for arguments, variables, words in (
        (["trajctory"], {}, "did you mean 'trajectory'"),
        (["toggles"], {"OMPI_COMM_WORLD_SIZE": "2"}, "without mpirun"),
    ):
        done = bench(*arguments, "-o", "out", cwd=tmp_path, **variables)
        assert done.returncode == 2, done.stderr
        assert words in done.stderr
        assert "Traceback" not in done.stderr
    assert not list(tmp_path.iterdir())


def test_goals() -> None:
    least, most = Goal("a", 6.0, 5.9), Goal("b", 20.0, 20.0, at_most=True)
    assert (least.met, most.met, Goal("c", 1.0, None).met) == (False, True, None)
    lines = goals_table([least, most, Goal("c", 1.0, None)]).text().splitlines()
    assert len({len(line) for line in lines[1:2] + lines[-1:]}) == 1
    assert [line.split()[-1] for line in lines[4:-1]] == ["NO", "yes", "-"]
    part = Part("name", "title", [BenchTable("t", ("x", "y"), [["1", "2"]])], [least])
    assert part.to_json()["goals"][0]["met"] is False


def test_slope() -> None:
    assert slope([1, 10, 100], [3, 3e2, 3e4]) == pytest.approx((2.0, 3.0))
