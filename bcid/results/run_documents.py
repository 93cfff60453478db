"""The records of a run folder: written in format/2, read in format/1 and format/2."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, TypeVar

from bcid.base.errors import InputError
from bcid.base.run_folder import RunFolder
from bcid.results.diagnosis_record import DiagnosisRecord, DiscrepancyRecord
from bcid.results.exploration_record import ExplorationRecord
from bcid.results.format_one import upgraded
from bcid.results.identification_record import IdentificationRecord
from bcid.results.proposal_record import ProposalRecord
from bcid.results.record import FileRecord

RECORDS: tuple[type[FileRecord], ...] = (
    DiagnosisRecord,
    IdentificationRecord,
    ExplorationRecord,
    DiscrepancyRecord,
    ProposalRecord,
)
_R = TypeVar("_R", bound=FileRecord)


def write_documents(run: RunFolder, documents: Mapping[str, Any]) -> None:
    """Write records, datasets and texts, each under its name."""
    run.write_documents(
        {name: one.to_json() if isinstance(one, FileRecord) else one for name, one in documents.items()}
    )


def file_of(run: RunFolder, kind: type[FileRecord]) -> str | None:
    """The file in which a run has a record, under its name or that of format/1; None where it has none."""
    return next((name for name in (kind.file, kind.former) if name and run.holds(name)), None)


def read_record(run: RunFolder, kind: type[_R], clean: Callable[[Any], Any] = lambda content: content) -> _R:
    """A record that a run holds.

    Args:
        run: the folder.
        kind: which record.
        clean: what is done to parsed JSON before it is used.

    Raises:
        InputError: it is missing or damaged; the message names the value.
    """
    file = file_of(run, kind) or kind.file
    content = clean(run.read_json(file))
    try:
        return kind.from_json(upgraded(content) if run.first_format else content)
    except InputError as error:
        raise InputError(f"{run.path / file}: is damaged and cannot be read: {error}; repeat the run") from None


def read_documents(run: RunFolder) -> dict[str, Any]:
    """What a run wrote into its folder itself, by file name: records, datasets and texts; `InputError` when damaged."""
    files = {name for kind in RECORDS for name in (kind.file, kind.former)}
    records = {kind.file: read_record(run, kind) for kind in RECORDS if file_of(run, kind)}
    return records | run.read_documents(files)
