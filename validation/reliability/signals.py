"""F4: Ctrl-C, SIGTERM and the death of a rank at any time, and memory limits: on one rank and on two."""

from __future__ import annotations

import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable
from pathlib import Path

from bcid.predict.store import CHECKPOINT
from validation.reliability import ROOT, Reached
from validation.reliability.inputs import small_scene

_WITHIN = 10.0
_LONG = 240.0


def prepared(folder: Path) -> list[str]:
    """A scene and a measurement in a folder; the words of an identification of them, but for its output."""
    scene = small_scene(folder)
    words = [sys.executable, "-m", "bcid", "simulate", str(scene), "--anchors", "3,4", "--motion", "complex"]
    subprocess.run([*words, "--level", "1", "--quiet", "-o", str(folder / "seen")], check=True, capture_output=True)
    words = [sys.executable, "-m", "bcid", "identify", str(scene), str(folder / "seen"), "--exhaustive", "yes"]
    return [*words, "--quiet", "--no-picture", "-o"]


def started(words: list[str], ranks: int) -> subprocess.Popen[str]:
    """A command in a session of its own, on so many ranks."""
    job = ["mpirun", "-n", str(ranks), *words] if ranks > 1 else words
    more = {
        "OMPI_ALLOW_RUN_AS_ROOT": "1",
        "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1",
        "PRTE_MCA_rmaps_default_mapping_policy": ":oversubscribe",
    }
    return subprocess.Popen(
        job,
        env=os.environ | more,
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        start_new_session=True,
        cwd=ROOT,
    )


def members(output: Path) -> list[int]:
    """Processes whose command names a run folder."""
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                words = (entry / "cmdline").read_bytes().split(b"\0")
            except OSError:
                continue
            if str(output).encode() in words and int(entry.name) != os.getpid():
                found.append(int(entry.name))
    return found


def stopped(words: list[str], output: Path, ranks: int, after: int, number: int, rank: bool) -> tuple[str, bool]:
    """Send a signal when so many predictions are kept, to the job or a rank; what is wrong with its end, and if it was in time."""
    job = started([*words, str(output)], ranks)
    while job.poll() is None and not _reached(output, after):
        time.sleep(0.02)
    if job.poll() is not None:
        job.communicate()
        return "", False
    workers = [pid for pid in members(output) if pid != job.pid] or [job.pid]
    began = time.monotonic()
    os.kill(workers[-1] if rank else job.pid, number)
    try:
        _, said = job.communicate(timeout=_WITHIN)
    except subprocess.TimeoutExpired:
        os.killpg(job.pid, signal.SIGKILL)
        job.communicate()
        return f"was not gone after {_WITHIN:.0f} s", True
    while (left := members(output)) and time.monotonic() < began + _WITHIN:
        time.sleep(0.1)
    if left:
        for pid in left:
            os.kill(pid, signal.SIGKILL)
        return f"left processes {left}", True
    if "Traceback" in said:
        return f"a traceback: {said[-300:]!r}", True
    return ("" if job.returncode != 0 else "exit code 0"), True


def _kept(output: Path) -> int:
    """How many predictions a run has kept."""
    return len(list((output / CHECKPOINT).glob("*"))) if (output / CHECKPOINT).is_dir() else 0


def _reached(output: Path, predictions: int) -> bool:
    return (output / "run.json").exists() and _kept(output) >= predictions


def answer(output: Path) -> dict[str, object]:
    """What a run has found."""
    content: dict[str, object] = json.loads((output / "identification.json").read_text(encoding="utf-8"))
    return content


def signals(count: int = 12, seed: int = 0, ranks: Iterable[int] = (1, 2)) -> Reached:
    """F4: `count` identifications on each number of ranks, each stopped at a random time, then continued to the end."""
    rng = random.Random(seed)
    misses: list[str] = []
    ended, kept = 0, 0
    with tempfile.TemporaryDirectory(prefix="bcid-") as name:
        folder = Path(name)
        words = prepared(folder)
        for size in ranks:
            right_folder = folder / f"right-{size}"
            job = started([*words, str(right_folder)], size)
            _, said = job.communicate(timeout=_LONG)
            assert job.returncode == 0, said
            for number in range(count):
                kind = (signal.SIGINT, signal.SIGTERM, signal.SIGKILL)[number % 3]
                output = folder / f"{size}-{number}"
                after = rng.randrange(5)
                fault, in_time = stopped(words, output, size, after, kind, kind == signal.SIGKILL)
                ended += in_time
                if fault:
                    misses.append(f"{size} ranks, {kind.name} after {after} predictions: {fault}")
                if in_time and (output / "run.json").exists():
                    kept += _kept(output)
                    job = started([*words, str(output)], size)
                    _, said = job.communicate(timeout=_LONG)
                    if job.returncode != 0:
                        misses.append(
                            f"{size} ranks, {kind.name} after {after} predictions: does not go on: {said[-300:]!r}"
                        )
                    elif answer(output) != answer(right_folder):
                        misses.append(f"{size} ranks, {kind.name} after {after} predictions: goes on to another answer")
                shutil.rmtree(output, ignore_errors=True)
    where = ", ".join(map(str, ranks))
    text = f"{ended} jobs on {where} ranks stopped by SIGINT, SIGTERM, SIGKILL of a rank; {kept} predictions kept"
    goal = "ends within 10 s, no orphan, resumable: the same answer to the last bit"
    return Reached(goal, text, not misses and ended > 0, tuple(misses))


_MEMORY = """
import resource, sys
from bcid.app import cli
from bcid.forms.solver import equilibrium as solve
made = solve.Equilibrium.__init__
def limited(self, *arguments, **named):
    made(self, *arguments, **named)
    used = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + int(sys.argv[1]) * 1000, -1))
solve.Equilibrium.__init__ = limited
sys.exit(cli.main(sys.argv[2:]))
"""


def memory(count: int = 8) -> Reached:
    """F4: identifications whose memory is limited to what the model takes and a little more, from none on."""
    misses: list[str] = []
    ends: list[str] = []
    with tempfile.TemporaryDirectory(prefix="bcid-") as name:
        folder = Path(name)
        words = prepared(folder)
        for number in range(count):
            more, output = 250 * 2**number - 250, folder / str(number)
            limited = [sys.executable, "-c", _MEMORY, str(more), *words[3:], str(output)]
            done = subprocess.run(limited, capture_output=True, text=True, timeout=_LONG, check=False, cwd=ROOT)
            ends.append(f"{more} kB: {done.returncode}")
            named = done.returncode == 0 or (
                done.returncode == 3 and "memory" in done.stderr and "Traceback" not in done.stderr
            )
            if not named:
                misses.append(f"{more} kB more: exit code {done.returncode}, {done.stderr[-600:]!r}")
            elif done.returncode == 3:
                again = subprocess.run(
                    [*words, str(output)], capture_output=True, text=True, timeout=_LONG, check=False, cwd=ROOT
                )
                if again.returncode != 0:
                    misses.append(f"{more} kB more: does not go on: {again.stderr[-300:]!r}")
    goal = "memory limit: exit code 3, one message that says so, and a run that goes on"
    return Reached(goal, "exit codes by memory allowed: " + ", ".join(ends), not misses, tuple(misses))
