"""What half and double of each number that decides something does to the answers of golden cases.

These numbers are the fields of `Priors`, `Thresholds` and `SearchSettings`. Predictions are shared by all runs.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

from bcid.base.progress import Progress
from bcid.inference.priors import PRIORS
from bcid.inference.thresholds import THRESHOLDS
from bcid.search.settings import SETTINGS
from validation.golden import run as golden
from validation.golden.score import anchor_bits, certain_and_wrong, verdict_bits
from validation.text_table import TextTable

OBJECTS = (PRIORS, THRESHOLDS, SETTINGS)
# A probability near one is as far from that.
_NEAR_ONE = ("missing", "credible", "explained")
WHOLE = "as they are"
FACTORS = {"half": 0.5, "double": 2.0}

Answers = Mapping[str, Mapping[str, dict[str, Any]]]


def numbers() -> dict[str, Any]:
    """The value of every number by its name."""
    return {field.name: getattr(one, field.name) for one in OBJECTS for field in fields(one)}


def changes() -> dict[str, dict[str, Any]]:
    """By a name for the run what it changes."""
    found: dict[str, dict[str, Any]] = {WHOLE: {}}
    for name, value in numbers().items():
        for word, factor in FACTORS.items():
            other = 1 - scaled(1 - value, 1 / factor) if name in _NEAR_ONE else scaled(value, factor)
            if other != value:
                found[f"{word} {name}"] = {name: other}
    return found


def scaled(value: Any, factor: float) -> Any:
    """A number or several, whole ones at least 1; of several how many of something there are stays."""
    if isinstance(value, tuple):
        return [one if isinstance(one, int) else scaled(one, factor) for one in value]
    return max(1, round(value * factor)) if isinstance(value, int) else value * factor


def run(folder: Path, names: Iterable[str], jobs: int, store: Path, progress: Progress) -> None:
    """Explain cases with each change, into a folder for each; a run that was interrupted goes on."""
    chosen = list(names)
    for word, changed in changes().items():
        progress.say(word)
        golden.run(_folder(folder, word), chosen, jobs, progress, store, changed)


def read(folder: Path) -> dict[str, dict[str, dict[str, Any]]]:
    """Answers of a run so far, by change and case."""
    return {word: golden.read(_folder(folder, word)) for word in changes() if _folder(folder, word).is_dir()}


def table(found: Answers) -> TextTable:
    """How much each change moves the scores, over the cases that all of them have."""
    common = sorted(set.intersection(*(set(answers) for answers in found.values()))) if found else []
    rows = []
    for name, value in numbers().items():
        for word in FACTORS:
            if f"{word} {name}" in found:
                rows.append((name, _text(value), word, *_moved(found[WHOLE], found[f"{word} {name}"], common)))
    head = ("number", "value", "", "verdict bits", "anchor bits", "largest change", "certain and wrong")
    return TextTable(
        f"Half and double of each number: change of the score, {len(common)} golden cases", head, tuple(rows)
    )


def _moved(before: Mapping[str, Any], after: Mapping[str, Any], names: list[str]) -> tuple[str, ...]:
    """Mean change of both scores, the largest of a case, and how many more are certain and wrong."""
    means, all_apart = [], [0.0]
    for score in (verdict_bits, anchor_bits):
        pairs = [(score(before[name]), score(after[name])) for name in names]
        apart = [b - a for a, b in pairs if a is not None and b is not None]
        means.append(f"{sum(apart) / len(apart):+.3f}" if apart else "")
        all_apart += apart
    wrong = sum(bool(certain_and_wrong(after[name])) - bool(certain_and_wrong(before[name])) for name in names)
    return (*means, f"{max(all_apart, key=abs):+.3f}", f"{wrong:+d}" if wrong else "0")


def _text(value: Any) -> str:
    return ", ".join(f"{one:g}" for one in (value if isinstance(value, tuple) else (value,)))


def _folder(folder: Path, word: str) -> Path:
    return folder / word.replace(" ", "-")
