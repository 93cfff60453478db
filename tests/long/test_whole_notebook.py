"""The notebook runs from top to bottom, and its results show themselves."""

import json
import os
from pathlib import Path
from typing import Any

import pytest

from bcid.base.shipped import copy_examples

PROJECT = Path(__file__).resolve().parents[2]
NOTEBOOK = json.loads((PROJECT / "examples/first_steps.ipynb").read_text(encoding="utf-8"))
CODE = ["".join(cell["source"]) for cell in NOTEBOOK["cells"] if cell["cell_type"] == "code"]


def test_the_notebook_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    copy_examples(tmp_path / "here")
    monkeypatch.chdir(tmp_path / "here/examples")
    names: dict[str, Any] = {}
    shown = []
    for cell in CODE:
        *lines, last = cell.splitlines()
        exec("\n".join(lines), names)
        try:
            shown.append(eval(last.removesuffix(";"), names))
        except SyntaxError:
            exec(last, names)
    assert "31 frames of 16 markers" in capsys.readouterr().out
    assert names["found"].anchored == ("3", "4")
    assert names["found"].rms == pytest.approx(0.313e-3, rel=0.01)
    explained = names["explained"]
    assert explained.verdict == "gravity"
    assert [model.anchored for model in explained.model_sequence] == [("3", "4")] * 2
    assert [model.adequate for model in explained.model_sequence] == [False, True]
    assert explained.model_sequence[0].rms == pytest.approx(1.41e-3, rel=0.01)
    assert explained.rms == pytest.approx(0.215e-3, rel=0.03)
    # The weight that the measurement was made with is found within its error.
    weight = explained.parameters["gravity.weight"]
    assert weight.value == pytest.approx(1260, abs=3 * weight.stderr)
    assert repr(shown[-1]) == repr(explained)
    assert all(hasattr(one, "_repr_html_") for one in shown if "Result" in type(one).__name__)
    assert os.path.isdir("explained")
