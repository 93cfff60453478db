"""B2: bad scenes, measurements, mappings, errors of the frame and recordings, written by hand and generated."""

from __future__ import annotations

import re
import tempfile
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from validation.reliability import Reached
from validation.reliability.inputs import reader, refusal, write_inputs

# What no key takes that wants a number, a quantity, a length, a text, a whole number, a direction, numbers or a table.
_NO_LENGTH = (
    "0.3",
    "true",
    '"nan mm"',
    '"-1 mm"',
    '"0 mm"',
    '"1e400 mm"',
    '"3 s"',
    '""',
    "[]",
    '"3 mm mm"',
    '"inf mm"',
)
_NO_NUMBER = ("true", "nan", "inf", "-inf", "-1.0", '"three"', "[1]", "{}")
_NO_TEXT = ("3", "true", "[]", "nan", "{}")
_NO_COUNT = ("true", "1.5", "-1", '"4"', "nan", "[]")
_NO_DIRECTION = ("[0, 0, 0]", "[nan, 1, 0]", "[true, 0, 0]", "[0, 1]", '"down"', "[inf, 0, 0]", "1")
_NO_UNIT = ('"furlong"', "3", '"s s"', '""', "true", '"mm^"')
_NO_PLACES = ("3", "[]", "[1, 2]", "{}", '{ box = ["0 0 0 mm"] }', "{ plane = 3 }", "true", '{ on = "x", in = "y" }')
_NO_GRASP = (
    "3",
    '"grasp_I"',
    '{ on = "grasp_I" }',
    '{ on = "grasp_I", centre = [1, 2, 3] }',
    '{ on = "a", centre = "1 2 mm" }',
)
_NO_TRIPLE = ('["a", "b"]', "3", '["a", "b", 3]', "[]", '["a", "b", ""]')
_WRONG = '"bcid-other/1"'
# Keys that are names of the user's.
_FREE = ("I", "bottom", "a")
# By file, the key as it begins its line: values that must be refused.
VALUES: dict[str, dict[str, tuple[str, ...]]] = {
    "scene.toml": {
        "format": (_WRONG, "1", "true"),
        "name": _NO_TEXT,
        "description": _NO_TEXT,
        "down": _NO_DIRECTION,
        "support": ('"top"', "3", "true"),
        "noise_sigma": _NO_LENGTH,
        "attach_within": _NO_LENGTH,
        "file": ('"nothing.geo"', "3", '""', "true", '".."'),
        "length_unit": _NO_UNIT,
        "element_size": _NO_LENGTH,
        "degree": ("0", "4", "true", "1.0", '"2"', "nan"),
        "law": ('"hooke"', "3", '""'),
        "young": ("15.0", "true", '"15"', '"15 mm"', '"nan kPa"', '"-15 kPa"', '"0 kPa"', "nan", "[]"),
        "poisson": ("0.5", "0.7", "-2", "true", "nan", '"0.3 mm"', "[]"),
        '"1"': _NO_PLACES,
        "I": _NO_GRASP,
        "bottom": _NO_PLACES,
        '"16"': ("3", '"1 2 mm"', '"1 2 3"', '"1 2 nan mm"', '"1 2 3 s"', "[1, 2, 3]", "true"),
        "displacement": _NO_LENGTH,
        "force": ("2", '"2 mm"', '"-2 N"', "true", '"nan N"', '"0 N"'),
        "strain": (*_NO_NUMBER, "0"),
        "amplitudes": ("3", '["9 mm"]', "[3]", '["-1 mm"]', '["nan mm"]', "[true]"),
        "steps": (*_NO_COUNT, "1", "1000"),
        "cost": _NO_NUMBER,
        "regrasp": _NO_NUMBER,
        "directions": (
            "3",
            "{ out = [0, 0, 0] }",
            "{ out = [1, 0] }",
            '{ "a b" = [1, 0, 0] }',
            "{ out = [nan, 1, 0] }",
        ),
        "weight": ('"9.81 mm"', "true", "nan", "inf", '"nan N/m^3"', "[]", "{}"),
        "place": ('"9"', "3", "true"),
        "stiffness": ('"50 kPa"', "true", '"nan Pa/m"', "nan", "[]", '"-1 Pa/m"'),
    },
    "seen/measurement.toml": {
        "format": (_WRONG, "1"),
        "length_unit": _NO_UNIT,
        "time_unit": _NO_UNIT,
        "force_unit": _NO_UNIT,
        "noise_sigma": (*_NO_NUMBER, "0"),
    },
    "seen/frame.toml": {
        "format": (_WRONG, "1"),
        "centre": ("3", "[1, 2]", "[1, 2, nan]", '["a", 1, 2]', "[true, true, false]", '"1 2 3"', "[1, 2, inf]"),
    },
    "wide.toml": {
        "format": (_WRONG, "1"),
        "length_unit": _NO_UNIT,
        "time_unit": _NO_UNIT,
        "force_unit": _NO_UNIT,
        "file": ('"nothing.csv"', "3", "true", '""', '"."'),
        "delimiter": ('""', '";;"', "3", "true"),
        "grasp": _NO_TEXT,
        "description": _NO_TEXT,
        "noise_sigma": (*_NO_NUMBER, "0"),
        "first": _NO_COUNT,
        "last": _NO_COUNT,
        "every": (*_NO_COUNT, "0"),
        "time": ('"nothing"', "3", "true", "[]", '""', '["t"]'),
        "action": ('"nothing"', "3", "true", "[]", '""', '["trial"]'),
        "translation": _NO_TRIPLE,
        "a": _NO_TRIPLE,
    },
    "long.toml": {
        "action": _NO_TEXT,
        "step": ('"nothing"', "3", "true", "[]", '"label"'),
        "fiducial": ('"nothing"', "3", "true", "[]"),
        "position": (*_NO_TRIPLE, '["x", "y", "label"]'),
        "a": ("3", '"C"', "[]", "true"),
    },
    "recording.toml": {
        "format": (_WRONG, "1"),
        "cameras": ('"nothing.json"', "3", "true", '""', '"."'),
        "left": ("3", "true", "[]"),
        "grasps": ('"nothing.csv"', "3", "true", '""', '"."'),
        "rate": (*_NO_NUMBER, "0"),
        "length_unit": _NO_UNIT,
        "distance": _NO_LENGTH,
        "diameter": _NO_LENGTH,
        "colour": ('"green"', "3", "true", "[]"),
        "first": _NO_COUNT,
        "every": (*_NO_COUNT, "0"),
        "sigma": ("0.3", "true", '"nan mm"', '"-1 mm"', '"3 s"', "[]"),
        "scale": ("1", '"yes"', "nan"),
        '"1"': ("[1]", "[nan, 1]", '"a"', "3", "[true, false]", "[1, 2, 3]", "{}"),
    },
}
# By file and column: cells that must be refused, written into the last row.
CELLS: dict[str, dict[str, tuple[str, ...]]] = {
    "seen/fiducials.csv": {
        "step": ("-1", "1.5", "nan", "", "true", "1e3", "9999999999", "١"),
        "time": ("nan", "", "inf", "x", "1_0", "0x1", "true", "-1e400"),
        "fiducial": ("", "1"),
        "x": ("nan", "inf", "x", "1_0", "1;5", "true", "1e400"),
        "action": ("", "a/b", "../1", "\x07", "a" * 65),
    },
    "seen/grasps.csv": {
        "x": ("nan", "inf", "", "x", "true"),
        "qw": ("0", "2", "nan", "", "true"),
        "grasp": ("", "III"),
        "step": ("7", "-1", "0"),
    },
    "seen/wrench.csv": {"fx": ("nan", "inf", "x"), "step": ("-1", "x", "0")},
    "seen/loads.csv": {"fy": ("nan", "inf", "", "x"), "place": ("", "a\x07b")},
    "wide.csv": {"t": ("nan", "x", "inf", ""), "ax": ("x", "inf", "1e400"), "gx": ("nan", "", "inf", "x")},
    "long.csv": {"frame": ("-1", "1.5", "nan", "", "x", "1e400"), "x": ("x", "inf"), "label": ("A",)},
}
# By file: a part of the text, what stands there instead, and what must be named.
PARTS: dict[str, tuple[tuple[str, str, str], ...]] = {
    "wide.toml": (
        ("b = [10, 0, 0]", "b = [10, nan, 0]", "align.b"),
        ("b = [10, 0, 0]", "b = [10, true, 0]", "align.b"),
    ),
    "seen/frame.toml": (
        ("0.0001", "true", "covariance"),
        ("0.0001", "nan", "covariance"),
        ("0.0001", "-0.0001", "covariance"),
        ("0.0001, 0.0", "0.0001, 0.1", "covariance"),
    ),
    "cameras.json": (
        ("900", "true", "matrix"),
        ("900", '"900"', "matrix"),
        ("900", "NaN", "matrix"),
        ("900", "-900", "matrix"),
        ("-0.1", "0", "translation"),
        ("-0.1", "Infinity", "translation"),
        ("1.0", "2.0", "rotation"),
        ('"reprojection_error": 0.1', '"reprojection_error": "low"', "reprojection_error"),
        ('"reprojection_error": 0.1', '"reprojection_error": [1, 2]', "reprojection_error"),
        ('"length_unit": "m"', '"length_unit": "s"', "unit"),
    ),
}
_TOKENS = ("nan", "inf", "-1", "0", "1e400", "true", '""', "[]", "{}", "µ", "\x00", "\ufeff", "١", "1_0", "0x1")
_TOKENS += ("'", '"', "=", "[", "]", "[[a]]", "99999999999999999999", "1979-05-27", "\\", ",", ";", "#")
_TOKENS += ("-0.0", "1e-320", '"5 mm"', '"1 2 3 mm"', "../x")


