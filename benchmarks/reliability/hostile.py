"""S1: hostile files: nothing in them is run, nothing else is read or written; S2: names that lead out of the run folder."""

from __future__ import annotations

import contextlib
import io
import os
import pickle
import sys
import tempfile
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from bcid import Measurement, Scene
from bcid.errors import BcidError
from bcid.forms.mesh import level_mesh
from bcid.forms.model import check_physics
from bcid.run import Run
from bcid.vision.camera import Cameras
from bcid.vision.recording import Recording
from benchmarks.reliability import Reached
from benchmarks.reliability.inputs import small_scene, write_inputs

_SCRIPTS = (
    'SystemCall "touch {canary}";',
    'NonBlockingSystemCall "touch {canary}";',
    'Printf("x") > "{canary}";',
    'Merge "{secret}";',
    'Include "{secret}";',
    'Save "{canary}";',
    'OnelabRun("x", "touch {canary}");',
    'CreateDir "{canary}";',
    'General.BackgroundImageFileName = "{secret}"; Save "{canary}";',
    '// $MeshFormat\nSystemCall "touch {canary}";',
)
_HEADS = ("", "\n", " ", "\ufeff", "/* */", "$meshformat\n", "$Mesh\n")


class _Bomb:
    """Unpickling it writes the canary."""

    def __init__(self, canary: str) -> None:
        self.canary = canary

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        return os.system, (f"touch {self.canary}",)


def corpus(folder: Path, canary: Path, secret: Path) -> Iterator[tuple[str, Callable[[], Any]]]:
    """Hostile files by name, each with what reads it as a user would."""
    words = {"canary": str(canary), "secret": str(secret)}
    number = 0

    def mesh(content: bytes, ending: str) -> tuple[str, Callable[[], Any]]:
        nonlocal number
        number += 1
        place = folder / f"mesh-{number}"
        place.mkdir()
        scene_file = small_scene(place)
        (place / f"body{ending}").write_bytes(content)
        text = scene_file.read_text(encoding="utf-8").replace('element_size = "50 mm"', "refinements = 0")
        text = text.replace('element_size = "20 mm"', "refinements = 1")
        name = next(line for line in text.splitlines() if line.startswith("file = "))
        scene_file.write_text(text.replace(name, f'file = "body{ending}"'), encoding="utf-8")

        def read() -> Any:
            scene = Scene.read(scene_file, physics=check_physics)
            return level_mesh(scene, scene.levels[0])

        return f"mesh {number}{ending}: {content[:50]!r}", read

    for script in _SCRIPTS:
        for head in _HEADS[: 3 if script is not _SCRIPTS[0] else None]:
            yield mesh((head + script.format(**words)).encode(), ".msh")
    sections = "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n"
    for script in _SCRIPTS[:4]:
        yield mesh((sections + script.format(**words)).encode(), ".msh")
        yield mesh((sections + "$Comments\n" + script.format(**words) + "\n$EndComments\n").encode(), ".msh")
    for ending in (".pos", ".stl", ".step", ".brep", ".med", ".cgns", ".unv", ".py", ".opt", ".geo_unrolled", ".MSH"):
        yield mesh(_SCRIPTS[0].format(**words).encode(), ending)
    entity = f'<?xml version="1.0"?><!DOCTYPE a [<!ENTITY x SYSTEM "file://{secret}">]>'
    for ending in (".vtu", ".xdmf", ".xml"):
        yield mesh(f"{entity}<VTKFile type='UnstructuredGrid'>&x;</VTKFile>".encode(), ending)
    laughs = '<?xml version="1.0"?><!DOCTYPE a [<!ENTITY a "ha"><!ENTITY b "&a;&a;&a;&a;&a;&a;">]><a>&b;</a>'
    yield mesh(laughs.encode(), ".vtu")
    yield mesh(b"$MeshFormat\n4.1 0 8\n$EndMeshFormat\n$Nodes\n1 999999999999 1 999999999999\n", ".msh")
    yield from _others(folder, words)


