"""Lengths for people: every page and picture shows them in mm, whatever unit the measurement was written in."""

from __future__ import annotations

from typing import Any

import numpy as np

from bcid.base.errors import InputError
from bcid.base.units import unit_factor

# What is a length in the documents of a run.
_RMS = ("rms", "noise_rms", "discretisation_rms", "held_out_rms", "best_rms", "expected_rms", "fitted_rms")
_LENGTHS = frozenset((*_RMS, "distance", "position", "positions", "contributions"))


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


def round_length(most: float) -> float:
    """The largest of 1, 2, 5, 10, ... times a power of ten that is not larger."""
    power = 10.0 ** np.floor(np.log10(most))
    return float(power * max(step for step in (1, 2, 5) if step * power <= most * (1 + 1e-9)))
