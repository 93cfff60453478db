"""The benchmark: what a part makes of its measurements, its goals, and what is said of mistakes. No times are asserted."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from examples.bench_command import bench

from bcid.base.progress import Silent
from validation.bench import toggles_bench
from validation.bench.bench_plots import slope
from validation.bench.bench_table import BenchTable, Goal, Part, goals_table
from validation.bench.measure import Session


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """What bcid's process of the part says, on a mesh of 50 mm."""
    session = Session(tmp_path_factory.mktemp("toggles"), True, Silent())
    return session.run("bcid_toggles", 50.0, 1, toggles_bench.MEASUREMENT, toggles_bench.CENTRE)


@pytest.mark.parametrize(("factor", "agree"), [(1.0, True), (1.001, False)])
def test_toggles_part_compares_codes_set_by_set(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, measured: dict[str, Any], factor: float, agree: bool
) -> None:
    """The other code's misfits are bcid's, but for a factor."""
    outcomes = [one | {"chi2": factor * one["chi2"], "complete": True} for one in measured["outcomes"]]

    def recorded(_self: Session, module: str, *_: object) -> dict[str, Any]:
        return measured | {"outcomes": outcomes} if module.startswith("peers.") else measured

    monkeypatch.setattr(Session, "run", recorded)
    found = toggles_bench.run(Session(tmp_path, True, Silent())).to_json()
    neighbours, processes = found["tables"]
    assert (len(neighbours["rows"]), len(processes["rows"])) == (8, 2)
    assert all(len(row) == len(table["columns"]) for table in found["tables"] for row in table["rows"])
    met = {goal["what"]: goal["met"] for goal in found["goals"]}
    assert met["complete misfits agree (relative)"] == agree
    assert met["the same best neighbour (1 = yes)"]
    assert met["what was stopped was worse in truth (1 = yes)"]


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
