"""Study files, the search of the paper, and a small study from file to table: by children, in parts, and under mpirun."""

import json
import os
import signal
import subprocess
import sys
import time
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bcid.app.cli import main
from bcid.base.errors import InputError
from bcid.studies.engine.work import Workers, read_result
from bcid.studies.paper.algorithm1 import in_one_stage, in_stages, optimum
from bcid.studies.paper.condition import Condition
from bcid.studies.paper.identification_trial import see, turned
from bcid.studies.paper.study import Extent, run_study
from bcid.studies.paper.study_file import StudyFile

HERE = Path(__file__).resolve().parent
PROJECT = HERE.parents[1]
SCENE = PROJECT / "examples/scenes/gallbladder.toml"
SMALL = f"""
format = "bcid-study/1"
name = "small"
title = "A small study"
section = "0"
scene = "{SCENE}"
trials = 4
[setting]
grasp = "neck"
motion = "pull"
anchors = [["1", "2"], ["2", "5"]]
finest = 1
true_degree = 1
true_size = "8 mm"
[vary]
noise = ["0 mm", "20 mm"]
search = ["stages", "single"]
[table]
rows = "search"
columns = "noise"
[quick]
trials = 2
[[paper]]
where = {{ noise = "0 mm" }}
right = 1.0
calls = [165, 94]
[[paper]]
right_of_18 = 14
"""


@pytest.fixture
def small(tmp_path: Path) -> Path:
    file = tmp_path / "small.toml"
    file.write_text(SMALL, encoding="utf-8")
    return file


# -- files
# ------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("file", sorted((PROJECT / "studies").glob("*.toml")), ids=lambda file: file.stem)
def test_every_study_of_the_paper_can_be_read(file: Path) -> None:
    full, quick = StudyFile.read(file), StudyFile.read(file, quick=True)
    assert full.name == file.stem
    assert len({trial.name for trial in full.all_trials()}) == len(full.all_trials()) >= len(quick.all_trials())
    assert set(quick.vary) == set(full.vary)


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ('format = "bcid-study/1"', 'format = "bcid-study/9"', "format: expected 'bcid-study/1', found 'bcid-study/9'"),
        ("trials = 4", "trials = true", "trials: expected a positive whole number, found True"),
        ("trials = 4", "", "trials: is missing"),
        ("finest = 1", "finesse = 1", "setting.finesse: is not known; did you mean 'finest'?"),
        ('"20 mm"]', "20]", "vary.noise: 20 has no unit"),
        ('"20 mm"]', '"20 kg"]', "vary.noise: unit 'kg' cannot be used here"),
        ('"single"]', '"double"]', "vary.search: 'double': allowed are stages, single, identify"),
        ('rows = "search"', 'rows = "motion"', "table.rows: 'motion' is not varied; varied are noise, search"),
        ('name = "small"', 'name = "../small"', "name: '../small': letters, digits, - and _ only"),
        ('[["1", "2"], ["2", "5"]]', '["1"]', "setting.anchors: expected a list as"),
        ('["2", "5"]', '["2", "9"]', "anchors: patch '9': known: 1, 2"),
        ('grasp = "neck"', 'grasp = "nick"', "grasp 'nick': did you mean 'neck'?"),
        ("finest = 1", "finest = 4", "finest = 4: the scene has levels 0 to 3"),
        ("finest = 1", 'effects = ["gravitas: weight = 1 N/m^3"]', "gravitas"),
        ("right = 1.0", "wrong = 1.0", "paper.wrong: is not known"),
        ("[vary]", "[vary", "not a TOML file"),
    ],
)
def test_a_bad_file_is_refused_with_the_reason(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], old: str, new: str, told: str
) -> None:
    assert SMALL.count(old) >= 1
    file = tmp_path / "bad.toml"
    file.write_text(SMALL.replace(old, new, 1), encoding="utf-8")
    assert main(["study", str(file), "-o", str(tmp_path / "run")]) == 2
    assert told in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["nothing.toml"], "neither a file nor one of paper, hidden, exploration"),
        (["paper", "--jobs", "0"], "--jobs 0: must be at least 1"),
        (["paper", "--limit", "nan"], "--limit nan: must be a positive number of seconds"),
        (["FILE", "--part", "3/2"], "--part '3/2': expected I/N"),
        (["FILE", "--part", "half"], "--part 'half': expected I/N"),
    ],
)
def test_bad_arguments(
    tmp_path: Path, small: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], told: str
) -> None:
    arguments = [str(small) if a == "FILE" else a for a in arguments]
    assert main(["study", *arguments, "-o", str(tmp_path / "run")]) == 2
    assert told in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


# -- search
# ------------------------------------------------------------------------------------------------------------------

PATCHES = [str(i) for i in range(1, 7)]
EVERY = [frozenset(c) for n in range(7) for c in combinations(PATCHES, n)]


