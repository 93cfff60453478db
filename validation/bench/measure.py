"""Running what is measured: every timed thing in a process of its own, which prints a record in JSON as its last line."""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from bcid.base.errors import MachineError
from bcid.base.progress import Progress
from bcid.base.shipped import IMPORT_ROOT, shipped

PINS = "environment/bench.txt"
UNREACHABLE = ("NewConnectionError", "NameResolutionError", "ConnectTimeout", "Network is unreachable", "ProxyError")
THREADS = ("OMP", "OPENBLAS", "MKL", "BLIS", "NUMEXPR")
Record = dict[str, Any]

# Records of one thing are the same but for their times; these are the ones a median is taken of.
TIMES = ("setup_s", "wall_s", "cpu_s", "rss_mb", "residual_s", "triangular_s", "factor_s")


@dataclass
class Session:
    """One run of the benchmark: where it writes, how much it does, and what it says.

    Attributes:
        folder: output folder.
        quick: a reduced form, without peers that need the network.
        progress: told what is being measured.
    """

    folder: Path
    quick: bool
    progress: Progress
    _peers: list[tuple[str | None, str]] = field(default_factory=list)

    @property
    def scratch(self) -> Path:
        """Folder of what the measured processes write."""
        folder = self.folder / "work"
        folder.mkdir(parents=True, exist_ok=True)
        return folder

    def full(self, value: float) -> float | None:
        """What a goal is held against; None in a reduced form, which measures none."""
        return None if self.quick else value

    def run(
        self, module: str, *arguments: object, python: str | None = None, ranks: int = 1, timeout: float = 1500.0
    ) -> Record:
        """Run ``python -m validation.bench.MODULE`` and return its record.

        Raises:
            MachineError: it failed; with the end of what it said.
        """
        command = [python or sys.executable, "-m", f"validation.bench.{module}", *map(str, arguments)]
        if ranks > 1:
            command = ["mpirun", "-n", str(ranks), *command]
        try:
            done = subprocess.run(
                command,
                env=_environment(),
                cwd=self.scratch,
                capture_output=True,
                text=True,
                timeout=timeout,
                check=False,
            )
        except subprocess.TimeoutExpired:
            raise MachineError(f"validation.bench.{module} took more than {timeout:.0f} s") from None
        except OSError as error:
            raise MachineError(f"validation.bench.{module} could not be started: {error}") from None
        lines = done.stdout.strip().splitlines()
        if done.returncode != 0 or not lines:
            said = done.stderr.strip().splitlines()
            raise MachineError(f"validation.bench.{module} failed: {said[-1] if said else f'code {done.returncode}'}")
        record: Record = json.loads(lines[-1])
        return record

    def peer_python(self) -> tuple[str | None, str]:
        """The Python that has the peers of environment/bench.txt, or None and why not; installed on first use."""
        if not self._peers:
            self._peers.append((None, "left out of --quick") if self.quick else peer_python(self.progress.say))
        return self._peers[0]


def _environment() -> dict[str, str]:
    """One thread per process, and the project found by whatever Python runs."""
    found = os.environ.get("PYTHONPATH", "")
    threads = {f"{name}_NUM_THREADS": "1" for name in THREADS}
    return os.environ | threads | {"PYTHONPATH": os.pathsep.join(filter(None, [str(IMPORT_ROOT), found]))}


def peer_python(say: Callable[[str], None], pins: str = PINS) -> tuple[str | None, str]:
    """A Python with the packages of a list of pins, or None and why not; installed into the cache on first use.

    Args:
        say: told what is installed.
        pins: file of the project that lists the packages.
    """
    import scipy

    base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "bcid-bench"
    key = hashlib.sha256((shipped(pins).read_text(encoding="utf-8") + sys.version + sys.prefix).encode()).hexdigest()[
        :12
    ]
    folder, partial = base / f"venv-{key}", base / f"venv-{key}.partial-{os.getpid()}"
    python = folder / "bin" / "python"
    if python.exists():
        return str(python), ""
    say(f"installing the packages of {pins} into {folder} (once)")
    try:
        base.mkdir(parents=True, exist_ok=True)
        _must([sys.executable, "-m", "venv", "--system-site-packages", "--without-pip", str(partial)])
        made = partial / "bin" / "python"
        # A venv made from a venv sees the system below both, and not the first one.
        site = _must([str(made), "-c", "import sysconfig; print(sysconfig.get_path('purelib'))"]).strip()
        below = [path for path in sys.path if path.startswith(sys.prefix) and "site-packages" in path]
        (Path(site) / "below.pth").write_text("\n".join(below) + "\n", encoding="utf-8")
        try:
            _must([str(made), "-m", "pip", "--version"])
        except MachineError:
            _must([str(made), "-m", "ensurepip"])
        # The peers run on the NumPy and SciPy that DOLFINx runs on.
        fixed = partial / "constraints.txt"
        fixed.write_text(f"numpy=={np.__version__}\nscipy=={scipy.__version__}\n", encoding="utf-8")
        options = ["--no-input", "--retries", "1", "--timeout", "20", "--no-cache-dir", "--disable-pip-version-check"]
        _must([str(made), "-m", "pip", "install", *options, "-r", str(shipped(pins)), "-c", str(fixed)])
        partial.rename(folder)
    except (MachineError, OSError) as error:
        subprocess.run(["rm", "-rf", "--", str(partial)], check=False)
        return None, f"could not be installed ({error})"
    return str(python), ""


def _must(command: Sequence[str]) -> str:
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=900, check=False)
    except subprocess.TimeoutExpired:
        raise MachineError(f"{' '.join(command[1:4])} took more than 900 s") from None
    if done.returncode != 0:
        text = done.stdout + done.stderr
        if any(words in text for words in UNREACHABLE):
            raise MachineError("the package index could not be reached")
        errors = [line.strip() for line in text.splitlines() if "rror" in line or "ERROR" in line]
        raise MachineError((errors or [text.strip()])[0][:200])
    return done.stdout


def medians(records: Sequence[Record]) -> Record:
    """One record of several of the same thing: medians of the times, and how many there were."""
    middle = {name: float(np.median([r[name] for r in records])) for name in TIMES if name in records[0]}
    return records[0] | middle | {"repeats": len(records)}


def alternate(
    jobs: Mapping[str, Callable[[], Record]], repeats: int, say: Callable[[str], None], slow: float = 20.0
) -> tuple[dict[str, Record], dict[str, str]]:
    """Run jobs in turn, several times, so that all see the same machine; medians of each, and the errors of those that failed.

    What takes more than `slow` CPU seconds is run once.
    """
    found: dict[str, list[Record]] = {name: [] for name in jobs}
    errors: dict[str, str] = {}
    for turn in range(repeats):
        for name, job in jobs.items():
            if name in errors or any(record["cpu_s"] > slow for record in found[name]):
                continue
            say(f"{name} ({turn + 1} of {repeats})")
            try:
                found[name].append(job())
            except MachineError as error:
                errors[name] = str(error)
    return {name: medians(records) for name, records in found.items() if records and name not in errors}, errors
