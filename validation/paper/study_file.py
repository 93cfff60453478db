"""A study file: what is varied, how often each is tried, which tables are made of it, and what the paper says.

format = "bcid-study/1"
name = "noise"
title = "Noise and registration"
section = "5.2.2, Table 3"
scene = "../../examples/scenes/slab_paper.toml"
trials = 100
about = "..."                   # what is done here
in_paper = "..."                # what the paper did
chosen = "..."                  # where the paper leaves something open: what was taken
adds = "..."                    # what is told beyond the paper
code = ["bcid/search/hill_climbing.py"] # where it is done

[setting]                       # what all trials have in common: attributes of `Condition`
motion = "semicircle"
[vary]                          # every combination of these is a cell of the table
noise = ["0 mm", "1 mm"]
[table]                         # which of them are rows and columns, and what is told besides: "rms", "stages"
rows = "registration"
columns = "noise"
also = ["rms"]
[quick]                         # instead, with --quick
trials = 5
vary = { noise = ["1 mm"] }
[[paper]]                       # what the paper says
says = "100 % success"
[[paper]]
where = { noise = "1 mm" }      # of these trials
right = 1.0                     # its number, to stand beside ours
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

from bcid.base.errors import InputError, Problems, nearest
from bcid.base.text_file import read_toml
from bcid.forms.model import check_physics
from bcid.scene import Scene
from validation.paper.condition import NAMES, Condition, parsed

FORMAT = "bcid-study/1"
# Values of one attribute: each is a row or a column of a table.
_MOST_VALUES = 1000
_TEXTS = ("about", "in_paper", "chosen", "adds")
_KEYS = (
    "format",
    "name",
    "title",
    "section",
    "scene",
    "trials",
    "setting",
    "vary",
    "table",
    "quick",
    "paper",
    "code",
    *_TEXTS,
)
ALSO = ("rms", "stages")


def _numbers(count: int | None = None) -> Callable[[object], bool]:
    return lambda v: isinstance(v, list) and all(type(n) in (int, float) for n in v) and count in (None, len(v))


def _part(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and 0 <= value <= 1


def _sets(value: object) -> bool:
    return isinstance(value, list) and all(isinstance(s, list) and all(isinstance(n, str) for n in s) for s in value)


# What the paper says that can stand beside ours, what is right for each, and an example.
PAPER: dict[str, tuple[Callable[[object], bool], str]] = {
    "right": (_part, "a part from 0 to 1"),
    "wrong": (_sets, 'a list of sets as [["1", "5"], ["1", "8"]]'),
    "calls": (_numbers(), "a list of numbers as [165, 94, 0.9]"),
    "seconds": (_numbers(3), "mean, least and most as [84.28, 55.89, 2658]"),
    "more_right_than": (lambda v: type(v) is int, "a whole number, of 18"),
}


@dataclass(frozen=True)
class Trial:
    """A trial of a study: its cell, and its number in it."""

    cell: int
    number: int
    condition: Condition

    @property
    def name(self) -> str:
        """Of its file."""
        return f"{self.cell:03d}-{self.number:04d}"


@dataclass(frozen=True)
class StudyFile:
    """What a study file says.

    Attributes:
        setting: the condition that all trials start from.
        vary: values by attribute of `Condition`; every combination is a cell.
        rows, columns: attributes whose values head rows and columns of the table; the others make a table each.
        also: what the tables tell besides how many are right: "rms", "stages".
        trials: in each cell.
        about, in_paper, chosen, adds: what is done here, what the paper did, what was taken where it leaves something open, and
            what is told beyond it.
        code: files in which it is done.
        paper: what the paper says: `says`, a text, or `where` and one of `PAPER`, in its own words (`reads`) where these are no
            number.
    """

    name: str
    title: str
    section: str
    about: str
    in_paper: str
    chosen: str
    adds: str
    code: tuple[str, ...]
    scene: Path
    setting: Condition
    vary: Mapping[str, tuple[Any, ...]]
    rows: str
    columns: str
    also: tuple[str, ...]
    trials: int
    paper: tuple[Mapping[str, Any], ...]
    source: Path

    @classmethod
    def read(cls, path: Path, quick: bool = False) -> StudyFile:
        """Read and check a study file.

        Args:
            path: the TOML file; the scene's path is relative to it.
            quick: the reduced study.

        Raises:
            InputError: with every problem of the file.
        """
        content = read_toml(path)
        reader = _Reader(path)
        study = reader.study(content)
        study = reader.reduced(study, content.get("quick")) if quick else study
        reader.problems.raise_if_any()
        study.check()
        return study

    def cells(self) -> list[Condition]:
        """The condition of each cell."""
        return [
            replace(self.setting, **dict(zip(self.vary, values, strict=True)))
            for values in product(*self.vary.values())
        ]

    def all_trials(self) -> list[Trial]:
        """Every trial."""
        return [Trial(i, k, condition) for i, condition in enumerate(self.cells()) for k in range(self.trials)]

    def check(self) -> None:
        """Refuse conditions that the scene cannot serve."""
        scene = Scene.read(self.scene, physics=check_physics)
        problems = Problems(f"study {self.source}")
        for condition in self.cells():
            patches = {patch for item in condition.anchors for patch in item}
            unknown = sorted(patches - set(scene.patches))
            if unknown:
                problems.add(self.source, f"anchors: patch '{unknown[0]}': {nearest(unknown[0], scene.patches)}")
            if condition.grasp not in scene.grasps:
                problems.add(self.source, f"grasp '{condition.grasp}': {nearest(condition.grasp, scene.grasps)}")
            for name in ("finest", "compared"):
                if getattr(condition, name) >= len(scene.levels):
                    told = f"{name} = {getattr(condition, name)}: the scene has levels 0 to {len(scene.levels) - 1}"
                    problems.add(self.source, told)
            try:
                condition.truth(scene)
            except InputError as error:
                problems.add(self.source, str(error))
            if problems.found:
                break
        problems.raise_if_any()


class _Reader:
    """Collects the problems of a study file."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.problems = Problems(f"study {path}")

    def bad(self, key: str, text: str) -> None:
        self.problems.add(self.path, f"{key}: {text}")

    def study(self, content: Mapping[str, Any]) -> StudyFile:
        self.unknown(content, _KEYS, "")
        if content.get("format") != FORMAT:
            self.bad("format", f"expected '{FORMAT}', found {content.get('format')!r}")
        texts = {key: self.text(content, key) for key in ("name", "title", "section")}
        name, scene = texts["name"], self.text(content, "scene")
        if name and not all(c.isalnum() or c in "-_" for c in name):
            self.bad("name", f"'{name}': letters, digits, - and _ only; a folder is named after it")
        setting = {
            key: self.value(f"setting.{key}", key, v) for key, v in self.table(content, "setting", NAMES).items()
        }
        table = self.table(content, "table", ("rows", "columns", "also"))
        vary = self.varied(content)
        for key in ("rows", "columns"):
            if table.get(key, "") not in (*vary, ""):
                self.bad(f"table.{key}", f"{table[key]!r} is not varied; varied are {', '.join(vary) or 'none'}")
        good = {key: value for key, value in setting.items() if value is not None}
        return StudyFile(
            **texts,
            scene=self.path.parent / scene,
            **{key: self.text(content, key, optional=True) for key in _TEXTS},
            code=self.names(content.get("code", []), "code"),
            setting=replace(Condition(), **good),
            vary=vary,
            rows=str(table.get("rows", "")),
            columns=str(table.get("columns", "")),
            also=self.names(table.get("also", []), "table.also", ALSO),
            trials=self.count(content, "trials"),
            paper=self.paper(content.get("paper", [])),
            source=self.path,
        )

    def reduced(self, study: StudyFile, quick: object) -> StudyFile:
        """The study with what its table [quick] says."""
        if quick is None:
            return study
        table = self.table({"quick": quick}, "quick", ("trials", "vary"))
        trials = self.count(table, "trials", "quick.") if "trials" in table else study.trials
        vary = dict(study.vary) | self.varied(table, "quick.")
        return replace(study, trials=trials, vary={key: vary[key] for key in study.vary})

    def varied(self, content: Mapping[str, Any], where: str = "") -> dict[str, tuple[Any, ...]]:
        found = {}
        for key, values in self.table(content, "vary", NAMES, where).items():
            if not isinstance(values, list) or not values:
                self.bad(f"{where}vary.{key}", f"expected a list of values, found {values!r}")
                continue
            if len(values) > _MOST_VALUES:
                self.bad(f"{where}vary.{key}", f"expected at most {_MOST_VALUES} values, found {len(values)}")
                continue
            found[key] = tuple(self.value(f"{where}vary.{key}", key, value) for value in values)
        return found

    def paper(self, entries: object) -> tuple[Mapping[str, Any], ...]:
        if not isinstance(entries, list) or not all(isinstance(entry, dict) for entry in entries):
            self.bad("paper", "expected [[paper]] tables")
            return ()
        found = []
        for entry in entries:
            self.unknown(entry, ("says", "here", "reads", "where", *PAPER), "paper.")
            for key, (good, expected) in PAPER.items():
                if key in entry and not good(entry[key]):
                    self.bad(f"paper.{key}", f"expected {expected}, found {entry[key]!r}")
            where = entry.get("where", {})
            if not isinstance(where, dict):
                self.bad("paper.where", f'expected a table as {{ noise = "1 mm" }}, found {where!r}')
                continue
            self.unknown(where, NAMES, "paper.where.")
            known = {k: self.value(f"paper.where.{k}", k, v) for k, v in where.items() if k in NAMES}
            found.append({**entry, "where": known})
        return tuple(found)

    def names(self, value: object, key: str, allowed: tuple[str, ...] = ()) -> tuple[str, ...]:
        if not isinstance(value, list) or not all(isinstance(name, str) for name in value):
            self.bad(key, f"expected a list of texts, found {value!r}")
            return ()
        for name in value:
            if allowed and name not in allowed:
                self.bad(key, f"{name!r}: {nearest(name, allowed)}")
        return tuple(value)

    def value(self, where: str, name: str, value: object) -> Any:
        try:
            return parsed(name, value)
        except InputError as error:
            self.bad(where, str(error))
            return None

    def table(self, content: Mapping[str, Any], key: str, allowed: tuple[str, ...], where: str = "") -> dict[str, Any]:
        value = content.get(key, {})
        if not isinstance(value, dict):
            self.bad(where + key, f"expected a table, found {value!r}")
            return {}
        self.unknown(value, allowed, f"{where}{key}.")
        return {name: entry for name, entry in value.items() if name in allowed}

    def unknown(self, content: Mapping[str, Any], allowed: tuple[str, ...], where: str) -> None:
        self.problems.add_unknown(self.path, content, allowed, f"{where}{{}}: is not known; {{}}".format)

    def text(self, content: Mapping[str, Any], key: str, optional: bool = False) -> str:
        value = content.get(key, "" if optional else None)
        if isinstance(value, str) and (value or optional):
            return value
        self.bad(key, "is missing" if value is None else f"expected a text, found {value!r}")
        return ""

    def count(self, content: Mapping[str, Any], key: str, where: str = "") -> int:
        value = content.get(key)
        if type(value) is int and value > 0:
            return value
        self.bad(where + key, "is missing" if value is None else f"expected a positive whole number, found {value!r}")
        return 1