def test_the_search_of_the_paper_climbs_to_the_best_and_counts_its_calls() -> None:
    truth = frozenset("25")

    def misfit(_level: int, candidate: frozenset[str]) -> float:
        return float(len(candidate ^ truth))

    seed = frozenset("134")
    staged = in_stages(misfit, PATCHES, [seed], 2)
    assert staged.anchors == truth
    # Five toggles away: from each set on the path all six neighbours, and in the end those of the best.
    path = [seed]
    while path[-1] != truth:
        path.append(min((path[-1] ^ {p} for p in PATCHES), key=lambda c: (misfit(0, c), len(c), sorted(c))))
    looked_at = {c ^ {p} for c in path for p in PATCHES} | {seed}
    assert staged.calls == {0: len(looked_at), 1: 7, 2: 1}
    single = in_one_stage(misfit, PATCHES, [seed], 2)
    assert (single.anchors, single.calls) == (truth, {2: len(looked_at)})
    assert optimum(misfit, EVERY, 2) == truth


def test_a_search_may_end_on_another_maximum_than_the_best_of_all() -> None:
    deep, broad = frozenset("123456"), frozenset[str]()

    def misfit(_level: int, candidate: frozenset[str]) -> float:
        return -1.0 if candidate == deep else float(len(candidate ^ broad))

    assert in_one_stage(misfit, PATCHES, [frozenset("12")], 0).anchors == broad
    assert optimum(misfit, EVERY, 0) == deep


def test_turning_a_motion_turns_its_translations_and_its_axes() -> None:
    from bcid.scene.rotation import from_vector

    action = Condition(motion="complex").actions()[0]
    made = turned(action, from_vector([0.0, 0.0, 90.0]))
    assert np.allclose(made.translation[:, 0], -action.translation[:, 1])
    assert np.allclose(made.translation[:, 1], action.translation[:, 0])
    # Turns about x become turns about y, by the same angle.
    assert np.allclose(made.rotation[-1], action.rotation[-1][[0, 3, 1, 2]])


class Still:
    """A store whose truth is a body that stays at rest."""

    class Body:
        rest = np.arange(12.0).reshape(4, 3) * 1e-2

    def read(self) -> Any:
        return self.Body

    def truth(self, _condition: Condition, _anchors: frozenset[str], _actions: Any = None) -> np.ndarray:
        return np.broadcast_to(self.Body.rest, (50, 4, 3))


def test_what_is_drawn_has_the_size_that_is_asked_for() -> None:
    store: Any = Still()
    rest = Still.Body.rest

    def errors(condition: Condition, count: int = 300) -> np.ndarray:
        return np.array([see(store, condition, i, 3) - rest for i in range(count)])

    white = errors(Condition(noise=2e-3), 20)
    assert white.std() == pytest.approx(2e-3, rel=0.02)
    shift = errors(Condition(registration=2e-3))
    assert np.ptp(shift, axis=(1, 2)).max() < 1e-15
    assert shift.std() == pytest.approx(2e-3, rel=0.1)
    scale = errors(Condition(camera_scale=0.01)) / np.where(rest == rest.mean(axis=0), 1, rest - rest.mean(axis=0))
    assert scale[:, 0, 0, 0].std() == pytest.approx(0.01, rel=0.1)
    spun = np.linalg.norm(errors(Condition(camera_turn=1.0))[:, 0, 0], axis=1)
    arm = np.linalg.norm(rest[0] - rest.mean(axis=0))
    assert 0.4 * arm * np.radians(1.0) < np.sqrt(np.mean(spun**2)) <= 1.1 * arm * np.radians(1.0)
    # What is varied changes no other draw.
    both = errors(Condition(noise=2e-3, registration=2e-3), 20)
    assert np.allclose(both, white + shift[:20], atol=1e-15)


# -- from file to table
# ------------------------------------------------------------------------------------------------------------------


def without_times(folder: Path) -> dict[str, Any]:
    found = {file.name: json.loads(file.read_text(encoding="utf-8")) for file in (folder / "results").glob("*.json")}
    own = "seconds", "checksum"
    return {name: {k: v for k, v in content.items() if k not in own} for name, content in found.items()}


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_a_study_by_children_in_parts_and_on_ranks_is_the_same(small: Path, tmp_path: Path) -> None:
    import pandas as pd

    whole, parts, ranks = tmp_path / "whole", tmp_path / "parts", tmp_path / "ranks"
    run_study(small, whole, Extent(), Workers())
    told = (whole / "table.txt").read_text(encoding="utf-8")
    table = pd.read_parquet(whole / "trials.parquet")
    assert len(table) == 16
    assert set(table["state"]) == {"done"}
    quiet = table[table["noise"] == 0]
    assert quiet["right"].all()
    assert quiet["best_right"].all()
    assert not table[table["noise"] > 0]["right"].all()
    assert set(quiet["anchors"]) == {"1 2", "2 5"}
    assert "100 / 100" in told
    assert "paper, noise 0 mm: 100 % right; here 100.0 %; 165 + 94 calls; here" in told
    assert "at most 14 of 18; here " in told
    assert (whole / "picture.png").stat().st_size > 5000
    assert (whole / "table.csv").read_text(encoding="utf-8").startswith("noise,search,trials,failed,right,low,high,")
    with pytest.raises(InputError, match="finished"):
        run_study(small, whole, Extent(), Workers())

    # Two parts that share the folder, then the command that makes the tables.
    shared = whole / "shared"
    for i in (1, 2):
        run_study(small, parts, Extent(part=(i, 2), only_predict=True), Workers(), shared=shared)
    begun = [
        subprocess.Popen([*PYTHON, "study", str(small), "-o", str(parts), "--part", f"{i}/2", "--quiet"])
        for i in (1, 2)
    ]
    assert [process.wait(timeout=120) for process in begun] == [0, 0]
    assert not (parts / "table.txt").exists()
    run_study(small, parts, Extent(), Workers(), shared=shared)
    assert without_times(parts) == without_times(whole)
    assert (parts / "table.txt").read_text(encoding="utf-8") == told

    _on_ranks(small, ranks)
    assert without_times(ranks) == without_times(whole)


