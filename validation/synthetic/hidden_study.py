"""The hidden study: does a diagnosis find what was hidden in measurements whose truth it cannot see?

RUN/cases/0007/scene.toml     what the diagnosis gets: the scene file, and the geometry beside it
RUN/cases/0007/measurement/   and the measurement
RUN/cases/0007/truth.json     what is hidden: effects, parameters, anchors, sizes, conditions
RUN/cases/0007/diagnosis/     its run folder
RUN/logs/0007.txt             what the process of the case said
RUN/results/0007.json         the diagnosis of a case that is done, or why there is none
RUN/hidden.json  table.txt  goals.png  degradation.png
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bcid.base.collective import Comm, on_root
from bcid.base.errors import InputError, nearest
from bcid.base.fingerprint import file_fingerprint
from bcid.base.progress import Progress, Silent
from bcid.base.run_folder import RunFolder, running
from bcid.base.shipped import shipped
from bcid.base.text_file import read_json
from validation.engine.dispatch import dispatch
from validation.engine.work import Work, Workers, read_result
from validation.synthetic.bodies import BODIES, check_bodies
from validation.synthetic.cases import SIZES
from validation.synthetic.conditions import CONDITIONS
from validation.synthetic.score import scores
from validation.synthetic.score_table import table

MAKE = "validation.synthetic.truth:make"
DIAGNOSE = "validation.explained:run_explain"
_MAKES = ("cases/", "results/", "logs/", "hidden.json", "table.txt", "goals.png", "degradation.png")
# CPU seconds that the truth of a case may take besides: with cubic elements, drawn anew where it cannot be computed.
_MAKING = 900.0


@dataclass(frozen=True)
class HiddenOptions:
    """What a study does.

    Attributes:
        cases: how many.
        seed: of the cases; case i is the same whatever their number.
        jobs: child processes at a time.
        limit: CPU seconds that the diagnosis of a case may take.
        least: size that effects are drawn from, in units of noise; the largest is 10.
        bodies: names of those that take turns.
        conditions: one of `validation.synthetic.conditions.CONDITIONS`.
        make, diagnose: functions as "module:name": `validation.synthetic.truth.make` and the diagnosis.
    """

    cases: int = 400
    seed: int = 0
    jobs: int = 2
    limit: float = 900.0
    least: float = SIZES[0]
    bodies: tuple[str, ...] = tuple(BODIES)
    conditions: str = "all"
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
        if self.conditions not in CONDITIONS:
            raise InputError(f"--conditions {self.conditions}: {nearest(self.conditions, CONDITIONS)}")
        check_bodies(self.bodies)

    @property
    def drawn_from(self) -> dict[str, Any]:
        """What the cases depend on besides their number."""
        plain = {name: getattr(self, name) for name in ("seed", "least", "conditions")}
        return plain | {"bodies": list(self.bodies)}


def run_hidden(
    folder: Path,
    options: HiddenOptions,
    progress: Progress | None = None,
    overwrite: bool = False,
    comm: Comm | None = None,
) -> Path:
    """Run the study into a run folder; one that was interrupted goes on with the cases that have no result yet.

    Where child processes make the cases an interrupted study tells in its table what the cases so far say. Collective on `comm`,
    over which the cases are spread; without one they go to child processes.

    Raises:
        InputError: options, or a folder that cannot be used (see `RunFolder.start`).
    """
    progress = progress or Silent()
    options.check()
    inputs = {name: getattr(options, name) for name in ("cases", "limit", "make", "diagnose")} | options.drawn_from
    inputs |= {"scenes": [file_fingerprint(shipped(BODIES[name].scene)) for name in options.bodies]}
    with running(comm, folder, "study hidden", inputs, _MAKES, overwrite) as run:
        path = on_root(comm, folder.resolve)
        work = Work("validation.synthetic.case:maker", _job(path, options), path / "results")
        tasks = {f"{index:04d}": {"index": index} for index in range(options.cases)}
        how = Workers(comm, options.jobs, options.limit + _MAKING, tries=3, fresh=True)
        try:
            dispatch(work, tasks, how, progress)
        except KeyboardInterrupt:
            if run is not None and comm is None:
                _score(run, options, [i for i, name in enumerate(tasks) if work.file(name).is_file()])
            raise
        on_root(comm, lambda: _conclude(run, options))
    return folder


def _job(path: Path, options: HiddenOptions) -> dict[str, Any]:
    job = {name: getattr(options, name) for name in ("make", "diagnose", "limit")}
    return options.drawn_from | job | {"cases": str(path / "cases")}


def _read(path: Path, index: int) -> dict[str, Any]:
    """The result of a case with its truth, which is also known where there is no diagnosis."""
    found = read_result(path / "results" / f"{index:04d}.json")
    truth = path / "cases" / f"{index:04d}" / "truth.json"
    nothing = {"diagnosis": None, "seconds": found["seconds"], "cpu_seconds": 0.0}
    content: dict[str, Any] = {"index": index, "state": found["state"], "reason": found["reason"]}
    content["truth"] = read_json(truth) if truth.is_file() else None
    return content | (found["result"] or nothing)


def _conclude(run: RunFolder | None, options: HiddenOptions) -> None:
    assert run is not None
    found = _score(run, options, range(options.cases))
    run.finish({"rates": {name: rate["rate"] for name, rate in found["rates"].items()}, "states": found["states"]})


def _score(run: RunFolder, options: HiddenOptions, cases: Iterable[int]) -> dict[str, Any]:
    """Score the results of some cases, and write what is made of them."""
    found = scores([_read(run.path, i) for i in cases]) | {"asked": options.cases}
    run.write_json("hidden.json", found)
    run.write_text("table.txt", table(found))
    _draw(run, found)
    return found


def _draw(run: RunFolder, found: dict[str, Any]) -> None:
    """The pictures are a view of the numbers: without matplotlib there are none."""
    try:
        from validation.synthetic.hidden_pictures import degradation, goals
    except ImportError:
        return
    goals(run.path / "goals.png", found)
    degradation(run.path / "degradation.png", found)
