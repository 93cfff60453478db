"""Runs examples/first_steps.ipynb and keeps what it shows: ``./dev python docs/_make/notebook.py`` (a few minutes)."""

from __future__ import annotations

import ast
import io
import json
import os
from base64 import b64encode
from contextlib import redirect_stdout
from pathlib import Path
from pprint import pformat
from tempfile import TemporaryDirectory
from typing import Any

from bcid.base.shipped import copy_examples

NOTEBOOK = Path(__file__).resolve().parents[2] / "examples/first_steps.ipynb"


def run(source: str, names: dict[str, Any]) -> tuple[str, Any]:
    """Run a cell; what it prints, and the value of its last line, or None."""
    parsed = ast.parse(source)
    last = parsed.body.pop() if isinstance(parsed.body[-1], ast.Expr) else None
    printed = io.StringIO()
    with redirect_stdout(printed):
        exec(compile(parsed, "cell", "exec"), names)
        value = eval(compile(ast.Expression(last.value), "cell", "eval"), names) if isinstance(last, ast.Expr) else None
    return printed.getvalue(), value


def shown(value: Any) -> dict[str, Any]:
    """A value as a notebook shows it."""
    data: dict[str, Any] = {"text/plain": pformat(value).splitlines(keepends=True)}
    if hasattr(value, "savefig"):
        picture = io.BytesIO()
        value.savefig(picture, format="png", bbox_inches="tight")
        data["image/png"] = b64encode(picture.getvalue()).decode()
    elif hasattr(value, "_repr_html_"):
        data["text/html"] = value._repr_html_().splitlines(keepends=True)
    return data


def outputs(printed: str, value: Any, count: int) -> list[dict[str, Any]]:
    """The outputs of a cell, as a notebook keeps them."""
    found: list[dict[str, Any]] = []
    if printed:
        found.append({"name": "stdout", "output_type": "stream", "text": printed.splitlines(keepends=True)})
    if value is not None:
        data = dict(sorted(shown(value).items()))
        found.append({"data": data, "execution_count": count, "metadata": {}, "output_type": "execute_result"})
    return found


def main() -> None:
    notebook = json.loads(NOTEBOOK.read_text(encoding="utf-8"))
    names: dict[str, Any] = {}
    with TemporaryDirectory() as folder:
        copy_examples(Path(folder) / "here")
        os.chdir(Path(folder) / "here/examples")
        for count, cell in enumerate((cell for cell in notebook["cells"] if cell["cell_type"] == "code"), start=1):
            cell["execution_count"] = count
            cell["outputs"] = outputs(*run("".join(cell["source"]), names), count)
        os.chdir(NOTEBOOK.parent)
    NOTEBOOK.write_text(json.dumps(notebook, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