def _others(folder: Path, words: dict[str, str]) -> Iterator[tuple[str, Callable[[], Any]]]:
    """Measurements, recordings, calibrations and run folders."""
    place = folder / "others"
    place.mkdir()
    files = write_inputs(place)
    # HDF5 begins like this; whatever its links lead to, it is not opened as such.
    (place / "link.nc").write_bytes(b"\x89HDF\r\n\x1a\n" + words["secret"].encode())
    yield "netCDF: an external link", lambda: Measurement.read(place / "link.nc")
    (place / "pickle.nc").write_bytes(pickle.dumps(_Bomb(words["canary"])))
    yield "netCDF: a pickle", lambda: Measurement.read(place / "pickle.nc")
    (place / "huge.nc").write_bytes(b"CDF\x01\x00\x00\x00\x00\x00\x00\x00\x0a\x7f\xff\xff\xff" + b"\x7f" * 64)
    yield "netCDF: a huge count", lambda: Measurement.read(place / "huge.nc")
    entity = f'<?xml version="1.0"?><!DOCTYPE a [<!ENTITY x SYSTEM "file://{words["secret"]}">]><opencv_storage>&x;</opencv_storage>'
    for ending, text in (
        (".xml", entity),
        (".yml", "%YAML:1.0\n--- !!python/object/apply:os.system ['touch x']\n"),
        (".json", "[" * 100_000),
    ):
        (place / f"cameras{ending}").write_text(text.replace("touch x", f"touch {words['canary']}"), encoding="utf-8")
        yield f"calibration {ending}", lambda e=ending: Cameras.read(place / f"cameras{e}")
    run = Run.start(place / "run", "identify", {})
    run.finish({})
    np.savez(place / "object.npz", sets=np.array([_Bomb(words["canary"])], dtype=object), positions=1, numbers=1)
    with zipfile.ZipFile(place / "outside.npz", "w") as archive:
        archive.writestr("../../canary", "x")
    from bcid.explore.predictions import _entries

    for name in ("object.npz", "outside.npz"):
        yield f"predictions: {name}", lambda n=name: _entries(place / n)
    for name in ("seen/fiducials.csv", "wide.csv", "recording.toml"):
        target = place / name

        def linked(target: Path = target, name: str = name) -> Any:
            target.unlink()
            target.symlink_to("/dev/zero" if name == "wide.csv" else words["secret"])
            try:
                reads = {"seen/fiducials.csv": place / "seen", "wide.csv": place / "wide.toml"}
                return Recording.read(target) if name == "recording.toml" else Measurement.read(reads[name])
            finally:
                target.unlink()
                target.write_text(files[name], encoding="utf-8")

        if name != "wide.csv":
            yield f"a link in place of {name}", linked


class Watch:
    """Notes what this process opens for writing, and what it starts, while it is on."""

    def __init__(self) -> None:
        self.on = False
        self.written: list[str] = []
        self.begun: list[str] = []
        sys.addaudithook(self._seen)

    def _seen(self, event: str, arguments: tuple[Any, ...]) -> None:
        if not self.on:
            return
        if event == "open" and isinstance(arguments[0], str | bytes | os.PathLike):
            if (arguments[2] or 0) & (os.O_WRONLY | os.O_RDWR | os.O_CREAT):
                self.written.append(os.fsdecode(arguments[0]))
        elif event in ("subprocess.Popen", "os.posix_spawn", "os.exec"):
            words = [os.fsdecode(word) for word in arguments[1]]
            if not (words[1:2] == ["-m"] and words[2].startswith("bcid.")):
                self.begun.append(" ".join(words))
        elif event in ("os.system", "pty.spawn"):
            self.begun.append(str(arguments))


_watches: list[Watch] = []