def by_hand(files: dict[str, str]) -> Iterator[tuple[str, str, str]]:
    """File, its bad text, and a word that must be in the message: bad values, unknown, missing and double keys, bad cells."""
    for file, keys in VALUES.items():
        for key, values in keys.items():
            line = re.compile(rf"(?m)^{re.escape(key)} = .*$")
            assert line.search(files[file]), (file, key)
            word = key.strip('"')
            for value in values:
                yield file, line.sub(lambda _, k=key, v=value: f"{k} = {v}", files[file], count=1), word
            yield file, line.sub(lambda m: f"{m.group()}\n{m.group()}", files[file], count=1), ""
            if not key.startswith('"') and key not in _FREE:
                yield (
                    file,
                    line.sub(lambda m, k=key: m.group().replace(k, f"{k}x", 1), files[file], count=1),
                    f"{word}x",
                )
    for file, parts in PARTS.items():
        for old, instead, word in parts:
            assert old in files[file], (file, old)
            yield file, files[file].replace(old, instead, 1), word
    for file, columns in CELLS.items():
        lines = files[file].splitlines()
        separator = ";" if file == "wide.csv" else ","
        names = lines[0].split(separator)
        for column, cells in columns.items():
            for cell in cells:
                row = lines[-1].split(separator)
                row[names.index(column)] = cell
                yield file, "\n".join([*lines[:-1], separator.join(row)]) + "\n", ""
            for other in (column.upper() + "x", names[1], ""):
                head = separator.join(other if name == column else name for name in names)
                if other != column:
                    yield file, "\n".join([head, *lines[1:]]) + "\n", ""


