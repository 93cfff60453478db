"""Nothing that a run folder holds becomes a script, markup or an address of a report."""

from __future__ import annotations

import base64
import hashlib
import json
import re
from html.parser import HTMLParser
from pathlib import Path
from xml.etree import ElementTree

import pytest
import runs
from payloads import PAYLOADS, file_name, poisoned

from bcid.report import gallery, page
from bcid.report.text import clean

ELEMENTS = re.findall(
    r"\w+",
    "html head meta title style body header main footer nav section figure figcaption div span p b h1 h2 h3 dl dt dd ul ol li a "
    "table thead tbody tr th td details summary pre canvas label select option input button output img script "
    "svg g path text rect circle",
)


class Parsed(HTMLParser):
    """What a page consists of: elements with their attributes, scripts, visible text."""

    def __init__(self, source: str) -> None:
        super().__init__(convert_charrefs=True)
        self.elements: list[tuple[str, dict[str, str]]] = []
        self.scripts: list[tuple[str, str]] = []
        self.styles: list[str] = []
        self.comments: list[str] = []
        self.texts: list[str] = []
        self._open = ""
        self.feed(source)
        self.close()

    def handle_starttag(self, name: str, attributes: list[tuple[str, str | None]]) -> None:
        self.elements.append((name, {key: value or "" for key, value in attributes}))
        self._open = name
        if name == "script":
            self.scripts.append((dict(attributes).get("type") or "", ""))

    def handle_endtag(self, name: str) -> None:
        self._open = ""

    def handle_data(self, data: str) -> None:
        if self._open == "script":
            self.scripts[-1] = (self.scripts[-1][0], self.scripts[-1][1] + data)
        elif self._open == "style":
            self.styles.append(data)
        else:
            self.texts.append(data)

    def handle_comment(self, data: str) -> None:
        self.comments.append(data)


def harmless(source: str) -> Parsed:
    """Assert that a page has no elements, scripts and addresses but bcid's own."""
    found = Parsed(source)
    policies = []
    for name, attributes in found.elements:
        assert name in ELEMENTS, name
        for key, value in attributes.items():
            assert not key.startswith("on"), (name, key)
            assert key not in ("style", "action", "formaction", "srcdoc", "srcset", "background"), (name, key)
            assert "url(" not in value or key in ("alt", "value"), (name, value)
            if key == "href":
                assert value.startswith("#"), (name, value[:80])
            if key == "src":
                image = re.fullmatch(r"data:image/(png|svg\+xml);base64,([A-Za-z0-9+/=]+)", value)
                assert image, (name, value[:80])
                if image[1] == "svg+xml":
                    ElementTree.fromstring(base64.b64decode(image[2]))
        if name == "meta" and "http-equiv" in attributes:
            policies.append(attributes["content"])
    assert len(policies) == 1
    assert policies[0].startswith("default-src 'none'; img-src data:;")
    assert "unsafe" not in policies[0]
    own = {hashlib.sha256(page._web("viewer.js").encode()).digest(), hashlib.sha256(page._three().encode()).digest()}
    for kind, content in found.scripts:
        if kind == "application/json":
            json.loads(content)
        else:
            digest = hashlib.sha256(content.encode()).digest()
            assert kind == "module"
            assert digest in own
            assert f"'sha256-{base64.b64encode(digest).decode()}'" in policies[0]
    assert found.styles == [page._web("page.css")]
    assert found.comments == [" bcid-report/1 "]
    return found


@pytest.fixture
def plain_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pictures without VTK, which takes seconds; names do not come into its images but as labels."""
    from matplotlib.figure import Figure

    for name in ("residual_figure", "body_figure", "discrepancy_figure"):
        monkeypatch.setattr(gallery, name, lambda *_: Figure(figsize=(2, 1)))


def test_fifty_payloads() -> None:
    assert len(set(PAYLOADS)) == 50


@pytest.mark.usefixtures("plain_pictures")
@pytest.mark.parametrize("number", range(50))
def test_a_payload_stays_text(tmp_path: Path, number: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """In the tables and sentences of every payload, and in every figure; a figure is drawn with a third of the payloads."""
    payload, every = PAYLOADS[number], gallery.drawings
    monkeypatch.setattr(gallery, "drawings", lambda found: every(found)[number % 3 :: 3])
    folder = poisoned(tmp_path / file_name(payload), payload)
    report = page.write_report([folder], tmp_path / "report.html")
    source = report.path.read_text(encoding="utf-8")
    found = harmless(source)
    # It is there to be read, in the page and in what the view shows.
    words = " ".join("".join(found.texts).split())
    assert " ".join(clean(payload)[:200].split()) in words
    if "$" not in payload:
        assert report.troubles == {}, report.troubles
    data = [json.loads(content) for kind, content in found.scripts if kind == "application/json"]
    assert len(data) == 1
    assert clean(payload.replace("\x00", "").replace("\ud800", "?")) in data[0]["actions"]


@pytest.mark.usefixtures("plain_pictures")
def test_payloads_in_damaged_and_unfinished_runs(tmp_path: Path) -> None:
    """Messages about what is wrong quote it, and so do they."""
    folders = []
    for i, payload in enumerate(PAYLOADS[:12]):
        run = runs.started(tmp_path / f"failed-{i}")
        run.fail(payload)
        folders.append(run.path)
    unit = runs.explained(tmp_path / "unit")
    found = runs.diagnosis() | {"length_unit": PAYLOADS[0], "rms": PAYLOADS[2], "noise_rms": PAYLOADS[3]}
    runs.rewrite(unit, "diagnosis.json", json.dumps(found))
    broken = runs.explained(tmp_path / file_name(PAYLOADS[2]))
    runs.rewrite(broken, "diagnosis.json", PAYLOADS[0])
    (broken / "body.nc").write_text(PAYLOADS[0], encoding="utf-8")
    gone = tmp_path / file_name(PAYLOADS[4])
    report = page.write_report([*folders, unit, broken, gone], tmp_path / "report.html")
    harmless(report.path.read_text(encoding="utf-8"))
    assert set(report.troubles) == {unit, broken, gone}
