"""What is kept of answers gives the scores of the whole answers."""

from __future__ import annotations

from pathlib import Path

import pytest

from validation import stored_results
from validation.golden.run import frozen
from validation.golden.score import anchor_bits, certain_and_wrong, verdict_bits
from validation.stored_results import cut, keep, kept


def test_cut_answers_have_the_scores_of_the_whole() -> None:
    for answer in frozen().values():
        short = cut(answer)
        assert verdict_bits(short) == pytest.approx(verdict_bits(answer), abs=1e-4)
        assert anchor_bits(short) == pytest.approx(anchor_bits(answer), abs=1e-4)
        assert certain_and_wrong(short) == certain_and_wrong(answer)


def test_kept_results_come_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stored_results, "RESULTS", tmp_path / "results")
    result = {"a": {"probability": 0.25, "anchored": ["1"]}}
    assert keep("golden", result) == tmp_path / "results" / "golden.json"
    assert kept("golden") == result
