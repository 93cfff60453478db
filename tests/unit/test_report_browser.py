"""A report as a reader sees it: in headless Chromium, opened from disk."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import runs
from payloads import PAYLOADS, file_name, poisoned

from bcid.report import gallery
from bcid.report.found import Found
from bcid.report.page import write_report
from bcid.report.residual import Residual, residuals_of, rms

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

PROGRAMS = ("chromium-headless-shell", "chromium", "chromium-browser", "google-chrome", "chrome")
ARGUMENTS = [
    "--no-sandbox",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-gpu",
    "--no-first-run",
    "--disable-background-networking",
]


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    program = next((found for name in PROGRAMS if (found := shutil.which(name))), None)
    assert program, f"no browser: none of {', '.join(PROGRAMS)} is installed (./dev has chromium-headless-shell)"
    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        pytest.fail("no browser: the Python package playwright is not installed (the extra 'test')")
    with sync_playwright() as play:
        opened = play.chromium.launch(executable_path=program, args=ARGUMENTS)
        yield opened
        opened.close()


class Visit:
    """A page that is looked at, and what it did unasked."""

    def __init__(self, browser: Browser, file: Path, width: int = 1280, script: bool = True) -> None:
        self.page: Page = browser.new_page(viewport={"width": width, "height": 800}, java_script_enabled=script)
        self.unasked: list[str] = []
        self.page.on("dialog", lambda dialog: (self.unasked.append(f"dialog {dialog.message}"), dialog.dismiss()))
        self.page.on("console", self._told)
        self.page.on("pageerror", lambda error: self.unasked.append(f"error {error}"))
        self.page.on("request", lambda request: self._asked(request.url, file.as_uri()))
        self.page.goto(file.as_uri())

    def _told(self, message: Any) -> None:
        # The software renderer tells of its speed.
        if "GL Driver Message" not in message.text:
            self.unasked.append(f"{message.type} {message.text}")

    def _asked(self, url: str, own: str) -> None:
        if url != own and not url.startswith("data:image/png"):
            self.unasked.append(f"request {url[:200]}")

    def live(self) -> Any:
        """The view, once it is drawn."""
        self.page.locator("figure[data-view]").scroll_into_view_if_needed()
        self.page.wait_for_selector("figure.live[data-frame]")
        return self.page.locator("figure.live")

    def set_frame(self, frame: int) -> None:
        self.page.locator("input.frame").evaluate(f"e => {{ e.value = {frame}; e.dispatchEvent(new Event('input')); }}")

    def pixels(self) -> np.ndarray:
        import io

        from PIL import Image

        picture = self.page.locator("canvas").screenshot()
        return np.asarray(Image.open(io.BytesIO(picture)).convert("RGB"), dtype=int)


@pytest.fixture
def visit(browser: Browser) -> Iterator[Callable[..., Visit]]:
    """Opens pages; in the end none of them has asked for anything, or told of an error."""
    made: list[Visit] = []

    def open_page(file: Path, **more: Any) -> Visit:
        made.append(Visit(browser, file, **more))
        return made[-1]

    yield open_page
    for one in made:
        one.page.close()
        assert one.unasked == []


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of a run of `explain` and one of `explore`."""
    folder = tmp_path_factory.mktemp("report")
    with pytest.MonkeyPatch.context() as patch:
        _without_vtk(patch)
        made = [runs.explained(folder / "explained"), runs.explored(folder / "explored")]
        return write_report(made, folder / "report.html").path


def _without_vtk(patch: pytest.MonkeyPatch) -> None:
    def drawn(*_: Any) -> Any:
        from matplotlib.figure import Figure

        figure = Figure(figsize=(6, 4))
        figure.text(0.4, 0.5, "the body")
        return figure

    for name in ("residual_figure", "body_figure", "discrepancy_figure"):
        patch.setattr(gallery, name, drawn)


def _residual(report: Path) -> Residual:
    return residuals_of(Found.read(report.parent / "explained"))


