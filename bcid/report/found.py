"""What a run folder holds, as far as it holds it: a report shows runs of every kind and state."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import xarray as xr

from bcid.base.errors import BcidError, InputError
from bcid.base.run_folder import RunFolder
from bcid.report.text import clean
from bcid.results.diagnosis_record import DiagnosisRecord, DiscrepancyRecord
from bcid.results.exploration_record import ExplorationRecord
from bcid.results.identification_record import IdentificationRecord
from bcid.results.proposal_record import ProposalRecord
from bcid.results.record import FileRecord
from bcid.results.run_documents import file_of, read_record

_TEXTS = ("summary.txt", "table.txt")
# What damaged content makes the code raise that shows it, images and the drawing libraries included.
DAMAGE = (
    BcidError,
    ArithmeticError,
    AttributeError,
    LookupError,
    OSError,
    RuntimeError,
    SyntaxError,
    TypeError,
    ValueError,
)
# Longer texts are cut: they come from names and messages.
_LONGEST = 4000
_R = TypeVar("_R", bound=FileRecord)


@dataclass
class Found:
    """A run that is only looked at.

    Attributes:
        path: its folder.
        record: the content of `run.json`.
        diagnosis, identification, exploration, discrepancy, proposal: records of its JSON files, lengths in mm; None where
            they are not there, or damaged.
        calibration, tracking: content of those files, or None.
        body: `body.nc`, or None.
        positions: measured and predicted positions (`residuals.nc` or `prediction.nc`), or None.
        tracks: `tracking.nc`, or None.
        summary: the result in plain sentences, or "".
        troubles: what could not be read or shown, and why.
    """

    path: Path
    record: dict[str, Any]
    diagnosis: DiagnosisRecord | None = None
    identification: IdentificationRecord | None = None
    exploration: ExplorationRecord | None = None
    discrepancy: DiscrepancyRecord | None = None
    proposal: ProposalRecord | None = None
    calibration: dict[str, Any] | None = None
    tracking: dict[str, Any] | None = None
    body: xr.Dataset | None = None
    positions: xr.Dataset | None = None
    tracks: xr.Dataset | None = None
    summary: str = ""
    troubles: list[str] = field(default_factory=list)

    @classmethod
    def read(cls, path: str | Path) -> Found:
        """Look at a run folder; what is damaged is noted in `troubles`.

        Raises:
            InputError: the folder is not a run, or its `run.json` is damaged.
        """
        run = RunFolder.open(path)
        found = cls(run.path, _cleaned(run.record))
        found.diagnosis = found._record(run, DiagnosisRecord)
        found.identification = found._record(run, IdentificationRecord)
        found.exploration = found._record(run, ExplorationRecord)
        found.discrepancy = found._record(run, DiscrepancyRecord)
        found.proposal = found._record(run, ProposalRecord)
        found.calibration = found._part(run, "calibration.json", _document)
        found.tracking = found._part(run, "tracking.json", _document)
        found.body = found._part(run, "body.nc", _dataset)
        arrays = "residuals.nc" if run.holds("residuals.nc") else "prediction.nc"
        found.positions = found._part(run, arrays, _dataset)
        found.tracks = found._part(run, "tracking.nc", _dataset)
        texts = (found._part(run, name, lambda run, name: clean(run.read_text(name))) for name in _TEXTS)
        found.summary = next((text for text in texts if text), "")
        return found

    def _part(self, run: RunFolder, name: str, read: Callable[[RunFolder, str], Any]) -> Any:
        """What a file holds; None where it is not there, or damaged."""
        try:
            return read(run, name) if run.holds(name) else None
        except (BcidError, RecursionError, ValueError, KeyError) as error:
            self.troubles.append(str(error))
            return None

    def _record(self, run: RunFolder, kind: type[_R]) -> _R | None:
        """A record in mm, with texts that can be shown; None where it is not there, or damaged."""
        file = file_of(run, kind)
        if file is None:
            return None
        record: _R | None = self._part(run, file, lambda run, _: read_record(run, kind, _cleaned).converted("mm"))
        return record

    @property
    def command(self) -> str:
        """What was run, as "explain"."""
        return str(self.record["command"])

    @property
    def state(self) -> str:
        """ "running", "finished" or "failed"."""
        return str(self.record["state"])

    @property
    def anchored(self) -> tuple[str, ...]:
        """The anchored patches of its result."""
        record = self.diagnosis or self.identification or self.exploration
        return record.anchored if record else ()

    @property
    def name(self) -> str:
        """What the folder is called."""
        return clean(self.path.resolve().name) or "run"

    @property
    def scene(self) -> str:
        """Name of the body, or ""."""
        return "" if self.body is None else str(self.body.attrs.get("scene", ""))


def _cleaned(content: Any, depth: int = 40) -> Any:
    """JSON content with texts that can be shown."""
    if isinstance(content, str):
        return clean(content) if len(content) <= _LONGEST else f"{clean(content[:_LONGEST])} ..."
    if depth == 0:
        return "..."
    if isinstance(content, dict):
        return {clean(key): _cleaned(value, depth - 1) for key, value in content.items()}
    if isinstance(content, list):
        return [_cleaned(value, depth - 1) for value in content]
    return content


def _document(run: RunFolder, name: str) -> dict[str, Any]:
    content = run.read_json(name)
    if not isinstance(content, dict):
        raise InputError(f"{run.path / name}: is damaged and cannot be read: it holds no table")
    found: dict[str, Any] = _cleaned(content)
    return found


def _dataset(run: RunFolder, name: str) -> xr.Dataset:
    """A dataset whose names and attributes can be shown."""
    data = run.read_dataset(name)
    for variable in [str(variable) for variable in data.variables if data[variable].dtype.kind == "U"]:
        values = data[variable].values
        data[variable] = (data[variable].dims, np.array([clean(str(v)) for v in values.flat]).reshape(values.shape))
    data.attrs = {key: clean(value) if isinstance(value, str) else value for key, value in data.attrs.items()}
    return data
