"""Results of runs that the documentation shows, kept in the repository as one file for each experiment."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from bcid.base.run_folder import write_whole

RESULTS = Path(__file__).resolve().parent / "results"
# Of an answer, and of its diagnosis, what scores are of.
_ANSWER = ("kind", "truth", "diagnosis", "trajectories", "seconds", "cpu_seconds")
_DIAGNOSIS = ("verdict", "verdict_probability", "anchored", "anchors_probability", "posterior")
# Digits of a probability.
_DIGITS = 6


def cut(answer: Mapping[str, Any]) -> dict[str, Any]:
    """Of an answer what its scores are of."""
    found = {name: answer[name] for name in _ANSWER if name in answer}
    if found["diagnosis"] is not None:
        found["diagnosis"] = _rounded({name: found["diagnosis"][name] for name in _DIAGNOSIS})
    return found


def keep(experiment: str, result: Any) -> Path:
    """Write the result of an experiment into the repository; returns the file."""
    RESULTS.mkdir(exist_ok=True)
    file = RESULTS / f"{experiment}.json"
    write_whole(file, json.dumps(result, sort_keys=True, separators=(",", ":")) + "\n")
    return file


def kept(experiment: str) -> Any:
    """The result of an experiment, as `keep` wrote it."""
    return json.loads((RESULTS / f"{experiment}.json").read_text(encoding="utf-8"))


def _rounded(value: Any) -> Any:
    if isinstance(value, float):
        return float(f"{value:.{_DIGITS}g}")
    if isinstance(value, dict):
        return {name: _rounded(one) for name, one in value.items()}
    return [_rounded(one) for one in value] if isinstance(value, list) else value
