"""B1: mutated .msh files, loaded as bcid loads them: by gmsh in a process of its own, then checked."""

from __future__ import annotations

import contextlib
import json
import os
import resource
import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bcid.base.confined import limit_memory
from bcid.base.errors import InputError
from bcid.forms.mesh import BodyMesh, checked
from bcid.forms.mesh.check import group_faults
from bcid.forms.mesh.gmsh_mesh import with_gmsh
from bcid.forms.mesh.loading import refuse_scripts
from validation.reliability import ROOT, Reached

_LIMIT = 10
_MEMORY = 2e9
_NASTY = [
    b"nan",
    b"inf",
    b"-1",
    b"0",
    b"1e308",
    b"-1e308",
    b"99999999999",
    b"2147483648",
    b"4294967295",
    b"",
    b"1e-300",
]
# How a child ended: its exit code.
_READ, _REFUSED, _DAMAGED, _OTHER, _CHANGED = range(5)
# A volume or an area that differs by less from that of the sound file is the same.
_SAME = 1e-9


def good_files(folder: Path) -> list[bytes]:
    """The slab on its coarsest mesh in the formats that gmsh writes: 2.2 and 4.1, as text and binary."""
    import gmsh

    gmsh.initialize(["reliability", "-nopopup", "-v", "0", "-setnumber", "h", "50"], readConfigFiles=False)
    gmsh.open(str(ROOT / "meshes/geo/slab.geo"))
    gmsh.model.mesh.generate(3)
    files = []
    for version in (2.2, 4.1):
        for binary in (0, 1):
            gmsh.option.setNumber("Mesh.MshFileVersion", version)
            gmsh.option.setNumber("Mesh.Binary", binary)
            gmsh.write(str(folder / "good.msh"))
            files.append((folder / "good.msh").read_bytes())
    gmsh.finalize()
    return files


def mutated(good: bytes, rng: np.random.Generator) -> bytes:
    """One to three changes of bytes, words, lines or sections."""
    for _ in range(rng.integers(1, 4)):
        kind = rng.integers(8)
        lines = good.split(b"\n")
        i, j = rng.integers(len(lines), size=2)
        if kind == 0:
            changed = bytearray(good)
            for place in rng.integers(len(good), size=rng.integers(1, 6)):
                changed[place] = rng.integers(256)
            good = bytes(changed)
            continue
        if kind == 1:
            good = good[: rng.integers(1, max(2, len(good)))]
            continue
        if kind == 2:
            words = lines[i].split(b" ")
            words[rng.integers(len(words))] = _NASTY[rng.integers(len(_NASTY))]
            lines[i] = b" ".join(words)
        elif kind >= 6:
            # A node goes to where another is, or to its height.
            ends = [lines.index(word) if word in lines else 0 for word in (b"$Nodes", b"$EndNodes")]
            nodes = [k for k in range(*ends) if len(lines[k].split()) in (3, 4)]
            if len(nodes) > 1:
                i, j = rng.choice(nodes, 2, replace=False)
                kept = -3 if kind == 6 else -1
                lines[i] = b" ".join([*lines[i].split()[:kept], *lines[j].split()[kept:]])
        elif kind == 3:
            del lines[i]
        elif kind == 4:
            lines.insert(j, lines[i])
        else:
            lines[i], lines[j] = lines[j], lines[i]
        good = b"\n".join(lines) or b"$"
    return good


def unsound(mesh: BodyMesh) -> str:
    """What is wrong with a mesh that was accepted, found in other ways than bcid's own; "" if nothing is."""
    corners = mesh.points[mesh.cells]
    if not np.isfinite(corners).all():
        return "a node that is not finite"
    if np.linalg.det(corners[:, 1:] - corners[:, :1]).min() <= 0:
        return "a tetrahedron that is inverted or flat"
    if len({frozenset(map(int, cell)) for cell in mesh.cells}) < len(mesh.cells):
        return "a tetrahedron twice"
    if len({tuple(point) for point in mesh.points.tolist()}) < len(mesh.points):
        return "two nodes in one place"
    reached, new = set[int](), {int(mesh.cells[0, 0])}
    while new:
        reached |= new
        touched = mesh.cells[np.isin(mesh.cells, list(new)).any(axis=1)]
        new = set(map(int, touched.ravel())) - reached
    if len(reached) < len(mesh.points):
        return "unconnected parts"
    named = [part for part in mesh.groups.values() if part.min() < 0 or part.max() >= len(mesh.points)]
    return "a group of nodes that are not there" if named else ""


