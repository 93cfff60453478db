"""Ablation: golden cases without one term of the posterior after the other; what is worth nothing goes.

Predictions are shared by all runs, so that a term that changes no prediction costs no solve.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from bcid.base.progress import Progress
from validation.golden import run as golden
from validation.golden.score import anchor_bits, certain_and_wrong, verdict_bits
from validation.text_table import TextTable

# A probability of nothing, whose logarithm is finite.
_NEVER = 1e-12
WHOLE = "all terms"
# Numbers of `bcid.inference.priors` that take a term out.
TERMS: Mapping[str, Mapping[str, Any]] = {
    WHOLE: {},
    "no misfit in observation space": {"response": _NEVER},
    "no change point": {"change_point": _NEVER},
    "no smooth force or growth": {"force": _NEVER},
    "no errors of the fidelities": {"fidelity_error": [1e-6, 1e-6, 1e-6, 1e-6], "error_freedom": 1e20},
    "one scale of amounts instead of a half-Cauchy": {"amounts": [2.0, 2.0, 1]},
}

Answers = Mapping[str, Mapping[str, dict[str, Any]]]


def run(folder: Path, names: Iterable[str], jobs: int, store: Path, progress: Progress) -> None:
    """Explain cases without each term, into a folder for each; a run that was interrupted goes on."""
    chosen = list(names)
    for term, priors in TERMS.items():
        progress.say(term)
        golden.run(_folder(folder, term), chosen, jobs, progress, store, priors)


def read(folder: Path) -> dict[str, dict[str, dict[str, Any]]]:
    """Answers of a run so far, by term and case."""
    return {term: golden.read(_folder(folder, term)) for term in TERMS if _folder(folder, term).is_dir()}


def table(found: Answers) -> TextTable:
    """Scores by term, over the cases that all of them have."""
    common = set.intersection(*(set(answers) for answers in found.values())) if found else set()
    names = sorted(common)
    rows = tuple(_row(term, [answers[name] for name in names]) for term, answers in found.items())
    head = ("posterior", "verdict bits", "anchor bits", "certain and wrong", "solves")
    return TextTable(f"Ablation: mean log2 probability of the truth, {len(names)} golden cases", head, rows)


def _row(term: str, answers: list[dict[str, Any]]) -> tuple[str, ...]:
    bits = [_mean([score(one) for one in answers]) for score in (verdict_bits, anchor_bits)]
    wrong = sum(bool(certain_and_wrong(one)) for one in answers)
    solves = sum(sum((one["trajectories"] or {}).values()) for one in answers)
    return (term, *bits, str(wrong), f"{solves:.0f}")


def _mean(values: Iterable[float | None]) -> str:
    known = [value for value in values if value is not None]
    return f"{sum(known) / len(known):.3f}" if known else ""


def _folder(folder: Path, term: str) -> Path:
    return folder / term.replace(" ", "-")
