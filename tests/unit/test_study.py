"""Study files, the search of the paper, and a small study from file to table: by children, in parts, and under mpirun."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bcid.base.errors import InputError
from bcid.scene import Scene
from validation.__main__ import main
from validation.engine.work import Workers, read_result
from validation.paper.cells import wrong_answers
from validation.paper.claims import FAILS, HOLDS, claims
from validation.paper.condition import Condition
from validation.paper.paper_study import in_order, run_paper
from validation.paper.study import Extent, run_study
from validation.paper.study_file import StudyFile
from validation.paper.trial_errors import seen_positions, true_actions, true_scene, turned

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
compared = 1
true_degree = 1
true_size = "8 mm"
[vary]
noise = ["0 mm", "20 mm"]
search = ["stages", "single"]
[table]
rows = "search"
columns = "noise"
also = ["rms", "stages"]
[quick]
trials = 4
[[paper]]
where = {{ noise = "0 mm" }}
right = 1.0
calls = [165, 94]
[[paper]]
more_right_than = 14
[[paper]]
where = {{ anchors = [["1", "2"]] }}
wrong = [["4"], ["1", "2", "3", "4", "5", "6"]]
"""


@pytest.fixture
def small(tmp_path: Path) -> Path:
    file = tmp_path / "small.toml"
    file.write_text(SMALL, encoding="utf-8")
    return file


# -- files
# ------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("file", sorted((PROJECT / "validation/paper").glob("*.toml")), ids=lambda file: file.stem)
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
        ("right = 1.0", "wright = 1.0", "paper.wright: is not known"),
        ("right = 1.0", "right = 100", "paper.right: expected a part from 0 to 1, found 100"),
        ("right = 1.0", 'wrong = ["1"]', "paper.wrong: expected a list of sets"),
        ('also = ["rms"', 'also = ["arms"', "table.also: 'arms': did you mean 'rms'"),
        ('motion = "pull"', 'stop = "sane"', "setting.stop: 'sane': allowed are last, same, similarity, refinement"),
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
        (["study", "nothing.toml"], "nothing.toml: no such file"),
        (["paper", "--jobs", "0"], "--jobs 0: must be at least 1"),
        (["paper", "--limit", "nan"], "--limit nan: must be a positive number of seconds"),
        (["study", "FILE", "--part", "3/2"], "--part '3/2': expected I/N"),
        (["study", "FILE", "--part", "half"], "--part 'half': expected I/N"),
    ],
)
def test_bad_arguments(
    tmp_path: Path, small: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], told: str
) -> None:
    arguments = [str(small) if a == "FILE" else a for a in arguments]
    assert main([*arguments, "-o", str(tmp_path / "run")]) == 2
    assert told in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


def test_turning_a_motion_turns_its_translations_and_its_axes() -> None:
    from bcid.scene.rotation import from_vector

    action = Condition(motion="complex").actions()[0]
    made = turned(action, from_vector([0.0, 0.0, 90.0]))
    assert np.allclose(made.translation[:, 0], -action.translation[:, 1])
    assert np.allclose(made.translation[:, 1], action.translation[:, 0])
    # Turns about x become turns about y, by the same angle.
    assert np.allclose(made.rotation[-1], action.rotation[-1][[0, 3, 1, 2]])


REST = np.arange(12.0).reshape(4, 3) * 1e-2
STILL = np.broadcast_to(REST, (50, 4, 3))


def test_what_is_drawn_has_the_size_that_is_asked_for() -> None:
    def errors(condition: Condition, count: int = 300) -> np.ndarray:
        return np.array([seen_positions(condition, STILL, REST.mean(axis=0), i, 3) - REST for i in range(count)])

    white = errors(Condition(noise=2e-3), 20)
    assert white.std() == pytest.approx(2e-3, rel=0.02)
    shift = errors(Condition(registration=2e-3))
    assert np.ptp(shift, axis=(1, 2)).max() < 1e-15
    assert shift.std() == pytest.approx(2e-3, rel=0.1)
    scale = errors(Condition(camera_scale=0.01)) / np.where(REST.mean(axis=0) == REST, 1, REST - REST.mean(axis=0))
    assert scale[:, 0, 0, 0].std() == pytest.approx(0.01, rel=0.1)
    spun = np.linalg.norm(errors(Condition(camera_turn=1.0))[:, 0, 0], axis=1)
    arm = np.linalg.norm(REST[0] - REST.mean(axis=0))
    assert 0.4 * arm * np.radians(1.0) < np.sqrt(np.mean(spun**2)) <= 1.1 * arm * np.radians(1.0)
    # What is varied changes no other draw.
    both = errors(Condition(noise=2e-3, registration=2e-3), 20)
    assert np.allclose(both, white + shift[:20], atol=1e-15)


