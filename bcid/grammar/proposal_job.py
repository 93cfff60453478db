"""`bcid propose` as a job: search the grammar, and write the file of an effect and a run folder."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from bcid.base.collective import Comm, on_root
from bcid.base.errors import InputError
from bcid.base.fingerprint import file_fingerprint
from bcid.base.options import ProposeOptions
from bcid.base.progress import Progress
from bcid.base.run_folder import RunFolder, prove_writable, write_whole
from bcid.forms.model import Model
from bcid.grammar.effect_file import check_name
from bcid.grammar.proposal_documents import WrittenProposal, proposal_documents, searched
from bcid.predict.predictor import Predictor
from bcid.predict.store import PredictionStore
from bcid.results.diagnosis_record import DiagnosisRecord
from bcid.results.proposal_record import ProposalRecord
from bcid.results.run_documents import file_of, read_record
from bcid.search.answer.comparison_job import MAKES, notes
from bcid.search.answer.diagnosis import Diagnosis, on_predictor
from bcid.search.answer.job import Job, Made
from bcid.search.answer.output import collect
from bcid.search.answer.source import Source, from_run

# The file in the run folder where none is named.
FILE = "proposed_term.py"
_FOLDER = "proposed/"


@dataclass(frozen=True)
class ProposalJob(Job):
    """Which term beyond the catalogue explains a measurement.

    Attributes:
        source: model and measurement that the run folder names.
        begun: the model that terms are added to.
        options: how far to go.
        names: of the effects, at least as many as terms may be proposed.
        output: file of the first effect; None for one in the run folder. Others are written beside it.
    """

    source: Source
    begun: Model
    options: ProposeOptions
    names: tuple[str, ...]
    output: Path | None = None

    command, makes = "propose", (*MAKES, "proposal.json", _FOLDER)
    main, told = "diagnosis.json", ("adequate", "verdict", "anchored", "rms", "noise_rms")

    @classmethod
    def of_run(
        cls,
        run: Path,
        output: Path | None,
        comm: Comm,
        options: ProposeOptions | None = None,
        overwrite: bool = False,
        files: Sequence[Path] = (),
    ) -> ProposalJob:
        """Beside the model of a run; collective on `comm`.

        Args:
            run: folder of an earlier run.
            output: file of the effect; None for one in the folder of this run.
            options: how far to go.
            overwrite: replace files of effects that are there.
            files: effect files that the earlier run used.

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
        return cls(given, on_root(comm, lambda: _begun(run, given)), options, tuple(names), output)

    @property
    def inputs(self) -> dict[str, Any]:
        """Fingerprints, model and options."""
        return self.source.inputs(asdict(self.options))

    def made(self, comm: Comm, progress: Progress | None = None, store: PredictionStore | None = None) -> Made:
        """The proposal; collective on `comm`."""
        written: list[WrittenProposal] = []

        def work(predictor: Predictor, here: Source) -> Diagnosis:
            found, done = searched(predictor, self.begun, self.options, self.names)
            written.append(found)
            return done

        def use(predictor: Predictor, here: Source, done: Diagnosis) -> Made:
            content = collect(predictor, done)
            documents = proposal_documents(written[-1], here, predictor, done, content)
            return Made(documents, notes(here, predictor, content))

        begun = replace(self.source, model=self.begun)
        return on_predictor(begun, comm, self.options.level, progress, work, use, store)

    def files(self, folder: Path) -> list[Path]:
        """The files of effects that a finished run in a folder has written."""
        proposed = read_record(RunFolder.open(folder), ProposalRecord).proposed
        return [self._target(folder, term.effect) for term in proposed]

    def _target(self, folder: Path, name: str) -> Path:
        """Where the file of an effect goes."""
        return (folder / _FOLDER if self.output is None else self.output.parent) / f"{name}.py"

    def _write(self, run: RunFolder | None, done: Made) -> None:
        assert run is not None
        for term in done.documents[ProposalRecord.file].proposed:
            kept = run.write_text(f"{_FOLDER}{term.effect}.py", term.file)
            # Whoever goes on from this run names the file, which is known by its content.
            run.record["inputs"]["effects"].append(file_fingerprint(kept))
            if self.output is not None:
                write_whole(self._target(run.path, term.effect), term.file)
        super()._write(run, done)


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
