"""The ablation table: each term is taken out of the process that explains, and scores are of the cases that all have."""

from __future__ import annotations

import copy
import inspect
import re
from dataclasses import fields
from pathlib import Path
from typing import Any

import pytest

from bcid.inference import priors
from bcid.inference.priors import PRIORS
from validation import ablation, numbers
from validation.golden import run as golden


def answer(p: float, solves: float, verdict: str = "gravity") -> dict[str, Any]:
    truth = {"kind": "one", "anchored": ["1"], "not_asked": [], "effects": [{"effect": "gravity", "size": 10.0}]}
    hypotheses = [{"anchored": ["1"], "probability": p}]
    diagnosis = {
        "verdict": verdict,
        "verdict_probability": 0.99,
        "anchored": ["1"],
        "anchors_probability": p,
        "posterior": {"effects": {"gravity": p, "none": 1 - p}, "hypotheses": hypotheses},
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
    golden.maker({"cases": str(tmp_path), "store": "", "numbers": changed})
    assert own.amounts == (2.0, 2.0, 1)
    assert PRIORS.amounts != own.amounts


def test_few_numbers_decide_and_each_is_halved_and_doubled() -> None:
    names = [field.name for one in numbers.OBJECTS for field in fields(one)]
    assert len(names) == len(set(names)) <= 60
    changes = numbers.changes()
    for name, value in numbers.numbers().items():
        tried = [changes[f"{word} {name}"][name] for word in numbers.FACTORS if f"{word} {name}" in changes]
        assert tried, name
        assert all(other != value for other in tried), name
    assert changes["half credible"]["credible"] == pytest.approx(0.9)
    assert changes["double amounts"]["amounts"] == [0.2, 20.0, 7]
    assert changes["half batch"]["batch"] == 2


def test_every_number_is_described_where_it_is_defined() -> None:
    for one in numbers.OBJECTS:
        described = re.findall(r"^    ([a-z_][a-z_, ]*): ", inspect.getdoc(type(one)) or "", re.MULTILINE)
        assert {name for line in described for name in line.split(", ")} == {field.name for field in fields(one)}


def test_table_shows_what_a_change_moves() -> None:
    found = {numbers.WHOLE: {"a": answer(0.5, 1)}, "half force": {"a": answer(0.25, 1, "none")}}
    row = next(line.split() for line in numbers.table(found).text().splitlines() if line.startswith("force "))
    assert row == ["force", "0.1", "half", "-1.000", "-1.000", "-1.000", "+1"]
