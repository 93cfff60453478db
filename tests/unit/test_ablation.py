"""The ablation table: each term is taken out of the process that explains, and scores are of the cases that all have."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

import pytest

from bcid.inference import priors
from bcid.inference.priors import PRIORS
from validation import ablation
from validation.golden import run as golden


def answer(p: float, solves: float, verdict: str = "gravity") -> dict[str, Any]:
    truth = {"kind": "one", "anchored": ["1"], "not_asked": [], "effects": [{"effect": "gravity", "size": 10.0}]}
    hypotheses = [{"anchored": ["1"], "probability": p}]
    diagnosis = {
        "verdict": verdict,
        "verdict_probability": 0.99,
        "anchored": ["1"],
        "anchors_probability": p,
        "probabilities": {"effects": {"gravity": p, "none": 1 - p}, "hypotheses": hypotheses},
    }
    return {"truth": truth, "diagnosis": diagnosis, "trajectories": {"working": solves}}


def test_table_scores_the_cases_that_all_have() -> None:
    whole = {"a": answer(0.5, 10), "b": answer(0.25, 4)}
    less = {"a": answer(0.125, 12, "none")}
    text = ablation.table({ablation.WHOLE: whole, "no change point": less}).text()
    rows = {line.split("  ")[0]: line.split()[-4:] for line in text.splitlines() if line.startswith(("all", "no"))}
    assert rows[ablation.WHOLE] == ["-1.000", "-1.000", "0", "10"]
    assert rows["no change point"] == ["-3.000", "-3.000", "1", "12"]
    assert "1 golden cases" in text


def test_terms_are_numbers_of_the_prior(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    own = copy.copy(PRIORS)
    monkeypatch.setattr(priors, "PRIORS", own)
    for changes in ablation.TERMS.values():
        assert all(hasattr(PRIORS, name) for name in changes)
    changed = ablation.TERMS["one scale of amounts instead of a half-Cauchy"]
    golden.maker({"cases": str(tmp_path), "store": "", "priors": changed})
    assert own.amounts == (2.0, 2.0, 1)
    assert PRIORS.amounts != own.amounts