def test_the_robot_is_elsewhere_in_each_step_but_at_rest() -> None:
    """Section 5.2.2: white noise on the robot's trajectory in each step; trials of one number differ by its size alone."""
    still = Condition().actions()[0]

    def off(sigma: float, number: int = 0) -> np.ndarray:
        return true_actions(Condition(robot_noise=sigma), number, 3)[0].translation - still.translation

    drawn = np.array([off(2e-3, number) for number in range(100)])
    assert not drawn[:, 0].any()
    assert drawn[:, 1:].std(axis=(0, 1)) == pytest.approx(np.full(3, 2e-3), rel=0.05)
    steps = drawn[:, 1:-1].ravel(), drawn[:, 2:].ravel()
    assert abs(np.corrcoef(*steps)[0, 1]) < 0.03
    assert np.allclose(off(1e-3), off(2e-3) / 2)
    assert not off(0.0).any()


def test_the_grasp_is_elsewhere_in_x_and_z_alone() -> None:
    """Section 5.2.3; the gripper, its centre and the mesh are shifted together, and never further than every grasp succeeds."""
    scene = Scene.read(PROJECT / "examples/scenes/slab_paper.toml")
    centre = np.array(scene.grasps["II"].centre)

    def off(sigma: float, number: int) -> np.ndarray:
        true = true_scene(Condition(grasp_error=sigma), scene, number, 3)
        moved = np.array(true.grasps["II"].centre) - centre
        assert true.parameters == pytest.approx({"shift_x": moved[0] * 1e3, "shift_z": moved[2] * 1e3})
        return moved

    drawn = np.array([off(2e-3, number) for number in range(200)])
    assert drawn.std(axis=0) == pytest.approx([2e-3, 0.0, 2e-3], rel=0.12)
    assert np.abs(np.array([off(20e-3, number) for number in range(50)])).max() == pytest.approx(15e-3)
    assert true_scene(Condition(), scene, 0, 3).parameters == {}


def test_markers_are_elsewhere_along_the_surface() -> None:
    scene = Scene.read(PROJECT / "examples/scenes/slab_paper.toml")
    drawn = np.array([true_scene(Condition(placement=2e-4), scene, i, 3).rest - scene.rest for i in range(50)])
    assert drawn.std(axis=(0, 1)) == pytest.approx([2e-4, 0.0, 2e-4], rel=0.1)


# -- what the paper says
# ------------------------------------------------------------------------------------------------------------------


def rows(**found: int) -> list[dict[str, Any]]:
    """Trials with {1 2} anchored, in which sets were found so many times."""
    answers = [name for name, count in found.items() for _ in range(count)]
    return [
        {"cell": 0, "number": i, "anchors": ["1", "2"], "found": list(name[1:]), "right": name == "s12", "noise": 0.0}
        | {
            "why": "" if name == "s12" else "data",
            "calls": {"0": 100.0 + i, "1": 10.0},
            "cpu_seconds": None,
            "search": "stages",
        }
        for i, name in enumerate(answers)
    ]


def test_what_the_paper_says_holds_or_does_not(small: Path) -> None:
    study = StudyFile.read(small)

    def verdicts(*entries: dict[str, Any], **found: int) -> list[str]:
        said = claims(
            replace(study, paper=tuple({"where": {}} | e for e in entries)), rows(**found), {"0": 0.1, "1": 1.0}
        )
        return [claim.verdict for claim in said]

    assert verdicts({"right": 1.0}, s12=10) == [HOLDS]
    assert verdicts({"right": 1.0}, s12=9, s1=1) == [FAILS]
    # 9 of 10 may be chance where 95 % are right; 5 of 10 may not.
    assert verdicts({"right": 0.95}, s12=9, s1=1) == [HOLDS]
    assert verdicts({"right": 0.95}, s12=5, s1=5) == [FAILS]
    assert verdicts({"wrong": [["1", "5"], ["1"]]}, s12=3, s1=1, s15=1) == [HOLDS]
    assert verdicts({"wrong": [["1", "5"], ["1"]]}, s12=3, s1=1) == [FAILS]
    assert verdicts({"more_right_than": 14}, s12=10) == [HOLDS]
    assert verdicts({"where": {"anchors": (("3", "4"),)}, "right": 1.0}, s12=10) == []
    times = replace(study, paper=({"where": {}, "calls": [165, 94], "seconds": [84.28, 55.89, 2658]},))
    calls, seconds = claims(times, rows(s12=3), {"0": 0.1, "1": 1.0})
    assert (calls.paper, calls.here) == ("165 + 94 calls by level", "101 + 10")
    assert seconds.here == "20.1 CPU s (20 to 20.2)"


