"""The documentation builds without a warning, and runs an example on the way."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

PROJECT = Path(__file__).resolve().parents[2]


@pytest.mark.slow
def test_the_site_is_built_without_warnings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # One example here; `./dev docs` runs all of them.
    monkeypatch.setenv("BCID_DOCS_EXAMPLES", "/04_")
    command = [sys.executable, "-m", "sphinx", "-q", "-W", "--keep-going", "-d", str(tmp_path / "trees")]
    made = subprocess.run(
        [*command, str(PROJECT / "docs"), str(tmp_path / "site")],
        cwd=PROJECT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert made.returncode == 0, made.stdout + made.stderr
    pages = {file.stem: file.read_text(encoding="utf-8") for file in (tmp_path / "site").rglob("*.html")}
    assert "with strain_stiffening" in re.sub("<[^>]+>", "", pages["04_tension"])
    for command_name in ("identify", "explain", "explore", "report"):
        assert f"bcid {command_name}" in pages["commands"]
    assert "mean log2 probability of the truth" in pages["validation"]
    results = (tmp_path / "site/results.html").read_text(encoding="utf-8")
    assert "Identification" in results
    assert "What it does not do" in results
    assert "scene.toml" in pages["first_answer"] or "slab.toml" in pages["first_answer"]
    # Pages link to each other, not to the Markdown they were made from.
    assert not [name for name, page in pages.items() if re.search(r'href="[^":]*\.md["#]', page)]


def test_everything_in_the_map_of_the_paper_is_there() -> None:
    text = (PROJECT / "docs/paper.md").read_text(encoding="utf-8")
    files = re.findall(r"`((?:bcid|validation)/[\w/.-]+)`", text)
    assert len(files) > 10
    assert not [file for file in files if not (PROJECT / file).exists()]
