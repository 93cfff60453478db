"""What a run folder holds, as far as it holds it: a report shows runs of every kind and state."""

from __future__ import annotations

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
            if run.holds(f"{name}.json"):
                found._document(run, name)
        arrays = "residuals.nc" if run.holds("residuals.nc") else "prediction.nc"
        found.body = found._dataset(run, "body.nc")
        found.positions = found._dataset(run, arrays)
        found.tracks = found._dataset(run, "tracking.nc")
        for name in _TEXTS:
            if not found.summary and run.holds(name):
                found._summary(run, name)
        return found

    def _document(self, run: RunFolder, name: str) -> None:
        try:
            content = run.read_json(f"{name}.json")
        except (BcidError, RecursionError) as error:
            self.troubles.append(str(error))
            return
        if isinstance(content, dict):
            self.documents[name] = in_mm(_cleaned(content))
        else:
            self.troubles.append(f"{run.path / name}.json: is damaged and cannot be read: it holds no table")

    def _summary(self, run: RunFolder, name: str) -> None:
        try:
            self.summary = clean(run.read_text(name))
        except BcidError as error:
            self.troubles.append(str(error))

    def _dataset(self, run: RunFolder, name: str) -> xr.Dataset | None:
        if not run.holds(name):
            return None
        try:
            return _named(run.read_dataset(name))
        except (BcidError, ValueError, KeyError) as error:
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
        for name in _DOCUMENTS:
            if name in self.documents:
                return self.documents[name]
        return {}

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


def _named(data: xr.Dataset) -> xr.Dataset:
    """A dataset whose names and attributes can be shown."""
    for name in [str(name) for name in data.variables if data[name].dtype.kind == "U"]:
        data[name] = (
            data[name].dims,
            np.array([clean(str(v)) for v in data[name].values.ravel()]).reshape(data[name].shape),
        )
    data.attrs = {key: clean(value) if isinstance(value, str) else value for key, value in data.attrs.items()}
    return data


def in_mm(document: dict[str, Any]) -> dict[str, Any]:
    """A document of a run with its lengths in mm; one that states no usable unit stays as it is."""
    unit = document.get("length_unit")
    try:
        factor = unit_factor(unit, "mm") * 1e3 if isinstance(unit, str) else 1.0
    except InputError:
        return document
    if factor == 1.0 or unit == "mm":
        return document
    return _scaled(document, factor, False) | {"length_unit": "mm"}


def _scaled(content: Any, factor: float, length: bool) -> Any:
    if isinstance(content, dict):
        return {key: _scaled(value, factor, length or key in _LENGTHS) for key, value in content.items()}
    if isinstance(content, list):
        return [_scaled(value, factor, length) for value in content]
    return (
        content * factor if length and isinstance(content, int | float) and not isinstance(content, bool) else content
    )
