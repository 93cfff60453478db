"""The command line as a stranger uses it: one readable message for a mistake, its exit code, and nothing half-written."""

import contextlib
import io
import itertools
import json
import os
import shutil
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import runs

from bcid import Measurement
from bcid.app import answer_commands, cli, console
from bcid.base.errors import MachineError
from bcid.base.progress import Lines
from bcid.base.run_folder import RunFolder, sealed
from validation.__main__ import main as validate

ROOT = Path(__file__).resolve().parents[2]
SLAB = ROOT / "examples/scenes/slab.toml"
LIMITED = ROOT / "examples/scenes/slab_explain.toml"
SEEN = ROOT / "examples/measurements/slab-12-semicircle"


Done = subprocess.CompletedProcess[str]


def bcid(*arguments: object, cwd: Path) -> Done:
    """The command in this process: one of its own takes seconds, and here are a hundred."""
    words = list(map(str, arguments))
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    with (
        contextlib.chdir(cwd),
        contextlib.redirect_stdout(io.StringIO()) as out,
        contextlib.redirect_stderr(io.StringIO()) as err,
    ):
        try:
            code = cli.main(words)
        except SystemExit as end:
            code = int(end.code or 0)
    for number, handler in handlers.items():
        signal.signal(number, handler)
    return subprocess.CompletedProcess(words, code, out.getvalue(), err.getvalue())


def process(*arguments: object, cwd: Path) -> Done:
    """The command as a process."""
    command = [sys.executable, "-m", "bcid", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, cwd=cwd, timeout=280, check=False)


def refused(result: Done, *words: str) -> None:
    assert result.returncode == 2, result.stderr
    assert "Traceback" not in result.stderr
    assert all(word in result.stderr for word in words), result.stderr


COMMANDS = [
    "demo",
    "identify",
    "simulate",
    "explore",
    "report",
    "figure",
    "import",
    "compare",
    "diagnose",
    "fit",
    "explain",
]


def test_help_names_every_command(tmp_path: Path) -> None:
    result = bcid("--help", cwd=tmp_path)
    assert result.returncode == 0
    assert all(word in result.stdout for word in (*COMMANDS, "doctor", "exit codes"))
    for command in COMMANDS:
        assert bcid(command, "--help", cwd=tmp_path).returncode == 0
    assert bcid(cwd=tmp_path).returncode == 2
    assert "did you mean 'identify'" in bcid("identfy", cwd=tmp_path).stderr
    assert "./dev bcid-validate" in bcid("study", "paper", cwd=tmp_path).stderr


def test_renamed_flag_is_refused_with_its_name(tmp_path: Path) -> None:
    refused(
        bcid("identify", SLAB, SEEN, "-o", "run", "--certify", "yes", cwd=tmp_path), "--certify is --exhaustive now"
    )
    refused(
        bcid("explore", SLAB, "--robot", "simulated:1", "-o", "run", "--consider", ",", cwd=tmp_path), "names nothing"
    )
    refused(
        bcid("explore", SLAB, "--robot", "simulated:1", "-o", "run", "--samples", "x", cwd=tmp_path), "a whole number"
    )