def test_wrong_answers_are_counted_with_their_reason() -> None:
    first, second = wrong_answers(rows(s12=3, s15=2, s1=1))
    assert (first.found, first.count, dict(first.why)) == (("1", "5"), 2, {"data": 2})
    assert (second.found, second.count) == (("1",), 1)


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
    assert re.search(r"noise 0 mm +100 % right +100 %, 8 of 8 +holds", told)
    assert re.search(r"noise 0 mm +165 \+ 94 calls by level +[0-9.]+ \+ [0-9.]+", told)
    assert "at most 14 of 18 right" in told
    assert re.search(r"\{1 2\} +\{.*\} +\d+ +\d+ +\d+ +\d+", told), "a wrong answer, how often, and why"
    assert re.search(r"\{2 5\} +stages +all", told)
    page = (whole / "page.md").read_text(encoding="utf-8")
    assert page.startswith("## A small study\n\nSection 0\n")
    assert "| noise 0 mm | 100 % right | 100 %, 8 of 8 | holds |" in page
    # Numbers to the right, words to the left.
    assert "| anchored | found | times | search | mesh | data |\n| --- | --- | ---: | ---: | ---: | ---: |" in page
    assert "![A small study](picture.png)" in page
    content = json.loads((whole / "study.json").read_text(encoding="utf-8"))
    assert {claim["verdict"] for claim in content["claims"]} >= {"holds"}
    assert sum(wrong["count"] for cell in content["cells"] for wrong in cell["wrong"]) == (~table["right"]).sum()
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
    _as_the_paper(small, tmp_path / "paper")


def _as_the_paper(small: Path, folder: Path) -> None:
    """All study files of a folder, reduced: their tables in one, what holds first, and a page."""
    run_paper(folder, True, 0, Workers(), studies=small.parent, explored=False)
    told = (folder / "table.txt").read_text(encoding="utf-8")
    first = re.match(r"(\d) of (\d) statements of the paper that can be judged hold here:\n", told)
    assert first
    assert told.count("  holds\n") == 2 * int(first[1])
    assert told.count("does not hold\n") == 2 * (int(first[2]) - int(first[1]))
    page = (folder / "paper.md").read_text(encoding="utf-8")
    assert "## A small study" in page
    assert "](small/picture.png)" in page
    assert (folder / "small/picture.png").is_file()
    assert json.loads((folder / "run.json").read_text(encoding="utf-8"))["result"]["studies"] == ["small"]


def test_sections_stand_in_the_order_of_the_paper() -> None:
    numbers = {
        "a": "beyond 5.2.2",
        "b": "7 and 8, Tables 8 to 10",
        "c": "5.2.2, Figure 6",
        "f": "5.2.2 and 5.3, Table 3",
        "d": "3.5",
        "e": "5.2.1",
    }
    texts = {name: f"## Title\n\nSection {number}\n" for name, number in numbers.items()}
    assert in_order(texts) == ["d", "e", "c", "f", "b", "a"]


PYTHON = [sys.executable, "-m", "validation"]


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
from validation.engine.dispatch import dispatch
from validation.engine.work import Workers
from validation.reliability.kills import tasks, work
dispatch(work(Path(sys.argv[1]), sleep=0.05), tasks(60, t7="raise"), Workers(MPI.COMM_WORLD), Silent())
"""


@pytest.mark.timeout(200)
def test_a_rank_that_is_killed_ends_the_job_and_the_next_goes_on(tmp_path: Path) -> None:
    from validation.reliability.kills import begun, values, work

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
from validation.engine.dispatch import dispatch
from validation.engine.work import Workers
from validation.reliability.kills import tasks, work
dispatch(work(Path(sys.argv[1])), tasks(8, t1="spin", t3="hang"), Workers(MPI.COMM_WORLD, limit=1.0), Silent())
"""


@pytest.mark.timeout(100)
def test_a_trial_that_takes_too_long_ends_on_ranks_too(tmp_path: Path) -> None:
    from validation.reliability.kills import begun, values, work

    made = work(tmp_path)
    assert _mpirun(sys.executable, "-c", _SLOW, str(tmp_path)).wait(timeout=60) == 0
    assert values(made, 8) == [None if i in (1, 3) else i * i for i in range(8)]
    # A machine that is busy may not give the first its second of CPU time in four.
    for index, reasons in {
        1: ("took more than 1 CPU s", "was not done after 4 s"),
        3: ("was not done after 4 s",),
    }.items():
        result = read_result(made.file(f"{index:04d}"))
        assert result["state"] == "timeout"
        assert result["reason"] in reasons
    assert len(begun(made)) == 8


_LATE = """
import json
import sys
from pathlib import Path
from mpi4py import MPI
from bcid.base.progress import Silent
from validation.engine.dispatch import dispatch
from validation.engine.work import Workers, Work

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
