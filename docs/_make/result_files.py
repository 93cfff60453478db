"""The reference of result files, from the records themselves."""

import inspect
import re
import types
from dataclasses import Field, fields
from pathlib import Path
from typing import Any, Union, get_args, get_origin, get_type_hints

from bcid.results.record import FileRecord, Record
from bcid.results.run_documents import RECORDS

WORDS = {float: "number", int: "whole number", str: "text", bool: "true or false"}


def write_result_files(head: Path, target: Path) -> None:
    """Write a table of the keys of every record behind a page's head."""
    parts, shown = [head.read_text(encoding="utf-8")], set[type[Record]]()
    for kind in RECORDS:
        parts.append(f"## {kind.file}\n\n{about(kind)}\n\n{table(kind)}")
        for row in rows_of(kind):
            if row not in shown:
                shown.add(row)
                parts.append(f"({row.__name__})=\n### {title(row)}\n\n{about(row)}\n\n{table(row)}")
    text = "\n\n".join(parts) + "\n"
    if not target.is_file() or target.read_text(encoding="utf-8") != text:
        target.write_text(text, encoding="utf-8")


def title(kind: type[Record]) -> str:
    """A class's name as words."""
    return re.sub(r"(?<!^)(?=[A-Z])", " ", kind.__name__.removesuffix("Row").removesuffix("Record")).capitalize()


def about(kind: type[Record]) -> str:
    """What stands before a class's attributes."""
    return (kind.__doc__ or "").split("\n\n")[0].strip()


def meanings(kind: type[Record]) -> dict[str, str]:
    """What the docstrings of a class and its bases say of each key."""
    found: dict[str, str] = {}
    for base in reversed(kind.__mro__):
        _, _, listed = inspect.cleandoc(vars(base).get("__doc__") or "").partition("Attributes:\n")
        for names, text in re.findall(r"(?m)^    ([\w, ]+): ((?:.|\n(?!    \w[\w, ]*: ))*)", listed):
            found |= dict.fromkeys(names.split(", "), " ".join(text.split()))
    return found


def table(kind: type[Record]) -> str:
    """Key, type and meaning of each field."""
    said, hints = meanings(kind), get_type_hints(kind)
    lines = ["| key | type | meaning |", "|---|---|---|"]
    for field in fields(kind):
        lines.append(f"| `{field.name}` | {typed(hints[field.name], field)} | {said.get(field.name, '')} |")
    return "\n".join(lines)


def typed(kind: Any, field: Field[Any]) -> str:
    """A type of a field as words."""
    origin, inner = get_origin(kind), get_args(kind)
    if origin in (Union, types.UnionType):
        return f"{typed(inner[0], field)} or null"
    if origin is tuple:
        return f"list of {plural(typed(inner[0], field))}"
    if origin is dict:
        return f"table of {plural(typed(inner[1], field))}"
    if issubclass(kind, Record):
        return f"[{title(kind).lower()}](#{kind.__name__})"
    return "length" if kind is float and "length" in field.metadata else WORDS[kind]


def plural(words: str) -> str:
    """Of a type's words."""
    link = re.fullmatch(r"\[(.*)\](\(.*\))", words)
    if link:
        return f"[{link[1]}]{link[2]} rows"
    first, _, rest = words.partition(" of ")
    return f"{first}s of {rest}" if rest else re.sub("(number|text|length)", r"\1s", words)


def rows_of(kind: type[Record]) -> list[type[Record]]:
    """Records within a record, at any depth, in their order."""
    found: list[type[Record]] = []

    def visit(one: Any) -> None:
        if isinstance(one, type) and issubclass(one, Record) and not issubclass(one, FileRecord):
            if one not in found:
                found.append(one)
                for hint in get_type_hints(one).values():
                    visit(hint)
            return
        for part in get_args(one):
            visit(part)

    for hint in get_type_hints(kind).values():
        visit(hint)
    return found
