"""The report: one file that opens from disk, with the runs one after the other."""

from __future__ import annotations

import base64
import hashlib
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path

from jinja2 import Environment, StrictUndefined

from bcid.base.errors import InputError
from bcid.base.run_folder import write_whole
from bcid.base.version import VERSION
from bcid.report.found import Found
from bcid.report.markup import Markup, clean, json_text, tag, verbatim
from bcid.report.section import Section

# What a report begins with: only such a file is overwritten.
MARK = "<!-- bcid-report/1 -->"
_EXPORTS = re.compile(r"export\s*\{([^{}]*)\};?\s*$")


@dataclass
class Report:
    """What was written.

    Attributes:
        path: the file.
        shown: folders of the runs that it shows.
        troubles: by folder, what could not be read or shown.
    """

    path: Path
    shown: list[Path] = field(default_factory=list)
    troubles: dict[Path, list[str]] = field(default_factory=dict)


def write_report(runs: Sequence[Path], target: Path) -> Report:
    """Write a report of run folders; what of them is damaged is named in it, and in the result.

    Raises:
        InputError: no run can be shown, or `target` is something else than a report.
        MachineError: it cannot be written.
    """
    _check_target(target)
    report = Report(target)
    opened: list[Found | tuple[Path, str]] = []
    for path in runs:
        try:
            opened.append(Found.read(path))
        except InputError as error:
            opened.append((Path(path), str(error)))
            report.troubles[Path(path)] = [str(error)]
    if not any(isinstance(one, Found) for one in opened):
        raise InputError("\n".join(text for texts in report.troubles.values() for text in texts))
    text = page(opened)
    for one in opened:
        if isinstance(one, Found):
            report.shown.append(one.path)
            if one.troubles:
                report.troubles[one.path] = one.troubles
    write_whole(target, text)
    return report


def _check_target(target: Path) -> None:
    if target.is_dir():
        raise InputError(f"{target}: is a folder; give the name of a file, as {target / 'report.html'}")
    if not target.exists():
        return
    try:
        with target.open("rb") as stream:
            begin = stream.read(len(MARK))
    except OSError as error:
        raise InputError(f"{target}: cannot be read: {error.strerror}; choose another file") from None
    if begin != MARK.encode():
        raise InputError(f"{target}: is there already and is not a report of bcid; choose another file, or remove it")


def page(runs: Sequence[Found | tuple[Path, str]]) -> str:
    """The whole page; a run that cannot be read at all is a folder and the reason."""
    single = len(runs) == 1
    sections, contents, data = [], [], []
    for number, one in enumerate(runs, start=1):
        if isinstance(one, Found):
            section = Section(one, number)
            sections.append(section.html("h1" if single else "h2"))
            contents.append({"id": section.id, "name": one.name, "sentence": section.said.sentence})
            if section.data is not None:
                data.append(verbatim("script", json_text(section.data), type="application/json", id=f"view-{number}"))
        else:
            sections.append(_unreadable(*one, number))
            contents.append({"id": f"run-{number}", "name": one[0].name, "sentence": "cannot be read"})
    # The template escapes what is not markup; what a page cannot hold at all is taken out before.
    contents = [{key: clean(value) for key, value in entry.items()} for entry in contents]
    return _document(", ".join(entry["name"] for entry in contents), [] if single else contents, sections, data)


def _unreadable(path: Path, reason: str, number: int) -> Markup:
    about = tag("p", clean(path.name), class_="about")
    return tag(
        "section",
        about,
        tag("h2", "This run cannot be read."),
        tag("p", reason, class_="doubt"),
        class_="run",
        id=f"run-{number}",
    )


def _document(title: str, contents: list[dict[str, str]], sections: list[Markup], data: list[Markup]) -> str:
    style = _web("page.css")
    scripts = [_three(), _web("viewer.js")] if data else []
    policy = "default-src 'none'; img-src data:; base-uri 'none'; form-action 'none'; "
    policy += f"style-src {_hash(style)}; script-src {' '.join(map(_hash, scripts)) or chr(39) + 'none' + chr(39)}"
    template = Environment(autoescape=True, undefined=StrictUndefined).from_string(_web("page.html"))
    return template.render(
        mark=Markup(MARK),
        policy=policy,
        version=VERSION,
        title=title,
        style=verbatim("style", style),
        contents=contents,
        sections=sections,
        data=data,
        scripts=[verbatim("script", script, type="module") for script in scripts],
    )


def _hash(content: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(content.encode()).digest()).decode()}'"


def _web(name: str) -> str:
    return resources.files("bcid.report").joinpath("web", name).read_text(encoding="utf-8")


def _three() -> str:
    """three.js as a module that leaves what it exports in the global THREE, for a page from disk cannot import files."""
    source = _web("three.module.min.js")
    found = _EXPORTS.search(source)
    if found is None:
        raise ValueError("three.module.min.js does not end with its exports")
    pairs = [(name.split(" as ") * 2)[:2] for name in found[1].split(",")]
    table = ",".join(f"{exported}:{own}" for own, exported in pairs)
    return f"{source[: found.start()]}globalThis.THREE={{{table}}};"
