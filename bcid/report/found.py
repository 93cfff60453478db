"""What a run folder holds, as far as it holds it: a report shows runs of every kind and state."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from bcid.base.errors import BcidError, InputError
from bcid.base.run_folder import RunFolder
from bcid.base.units import unit_factor
from bcid.report.text import clean

_DOCUMENTS = ("diagnosis", "identification", "exploration", "calibration", "tracking", "where", "model", "proposal")
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
# What is a length in the documents of a run.
_RMS = ("rms", "noise_rms", "discretisation_rms", "held_out_rms", "best_rms", "expected_rms", "fitted_rms")
_LENGTHS = frozenset((*_RMS, "distance", "position", "positions", "contributions"))
# Longer texts are cut: they come from names and messages.
_LONGEST = 4000


@dataclass
class Found:
    """A run that is only looked at.

    Attributes:
        path: its folder.
        record: the content of `run.json`.
        documents: by name, as "diagnosis", what the folder's JSON files hold.
        body: `body.nc`, or None.
        positions: measured and predicted positions (`residuals.nc` or `prediction.nc`), or None.
        tracks: `tracking.nc`, or None.
        summary: the result in plain sentences, or "".
        troubles: what could not be read or shown, and why.
    """

    path: Path
    record: dict[str, Any]
    documents: dict[str, dict[str, Any]] = field(default_factory=dict)
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
        for name in _DOCUMENTS:
            content = found._part(run, f"{name}.json", _document)
            if content is not None:
                found.documents[name] = content
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

    @property
    def command(self) -> str:
        """What was run, as "explain"."""
        return str(self.record["command"])

    @property
    def state(self) -> str:
        """ "running", "finished" or "failed"."""
        return str(self.record["state"])

    @property
    def result(self) -> dict[str, Any]:
        """The document that the verdict stands in; empty where there is none."""
        return next(iter(self.documents.values()), {})

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
    try:
        return in_mm(_cleaned(content))
    except InputError as error:
        raise InputError(f"{run.path / name}: is damaged and cannot be read: {error}; repeat the run") from None


def _dataset(run: RunFolder, name: str) -> xr.Dataset:
    """A dataset whose names and attributes can be shown."""
    data = run.read_dataset(name)
    for variable in [str(variable) for variable in data.variables if data[variable].dtype.kind == "U"]:
        values = data[variable].values
        data[variable] = (data[variable].dims, np.array([clean(str(v)) for v in values.flat]).reshape(values.shape))
    data.attrs = {key: clean(value) if isinstance(value, str) else value for key, value in data.attrs.items()}
    return data


def in_mm(document: dict[str, Any]) -> dict[str, Any]:
    """A document of a run with its lengths in mm, in which pages and pictures show them.

    Raises:
        InputError: its `length_unit` is no unit of length.
    """
    factor = unit_factor(str(document.get("length_unit", "mm")), "mm") * 1e3
    return document if factor == 1.0 else _scaled(document, factor, False) | {"length_unit": "mm"}


def _scaled(content: Any, factor: float, length: bool) -> Any:
    if isinstance(content, dict):
        return {key: _scaled(value, factor, length or key in _LENGTHS) for key, value in content.items()}
    if isinstance(content, list):
        return [_scaled(value, factor, length) for value in content]
    return content * factor if length and type(content) in (int, float) else content