def damage(count: int = 10_000, seed: int = 0) -> Reached:
    """B1: load mutated files, each in a child forked from one process that has gmsh loaded."""
    rng = np.random.default_rng(seed)
    names = {_READ: "read right", _REFUSED: "refused", _DAMAGED: "ACCEPTED DAMAGED", _OTHER: "ANOTHER EXCEPTION"}
    names[_CHANGED] = "read with another volume, area or set of groups, as the summary shows"
    ends: Counter[str] = Counter()
    misses: list[str] = []
    longest, largest = 0.0, 0.0
    with tempfile.TemporaryDirectory(prefix="bcid-") as name:
        files = _good_in_child(Path(name))
        path = Path(name) / "some.msh"
        for number in range(count):
            path.write_bytes(mutated(files[number % len(files)].content, rng))
            code, seconds, peak = _loaded(path, files[number % len(files)].sizes)
            longest, largest = max(longest, seconds), max(largest, peak)
            end = names.get(code, "gmsh died" if code > -1000 else "HUNG")
            ends[end] += 1
            if end.isupper() or peak > _MEMORY:
                kept = Path(tempfile.gettempdir()) / f"bcid-{number}.msh"
                misses.append(f"case {number} of seed {seed}: {end}, {peak / 1e6:.0f} MB, {seconds:.1f} s; {kept.name}")
                kept.write_bytes(path.read_bytes())
    text = ", ".join(f"{what} {times}" for what, times in sorted(ends.items()))
    text += f" (in the child, which bcid tells); longest {longest:.1f} s, most memory {largest / 1e6:.0f} MB"
    goal = "10,000 mutated .msh files: no death, none over 10 s or 2 GB, none accepted damaged"
    return Reached(goal, text, not misses, tuple(misses))


@dataclass(frozen=True)
class _Good:
    """A sound file, and the volume of its body and the areas of its groups by name ("" is the body), m^3 and m^2."""

    content: bytes
    sizes: dict[str, float]


def _good_in_child(folder: Path) -> list[_Good]:
    """gmsh is never initialised in the process that forks."""
    with _forked() as child:
        if child:
            for number, content in enumerate(good_files(folder)):
                path = folder / f"{number}.msh"
                path.write_bytes(content)
                path.with_suffix(".json").write_text(json.dumps(_sizes(_mesh(path))), encoding="utf-8")
    paths = [folder / f"{number}.msh" for number in range(4)]
    return [_Good(path.read_bytes(), json.loads(path.with_suffix(".json").read_text())) for path in paths]


def _mesh(path: Path) -> BodyMesh:
    """As bcid loads it, with every group taken for a patch."""
    refuse_scripts(path)
    arrays = with_gmsh(path)
    groups = {name[6:]: part for name, part in arrays.items() if name.startswith("group:")}
    mesh = checked(BodyMesh(arrays["points"] * 1e-3, arrays["cells"], groups), path)
    faults = [text for part in mesh.groups.values() for text in group_faults(mesh, part)]
    if faults:
        raise InputError(faults[0])
    return mesh


def _sizes(mesh: BodyMesh) -> dict[str, float]:
    return {"": mesh.volume} | {name: mesh.area(part) for name, part in mesh.groups.items()}


@contextlib.contextmanager
def _forked() -> Iterator[bool]:
    """True in a child, which ends after the block; the parent gets False and waits for it."""
    child = os.fork()
    if child:
        os.waitpid(child, 0)
        yield False
        return
    try:
        yield True
    finally:
        os._exit(0)


def _loaded(path: Path, right: dict[str, float]) -> tuple[int, float, float]:
    """Exit code of a child that loads a file (-1000: it hung), its seconds, and its peak memory, bytes."""
    import gmsh  # noqa: F401 (loaded once, for all children)

    start = time.monotonic()
    child = os.fork()
    if child == 0:
        os._exit(_load(path, right))
    _, status, usage = os.wait4(child, 0)
    seconds, code = time.monotonic() - start, os.waitstatus_to_exitcode(status)
    hung = code == -signal.SIGALRM or seconds > _LIMIT
    return -1000 if hung else code, seconds, usage.ru_maxrss * 1024.0


def _load(path: Path, right: dict[str, float]) -> int:
    signal.alarm(_LIMIT)
    quiet = os.open(os.devnull, os.O_WRONLY)
    os.dup2(quiet, 1)
    os.dup2(quiet, 2)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    limit_memory(path)
    try:
        mesh = _mesh(path)
    except (InputError, RuntimeError, ValueError, MemoryError):
        # The child of bcid says the same in one line.
        return _REFUSED
    except BaseException as error:
        print(repr(error), file=sys.__stderr__)
        return _OTHER
    if unsound(mesh):
        return _DAMAGED
    found = _sizes(mesh)
    if right.keys() - found.keys():
        # The scene names what is missing.
        return _REFUSED
    same = all(abs(found[name] - size) <= _SAME * abs(right[""]) ** (2 / 3) for name, size in right.items())
    return _READ if same else _CHANGED
