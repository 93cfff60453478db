"""Every table and figure of Boonvisut & Cavusoglu (2014) in one run: the study files beside this one, and the exploration study.

RUN/NAME/         the run folder of each study
RUN/shared/       what they share
RUN/table.txt     all their tables;  paper.md  the page of the paper: every section with its tables and pictures
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

from bcid.base.collective import on_root
from bcid.base.errors import InputError
from bcid.base.progress import Progress, Silent
from bcid.base.run_folder import RunFolder, running
from bcid.base.shipped import shipped
from bcid.base.text_file import read_json
from validation.engine.work import Workers
from validation.exploration import exploration_study as exploration
from validation.exploration.exploration_trials import ExplorationExtent as Explored
from validation.paper.claims import FAILS, Claim, verdicts
from validation.paper.study import Extent, run_study
from validation.sections import PICTURE

STUDIES, PAGE = "validation/paper", "paper.md"
_EXPLORATION = "exploration"
# Sections 7 and 8: pulls chosen as the paper does and by information, nothing hidden or enclosed; in short with one grasp.
_CHOSEN = ("entropy", "information")
EXPLORED = Explored(3, hidden=(), enclosed=(), strategies=_CHOSEN)
_FEW = Explored(1, (0.0, 0.3e-3), (), (), (("II",),), _CHOSEN)


def run_paper(
    folder: Path,
    quick: bool,
    seed: int,
    how: Workers,
    progress: Progress | None = None,
    overwrite: bool = False,
    studies: Path | None = None,
    explored: bool = True,
) -> Path:
    """Run all studies of the paper into a run folder; collective on `how.comm`. One that was interrupted goes on.

    Args:
        folder, seed, how, progress, overwrite: as for `run_study`.
        quick: each study reduced.
        studies: folder of study files.
        explored: with the exploration study.

    Raises:
        InputError: a file, or a folder that cannot be used (see `RunFolder.start`).
    """
    progress = progress or Silent()
    place = studies or shipped(STUDIES)
    files = on_root(how.comm, lambda: sorted(place.glob("*.toml")))
    if not files:
        raise InputError(f"{place}: holds no study files")
    # What each study depends on is looked at where it is run.
    inputs = {"quick": quick, "seed": seed, "studies": [file.stem for file in files], "explored": explored}
    path = on_root(how.comm, folder.resolve)
    # Studies are runs of their own in it.
    made = [file.stem for file in files] + ([_EXPLORATION] if explored else [])
    makes = ["shared/", "table.txt", PAGE, *(f"{name}/" for name in made)]

    def one(file: Path) -> Callable[[Path], Path]:
        extent = Extent(quick, seed=seed)
        return lambda target: run_study(file, target, extent, how, progress, overwrite, path / "shared")

    def explore(target: Path) -> Path:
        return exploration.run_study(target, _FEW if quick else EXPLORED, seed, how, progress, overwrite)

    with running(how.comm, folder, "study paper", inputs, makes, overwrite) as run:
        parts = {file.stem: one(file) for file in files} | ({_EXPLORATION: explore} if explored else {})
        for i, (name, make) in enumerate(parts.items(), start=1):
            if on_root(how.comm, lambda name=name: _finished(path / name)):  # type: ignore[misc]
                continue
            progress.say(f"study {i} of {len(parts)}: {name}")
            make(path / name)
        on_root(how.comm, lambda: _conclude(run, list(parts)))
    return folder


def _finished(folder: Path) -> bool:
    return (folder / "run.json").is_file() and RunFolder.open(folder).record["state"] == "finished"


def _conclude(run: RunFolder | None, names: list[str]) -> None:
    assert run is not None
    texts = {name: _text(run.path / name, "page.md") for name in names}
    said = [entry for name in in_order(texts) for entry in _said(run.path / name)]
    judged = verdicts(said)
    tables = [_text(run.path / name, "table.txt").rstrip() for name in names]
    rule = "\n\n" + "-" * 100 + "\n\n"
    run.write_text("table.txt", rule.join([judged.text(), *tables]) + "\n")
    run.write_text(PAGE, judged.markdown() + "\n\n" + page(run.path, names))
    seconds = {name: RunFolder.open(run.path / name).record["seconds"] for name in names}
    not_held = sum(claim.verdict == FAILS for _, claim in said)
    run.finish({"studies": names, "seconds": seconds, "not_held": not_held})


def _text(folder: Path, name: str) -> str:
    return RunFolder.open(folder).read_text(name)


def _said(folder: Path) -> list[tuple[str, Claim]]:
    """What the paper says of a study in a run, with the study's title; nothing of one that is no study file."""
    file = folder / "study.json"
    if not file.is_file():
        return []
    content = read_json(file)
    return [(content["title"], Claim(**claim)) for claim in content["claims"]]


def page(folder: Path, names: Iterable[str]) -> str:
    """The sections of all studies in the order of the paper; pictures are looked for in the folders of the studies."""
    texts = {name: _text(folder / name, "page.md") for name in names}
    return "\n".join(texts[name].replace(f"]({PICTURE})", f"]({name}/{PICTURE})") for name in in_order(texts))


def in_order(texts: Mapping[str, str]) -> list[str]:
    """Names of sections, by the paper's number in their third line, then by figure and table; what goes beyond comes last."""

    def place(name: str) -> tuple[bool, list[str], str, str]:
        number, _, shown = texts[name].splitlines()[2].removeprefix("Section ").partition(",")
        beyond, number = number.startswith("beyond "), number.removeprefix("beyond ")
        return beyond, number.split()[0].split("."), shown, name

    return sorted(texts, key=place)