PYTHON = [sys.executable, "-m", "bcid"]


def _mpirun(*command: str) -> subprocess.Popen[bytes]:
    clean = {k: v for k, v in os.environ.items() if not k.startswith(("OMPI_COMM", "PMIX_", "PMI_"))}
    environment = clean | {"PYTHONPATH": os.pathsep.join([str(PROJECT), str(HERE)])}
    return subprocess.Popen(["mpirun", "-n", "3", *command], env=environment, stderr=subprocess.DEVNULL)


def _on_ranks(file: Path, folder: Path) -> None:
    assert _mpirun(*PYTHON, "study", str(file), "-o", str(folder), "--quiet").wait(timeout=200) == 0


_DEAL = """
import sys
from pathlib import Path
from mpi4py import MPI
from bcid.base.progress import Silent
from bcid.studies.engine.dispatch import dispatch
from bcid.studies.engine.work import Workers
from benchmarks.reliability.kills import tasks, work
dispatch(work(Path(sys.argv[1]), sleep=0.05), tasks(60, t7="raise"), Workers(MPI.COMM_WORLD), Silent())
"""


@pytest.mark.timeout(200)
def test_a_rank_that_is_killed_ends_the_job_and_the_next_goes_on(tmp_path: Path) -> None:
    from benchmarks.reliability.kills import begun, values, work

    made = work(tmp_path)
    job = _mpirun(sys.executable, "-c", _DEAL, str(tmp_path))
    end = time.monotonic() + 60
    while len(begun(made)) < 15:
        assert time.monotonic() < end
        time.sleep(0.02)
    os.kill(begun(made)[-1][1], signal.SIGKILL)
    assert job.wait(timeout=20) != 0
    done = {file.stem for file in made.results.glob("0*.json")}
    assert 0 < len(done) < 60
    before = len(begun(made))
    assert _mpirun(sys.executable, "-c", _DEAL, str(tmp_path)).wait(timeout=100) == 0
    assert len(begun(made)) - before == 60 - len(done)
    assert values(made, 60) == [None if i == 7 else i * i for i in range(60)]


_SLOW = """
import sys
from pathlib import Path
from mpi4py import MPI
from bcid.base.progress import Silent
from bcid.studies.engine.dispatch import dispatch
from bcid.studies.engine.work import Workers
from benchmarks.reliability.kills import tasks, work
dispatch(work(Path(sys.argv[1])), tasks(8, t1="spin", t3="hang"), Workers(MPI.COMM_WORLD, limit=1.0), Silent())
"""


@pytest.mark.timeout(100)
def test_a_trial_that_takes_too_long_ends_on_ranks_too(tmp_path: Path) -> None:
    from benchmarks.reliability.kills import begun, values, work

    made = work(tmp_path)
    assert _mpirun(sys.executable, "-c", _SLOW, str(tmp_path)).wait(timeout=60) == 0
    assert values(made, 8) == [None if i in (1, 3) else i * i for i in range(8)]
    for index, reason in {1: "took more than 1 CPU s", 3: "was not done after 4 s"}.items():
        result = read_result(made.file(f"{index:04d}"))
        assert (result["state"], result["reason"]) == ("timeout", reason)
    assert len(begun(made)) == 8


_LATE = """
import json
import sys
from pathlib import Path
from mpi4py import MPI
from bcid.base.progress import Silent
from bcid.studies.engine.dispatch import dispatch
from bcid.studies.engine.work import Workers, Work

def maker(job):
    from petsc4py import PETSc

    return lambda task: {"ranks": PETSc.COMM_WORLD.size}

if __name__ == "__main__":
    folder = Path(sys.argv[1])
    dispatch(Work("late:maker", {}, folder), {name: {} for name in "abcd"}, Workers(MPI.COMM_WORLD), Silent())
"""


@pytest.mark.timeout(100)
def test_ranks_that_need_petsc_first_in_a_trial_do_not_wait_for_each_other(tmp_path: Path) -> None:
    (tmp_path / "late.py").write_text(_LATE, encoding="utf-8")
    job = _mpirun(sys.executable, str(tmp_path / "late.py"), str(tmp_path / "results"))
    try:
        assert job.wait(timeout=40) == 0
    finally:
        job.kill()
    for name in "abcd":
        assert json.loads((tmp_path / f"results/{name}.json").read_text(encoding="utf-8"))["result"] == {"ranks": 3}
