"""`bcid propose` as a command: read a run, search the grammar, write the file of an effect and a run folder."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from bcid.base.collective import Comm, on_root
from bcid.base.errors import InputError
from bcid.base.fingerprint import file_fingerprint
from bcid.base.options import ProposeOptions
from bcid.base.progress import Progress
from bcid.base.run_folder import RunFolder, prove_writable, running, write_whole
from bcid.forms.model import Model
from bcid.grammar.effect_file import check_name
from bcid.grammar.proposal_documents import WrittenProposal, proposal_documents, searched
from bcid.predict.predictor import Predictor
from bcid.predict.store import PredictionStore
from bcid.results.diagnosis_record import DiagnosisRecord
from bcid.results.run_documents import file_of, read_record
from bcid.search.answer.compare_runs import MAKES, finish
from bcid.search.answer.diagnosis import Diagnosis, on_predictor
from bcid.search.answer.output import collect
from bcid.search.answer.source import Source, from_run

# The file in the run folder where none is named.
FILE = "proposed_term.py"
_FOLDER = "proposed/"


def run_propose(
    run: Path,
    output: Path | None,
    folder: Path,
    comm: Comm,
    options: ProposeOptions | None = None,
    progress: Progress | None = None,
    overwrite: bool = False,
    files: Sequence[Path] = (),
) -> list[Path]:
    """Search the grammar for what the model of a run lacks; collective.

    Args:
        run: folder of an earlier run.
        output: file of the effect; a second term is written beside it. None for one in the folder of this run.
        folder: of this run.
        options: how far to go.
        files: effect files that the earlier run used.

    Returns:
        The files of effects that were written: none where nothing is proposed.

    Raises:
        InputError: the run, the name of the file or an option cannot be used.
        MachineError: nothing can be written where the file is to be.
    """
    options = options or ProposeOptions()
    options.check()
    names = effect_names(Path(FILE) if output is None else output, options.max_effects)
    if output is not None and not overwrite:
        _refuse_existing([output.with_name(f"{name}.py") for name in names])
    if output is not None:
        parent = output.parent
        on_root(comm, lambda: prove_writable(parent))
    given = from_run(run, files, comm)
    begun = on_root(comm, lambda: _begun(run, given))
    told: list[WrittenProposal] = []
    makes = (*MAKES, "proposal.json", _FOLDER)
    inputs = given.inputs(asdict(options))
    with running(comm, folder, "propose", inputs, makes, overwrite) as to:
        store = PredictionStore.of_run(folder, comm, inputs, progress)

        def work(predictor: Predictor, here: Source) -> Diagnosis:
            written, done = searched(predictor, begun, options, names)
            told.append(written)
            return done

        def use(predictor: Predictor, here: Source, done: Diagnosis) -> None:
            content = collect(predictor, done)
            found = proposal_documents(told[-1], here, predictor, done, content)
            on_root(comm, lambda: _write(to, here, predictor, found, content, told[-1].files, output))

        on_predictor(replace(given, model=begun), comm, options.level, progress, work, use, store)
        store.clear()
    return [_target(folder, output, name) for name in told[-1].files]


def effect_names(file: Path, count: int) -> list[str]:
    """Names of the effects: that of the file, and numbered ones.

    Raises:
        InputError: it is no Python file, or its name cannot be that of an effect.
    """
    if file.suffix != ".py":
        raise InputError(f"{file}: the file of an effect is a Python file: its name must end in .py")
    check_name(file.stem)
    return [file.stem, *(f"{file.stem}_{k}" for k in range(2, count + 1))]


def _refuse_existing(files: Sequence[Path]) -> None:
    for file in files:
        if file.exists():
            raise InputError(f"{file}: exists already; choose another name, or give --overwrite")


def _begun(run: Path, given: Source) -> Model:
    """The model that terms are added to: that of the run, or where `explain` found no effect for sure that of the scene."""
    stored = RunFolder.open(run)
    if file_of(stored, DiagnosisRecord):
        found = read_record(stored, DiagnosisRecord)
        if found.posterior is not None and found.verdict == "unknown":
            return Model.of(given.scene)
    return given.model


def _target(folder: Path, output: Path | None, name: str) -> Path:
    """Where the file of an effect goes."""
    return (folder / _FOLDER if output is None else output.parent) / f"{name}.py"


def _write(
    run: RunFolder | None,
    here: Source,
    predictor: Predictor,
    found: dict[str, Any],
    content: dict[str, Any],
    files: dict[str, str],
    output: Path | None,
) -> None:
    """Write everything into the run folder, which only rank 0 has, and the files of effects; finish the run."""
    assert run is not None
    for name, text in files.items():
        kept = run.write_text(f"{_FOLDER}{name}.py", text)
        # Whoever goes on from this run names the file, which is known by its content.
        run.record["inputs"]["effects"].append(file_fingerprint(kept))
        if output is not None:
            write_whole(_target(run.path, output, name), text)
    finish(run, here, predictor, found, content)
