"""The command of the benchmark, for tests of its reduced form."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def bench(*arguments: object, cwd: Path, **variables: str) -> subprocess.CompletedProcess[str]:
    environment = os.environ | {"PYTHONPATH": str(ROOT), "BCID_PROJECT": str(ROOT)} | variables
    command = [sys.executable, "-m", "validation", "bench", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, cwd=cwd, env=environment, timeout=590, check=False)


def quick(*parts: str, cwd: Path) -> tuple[dict, str]:
    """What the reduced form of some parts writes and prints."""
    done = bench(*parts, "--quick", "-o", "out", cwd=cwd)
    assert done.returncode == 0, done.stderr
    return json.loads((cwd / "out/bench.json").read_text(encoding="utf-8")), done.stdout


def met(result: dict, part: str, words: str) -> bool:
    """Whether the one goal of a part that has these words is met."""
    (goal,) = (goal for goal in result["parts"][part]["goals"] if words in goal["what"])
    return bool(goal["met"])
