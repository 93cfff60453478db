"""`summary.txt`: a result in sentences and tables, from its record."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined

from bcid.base.units import force_unit, p_value, percent
from bcid.results import diagnosis_words, identification_words, words
from bcid.results.common_rows import set_label, unknown_thickness
from bcid.results.diagnosis_record import DiagnosisRecord, DiscrepancyRecord, ForceRow
from bcid.results.exploration_record import ExplorationRecord
from bcid.results.identification_record import IdentificationRecord

# Regions of a missing force that are named, and steps whose residual is.
_REGIONS, _STEPS = 6, 8


def diagnosis_summary(record: DiagnosisRecord, force: DiscrepancyRecord | None = None, head: Sequence[str] = ()) -> str:
    """Of a diagnosis.

    Args:
        record: it, in any unit of length.
        force: the force that would explain what the model misses.
        head: lines in place of its conclusion.
    """
    about = {"d": record.converted("mm"), "force": None if force is None else force.converted("mm"), "head": head}
    return _made("diagnosis.txt", words=diagnosis_words, force_lines=_force_lines, **about)


def identification_summary(record: IdentificationRecord) -> str:
    """Of an identification, in any unit of length."""
    return _made("identification.txt", r=record.converted("mm"), words=identification_words)


def exploration_summary(record: ExplorationRecord) -> str:
    """Of an exploration, in any unit of length."""
    return _made("exploration.txt", r=record.converted("mm"))


@cache
def _templates() -> Environment:
    made = Environment(
        loader=PackageLoader("bcid.results", "templates"),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    made.filters |= {"percent": percent, "p": p_value, "g": _three_digits}
    made.globals |= {
        "set_label": set_label,
        "parameter_text": words.parameter_text,
        "input_text": words.input_text,
        "unknown_thickness": unknown_thickness,
        "NO_EFFECTS": words.NO_EFFECTS,
        "adequacy": words.ADEQUACY,
        "some_steps": _some_steps,
        "ranking_lines": diagnosis_words.ranking_lines,
    }
    return made


def _made(name: str, **about: Any) -> str:
    return _templates().get_template(name).render(**about)


def _three_digits(value: float | None) -> str:
    return "" if value is None else f"{value:.3g}"


def _some_steps(steps: Sequence[Any]) -> list[Any]:
    """Some of many, the first and the last among them."""
    if len(steps) <= _STEPS:
        return list(steps)
    return [steps[k] for k in np.linspace(0, len(steps) - 1, _STEPS).astype(int)]


def _force_lines(force: DiscrepancyRecord) -> list[str]:
    """A missing force: its sum over the body, and its largest parts."""
    parts = [("in all frames", row) for row in force.steady]
    parts += [(f"action {action}, growing", row) for action, rows in force.growing.items() for row in rows]
    parts.sort(key=lambda part: -_size(part[1]))
    shown = [("together", "in all frames", force.together.steady)]
    for when, row in parts[:_REGIONS]:
        shown.append((f"at ({' '.join(f'{v:.0f}' for v in row.position)}) mm", when, row))
    per_newton, newtons = force_unit(max(_size(row) for *_, row in shown))
    return [
        f"{what}: ({' '.join(f'{per_newton * v:+.2f}' for v in row.force)}) {newtons} ± {per_newton * row.stderr:.2f}, {when}"
        for what, when, row in shown
    ]


def _size(row: ForceRow) -> float:
    return float(np.linalg.norm(row.force))