def test_a_process_ends_with_the_exit_code(tmp_path: Path) -> None:
    assert process("--version", cwd=tmp_path).returncode == 0
    refused(process("identify", "none.toml", SEEN, "-o", "run", cwd=tmp_path), "none.toml", "no such scene file")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["identify", "none.toml", SEEN, "-o", "run"], ["none.toml", "no such scene file"]),
        (["identify", SLAB, "none", "-o", "run"], ["none", "no such measurement folder"]),
        (["identify", SLAB, SEEN, "-o", "run", "--exhaustive", "guess"], ["guess", "auto, yes, no"]),
        (["identify", SLAB, SEEN, "-o", "run", "--stages", "--finest", "9"], ["finest level 9", "levels 0 to 3"]),
        (["identify", SLAB, SEEN, "-o", "run", "--stages", "--seeds", "0"], ["seeds = 0"]),
        (["identify", SLAB, SEEN, "-o", "run", "--stages", "--start", "x"], ["maxima, threshold"]),
        (["identify", SLAB, SEEN, "-o", "run", "--seeds", "3"], ["--seeds", "add --stages"]),
        (["identify", SLAB, SEEN, "-o", "run", "--level", "9"], ["level 9", "levels 0 to 3"]),
        (["identify", SLAB, SEEN, "-o", "run", "--refine", "-1"], ["refine = -1", "at least 0"]),
        (["explain", "none.toml", SEEN, "-o", "run"], ["none.toml", "no such scene file"]),
        (["explain", SLAB, "none", "-o", "run"], ["none", "no such measurement folder"]),
        (["explain", SLAB, SEEN, "-o", "run", "--only", "gravty"], ["did you mean 'gravity'"]),
        (["explain", SLAB, SEEN, "-o", "run", "--only", ","], ["names nothing"]),
        (["explain", SLAB, SEEN, "-o", "run", "--level", "7"], ["--level 7", "levels 0 to 3"]),
        (["explain", SLAB, SEEN, "-o", "run", "--max-effects", "0"], ["--max-effects 0", "at least 1"]),
        (["explain", SLAB, SEEN, "-o", "run", "--effects", "none.py"], ["none.py", "no such file"]),
        (["explore", "none.toml", "--robot", "simulated:1", "-o", "run"], ["none.toml", "no such scene file"]),
        (["explore", SLAB, "--robot", "simulated:1", "-o", "run"], ["has no [explore] table"]),
        (["explore", LIMITED, "--robot", "hand", "-o", "run"], ["--robot 'hand'", "folder:DIR"]),
        (["explore", LIMITED, "--robot", "simulated:9", "-o", "run"], ["patch '9'", "it has 1, 2"]),
        (["explore", LIMITED, "--robot", "simulated:1", "-o", "run", "--noise", "2"], ["'2'", "unit"]),
        (["explore", LIMITED, "--robot", "simulated:1", "-o", "run", "--noise", "-2 mm"], ["must not be negative"]),
        (
            ["explore", LIMITED, "--robot", "simulated:1", "-o", "run", "--grasps", "iii"],
            ["--grasps iii", "mean 'III'"],
        ),
        (
            ["explore", LIMITED, "--robot", "simulated:1", "-o", "run", "--criterion", "luck"],
            ["information, entropy, random"],
        ),
        (["explore", LIMITED, "--robot", "folder:lab", "-o", "run", "--wait", "0"], ["--wait 0"]),
        (["compare", "none"], ["none", "is not a run folder"]),
        (["diagnose", ROOT / "examples"], ["is not a run folder"]),
        (["fit", "none", "--add", "gravity", "-o", "run"], ["is not a run folder"]),
        (["fit", "none", "-o", "run"], ["nothing to do", "--add"]),
        (["simulate", SLAB, "--motion", "dance", "-o", "made"], ["dance", "semicircle"]),
        (
            ["simulate", SLAB, "--motion", "pull", "--anchors", "1,9", "--level", "0", "-o", "made"],
            ["patch '9'", "known: 1, 2"],
        ),
        (
            ["simulate", SLAB, "--motion", "pull", "--grasp", "IV", "--level", "0", "-o", "made"],
            ["grasp 'IV'", "I, II, III"],
        ),
        (["simulate", SLAB, "--motion", "pull", "--level", "7", "-o", "made"], ["--level 7"]),
        (["simulate", SLAB, "--motion", "pull", "--noise", "3", "-o", "made"], ["has no unit"]),
        (["simulate", SLAB, "--motion", "pull", "--noise", "-3 mm", "-o", "made"], ["negative"]),
        (["simulate", SLAB, "--motion", "Pull", "-o", "made"], ["did you mean 'pull'"]),
        (["simulate", SLAB, "--motion", "pull", "--amplitude", "3", "-o", "made"], ["--amplitude", "has no unit"]),
        (["simulate", SLAB, "--motion", "pull", "--amplitude", "0 mm", "-o", "made"], ["amplitude 0 m", "above 0"]),
        (["simulate", SLAB, "--motion", "pull", "--steps", "0", "-o", "made"], ["steps 0", "at least 1"]),
        (["simulate", SLAB, "--motion", "pull", "--direction", "up", "-o", "made"], ["'up'", "0,0,1"]),
        (["simulate", SLAB, "--motion", "pull", "--direction", "0,0,0", "-o", "made"], ["not all zero"]),
        (["simulate", SLAB, "--like", SEEN, "--steps", "0", "-o", "made"], ["--like", "--steps"]),
        (
            ["simulate", SLAB, "--motion", "pull", "--true-effect", "Gravity: weight = 1 kN/m^3", "-o", "made"],
            ["mean 'gravity'"],
        ),
        (
            ["simulate", SLAB, "--motion", "pull", "--true-effect", "gravity: weight = 9.8", "-o", "made"],
            ["gravity.weight", "unit"],
        ),
        (["simulate", SLAB, "--motion", "pull", "--true-effect", "gravity", "-o", "made"], ["expected as in"]),
        (["Identify", SLAB, SEEN, "-o", "run"], ["'Identify' is no command", "did you mean 'identify'"]),
        (["identify", SLAB, SEEN, "-o", "run", "--exhaustive", "Yes"], ["did you mean 'yes'"]),
    ],
)
def test_mistakes(arguments: list[object], words: list[str], tmp_path: Path) -> None:
    refused(bcid(*arguments, cwd=tmp_path), *words)
    assert not list(tmp_path.iterdir())


