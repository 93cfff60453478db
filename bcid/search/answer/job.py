"""Jobs: what a command or a function computes, and how it comes into a run folder."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bcid.base.collective import Comm, on_root
from bcid.base.errors import InputError
from bcid.base.progress import Progress
from bcid.base.run_folder import RunFolder, running
from bcid.predict.store import PredictionStore
from bcid.results.run_documents import write_documents


@dataclass(frozen=True)
class Made:
    """What a job made.

    Attributes:
        documents: records, datasets and texts by file name.
        notes: what `run.json` holds besides.
    """

    documents: dict[str, Any]
    notes: dict[str, Any]


class Job(ABC):
    """Something to compute, with all inputs checked.

    Attributes:
        command: whose run folder holds it.
        makes: files and, with a slash, folders of the run folder.
        main, told: name of the record that the answer stands in, and its keys that `run.json` repeats.
    """

    command: str
    makes: tuple[str, ...]
    main: str
    told: tuple[str, ...]

    @property
    @abstractmethod
    def inputs(self) -> dict[str, Any]:
        """What the result depends on: fingerprints and options. A run is only continued where they are equal."""

    @abstractmethod
    def made(self, comm: Comm, progress: Progress | None = None, store: PredictionStore | None = None) -> Made:
        """Compute; collective on `comm`, with the same result on every rank.

        Raises:
            SolveError: the model cannot be followed.
        """

    def run(
        self,
        folder: Path,
        comm: Comm,
        progress: Progress | None = None,
        overwrite: bool = False,
        store: Path | None = None,
    ) -> Path:
        """Compute and write the run folder, or go on with an interrupted run; collective on `comm`. Returns the folder.

        Args:
            folder: of the run.
            comm, progress: as for `made`.
            overwrite: discard what a run has left there.
            store: folder of predictions that runs share; by default they last as long as the run.

        Raises:
            BcidError: as `made`, and `bcid.base.run_folder.RunFolder.start`.
        """
        if on_root(comm, lambda: store is not None and store.exists() and not store.is_dir()):
            raise InputError(f"--store {store}: is a file; name a folder")
        with running(comm, folder, self.command, self.inputs, self.makes, overwrite) as run:
            kept = PredictionStore.of_run(folder, comm, self.store_inputs, progress, store)
            done = self.made(comm, progress, kept)
            on_root(comm, lambda: self._write(run, done))
            kept.clear()
        return folder

    @property
    def store_inputs(self) -> dict[str, Any]:
        """What stored predictions depend on beside what they are filed under."""
        return self.inputs

    def _write(self, run: RunFolder | None, done: Made) -> None:
        """Write everything into the run folder, which only rank 0 has, and finish the run."""
        assert run is not None
        write_documents(run, done.documents)
        run.record |= done.notes
        result = done.documents[self.main].to_json()
        run.finish({key: result[key] for key in self.told})
