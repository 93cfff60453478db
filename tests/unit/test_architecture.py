"""The figures of the architecture say what the code is: rooms in rows, and the path of a measurement."""

from __future__ import annotations

import ast
import importlib
from pathlib import Path
from typing import Any

import pytest

PROJECT = Path(__file__).resolve().parents[2]


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> Any:
    """The module that draws them."""
    pytest.importorskip("matplotlib")
    monkeypatch.syspath_prepend(str(PROJECT / "docs/_make"))
    return importlib.import_module("architecture")


def imported(module: str) -> set[str]:
    """Modules of the product that a module imports, at once or through others."""
    known: set[str] = set()
    waiting = [module]
    while waiting:
        name = waiting.pop()
        file = PROJECT / f"{name.replace('.', '/')}.py"
        if name in known or not file.is_file():
            continue
        known.add(name)
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("bcid."):
                waiting += [node.module or "", *(f"{node.module}.{one.name}" for one in node.names)]
    return known - {module}


def test_rooms_stand_above_all_that_they_import(drawn: Any) -> None:
    height = {room: k for k, row in enumerate(drawn.ROWS) for room in row}
    assert set(height) == {path.parent.name for path in (PROJECT / "bcid").glob("*/__init__.py")}
    upwards = [(room, other) for room in height for other in drawn.imports(room) if height[other] >= height[room]]
    assert upwards == []


def test_a_measurement_meets_no_import_of_what_comes_later(drawn: Any) -> None:
    for module, name, _ in drawn.PATH:
        assert hasattr(importlib.import_module(module), name)
    modules = [module for module, *_ in drawn.PATH]
    for k, module in enumerate(modules):
        later = {one for one in modules[k + 1 :] if not one.startswith("bcid.results.")}
        assert not imported(module) & later, module


def test_figures_are_written(drawn: Any, tmp_path: Path) -> None:
    drawn.draw_architecture(tmp_path)
    assert "HypothesisTable" in (tmp_path / "path.svg").read_text(encoding="utf-8")
    assert "inference" in (tmp_path / "rooms.svg").read_text(encoding="utf-8")
