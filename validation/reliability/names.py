"""S2: names in scenes, measurements and run folders that would lead out of the run folder."""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Iterator
from pathlib import Path

from bcid import Scene
from bcid.base.errors import BcidError
from bcid.base.run_folder import RunFolder
from validation.reliability import Reached
from validation.reliability.inputs import write_inputs

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
                    run = RunFolder.start(folder / "run", "identify", {"scene": scene.name})
                    run.write_json("identification.json", {"scene": scene.name})
                    run.finish({})
                    RunFolder.start(folder / "run", "identify", {}, overwrite=True).finish({})
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
    makes = ("identification.json", "paraview/")
    run = RunFolder.start(folder / "linked", "identify", {}, makes=makes)
    run.finish({})
    (folder / "linked/paraview").symlink_to(precious)
    (folder / "linked/identification.json").symlink_to(precious / "kept.txt")
    again = RunFolder.start(folder / "linked", "identify", {}, overwrite=True, makes=makes)
    again.write_json("identification.json", {"a": 1})
    again.finish({})
    if [p.name for p in precious.iterdir()] != ["kept.txt"] or (precious / "kept.txt").read_text() != "kept":
        misses.append(f"through a link: {[p.name for p in precious.iterdir()]}")
    return misses
