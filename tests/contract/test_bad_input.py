"""Thousands of broken folders and scenes: each is read right or refused in words, never with another exception."""

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from bcid import Measurement, Scene
from bcid.base.errors import InputError
from bcid.forms.model import check_physics

ROOT = Path(__file__).resolve().parents[2]
MEASURED = ROOT / "examples/measurements/slab-34-complex"
FILES = {
    name: (MEASURED / name).read_text(encoding="utf-8").splitlines()[:60]
    for name in ("measurement.toml", "fiducials.csv", "grasps.csv")
}
SCENE = (ROOT / "examples/scenes/slab.toml").read_text(encoding="utf-8").replace("../../", f"{ROOT}/").splitlines()
NASTY = [
    "",
    " ",
    "nan",
    "NaN",
    "inf",
    "-1",
    "1e400",
    "1_0",
    "0x1",
    "true",
    "\t",
    '"',
    "'",
    "\\",
    ",",
    ";",
    "\x00",
    "\ufeff",
    "µ",
    "١",
    "1,5",
    "[",
    "]",
    "=",
    "#",
]


def common(count: int) -> settings:
    return settings(deadline=None, suppress_health_check=list(HealthCheck), derandomize=True, max_examples=count)


tokens = st.one_of(st.sampled_from(NASTY), st.text(max_size=6), st.integers(-9, 10**12).map(str), st.floats().map(repr))


@st.composite
def broken(draw: st.DrawFn, lines: list[str], separator: str) -> list[str]:
    """The lines with a few cells replaced, and lines dropped, doubled, swapped or cut."""
    lines = list(lines)
    for _ in range(draw(st.integers(1, 3))):
        if not lines:
            break
        i = draw(st.integers(0, len(lines) - 1))
        kind = draw(st.sampled_from(["cell", "cell", "cell", "drop", "double", "swap", "cut", "insert", "truncate"]))
        if kind == "cell":
            cells = lines[i].split(separator)
            cells[draw(st.integers(0, len(cells) - 1))] = draw(tokens)
            lines[i] = separator.join(cells)
        elif kind == "drop":
            del lines[i]
        elif kind == "double":
            lines.insert(draw(st.integers(0, len(lines))), lines[i])
        elif kind == "swap":
            j = draw(st.integers(0, len(lines) - 1))
            lines[i], lines[j] = lines[j], lines[i]
        elif kind == "cut":
            lines[i] = lines[i][: draw(st.integers(0, len(lines[i])))]
        elif kind == "insert":
            lines.insert(i, draw(tokens))
        else:
            del lines[i:]
    return lines


def put(path: Path, lines: list[str]) -> None:
    path.write_bytes("\n".join(lines).encode("utf-8", "surrogatepass"))


def attempt(read: Callable[[], Any]) -> tuple[Any, str]:
    """What was read and "", or None and the message it was refused with."""
    try:
        return read(), ""
    except InputError as error:
        return None, str(error)


def readable(text: str) -> bool:
    """A message with a place and a reason, of bounded length."""
    return ":" in text and len(text) > 20 and len(text.splitlines()) <= 22


@pytest.mark.parametrize("name", list(FILES))
def test_broken_measurement_folders(name: str, tmp_path: Path) -> None:
    folder = tmp_path / "seen"
    shutil.copytree(MEASURED, folder)
    for file, lines in FILES.items():
        put(folder / file, lines)

    @common(1200)
    @given(broken(FILES[name], "=" if name.endswith("toml") else ","))
    def check(lines: list[str]) -> None:
        put(folder / name, lines)
        measurement, said = attempt(lambda: Measurement.read(folder))
        if measurement is None:
            assert readable(said)
            assert any(file in said for file in (name, "fiducials.csv", "grasps.csv"))
        else:
            assert len(measurement.positions)
            assert measurement.actions

    check()


def test_broken_scenes(tmp_path: Path) -> None:
    path = tmp_path / "scene.toml"

    @common(1500)
    @given(broken(SCENE, "="))
    def check(lines: list[str]) -> None:
        put(path, lines)
        scene, said = attempt(lambda: Scene.read(path, physics=check_physics))
        if scene is None:
            assert readable(said)
            assert "scene.toml" in said
        else:
            assert scene.patches
            assert scene.levels

    check()


def test_random_bytes(tmp_path: Path) -> None:
    folder = tmp_path / "seen"
    shutil.copytree(MEASURED, folder)

    @common(300)
    @given(st.binary(max_size=200), st.sampled_from(list(FILES)))
    def check(content: bytes, name: str) -> None:
        kept = (folder / name).read_bytes()
        (folder / name).write_bytes(content)
        (tmp_path / "scene.toml").write_bytes(content)
        with pytest.raises(InputError):
            Measurement.read(folder)
        with pytest.raises(InputError):
            Scene.read(tmp_path / "scene.toml")
        (folder / name).write_bytes(kept)

    check()