def test_slider_and_numbers(report: Path, visit: Callable[..., Visit]) -> None:
    seen = visit(report)
    view = seen.live()
    residual = _residual(report)
    assert view.locator(".where").text_content() == "action 2, step 3, grasp I"
    before = seen.pixels()
    assert (before.max(axis=2) - before.min(axis=2) > 40).sum() > 500, "nothing coloured is drawn"
    for model, name in enumerate(residual.models):
        view.locator("select.model").select_option(str(model))
        for frame in (0, 2, 5):
            seen.set_frame(frame)
            assert view.locator(".where").text_content() == f"action {1 + frame // 4}, step {frame % 4}, grasp I"
            assert view.locator(".rms").text_content() == f"{rms(residual.models[name][frame]):.3g} mm"
    assert view.locator(".count").text_content() == "3 of 3"
    seen.set_frame(2)
    assert view.locator(".count").text_content() == "2 of 3"
    lengths = np.linalg.norm(residual.models[residual.last][2], axis=1)
    worst = int(np.nanargmax(lengths))
    wanted = f"{lengths[worst]:.3g} mm at fiducial {'abc'[worst]}"
    assert view.locator(".worst").text_content() == wanted
    assert (np.abs(seen.pixels() - before).max(axis=2) > 30).sum() > 200, "the picture does not follow the slider"


def test_turning_scale_and_colours(report: Path, visit: Callable[..., Visit]) -> None:
    seen = visit(report)
    view = seen.live()

    def differs(before: np.ndarray) -> np.ndarray:
        after = seen.pixels()
        assert (np.abs(after - before).max(axis=2) > 30).sum() > 100
        return after

    picture = seen.pixels()
    box = seen.page.locator("canvas").bounding_box()
    assert box is not None
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    seen.page.mouse.move(x, y)
    seen.page.mouse.down()
    seen.page.mouse.move(x + 120, y + 20, steps=4)
    seen.page.mouse.up()
    picture = differs(picture)
    seen.page.locator("canvas").press("ArrowLeft")
    picture = differs(picture)
    view.locator(".nearer").click()
    picture = differs(picture)
    view.locator("select.scale").select_option("1")
    view.locator("select.model").select_option("0")
    picture = differs(picture)
    view.locator("select.shown").select_option("chance")
    differs(picture)
    assert view.locator(".labels").text_content() == "left: 99 %right: 3 %"
    view.locator(".reset").click()


def test_the_surface_is_coloured_by_what_is_asked_for(report: Path, visit: Callable[..., Visit]) -> None:
    seen = visit(report)
    view = seen.live()
    # The last model, and the frame in which the first one misses most.
    assert view.locator("select.model").input_value() == "1"
    choices = view.locator("select.shown option").all_text_contents()
    assert choices == ["anchors", "probability", "displacement", "strain energy", "residual (interpolated)"]
    plain = seen.pixels()
    most = {}
    for name in ("displacement", "energy", "residual"):
        view.locator("select.shown").select_option(name)
        most[name] = str(view.locator(".shade-most").text_content())
        painted = seen.pixels()
        assert (np.abs(painted - plain).max(axis=2) > 30).sum() > 2000, name
    # The far end of the slab moves 20 mm; 99 % of the energy that is there stays below its largest value, 40.
    assert most["displacement"] == "20 mm"
    assert most["energy"].endswith(" J/m³")
    assert 20 < float(most["energy"].split()[0]) <= 40
    largest = np.nanmax(np.linalg.norm(_residual(report).models["neo-Hookean + gravity"], axis=2))
    assert most["residual"] == f"{largest:.3g} mm"
    # Yellow where it moves most, dark blue where it is held.
    view.locator("select.shown").select_option("displacement")
    shades = seen.pixels().reshape(-1, 3)
    assert (np.abs(shades - [0, 34, 78]).max(axis=1) < 25).any()
    assert (np.abs(shades - [253, 231, 55]).max(axis=1) < 45).any()


