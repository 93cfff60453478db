"""The report: one file that opens from disk, with the runs one after the other."""

from __future__ import annotations

import base64
import hashlib
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from bcid.base.errors import InputError
from bcid.base.run_folder import write_whole
from bcid.base.version import VERSION
from bcid.report.figure import COLOURS
from bcid.report.found import Found
from bcid.report.section import Section
from bcid.report.text import clean

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
    opened: list[Section | dict[str, str]] = []
    for number, path in enumerate(runs, start=1):
        try:
            section = Section(Found.read(path), f"run-{number}")
        except InputError as error:
            unread = {
                "id": f"run-{number}",
                "name": Path(path).name,
                "reason": str(error),
                "sentence": "cannot be read",
            }
            opened.append(unread)
            report.troubles[Path(path)] = [str(error)]
            continue
        opened.append(section)
        report.shown.append(section.found.path)
        if section.troubles:
            report.troubles[section.found.path] = section.troubles
    if not report.shown:
        raise InputError("\n".join(text for texts in report.troubles.values() for text in texts))
    write_whole(target, _document(opened))
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


def _document(runs: Sequence[Section | dict[str, str]]) -> str:
    """The whole page. Its templates escape whatever is put into them; what a page cannot hold at all is taken out before."""
    viewed = any(isinstance(run, Section) and run.view for run in runs)
    style, scripts = _web("page.css"), [_three(), _web("viewer.js")] if viewed else []
    templates = Environment(
        loader=PackageLoader("bcid.report", "web"),
        autoescape=True,
        undefined=StrictUndefined,
        finalize=lambda value: clean(value) if type(value) is str else value,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    templates.policies["json.dumps_kwargs"] = {"allow_nan": False, "separators": (",", ":")}
    templates.filters["sha256"] = lambda text: base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
    own = {"mark": Markup(MARK), "style": Markup(style), "scripts": [Markup(script) for script in scripts]}
    return templates.get_template("page.html").render(runs=runs, version=VERSION, colours=COLOURS, **own)


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