def hostile() -> Reached:
    """S1: read each file; the canary must not appear, no process but bcid's loaders start, nothing else be written."""
    if not _watches:
        _watches.append(Watch())
    watch, misses = _watches[0], list[str]()
    count, refused = 0, 0
    with tempfile.TemporaryDirectory(prefix="bcid-hostile-") as name:
        folder = Path(name)
        canary, secret = folder / "canary", folder / "secret"
        secret.write_text('SystemCall "touch ' + str(canary) + '-secret";\n', encoding="utf-8")
        for what, read in corpus(folder, canary, secret):
            count += 1
            watch.written, watch.begun, watch.on = [], [], True
            try:
                with contextlib.redirect_stderr(io.StringIO()):
                    read()
            except BcidError:
                refused += 1
            except Exception as error:
                misses.append(f"{what}: {error!r}")
            finally:
                watch.on = False
            outside = [p for p in watch.written if "bcid-" not in p and p != os.devnull and "/dev/" not in p]
            touched = [p.name for p in folder.parent.rglob("canary*")]
            if watch.begun or outside or touched:
                misses.append(f"{what}: started {watch.begun}, wrote {outside}, canary {touched}")
            for item in folder.parent.rglob("canary*"):
                item.unlink()
    text = f"{count} files, {refused} refused; no process but bcid's loaders, no file outside, canary untouched"
    return Reached(
        "60 hostile files: nothing is run, nothing else is read", text, not misses and count >= 60, tuple(misses)
    )


NAMES = (
    "../out",
    "/tmp/out",
    "a/../../out",
    "..",
    ".",
    "a\x00b",
    "a" * 300,
    "a/b",
    "a\\b",
    "",
    " ",
    "a\nb",
    "~/out",
    "$(touch out)",
)


def names() -> Reached:
    """S2: names in scenes and measurements, and links in a run folder, that would lead a file out of the run folder."""
    misses: list[str] = []
    count = 0
    with tempfile.TemporaryDirectory(prefix="bcid-") as outer:
        folder = Path(outer) / "inner"
        folder.mkdir()
        files = write_inputs(folder)
        before = _tree(Path(outer))
        for bad in NAMES:
            quoted = '"' + bad.replace("\\", "\\\\").replace("\x00", "\\u0000").replace("\n", "\\n") + '"'
            for what, text in _renamed(files["scene.toml"], quoted):
                count += 1
                (folder / "scene.toml").write_text(text, encoding="utf-8")
                with contextlib.suppress(BcidError):
                    scene = Scene.read(folder / "scene.toml")
                    if what != "name":
                        misses.append(f"{what} {bad!r}: accepted")
                    run = Run.start(folder / "run", "identify", {"scene": scene.name})
                    run.write_json("identification.json", {"scene": scene.name})
                    run.finish({})
                    Run.start(folder / "run", "identify", {}, overwrite=True).finish({})
            (folder / "scene.toml").write_text(files["scene.toml"], encoding="utf-8")
        new = [p for p in _tree(Path(outer)) - before if not p.startswith("inner/run")]
        misses += [f"made {p}" for p in new]
        count, found = count + 3, _links(folder)
        misses += found
    text = f"{count} names and links: nothing outside the run folder"
    return Reached(
        "names with ../, absolute, NUL, links, 300 characters: nothing outside the run folder",
        text,
        not misses,
        tuple(misses),
    )


def _renamed(text: str, quoted: str) -> Iterator[tuple[str, str]]:
    for what, old in (
        ("name", 'name = "slab"'),
        ("patches", '"1" = "patch_1"'),
        ("grasps", "I = {"),
        ("fiducials", '"16" ='),
    ):
        assert old in text
        key = f"name = {quoted}" if what == "name" else old.replace(old.split(" =")[0], quoted, 1)
        yield what, text.replace(old, key, 1)


def _tree(folder: Path) -> set[str]:
    return {str(p.relative_to(folder)) for p in folder.rglob("*")}


def _links(folder: Path) -> list[str]:
    """Links inside a run folder: what is overwritten, or discarded, is the link and not where it leads."""
    precious, misses = folder / "precious", []
    precious.mkdir()
    (precious / "kept.txt").write_text("kept", encoding="utf-8")
    run = Run.start(folder / "linked", "identify", {})
    run.finish({})
    (folder / "linked/outcomes").symlink_to(precious)
    (folder / "linked/identification.json").symlink_to(precious / "kept.txt")
    again = Run.start(folder / "linked", "identify", {}, overwrite=True)
    again.write_json("identification.json", {"a": 1})
    again.add_batch([{"a": 1}])
    again.finish({})
    if [p.name for p in precious.iterdir()] != ["kept.txt"] or (precious / "kept.txt").read_text() != "kept":
        misses.append(f"through a link: {[p.name for p in precious.iterdir()]}")
    return misses