def identified(folder: Path, scene: Path = SLAB, state: str = "finished", **record: Any) -> Path:
    """A run folder as `bcid identify` leaves it, without the search."""
    from mpi4py import MPI

    from bcid.base.run_folder import RunFolder
    from bcid.search.answer.source import from_files

    source = from_files(scene, SEEN, (), MPI.COMM_SELF)
    run = RunFolder.start(folder, "identify", source.inputs({}))
    run.record["names"] = {"scene": str(scene), "measurement": str(SEEN)}
    run.write_json("identification.json", runs.identification() | {"anchored": ["1", "2"]})
    run.finish({})
    run.write_json("run.json", sealed(run.record | {"state": state} | record))
    return folder


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["compare", "run", "--level", "9"], ["--level 9", "levels 0 to 3"]),
        (["compare", "run", "-o", "run"], ["finished run", "--overwrite"]),
        (["compare", "run", "-o", "file"], ["is a file"]),
        (["diagnose", "run", "--only", "gravty"], ["did you mean 'gravity'"]),
        (["diagnose", "run", "--effects", "none.py"], ["none.py", "no such file"]),
        (["fit", "run", "--add", "gravty", "-o", "run2"], ["did you mean 'gravity'"]),
        (["fit", "run", "--add", "soft_anchor:9", "-o", "run2"], ["place '9'", "known: 1, 2"]),
        (["fit", "run", "--add", "gravity:3", "-o", "run2"], ["gravity:3", "no places"]),
        (["fit", "run", "--add", "marker_fault", "-o", "run2"], ["say where", "marker_fault:1"]),
        (["fit", "run", "--add", "gravity:weight=heavy", "-o", "run2"], ["'heavy' is not a quantity", "N/m^3"]),
        (["fit", "run", "--add", "gravity:wight=1", "-o", "run2"], ["did you mean 'weight'"]),
        (["fit", "run", "--add", "gravity:weight=-1", "-o", "run2"], ["outside the allowed range"]),
        (["fit", "run", "--add", "gravity:weight=nan", "-o", "run2"], ["not a finite number"]),
        (["fit", "run", "--add", "gravity", "--add", "gravity", "-o", "run2"], ["has it already"]),
        (["fit", "run", "--free", "young,poison", "-o", "run2"], ["no number 'poison'", "did you mean 'poisson'"]),
        (["fit", "run", "--free", "yung", "-o", "run2"], ["no number 'yung'", "did you mean 'young'"]),
        (["fit", "run", "--add", "inclusion", "--fixed", "x", "-o", "run2"], ["no number 'x'", "inclusion.radius"]),
    ],
)
def test_mistakes_about_a_run(arguments: list[object], words: list[str], tmp_path: Path) -> None:
    identified(tmp_path / "run")
    (tmp_path / "file").touch()
    refused(bcid(*arguments, cwd=tmp_path), *words)
    assert {entry.name for entry in tmp_path.iterdir()} == {"run", "file"}


