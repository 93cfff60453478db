"""The hidden study: does a diagnosis find what was hidden in measurements whose truth it cannot see?

RUN/cases/0007/measurement/   what the diagnosis gets, besides the scene file
RUN/cases/0007/truth.json     what is hidden: effects, parameters, anchors, sizes
RUN/cases/0007/diagnosis/     its run folder
RUN/cases/0007/log.txt        what the process of the case said
RUN/results/0007.json         truth and diagnosis of a case that is done, or why there is none
RUN/hidden.json  table.txt  degradation.png
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bcid.errors import InputError
from bcid.fingerprint import file_fingerprint
from bcid.progress import Progress, Silent
from bcid.run import Run
from bcid.studies.case_child import write_result
from bcid.studies.cases import SIZES
from bcid.studies.children import Ended, Task, supervise
from bcid.studies.score import scores, table

SCENE = Path(__file__).resolve().parents[2] / "examples/scenes/slab_hidden.toml"
MAKE = "bcid.studies.truth:make"
DIAGNOSE = "bcid.compare.job:run_explain"


@dataclass(frozen=True)
class Options:
    """What a study does.

    Attributes:
        cases: how many.
        seed: of the cases; case i is the same whatever their number.
        jobs: processes at a time.
        limit: CPU seconds that a case may take.
        least: size that effects are drawn from, in units of noise; the largest is 10.
        make, diagnose: functions as "module:name": `bcid.studies.truth.make` and the diagnosis.
    """

    cases: int = 100
    seed: int = 0
    jobs: int = 2
    limit: float = 900.0
    least: float = SIZES[0]
    make: str = MAKE
    diagnose: str = DIAGNOSE

    def check(self) -> None:
        """Refuse numbers that make no sense."""
        for name, lowest in (("cases", 1), ("seed", 0), ("jobs", 1)):
            if getattr(self, name) < lowest:
                raise InputError(f"--{name} {getattr(self, name)}: must be at least {lowest}")
        if not self.limit > 0:
            raise InputError(f"--limit {self.limit:g}: must be a positive number of seconds")
        if not SIZES[0] <= self.least < SIZES[1]:
            raise InputError(f"--least {self.least:g}: must be a size from {SIZES[0]:g} to below {SIZES[1]:g} noises")


def run_hidden(
    folder: Path,
    options: Options,
    scene: Path = SCENE,
    progress: Progress | None = None,
    overwrite: bool = False,
) -> Path:
    """Run the study into a run folder; one that was interrupted goes on with the cases that have no result yet.

    Raises:
        InputError: options, or a folder that cannot be used (see `Run.start`).
    """
    progress = progress or Silent()
    options.check()
    if not scene.is_file():
        raise InputError(f"{scene}: is missing; `bcid study` needs the project's folder with its examples")
    inputs = {name: getattr(options, name) for name in ("cases", "seed", "limit", "least", "make", "diagnose")}
    run = Run.start(folder, "study hidden", inputs | {"scene": file_fingerprint(scene)}, overwrite)
    path = run.path.resolve()
    tasks = [_task(path, i, options, scene) for i in range(options.cases) if not _result(path, i).is_file()]
    if len(tasks) < options.cases:
        progress.say(f"going on with an interrupted study: {options.cases - len(tasks)} cases are done already")
    left = len(tasks)

    def ended(task: Task, outcome: Ended) -> None:
        nonlocal left
        left -= 1
        file = _result(path, int(task.name))
        if not file.is_file():
            reason = outcome.reason or "the process ended without a result"
            state = outcome.state if outcome.state != "done" else "failed"
            write_result(file, int(task.name), task.log.parent, state, reason, None, outcome.seconds)
        progress.say(f"case {task.name}: {_read(file)['state']} after {outcome.seconds:.0f} s; {left} left")

    try:
        supervise(tasks, options.jobs, options.limit, ended)
        _conclude(run, options)
    except BaseException as error:
        run.fail("interrupted" if isinstance(error, KeyboardInterrupt) else f"{type(error).__name__}: {error}")
        raise
    return folder


def _task(path: Path, index: int, options: Options, scene: Path) -> Task:
    folder = path / "cases" / f"{index:04d}"
    job = {
        "folder": str(folder),
        "result": str(_result(path, index)),
        "scene": str(scene.resolve()),
        "seed": options.seed,
        "index": index,
        "least": options.least,
        "make": options.make,
        "diagnose": options.diagnose,
    }
    return Task(f"{index:04d}", ("-m", "bcid.studies.case_child", json.dumps(job)), folder / "log.txt")


def _result(path: Path, index: int) -> Path:
    return path / "results" / f"{index:04d}.json"


def _read(file: Path) -> dict[str, Any]:
    content: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
    return content


def _conclude(run: Run, options: Options) -> None:
    """Score all results and write what is made of them."""
    results = [_read(_result(run.path, i)) for i in range(options.cases)]
    found = scores(results)
    run.write_json("hidden.json", found)
    run.write_text("table.txt", table(found))
    _draw(run, found)
    run.finish({"rates": {name: rate["rate"] for name, rate in found["rates"].items()}, "states": found["states"]})


def _draw(run: Run, found: dict[str, Any]) -> None:
    """The picture is a view of the numbers: without matplotlib there is none."""
    try:
        from bcid.studies.plots import degradation
    except ImportError:
        return
    degradation(run.path / "degradation.png", found)