def generated(files: dict[str, str], count: int, seed: int) -> Iterator[tuple[str, str]]:
    """File and its text with a few changes of words, lines and letters; some of them are harmless."""
    rng = np.random.default_rng(seed)
    names = [name for name in files if name != "grasps.csv"]
    for number in range(count):
        name = names[number % len(names)]
        text = files[name]
        for _ in range(rng.integers(1, 4)):
            text = _changed(text, rng)
        yield name, text


def _changed(text: str, rng: np.random.Generator) -> str:
    lines = text.split("\n")
    i, j = rng.integers(len(lines), size=2)
    kind = rng.integers(8)
    token = _TOKENS[rng.integers(len(_TOKENS))]
    if kind < 3:
        parts = re.split(r"([=,;]\s*)", lines[i])
        parts[2 * rng.integers((len(parts) + 1) // 2)] = token
        lines[i] = "".join(parts)
    elif kind == 3:
        del lines[i]
    elif kind == 4:
        lines.insert(j, lines[i])
    elif kind == 5:
        lines[i], lines[j] = lines[j], lines[i]
    elif kind == 6 and lines[i]:
        at = rng.integers(len(lines[i]))
        lines[i] = lines[i][:at] + token + lines[i][at + rng.integers(3) :]
    else:
        return text[: rng.integers(len(text) + 1)]
    return "\n".join(lines)


def judge(file: str, said: str | None, word: str, must: bool) -> str:
    """What is wrong with an answer; "" if nothing is."""
    if said is None:
        return "accepted" if must else ""
    stem = Path(file).name
    others = {"wide.csv": "wide.toml", "long.csv": "long.toml", "wide.toml": "wide.csv", "long.toml": "long.csv"}
    if not any(name and name in said for name in (stem, others.get(stem), "seen")):
        return f"the file is not named: {said[:200]}"
    if word and word not in said and not re.search(r"\.csv:\d+: ", said):
        return f"'{word}' is not named: {said[:300]}"
    return "" if len(said) > 20 and len(said.splitlines()) <= 22 and len(said) < 8000 else f"unreadable: {said[:200]}"


def refusals(count: int = 20_000, seed: int = 0) -> Reached:
    """B2: each bad text is written in place of the sound one, and read."""
    misses: list[str] = []
    ends: Counter[str] = Counter()
    with tempfile.TemporaryDirectory(prefix="bcid-") as name:
        folder = Path(name)
        files = write_inputs(folder)
        hand = [(file, text, word, True) for file, text, word in by_hand(files)]
        made = ((file, text, "", False) for file, text in generated(files, count, seed))
        for number, (file, text, word, must) in enumerate([*hand, *made]):
            (folder / file).write_text(text, encoding="utf-8", errors="replace")
            try:
                said = refusal(reader(folder, file))
                wrong = judge(file, said, word, must)
                ends["accepted" if said is None else "refused"] += 1
            except Exception as error:
                wrong = f"{type(error).__name__}: {error}"
            if wrong:
                misses.append(f"case {number}, {file}, {difference(files[file], text)}: {wrong}")
            (folder / file).write_text(files[file], encoding="utf-8")
    text = f"{len(hand)} by hand and {count} generated: refused {ends['refused']}, harmless {ends['accepted']}, wrong {len(misses)}"
    goal = "300 by hand and 20,000 generated: refused in one message naming file, key or line, value and rule"
    return Reached(goal, text, not misses, tuple(misses))


def difference(good: str, bad: str) -> str:
    """The first lines of a text that are not in another."""
    known = set(good.splitlines())
    return repr([line for line in bad.splitlines() if line not in known][:2])[:160]
