"""F8: explanations that are killed after any of their steps, and go on, on any number of ranks."""

from __future__ import annotations

import json
import math
import random
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from bcid.base.run_folder import RunFolder
from validation.reliability import Reached
from validation.reliability.inputs import small_scene
from validation.reliability.signals import started

_LONG = 300.0
# What is left of a state that was computed again is found from there anew, to the last digits only.
_ROUNDING = 1e-6
# Ends a command by SIGKILL on rank 0, once it has kept so many results.
_KILLED = """
import os, signal, sys
from bcid.app import cli
from bcid.predict.store import PredictionStore
keep = PredictionStore._keep
def killed(self, *arguments):
    keep(self, *arguments)
    if self.computed == int(sys.argv[1]):
        os.kill(os.getpid(), signal.SIGKILL)
PredictionStore._keep = killed
sys.exit(cli.main(sys.argv[2:]))
"""


def prepared(folder: Path) -> list[str]:
    """A scene and a measurement of a heavy body, in a folder; the words of their explanation, but for its output."""
    scene, seen = str(small_scene(folder)), str(folder / "seen")
    words = [sys.executable, "-m", "bcid", "simulate", scene, "--anchors", "3,4", "--motion", "pull", "--level", "1"]
    words += ["--true-effect", "gravity: weight = 3 kN/m^3", "--noise", "0.1 mm", "--quiet", "-o", seen]
    subprocess.run(words, check=True, capture_output=True)
    return ["explain", scene, seen, "--only", "gravity,fibres", "--no-picture", "--no-propose", "-o"]


def explained(words: Sequence[str], output: Path, ranks: int = 1) -> str:
    """Run an explanation to its end; what it said on the way."""
    job = started([sys.executable, "-m", "bcid", *words, str(output)], ranks)
    _, said = job.communicate(timeout=_LONG)
    if job.returncode != 0:
        raise RuntimeError(f"exit code {job.returncode}: {said[-300:]!r}")
    return said


def killed(words: Sequence[str], output: Path, after: int, ranks: int = 1) -> None:
    """Run it until so many more results are kept."""
    job = started([sys.executable, "-c", _KILLED, str(after), *words, str(output)], ranks)
    _, said = job.communicate(timeout=_LONG)
    if ranks == 1 and job.returncode != -signal.SIGKILL:
        raise RuntimeError(f"was not killed: exit code {job.returncode}, {said[-300:]!r}")


def answer(output: Path) -> dict[str, Any]:
    """What a run has found: everything but when it was found."""
    found = RunFolder.open(output).read_documents()
    return {name: found[name].to_dict() if name.endswith(".nc") else found[name] for name in found}


def steps(output: Path) -> dict[str, int]:
    """How many expensive steps its last attempt computed, and how many it recalled."""
    record: dict[str, Any] = json.loads((output / "run.json").read_text(encoding="utf-8"))
    return record["steps"]


def resumed(count: int = 8, seed: int = 0, ranks: Iterable[int] = (1, 2)) -> Reached:
    """F8: `count` explanations on each number of ranks, each killed twice at random steps, then continued to the end."""
    rng, misses, sizes = random.Random(seed), list[str](), list(ranks)
    spared = 0
    with tempfile.TemporaryDirectory(prefix="bcid-") as name:
        folder = Path(name)
        words = prepared(folder)
        explained(words, folder / "right")
        right, whole = answer(folder / "right"), steps(folder / "right")["computed"]
        for number in range(count):
            output, first, second = folder / str(number), rng.randrange(1, whole // 2), rng.randrange(1, whole // 2)
            for after in (first, second):
                killed(words, output, after, rng.choice(sizes))
            explained(words, output, rng.choice(sizes))
            done = steps(output)
            spared += done["recalled"]
            where = f"killed after {first} and {second} more of {whole} steps"
            if done != {"computed": whole - first - second, "recalled": first + second}:
                misses.append(f"{where}: {done}")
            if not same(answer(output), right):
                misses.append(f"{where}: goes on to another answer")
            if (output / "checkpoint").exists():
                misses.append(f"{where}: the checkpoint is left")
    text = f"{count} runs of {whole} steps, each killed twice; {spared} of all steps were not computed again"
    goal = "no step is computed twice, and the answer is the same"
    return Reached(goal, text, not misses, tuple(misses))


def same(one: Any, other: Any) -> bool:
    """Whether two answers are the same: texts as they are, numbers to rounding."""
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(same(one[key], other[key]) for key in one)
    if isinstance(one, list | tuple):
        return len(one) == len(other) and all(map(same, one, other))
    if isinstance(one, float) and isinstance(other, float):
        return math.isclose(one, other, rel_tol=_ROUNDING, abs_tol=_ROUNDING) or (one != one and other != other)
    return bool(one == other)