def test_runs_that_nothing_can_start_from(tmp_path: Path) -> None:
    """Unfinished, of another command, damaged, or of a scene that has changed since."""
    refused(bcid("compare", identified(tmp_path / "a", state="failed"), cwd=tmp_path), "the run failed", "--overwrite")
    refused(bcid("compare", identified(tmp_path / "b", names={}), cwd=tmp_path), "names no scene")
    changed = identified(tmp_path / "d", edited(tmp_path))
    edited(tmp_path, ('"15 kPa"', '"16 kPa"'))
    refused(bcid("compare", changed, cwd=tmp_path), "scene.toml has changed since")
    gone = identified(tmp_path / "e", names={"scene": "gone.toml", "measurement": str(SEEN)})
    refused(bcid("compare", gone, cwd=tmp_path), "gone.toml", "no such scene file")


def test_an_effect_file_is_run_once(tmp_path: Path) -> None:
    """However often the effects are asked for: they are the same objects, in the order of the files."""
    from mpi4py import MPI

    from bcid.search.answer.source import find_effect, from_files

    text = (ROOT / "examples/effects/magnetic_force.py").read_text(encoding="utf-8")
    path, times = tmp_path / "magnetic_force.py", tmp_path / "times"
    path.write_text(f"{text}\nwith open({str(times)!r}, 'a') as file:\n    file.write('x')\n", encoding="utf-8")
    source = from_files(SLAB, SEEN, (path,), MPI.COMM_SELF)
    assert [effect.name for effect in source.own] == ["magnetic_force"]
    assert find_effect("magnetic_force", source.own) is source.own[0]
    assert times.read_text(encoding="utf-8") == "x"


JOBS = {
    "demo": [],
    "identify": ["scene.toml", "seen", "-o", "run"],
    "explain": ["scene.toml", "seen", "-o", "run"],
    "compare": ["run"],
    "diagnose": ["run"],
    "fit": ["run", "--add", "gravity", "-o", "run2"],
}


