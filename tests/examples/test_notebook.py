"""The notebook that is shipped was run, and asks for nothing that does not exist; tests/long runs it."""

import ast
import json
from pathlib import Path

import bcid

PROJECT = Path(__file__).resolve().parents[2]
NOTEBOOK = json.loads((PROJECT / "examples/first_steps.ipynb").read_text(encoding="utf-8"))
CODE = ["".join(cell["source"]) for cell in NOTEBOOK["cells"] if cell["cell_type"] == "code"]


def test_the_notebook_asks_for_names_that_exist() -> None:
    nodes = [node for cell in CODE for node in ast.walk(ast.parse(cell)) if isinstance(node, ast.Attribute)]
    asked = {node.attr for node in nodes if isinstance(node.value, ast.Name) and node.value.id == "bcid"}
    assert {"identify", "explain", "load"} <= asked
    assert all(hasattr(bcid, name) for name in asked)
    files = {node.value for cell in CODE for node in ast.walk(ast.parse(cell)) if isinstance(node, ast.Constant)}
    for name in files:
        if str(name).startswith(("scenes/", "measurements/")):
            assert (PROJECT / "examples" / name).exists()


def test_the_notebook_that_is_shipped_was_run() -> None:
    """On the pages of a forge a notebook is read, not run."""
    cells = [cell for cell in NOTEBOOK["cells"] if cell["cell_type"] == "code"]
    assert all(cell["outputs"] for cell in cells)
    assert not [out for cell in cells for out in cell["outputs"] if out["output_type"] == "error"]
    assert len(json.dumps(NOTEBOOK)) < 600_000
