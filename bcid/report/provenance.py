"""What was run: command, inputs with fingerprints, options, effort, versions."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from bcid.report.found import Found
from bcid.report.text import duration

_FINGERPRINTED = ("scene", "measurement", "recording", "layout", "corners", "expected")
# A value that is longer is cut.
_LONGEST = 400


def groups(found: Found) -> dict[str, list[tuple[str, str]]]:
    """The record of a run: names and values, by group."""
    record = found.record
    return {
        "run": list(_about(record)),
        "inputs": list(_inputs(record)),
        "options": list(_flat({k: v for k, v in record["inputs"].items() if k not in _FINGERPRINTED})),
        "effort": list(_effort(record)),
        "versions": list(_flat(record["versions"])),
    }


def facts(found: Found) -> list[tuple[str, str]]:
    """The same in pairs, for a file."""
    return list(_flat({key: value for key, value in found.record.items() if key != "result"}))


def _about(record: dict[str, Any]) -> Iterator[tuple[str, str]]:
    yield "command", f"bcid {record['command']}"
    for key in ("state", "reason", "started", "ended"):
        if record.get(key):
            yield key, str(record[key])
    attempts = f" in {record['attempts']} attempts" if record["attempts"] != 1 else ""
    yield "took", duration(float(record["seconds"])) + attempts
    if "ranks" in record:
        yield "ranks", str(record["ranks"])


def _inputs(record: dict[str, Any]) -> Iterator[tuple[str, str]]:
    for key in _FINGERPRINTED:
        if key in record.get("names", {}):
            yield key, str(record["names"][key])
        if record["inputs"].get(key):
            yield f"{key}, fingerprint", _shown(record["inputs"][key])
    if "mesh" in record:
        yield "mesh, fingerprint", str(record["mesh"])


def _effort(record: dict[str, Any]) -> Iterator[tuple[str, str]]:
    for key in ("trajectories", "evaluations"):
        for level, count in record.get(key, {}).items():
            yield f"{key}, {'level ' if str(level).isdecimal() else ''}{level}", _shown(count)
    if "search_seconds" in record:
        yield "search", duration(float(record["search_seconds"]))


def _flat(content: Any, name: str = "") -> Iterator[tuple[str, str]]:
    if isinstance(content, dict) and content:
        for key, value in content.items():
            yield from _flat(value, f"{name}.{key}" if name else str(key))
    elif content is not None and content != {} and content != []:
        yield name, _shown(content)


def _shown(value: Any) -> str:
    if isinstance(value, list):
        value = ", ".join(map(str, value))
    if isinstance(value, bool):
        value = "yes" if value else "no"
    text = f"{value:g}" if isinstance(value, float) else str(value)
    return text if len(text) <= _LONGEST else f"{text[:_LONGEST]} ..."
