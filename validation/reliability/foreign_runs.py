"""S8: run folders that somebody has changed, given to every command that takes one."""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from itertools import islice
from pathlib import Path

import numpy as np
import xarray as xr

from bcid.base.run_folder import RunFolder, sealed
from validation.reliability import Reached

# Stands in files outside of the run, and must be seen nowhere.
SECRET = "nobody-may-read-this-4711"
_LIMIT = 90
_COMMANDS = ("report", "figure", "load", "compare", "diagnose", "fit", "propose")
_LOAD = """
import sys, bcid
from bcid.base.errors import InputError
try:
    print(bcid.load(sys.argv[1]))
except InputError as error:
    print(error)
    sys.exit(2)
"""
_FILES = ("run.json", "diagnosis.json", "model.json", "body.nc", "residuals.nc", "summary.txt")


def explained(folder: Path) -> Path:
    """A finished run of `explain` of one tetrahedron."""
    run = RunFolder.start(folder, "explain", {"scene": "a", "measurement": "b", "options": {}})
    points = np.vstack([np.zeros(3), 0.1 * np.eye(3)])
    body = {
        "points": (("node", "axis"), points),
        "cells": (("cell", "corner"), np.array([[0, 1, 2, 3]], np.int32)),
        "triangles": (("triangle", "vertex"), np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], np.int32)),
        "place": ("triangle", np.array([1, 0, 0, 0], np.int32)),
        "place_name": ("place_number", ["", "patch left"]),
        "displacement": (("frame", "node", "axis"), np.zeros((2, 4, 3))),
        "energy": (("frame", "node"), np.zeros((2, 4), np.float32)),
    }
    where = (("frame", "fiducial", "axis"), np.zeros((2, 1, 3)))
    seen = {"measured": where, "predicted_first": where, "predicted": where, "grasp": ("frame", ["I", "I"])}
    coords = {"fiducial": ["a"], "axis": list("xyz"), "action": ("frame", ["1", "1"]), "step": ("frame", [0, 1])}
    found = {"verdict": "gravity", "anchored": ["left"], "adequate": True, "rms": 0.1, "noise_rms": 0.1}
    run.write_documents(
        {
            "diagnosis.json": found | {"length_unit": "mm", "model": "neo_hooke"},
            "model.json": {"law": {}, "effects": [], "anchored": ["left"], "free": []},
            "body.nc": xr.Dataset(body, {"axis": list("xyz")}, {"scene": "one", "up": "0 1 0"}),
            "residuals.nc": xr.Dataset(seen, coords),
            "summary.txt": "Missing in the plain model: gravity.\n",
        }
    )
    run.record["names"] = {"scene": "slab.toml", "measurement": "pulled"}
    run.finish({})
    return folder


def seal(folder: Path, name: str) -> None:
    """Make the checksum of a changed file right, as one who means harm would."""
    record = json.loads((folder / "run.json").read_text())
    record["files"][name] = hashlib.sha256((folder / name).read_bytes()).hexdigest()[:32]
    (folder / "run.json").write_text(json.dumps(sealed(record)))


def _replaced(make: Callable[[Path, Path], None]) -> Callable[[Path, str], None]:
    """A change that puts something else in the place of a file; `make` gets the place and a file with the secret."""

    def change(folder: Path, name: str) -> None:
        secret = folder.parent / "secret"
        secret.write_text(SECRET)
        (folder / name).unlink()
        make(folder / name, secret)

    return change


def _sparse(place: Path, _secret: Path) -> None:
    with place.open("wb") as stream:
        stream.truncate(30_000_000_000)


def _swapped(folder: Path, name: str) -> None:
    other = folder / ("model.json" if name != "model.json" else "summary.txt")
    content = other.read_bytes()
    other.write_bytes((folder / name).read_bytes())
    (folder / name).write_bytes(content)


CHANGES: dict[str, Callable[[Path, str], None]] = {
    "deleted": lambda folder, name: (folder / name).unlink(),
    "edited": lambda folder, name: (folder / name).write_text(SECRET),
    "link": _replaced(lambda place, secret: place.symlink_to(secret)),
    "FIFO": _replaced(lambda place, _: os.mkfifo(place)),
    "sparse": _replaced(_sparse),
    "folder": _replaced(lambda place, _: place.mkdir()),
    "swapped": _swapped,
}

ABSURD = {
    "triangles": 1_000_000_000,
    "cells": -1,
    "place": 1_000_000,
    "points": np.nan,
    "displacement": 1e300,
    "energy": np.inf,
}


def absurd(folder: Path, name: str) -> None:
    """Put an absurd number into an array of `body.nc`, and make the checksum right."""
    with xr.open_dataset(folder / "body.nc", engine="scipy") as opened:
        body = opened.load()
    values = body[name].values.copy()
    values.flat[0] = ABSURD[name]
    body[name] = (body[name].dims, values)
    body.to_netcdf(folder / "body.nc", engine="scipy")
    seal(folder, "body.nc")


def cases() -> Iterator[tuple[str, Callable[[Path], None]]]:
    """Changes of a run folder, each with its name."""
    for what, change in CHANGES.items():
        for name in _FILES:
            yield f"{name} {what}", lambda folder, change=change, name=name: change(folder, name)  # type: ignore[misc]
    for name in ABSURD:
        yield f"{name} absurd", lambda folder, name=name: absurd(folder, name)  # type: ignore[misc]


def trouble(folder: Path, command: str) -> str:
    """What goes wrong when a command is given a changed run; "" where nothing does."""
    out = folder.parent / "out"
    given = [sys.executable, "-m", "bcid", command, str(folder), "-o", str(out / "new")]
    if command == "load":
        given = [sys.executable, "-c", _LOAD, str(folder)]
    elif command == "propose":
        given += ["--folder", str(out / "proposed")]
    elif command == "fit":
        given += ["--anchors", "left"]
    try:
        ended = subprocess.run(given, capture_output=True, timeout=_LIMIT, check=False)
    except subprocess.TimeoutExpired:
        return f"takes more than {_LIMIT} s"
    written = b"".join(file.read_bytes() for file in out.rglob("*") if file.is_file()) if out.exists() else b""
    said = ended.stdout + ended.stderr
    if SECRET.encode() in said + written:
        return "shows what is not the run's"
    if b"Traceback" in said or ended.returncode not in (0, 2):
        return f"ends with {ended.returncode}: {said[-300:].decode(errors='replace')}"
    if ended.returncode == 0 and command != "report":
        return "is not refused"
    return ""


def foreign(count: int | None = None) -> Reached:
    """S8: every change and every command that takes a run folder."""
    misses = []
    every = [(what, change, command) for what, change in cases() for command in _COMMANDS]
    chosen = list(islice(every, 0, None, max(1, len(every) // count) if count else 1))
    for what, change, command in chosen:
        with tempfile.TemporaryDirectory(prefix="bcid-") as name:
            folder = explained(Path(name) / "run")
            change(folder)
            wrong = trouble(folder, command)
        if wrong:
            misses.append(f"{what}, {command}: {wrong}")
    goal = "changed run folders: no command hangs, crashes or shows what is not the run's"
    return Reached(goal, f"{len(chosen)} cases, {len(misses)} missed", not misses, tuple(misses))
