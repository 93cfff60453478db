"""B5: text that no hand has written, in every file that bcid reads: exit code 2, one message, under 2 s, on any number of ranks."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from bcid import Measurement, Scene
from bcid.base.run_folder import RunFolder, unsealed
from bcid.vision.camera import Cameras
from bcid.vision.corners import read_corners
from validation.paper.study_file import StudyFile
from validation.reliability import ROOT, Reached
from validation.reliability.folders import finished
from validation.reliability.inputs import reader, refusal, small_scene, write_inputs

SECONDS = 2.0
_MANY = 100_000
# What stands in the place of a value, or of the whole text where it begins with a line break: TOML.
TOML: dict[str, str] = {
    "5,000 digits": "1" * 5000,
    "minus 400 digits": "-1" + "0" * 399,
    "5,000 hexadecimal digits": "0x" + "f" * 5000,
    "100,000 brackets": "[" * _MANY,
    "100,000 closed brackets": "[" * _MANY + "]" * _MANY,
    "100,000 tables within each other": "{ a = " * _MANY + "1" + " }" * _MANY,
    "1e200": "1e200",
    "1e200 in a list": "[1e200, 1e200, 1e200]",
    "1e200 mm": '"1e200 mm"',
    "1e200 mm, three times": '"1e200 1e200 1e200 mm"',
    "1e-200 mm": '"1e-200 mm"',
    "100,000 digits in text": '"' + "1" * _MANY + '.."',
    "100,000 spaces in text": '"1' + " " * _MANY + '-"',
    "a text of 1 MB": '"' + "x" * 1_000_000 + '"',
    "a text of 0.4 MB": '"' + "x" * 400_000 + '"',
    "a unit of 100,000 factors": '"' + "m/" * _MANY + 'm"',
    "a unit to the power of 999": '"kN^999"',
    "1e6 quotes": '"' * 1_000_000,
    "400,000 quotes": "'" * 400_000,
    "a text without an end": '"""' + '\\"""' * _MANY,
    "a list of 200,000": "[" + "1," * 200_000 + "]",
    "100,000 lines of text": '"""' + "\n" * _MANY + '"""',
    "a key of 100,000 parts": "\n" + "a." * _MANY + "b = 1\n",
    "a key of 100,000 quoted parts": "\n" + '"a".' * _MANY + "b = 1\n",
    "a header of 100,000 parts": "\n[" + "a." * _MANY + "b]\n",
    "100,000 keys": "\n" + "".join(f"k{i} = 1\n" for i in range(_MANY)),
    "40,000 keys": "\n" + "".join(f"k{i} = 1\n" for i in range(40_000)),
    "40,000 tables": "\n" + "".join(f"[k{i}]\n" for i in range(40_000)),
    "a key of 0.4 MB": '\n"' + "k." * 200_000 + '" = 1\n',
    "nothing but spaces": "\n" + " " * 400_000,
}
# The same for JSON.
JSON: dict[str, str] = {
    "5,000 digits": "1" * 5000,
    "minus 400 digits": "-1" + "0" * 399,
    "100,000 brackets": "[" * _MANY,
    "100,000 closed brackets": "[" * _MANY + "]" * _MANY,
    "100,000 tables within each other": '{"a":' * _MANY + "1" + "}" * _MANY,
    "1e200": "1e200",
    "a text of 1 MB": '"' + "x" * 1_000_000 + '"',
    "a text without an end": '"' + '\\"' * _MANY,
    "1e6 quotes": '"' * 1_000_000,
}
# Whole tables, by how they are made of the sound one.
TABLES: dict[str, Callable[[str, str], str]] = {
    "100,000 columns": lambda text, comma: (
        comma.join(f"c{i}" for i in range(_MANY)) + "\n" + comma.join("1" * _MANY) + "\n"
    ),
    "100,000 columns more": lambda text, comma: text.replace(
        "\n", comma + comma.join(f"c{i}" for i in range(_MANY)) + "\n", 1
    ),
    "100,000 columns of one name": lambda text, comma: comma.join(["x"] * _MANY) + "\n",
    "a row of a million cells": lambda text, comma: text + comma.join("1" * 1_000_000) + "\n",
    "a cell of 10 MB": lambda text, comma: text + "1" * 10_000_000 + "\n",
    "a quoted cell without an end": lambda text, comma: text + '"' + "1,2\n" * _MANY,
    "line breaks in a cell": lambda text, comma: text + '"' + "\n" * _MANY + '1"\n',
    "100,000 rows too short": lambda text, comma: text + "1\n" * _MANY,
    "5,000 digits": lambda text, comma: _last_row(text, comma, "1" * 5000),
    "NUL characters": lambda text, comma: text + "\0" * _MANY,
}
# Rows of a table of fiducials.
NAMES = {
    "100,000 fiducials": "1,0,0,f{i},1,2,3",
    "100,000 fiducials, each in a step of its own": "1,{i},{i},f{i},1,2,3",
    "100,000 actions": "a{i},0,0,f,1,2,3",
}
# By file: the key whose value is replaced. Others than these take any text.
KEYS = {
    "scene.toml": ("format", "noise_sigma", "down", "length_unit", "young", "poisson", "I", "weight", "displacement"),
    "seen/measurement.toml": ("format", "length_unit", "noise_sigma"),
    "seen/frame.toml": ("format", "centre"),
    "wide.toml": ("format", "length_unit", "noise_sigma", "first", "a"),
    "recording.toml": ("format", "rate", "diameter", "first", "length_unit"),
}
_CAMERAS = """length_unit = "mm"
K1 = [[900, 0, 320], [0, 900, 240], [0, 0, 1]]
D1 = [0, 0, 0, 0, 0]
K2 = [[900, 0, 320], [0, 900, 240], [0, 0, 1]]
D2 = [0, 0, 0, 0, 0]
R = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]
T = [-100, 0, 0]
"""
_STUDY = """format = "bcid-study/1"
name = "noise"
title = "Noise"
section = "5"
scene = "scene.toml"
trials = 3
[vary]
noise = ["0 mm", "1 mm"]
"""
_CORNERS = "pair,corner,x_mm,y_mm,u1,v1,u2,v2\n" + "".join(f"0,{i},{i},0,1,2,3,4\n" for i in range(8))


def _last_row(text: str, comma: str, cell: str) -> str:
    *lines, last = text.rstrip("\n").split("\n")
    return "\n".join([*lines, comma.join([cell] * (last.count(comma) + 1))]) + "\n"


def cases(files: dict[str, str]) -> Iterator[tuple[str, str, str]]:
    """File, what is absurd in it, and its text."""
    keys = dict(KEYS) | {"cameras.toml": ("length_unit", "K1", "T"), "study.toml": ("format", "trials", "noise")}
    for file, names in keys.items():
        for what, value in TOML.items():
            if value.startswith("\n"):
                yield file, what, value
                continue
            for name in names:
                line = re.compile(rf"(?m)^{re.escape(name)} = .*$")
                assert line.search(files[file]), (file, name)
                yield file, f"{name}: {what}", line.sub(lambda _, n=name, v=value: f"{n} = {v}", files[file], count=1)
    for what, value in JSON.items():
        yield "cameras.json", f"matrix: {what}", files["cameras.json"].replace("900", value, 1)
        yield "run/run.json", what, files["run/run.json"].replace('"seconds": 0.0', f'"seconds": {value}', 1)
        yield "run/run.json", f"instead: {what}", value
        yield "sealed.json", what, f'{{"checksum": "", "a": {value}}}'
    for file in ("seen/fiducials.csv", "seen/grasps.csv", "seen/wrench.csv", "wide.csv", "long.csv", "corners.csv"):
        for what, made in TABLES.items():
            yield file, what, made(files[file], ";" if file == "wide.csv" else ",")
    head = files["seen/fiducials.csv"].partition("\n")[0]
    for what, row in NAMES.items():
        rows = "".join(row.format(i=i) + ("," * 3 if "sigma" in head else "") + "\n" for i in range(_MANY))
        yield "seen/fiducials.csv", what, f"{head}\n{rows}"


def write_all(folder: Path) -> dict[str, str]:
    """Write a sound file for every reader; returns their texts."""
    files = write_inputs(folder)
    files |= {"cameras.toml": _CAMERAS, "study.toml": _STUDY, "corners.csv": _CORNERS, "sealed.json": "{}"}
    for name in ("cameras.toml", "study.toml", "corners.csv", "sealed.json"):
        (folder / name).write_text(files[name], encoding="utf-8")
    finished(folder / "run")
    record = json.loads((folder / "run/run.json").read_text(encoding="utf-8")) | {"seconds": 0.0}
    files["run/run.json"] = json.dumps(record)
    return files


def _reader(folder: Path, file: str) -> Callable[[], Any]:
    readers: dict[str, Callable[[], Any]] = {
        "cameras.toml": lambda: Cameras.read(folder / "cameras.toml"),
        "study.toml": lambda: StudyFile.read(folder / "study.toml"),
        "corners.csv": lambda: read_corners(folder / "corners.csv"),
        "run/run.json": lambda: RunFolder.open(folder / "run"),
        "sealed.json": lambda: unsealed(folder / "sealed.json", "remove it"),
    }
    if file.startswith("seen/"):
        scene = Scene.read(folder / "scene.toml")
        return lambda: Measurement.read(folder / "seen").check(scene)
    return readers.get(file) or reader(folder, file)


def judge(file: str, said: str | None, seconds: float, most: float) -> str:
    """What is wrong with an answer; "" if nothing is."""
    if seconds > most:
        return f"took {seconds:.1f} s"
    if said is None:
        return "accepted"
    others = {"wide.csv": "wide.toml", "long.csv": "long.toml"}
    if not any(name in said for name in (Path(file).name, others.get(file, "nothing"), "seen")):
        return f"the file is not named: {said[:200]}"
    return "" if 20 < len(said) < 20_000 and len(said.splitlines()) < 70 else f"unreadable: {len(said)} characters"


def absurd(
    count: int = 0, seed: int = 0, ranks: Sequence[int] = (1, 2), commands: int = 0, seconds: float = SECONDS
) -> Reached:
    """B5: every reader with every kind, or `count` of the cases, each in `seconds` of CPU; `commands` kinds (0: all) on `ranks`."""
    misses: list[str] = []
    slowest = 0.0
    with tempfile.TemporaryDirectory(prefix="bcid-") as name:
        folder = Path(name)
        files = write_all(folder)
        every = list(cases(files))
        if count:
            every = [every[i] for i in sorted(np.random.default_rng(seed).choice(len(every), count, replace=False))]
        for file, what, text in every:
            (folder / file).write_text(text, encoding="utf-8")
            begun = time.process_time()
            try:
                with np.errstate(all="raise"):
                    said = refusal(_reader(folder, file))
                wrong = judge(file, said, time.process_time() - begun, seconds)
            except Exception as error:
                wrong = f"{type(error).__name__}: {str(error)[:200]}"
            slowest = max(slowest, time.process_time() - begun)
            if wrong:
                misses.append(f"{file}, {what}: {wrong}")
            (folder / file).write_text(files[file], encoding="utf-8")
        tried = _commands(folder, ranks, commands, misses)
    text = f"{len(every)} texts, at most {slowest:.2f} s; {tried} commands on {' and '.join(map(str, ranks))} ranks"
    goal = "every reader with every kind of absurd text: exit code 2, one message, under 2 s, on any number of ranks"
    return Reached(goal, text, not misses, tuple(misses))


def _commands(folder: Path, ranks: Sequence[int], count: int, misses: list[str]) -> int:
    """Scenes of every kind given to a command: its exit code, its one message, and nothing written."""
    scene = small_scene(folder)
    sound = scene.read_text(encoding="utf-8")
    tried = 0
    for what, value in list(TOML.items())[: count or None]:
        line = re.compile(r"(?m)^noise_sigma = .*$")
        text = value if value.startswith("\n") else line.sub(lambda _, v=value: f"noise_sigma = {v}", sound, count=1)
        scene.write_text(text, encoding="utf-8")
        for number in ranks:
            tried += 1
            words = [sys.executable, "-m", "bcid", "identify", str(scene), str(folder / "seen")]
            words = ["mpirun", "-n", str(number), *words] if number > 1 else words
            done = subprocess.run(
                [*words, "--quiet", "-o", str(folder / "out")],
                capture_output=True,
                text=True,
                check=False,
                env=os.environ | {"PYTHONPATH": str(ROOT)},
            )
            if done.returncode != 2 or "Traceback" in done.stderr or done.stderr.count("bcid: ") != 1:
                misses.append(f"scene, {what}, {number} ranks: exit code {done.returncode}, {done.stderr[-300:]!r}")
            if (folder / "out").exists():
                misses.append(f"scene, {what}, {number} ranks: something was written")
    return tried
