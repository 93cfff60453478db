"""The tasks test, lint, coverage and docs of ./dev: ``python environment/tasks.py TASK [ARG...]``, in the environment."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from contextlib import nullcontext, suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import IO

ROOT = Path(__file__).resolve().parents[1]

COMMANDS = {
    "lint": ["ruff check .", "ruff format --check .", "mypy bcid"],
    "coverage": [
        "coverage erase",
        "coverage run -m pytest tests --ignore tests/parallel -n 2 --dist loadfile",
        "mpirun -n 2 coverage run -m pytest -q -p no:cacheprovider tests/parallel",
        "coverage combine -q",
        "coverage html",
        "coverage report --skip-covered --sort cover",
    ],
    "docs": ["python -m sphinx -q -W --keep-going docs build/docs"],
}

# Long files first. The parallel tests are one long file: were it the last, one core would have nothing to do meanwhile.
FOLDERS = ["tests/examples", "tests/verify", "tests/reliability", "tests/contract", "tests/unit"]
PARALLEL = "tests/parallel"

# A process for each of two cores; tests of a file stay together, for they share what they have made.
SPREAD = ["-n", "2", "--dist", "loadfile", "--no-loadscope-reorder", "--durations", "25"]

# Of a rank: one that waits for another that is gone would otherwise wait forever.
TIMEOUT = ["-p", "no:cacheprovider", "-o", "timeout=120", "-o", "timeout_method=thread"]


def test(args: list[str]) -> bool:
    """All tests; with arguments pytest with these, and on ranks only what is named."""
    paths = [arg for arg in args if arg.startswith("tests/")]
    options = [arg for arg in args if arg not in paths]
    parallel = [path for path in paths if path.startswith(PARALLEL)]
    serial = [path for path in paths if path not in parallel]
    spread: list[str] = []
    counts = [1, 2, 3]
    if not paths:
        serial = [folder for folder in FOLDERS if (ROOT / folder).is_dir()]
    if not args:
        # On one rank the parallel tests need no mpirun.
        serial, parallel, counts = [PARALLEL, *serial], [PARALLEL], [2, 3]
        spread = SPREAD if len(os.sched_getaffinity(0)) > 1 else []
    steps = {"serial": ["python", "-m", "pytest", *serial, *spread, *options]} if serial else {}
    if parallel:
        steps |= {f"{n} rank(s)": ["python", __file__, "ranks", str(n), *parallel, *options] for n in counts}
    return run("test", steps)


def run(task: str, steps: dict[str, list[str]]) -> bool:
    """Run all steps and print one line about them; whether all ended well."""
    said, good, start = [], True, time.monotonic()
    for name, words in steps.items():
        begun = time.monotonic()
        passed = call(words)
        good = good and passed
        said.append(f"{name} {'passed' if passed else 'FAILED'} ({time.monotonic() - begun:.0f} s)")
    say(f"{task} {'OK' if good else 'FAILED'} after {time.monotonic() - start:.0f} s: {', '.join(said)}")
    return good


def call(words: list[str], output: IO[bytes] | None = None) -> bool:
    """Run a command in the clone, which ends with this process; whether it ended well."""
    with subprocess.Popen(words, cwd=ROOT, stdout=output, stderr=output) as child:
        try:
            return child.wait() == 0
        except KeyboardInterrupt:
            # From a terminal the child has it as well, and may have something to say.
            with suppress(subprocess.TimeoutExpired):
                child.wait(10)
            raise
        finally:
            child.terminate()


def on_ranks(n: str, args: list[str]) -> bool:
    """Run the same tests on each of n ranks. Only rank 0 is shown; of the others the end, where one failed."""
    with TemporaryDirectory() as folder:
        say(f"tests on {n} rank(s)")
        good = call(["mpirun", "-n", n, "python", __file__, "rank", folder, *args])
        for file in [] if good else sorted(Path(folder).iterdir()):
            say(f"the end of rank {file.name} of {n}:")
            print(*("    " + line for line in file.read_text().splitlines()[-40:]), sep="\n", file=sys.stderr)
    return good


def rank(folder: str, args: list[str]) -> bool:
    """Run tests as one rank."""
    name = os.environ.get("OMPI_COMM_WORLD_RANK") or os.environ.get("PMI_RANK") or "0"
    with Path(folder, name).open("wb") if name != "0" else nullcontext() as file:
        good = call(["python", "-m", "pytest", *TIMEOUT, *args], file)
    # mpirun kills the others when one ends with an error: they get five seconds to end by themselves and have their say.
    time.sleep(0 if good else 5)
    return good


def say(text: str) -> None:
    """Print a line beside the output of commands."""
    print(f"dev: {text}", file=sys.stderr, flush=True)


def main(task: str, *args: str) -> bool:
    """Do a task; whether it ended well."""
    if task == "test":
        return test([*args])
    if task == "ranks":
        return on_ranks(args[0], [*args[1:]])
    if task == "rank":
        return rank(args[0], [*args[1:]])
    return run(task, {command: command.split() for command in COMMANDS[task]})


if __name__ == "__main__":
    for number in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, lambda number, _: sys.exit(128 + number))
    try:
        sys.exit(0 if main(*sys.argv[1:]) else 1)
    except KeyboardInterrupt:
        sys.exit(130)
