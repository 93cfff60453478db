"""The tasks test, lint, coverage and docs of ./dev: ``python environment/tasks.py TASK [ARG...]``, in the environment."""

import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]

COMMANDS = {
    "lint": ["ruff check .", "ruff format --check .", "mypy"],
    "coverage": ["python -m coverage html -q", "python -m coverage report --skip-covered --sort cover"],
    "docs": ["python -m sphinx -q -W --keep-going docs build/docs"],
}

# Long files first. The parallel tests are one long file: were it the last, one core would have nothing to do meanwhile.
FOLDERS = ["tests/examples", "tests/verify", "tests/reliability", "tests/contract", "tests/unit"]
PARALLEL = "tests/parallel"

# A process for each of two cores; tests of a file stay together, for they share what they have made.
SPREAD = ["-n", "2", "--dist", "loadfile", "--no-loadscope-reorder", "--durations", "25"]

# Each rank runs the same tests, and only rank 0 is shown; of the others what they say last, if they fail. One that waits for a rank
# that is gone ends by the timeout. mpirun kills the others when one ends with an error: they get five seconds to have their say.
ONE_RANK = """
rank=${OMPI_COMM_WORLD_RANK:-${PMI_RANK:-0}}
test() { python -m pytest -p no:cacheprovider -o timeout=120 -o timeout_method=thread "$@"; }
if [ "$rank" = 0 ]; then test "$@"; else said=$(test "$@" 2>&1); fi && exit
[ "$rank" = 0 ] || tail -n 40 <<<"$said" | sed "s/^/rank $rank: /" >&2
sleep 5
exit 1
"""


# Line coverage of a whole run, of workers, commands and ranks as well; the threshold is in pyproject.toml.
COVERED = ("-m", "coverage", "run")
REPORT = "python -m coverage combine -q && python -m coverage report --format total"


def test(args: list[str]) -> bool:
    """All tests but the long ones, and their coverage; with arguments pytest with these, and on ranks only what is named."""
    several = SPREAD if len(os.sched_getaffinity(0)) > 1 else []
    folders = [folder for folder in FOLDERS if (ROOT / folder).is_dir()]
    if not args:
        call(["python", "-m", "coverage", "erase"])
        # On one rank the parallel tests need no mpirun.
        first = {"serial": ["python", *COVERED, "-m", "pytest", PARALLEL, *folders, *several]}
        return run("test", first | on_ranks([2, 3], [PARALLEL], COVERED) | {"coverage": ["bash", "-c", REPORT]})
    if args[0] == "--long":
        return run("test", {"long": ["python", "-m", "pytest", "tests/long", *several, *args[1:]]})
    paths, options = ([arg for arg in args if arg.startswith("tests/") == path] for path in (True, False))
    parallel = [path for path in paths if path.startswith(PARALLEL)]
    serial = [path for path in paths if path not in parallel] if paths else folders
    steps = {"serial": ["python", "-m", "pytest", *serial, *options]} if serial else {}
    return run("test", steps | (on_ranks([1, 2, 3], [*parallel, *options]) if parallel else {}))


def on_ranks(counts: list[int], args: list[str], how: tuple[str, ...] = ()) -> dict[str, list[str]]:
    """The steps that run pytest on so many ranks each."""
    script = ONE_RANK.replace("python", " ".join(["python", *how]))
    return {f"{n} rank(s)": ["mpirun", "-n", str(n), "bash", "-c", script, "rank", *args] for n in counts}


def run(task: str, steps: dict[str, list[str]]) -> bool:
    """Run all steps and print one line about them; whether all ended well."""
    said, good, start = [], True, time.monotonic()
    for name, words in steps.items():
        print("dev:", name, file=sys.stderr)
        begun = time.monotonic()
        passed = call(words)
        good = good and passed
        said.append(f"{name} {'passed' if passed else 'FAILED'} ({time.monotonic() - begun:.0f} s)")
    total = f"{time.monotonic() - start:.0f} s"
    print(f"dev: {task} {'OK' if good else 'FAILED'} after {total}: {', '.join(said)}", file=sys.stderr)
    return good


def call(words: list[str]) -> bool:
    """Run a command in the clone, which ends with this process; whether it ended well."""
    child = subprocess.Popen(words, cwd=ROOT)
    try:
        return child.wait() == 0
    except KeyboardInterrupt:
        # From a terminal the child has it as well, and may have something to say.
        with suppress(subprocess.TimeoutExpired):
            child.wait(10)
        raise
    finally:
        child.terminate()
        child.wait()


if __name__ == "__main__":
    for number in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, lambda number, _: sys.exit(128 + number))
    task, args = sys.argv[1], sys.argv[2:]
    try:
        good = test(args) if task == "test" else run(task, {command: command.split() for command in COMMANDS[task]})
    except KeyboardInterrupt:
        sys.exit(130)
    sys.exit(0 if good else 1)