@pytest.mark.parametrize("command", JOBS)
def test_a_command_counts_the_seconds_from_its_start(
    command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """What is said while drawing too: one object speaks for the whole command."""
    arguments = JOBS[command]
    run = RunFolder.start(tmp_path / "made", command, {})
    run.write_text("summary.txt", "the result\n\nmore\n")
    run.write_json("diagnosis.json", runs.diagnosis() | {"verdict": "none"})
    run.finish({})
    drawn: list[Path] = []
    made: list[Lines] = []

    def counted() -> Lines:
        made.append(Lines())
        return made[-1]

    def draw(folder: Path, progress: object) -> None:
        assert progress is made[0]
        drawn.append(folder)

    runs.play(monkeypatch, runs.Played(lambda _: run.path))
    monkeypatch.setattr(console, "progress_on", counted)
    for module in (console, answer_commands):
        monkeypatch.setattr(module, "draw", draw)
    assert cli.main([command, *arguments]) == 0
    assert len(made) == 1
    assert drawn == [run.path]
    out = capsys.readouterr().out
    assert "the result" in out
    assert f"run folder: {tmp_path}" in out
    assert cli.main([command, *arguments, "--quiet", "--no-picture"]) == 0
    assert len(made) == len(drawn) == 1


@pytest.mark.parametrize(
    ("arguments", "job", "said"),
    [
        (["bench", "-o", "run"], "validation.bench.bench_run.run", "in bench.json"),
        (["synthetic", "-o", "run"], "validation.synthetic.hidden_study.run_hidden", "goes on"),
        (["golden", "-o", "run"], "validation.golden.run.run", "goes on"),
    ],
)
def test_how_validation_ends(
    arguments: list[str], job: str, said: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail(error: BaseException) -> None:
        def work(*_: Any, **__: Any) -> None:
            raise error

        monkeypatch.setattr(job, work)

    fail(KeyboardInterrupt())
    assert validate(arguments) == 130
    assert "bcid: interrupted; " in (err := capsys.readouterr().err)
    assert said in err
    fail(MachineError("the disk is full"))
    assert validate(arguments) == 3
    assert capsys.readouterr().err == "bcid: the disk is full\n"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["synthetic", "-o", "run", "--cases", "0"], ["--cases 0", "at least 1"]),
        (["synthetic", "-o", "run", "--least", "10"], ["--least 10", "below 10"]),
    ],
)
def test_validation_refuses(
    tmp_path: Path, arguments: list[str], words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert validate([word.replace("run", str(tmp_path / "run")) for word in arguments]) == 2
    err = capsys.readouterr().err
    assert all(word in err for word in words)
    assert not (tmp_path / "run").exists()


def edited(tmp_path: Path, *changes: tuple[str, str]) -> Path:
    """A copy of the slab's scene with some text replaced."""
    text = SLAB.read_text(encoding="utf-8").replace("../../", f"{ROOT}/")
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    path = tmp_path / "scene.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_geometry_that_does_not_fit(tmp_path: Path) -> None:
    """Groups the mesh does not have, an empty box and a fiducial off the body are told together or one kind after the other."""
    scene = edited(
        tmp_path, ('"1" = "patch_1"', '"1" = "ptch_1"'), ('"2" = "patch_2"', '"2" = { box = ["1 1 1 mm", "2 2 2 mm"] }')
    )
    refused(
        bcid("identify", scene, SEEN, "-o", "run", cwd=tmp_path), "did you mean 'patch_1'", "no facet of the boundary"
    )
    scene = edited(tmp_path, ('"15 10 12.5 mm"', '"15 90 12.5 mm"'))
    refused(bcid("identify", scene, SEEN, "-o", "run", cwd=tmp_path), "fiducial 1", "80 mm outside the body")
    scene = edited(tmp_path, ('"1" = "patch_1"', '"1" = "grasp_II"'))
    refused(bcid("identify", scene, SEEN, "-o", "run", cwd=tmp_path), "patch 1 and grasp II share")
    assert not (tmp_path / "run").exists()


def test_a_mesh_file_is_never_run_as_a_script(tmp_path: Path) -> None:
    """gmsh executes a .msh that does not begin with $MeshFormat; such a file is refused unread."""
    bad = tmp_path / "bad.msh"
    bad.write_text(f'SystemCall "touch {tmp_path}/owned";\n', encoding="utf-8")
    scene = edited(tmp_path, (f"{ROOT}/meshes/geo/slab.geo", str(bad)))
    text = scene.read_text(encoding="utf-8")
    for size in ("50", "20", "7.2", "3.6"):
        text = text.replace(f'element_size = "{size} mm"', "refinements = 0")
    scene.write_text(text, encoding="utf-8")
    refused(bcid("identify", scene, SEEN, "-o", "run", cwd=tmp_path), "does not start with $MeshFormat")
    assert not (tmp_path / "owned").exists()


def test_a_broken_geometry(tmp_path: Path) -> None:
    (tmp_path / "bad.geo").write_text("Box(1) = {0, 0, 0, 1};\n", encoding="utf-8")
    scene = edited(tmp_path, (f"{ROOT}/meshes/geo/slab.geo", "bad.geo"))
    refused(bcid("identify", scene, SEEN, "-o", "run", cwd=tmp_path), "bad.geo", "cannot be meshed")


def test_simulate_then_identify_then_again(tmp_path: Path) -> None:
    """The whole chain, an interrupted run that goes on, and a finished one that is kept."""
    made = bcid(
        "simulate", SLAB, "--anchors", "3,4", "--motion", "pull", "--level", "2", "--wrench", "-o", "made", cwd=tmp_path
    )
    assert made.returncode == 0, made.stderr
    assert (tmp_path / "made/wrench.csv").exists()
    refused(bcid("simulate", SLAB, "--motion", "pull", "--level", "2", "-o", "made", cwd=tmp_path), "exists already")
    call = ["identify", SLAB, "made", "-o", "run", "--level", "1", "--exhaustive", "yes", "--quiet"]
    done = process(*call, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "Anchored patches of slab: {3 4}" in done.stdout
    result = json.loads((tmp_path / "run/identification.json").read_text(encoding="utf-8"))
    assert result["anchored"] == ["3", "4"]
    assert result["certified"] is True
    assert result["evaluations"]["1"] < 256
    assert result["evaluated"]["not"] == 0
    # The same on every machine and with every version.
    assert result["rms"] == pytest.approx(0.303468535, rel=1e-5)
    assert result["patches"]["1"] < 1e-3
    assert (tmp_path / "run/picture.png").stat().st_size > 20_000
    assert (tmp_path / "run/paraview/body.vtkhdf").exists()
    refused(bcid(*call, cwd=tmp_path), "finished run", "--overwrite")

    record = json.loads((tmp_path / "run/run.json").read_text(encoding="utf-8"))
    (tmp_path / "run/run.json").write_text(json.dumps(sealed(record | {"state": "running"})), encoding="utf-8")
    again = bcid(*call, "--no-picture", cwd=tmp_path)
    assert again.returncode == 0, again.stderr
    assert json.loads((tmp_path / "run/identification.json").read_text(encoding="utf-8")) == result


def test_foreign_mesh(tmp_path: Path) -> None:
    """A mesh that meshio reads, patches as boxes and planes, and the ladder by uniform refinement."""
    meshio = pytest.importorskip("meshio")
    import numpy as np

    grid = np.array(np.meshgrid([0, 20, 40], [0, 10], [0, 20], indexing="ij")).reshape(3, -1).T.astype(float)
    corner = np.arange(12).reshape(3, 2, 2)
    # Kuhn's division: six tetrahedra of a box, one for each order in which its axes are gone along.
    cells = [
        [corner[tuple(np.add([i, 0, 0], np.isin(np.arange(3), order[:k]).astype(int)))] for k in range(4)]
        for i in range(2)
        for order in itertools.permutations(range(3))
    ]
    meshio.write(tmp_path / "bar.vtu", meshio.Mesh(grid, [("tetra", np.array(cells))]))
    (tmp_path / "bar.toml").write_text(
        """format = "bcid-scene/1"
geometry = { file = "bar.vtu", length_unit = "mm" }
levels = [{ degree = 1 }, { degree = 1, refinements = 1 }]
material = { law = "neo_hooke", young = "15 kPa", poisson = 0.35 }
patches.left = { plane = { point = "0 0 0 mm", normal = [1, 0, 0] } }
patches.below = { box = ["0 0 0 mm", "20 0 20 mm"] }
grasps.end = { on = { plane = { point = "40 0 0 mm", normal = [1, 0, 0] } }, centre = "40 5 10 mm" }
fiducials = { m = "20 10 10 mm" }
noise_sigma = "0.1 mm"
""",
        encoding="utf-8",
    )
    made = bcid("simulate", "bar.toml", "--anchors", "left", "--motion", "pull", "-o", "made", cwd=tmp_path)
    assert made.returncode == 0, made.stderr
    found = bcid("identify", "bar.toml", "made", "-o", "run", "--exhaustive", "yes", "--no-picture", cwd=tmp_path)
    assert found.returncode == 0, found.stderr
    assert "{left}" in found.stdout


def test_two_ranks_say_a_mistake_once(tmp_path: Path) -> None:
    if shutil.which("mpirun") is None:
        pytest.skip("mpirun is not installed")
    command = ["mpirun", "-n", "2", sys.executable, "-m", "bcid", "identify", str(SLAB), "none", "-o", "run"]
    result = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, timeout=60, check=False)
    assert result.returncode == 2
    assert result.stderr.count("no such measurement folder") == 1


def test_a_slip_is_refused_before_anything_is_computed(tmp_path: Path) -> None:
    seen = Measurement.read(SEEN)
    data = seen.data.copy()
    data["position"] = (seen.data["position"].dims, seen.positions[:, :, [1, 0, 2]])
    replace(seen, data=data).write(tmp_path / "swapped")
    for command in ("identify", "explain"):
        refused(bcid(command, SLAB, "swapped", "-o", "run", cwd=tmp_path), "x and y look swapped", "axes of the scene")
    assert not (tmp_path / "run").exists()


def test_output_that_nobody_reads_is_no_error() -> None:
    reads, writes = os.pipe()
    os.close(reads)
    command = [sys.executable, "-m", "bcid", "scene", "check", str(SLAB)]
    done = subprocess.run(command, stdout=writes, stderr=subprocess.PIPE, text=True, check=False)
    os.close(writes)
    assert (done.returncode, done.stderr) == (128 + signal.SIGPIPE, "")