def test_axes_scale_and_labels_turn_with_the_body(report: Path, visit: Callable[..., Visit]) -> None:
    seen = visit(report)
    view = seen.live()
    bar = view.locator(".bar").bounding_box()
    length = float(str(view.locator(".bar-text").text_content()).removesuffix(" mm"))
    assert bar is not None
    # The slab is 80 by 20 by 80 mm, and fills the picture in one direction.
    size = seen.pixels().shape
    assert 60 < min(size[:2]) / bar["width"] * length < 150

    def way(axis: str) -> float:
        """How far an arrow of the key goes down the page."""
        begin, _, tip, *_ = re.findall(r"[ML]\S+ (\S+)", str(view.locator(f".axis-{axis} path").get_attribute("d")))
        return float(tip) - float(begin)

    assert way("y") < -10, "y is up"
    assert way("g") > 10, "gravity is down"
    # With solid patches the far one hides its name; from the other side it is the other one.
    view.locator("select.shown").select_option("displacement")
    hidden = "[...document.querySelectorAll('.labels span')].map(e => e.hidden)"
    before = seen.page.evaluate(hidden)
    assert sorted(before) == [False, True]
    seen.page.evaluate("document.querySelector('figure.live').querySelector('canvas').focus()")
    for _ in range(33):
        seen.page.locator("canvas").press("ArrowLeft")
    assert seen.page.evaluate(hidden) == [not one for one in before]


def test_on_a_phone(report: Path, visit: Callable[..., Visit]) -> None:
    seen = visit(report, width=360)
    seen.live()
    inside = "!e.closest('.table, svg, .labels, script')"
    beyond = "e.getBoundingClientRect().right > innerWidth + 0.5"
    broad = (
        f"[...document.querySelectorAll('body *')].filter(e => {inside} && {beyond}).map(e => e.outerHTML.slice(0, 80))"
    )
    assert seen.page.evaluate(broad) == []
    assert seen.page.evaluate("document.documentElement.scrollWidth") == 360


def test_printed(report: Path, visit: Callable[..., Visit], tmp_path: Path) -> None:
    """The picture stands for the canvas, runs begin on pages of their own."""
    seen = visit(report)
    seen.live()
    made = seen.page.pdf(format="A4")
    assert made.startswith(b"%PDF")
    assert made.count(b"/Type /Page\n") + made.count(b"/Type /Page ") + made.count(b"/Type/Page") >= 2
    seen.page.emulate_media(media="print")
    assert not seen.page.locator("canvas").is_visible()
    assert not seen.page.locator(".controls").first.is_visible()
    assert seen.page.locator(".stage img").is_visible()


def test_every_image_is_drawn(report: Path, visit: Callable[..., Visit]) -> None:
    sizes = visit(report).page.evaluate("[...document.images].map(e => e.naturalWidth)")
    assert len(sizes) == 11
    assert min(sizes) > 100


def test_without_scripts(report: Path, visit: Callable[..., Visit]) -> None:
    """The picture stays, and controls that would do nothing are not there."""
    seen = visit(report, script=False)
    assert seen.page.locator(".stage img").is_visible()
    assert not seen.page.locator("canvas").is_visible()
    assert not seen.page.locator(".controls").first.is_visible()


def test_no_payload_runs(tmp_path: Path, visit: Callable[..., Visit], monkeypatch: pytest.MonkeyPatch) -> None:
    """All fifty on pages of ten; the fixture holds that nothing was asked for and nothing told."""
    _without_vtk(monkeypatch)
    monkeypatch.setattr("bcid.report.section.gallery.drawings", _few)
    for begin in range(0, 50, 10):
        folders = [
            poisoned(tmp_path / f"{i}{file_name(PAYLOADS[i])}"[:60], PAYLOADS[i]) for i in range(begin, begin + 10)
        ]
        seen = visit(write_report(folders, tmp_path / f"{begin}.html").path, width=360)
        for i in range(10):
            view = seen.page.locator("figure[data-view]").nth(i)
            view.scroll_into_view_if_needed()
            seen.page.wait_for_selector(f"figure[data-view=view-run-{i + 1}][data-frame]")
            view.locator("select.shown").select_option("chance")
            view.locator("input.frame").press("ArrowLeft")
        assert seen.page.evaluate("document.querySelectorAll('script').length") == 12
        assert (
            seen.page.evaluate(
                "document.querySelectorAll('iframe, object, embed, link, base, form, video, math').length"
            )
            == 0
        )


def _few(found: Any) -> list[gallery.Drawing]:
    """One chart with names is enough here: `test_report_safety` looks at all of them."""
    return [drawing for drawing in gallery_drawings(found) if drawing.name == "models"]


gallery_drawings = gallery.drawings
