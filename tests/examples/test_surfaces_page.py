"""What docs/surfaces.md shows: its tables are taken, and its first commands make a body without markers."""

import re
import shlex
import tomllib
from pathlib import Path

import pytest

from bcid.app.cli import main
from bcid.base.errors import Problems
from bcid.measurement import Measurement
from bcid.measurement.surface_files import SurfaceFiles

PROJECT = Path(__file__).resolve().parents[2]
PAGE = (PROJECT / "docs/surfaces.md").read_text(encoding="utf-8")


def test_tables_of_the_page_are_taken() -> None:
    found = []
    for text in re.findall(r"^```toml\n(.*?)^```", PAGE, re.M | re.S):
        problems = Problems("page")
        found.append(SurfaceFiles.checked(tomllib.loads(text)["surface"], 1e-3, Path("page"), problems))
        problems.raise_if_any()
    assert [one is not None and one.depth for one in found] == [False, True]


def test_a_body_without_markers_is_simulated(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (simulate, remove, identify) = re.findall(r"^```sh\n(.*?)^```", PAGE, re.M | re.S)[0].strip().splitlines()
    monkeypatch.chdir(tmp_path)
    (tmp_path / "examples").symlink_to(PROJECT / "examples")
    words = shlex.split(simulate)[1:]
    # A coarser level than the page's.
    words[words.index("--level") + 1] = "0"
    assert main([*words, "--steps", "2", "--quiet"]) == 0
    (tmp_path / shlex.split(remove)[-1]).unlink()
    seen = Measurement.read(tmp_path / "seen")
    assert seen.cloud is not None
    assert len(seen.cloud.points) == 3 * 1000
    assert shlex.split(identify)[1:4] == ["identify", "examples/scenes/slab.toml", "seen"]
