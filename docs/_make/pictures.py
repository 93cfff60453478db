"""Makes the pictures of the README and the documentation: ``./dev python docs/_make/pictures.py [NAME...]`` (some minutes).

demo.png, report.png, explore.png and tracking.png; ``bcid-validate synthetic`` draws study.png and blind_bench.png in some hours.
"""

from __future__ import annotations

import importlib.util
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

from bcid.report.export import draw_pictures

DOCS = Path(__file__).resolve().parents[1]
PROJECT = DOCS.parent
SCENE = PROJECT / "examples/scenes/slab_explain.toml"
BROWSERS = ("chromium-headless-shell", "chromium", "chromium-browser", "google-chrome")


def bcid(*arguments: object) -> None:
    """Run a command."""
    subprocess.run([sys.executable, "-m", "bcid", *map(str, arguments)], check=True, cwd=PROJECT)


def demo(folder: Path) -> None:
    """The demo's picture, and the first screen of its report."""
    bcid("demo", "-o", folder / "demo", "--quiet")
    shutil.copyfile(folder / "demo/picture.png", DOCS / "demo.png")
    _screen(folder / "demo/report.html", DOCS / "report.png")


def _screen(page: Path, target: Path) -> None:
    """A page as a browser shows it, with the first model chosen: what is missing is seen then."""
    from playwright.sync_api import sync_playwright

    program = next(found for name in BROWSERS if (found := shutil.which(name)))
    flags = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--disable-gpu"]
    with sync_playwright() as play:
        browser = play.chromium.launch(executable_path=program, args=flags)
        shown = browser.new_page(viewport={"width": 1160, "height": 1240})
        shown.goto(page.as_uri())
        shown.wait_for_selector("figure.live[data-frame]")
        shown.locator("select.model").first.select_option("0")
        shown.evaluate("scrollTo(0, 0)")
        shown.screenshot(path=target)
        browser.close()


def explore(folder: Path) -> None:
    """The belief of an exploration with a noise far above that of a camera."""
    chosen = ("--robot", "simulated:1,2", "--noise", "4 mm", "--seed", 1, "--quiet")
    bcid("explore", SCENE, *chosen, "-o", folder / "explored")
    shutil.copyfile(folder / "explored/posterior.png", DOCS / "explore.png")


def tracking(folder: Path) -> None:
    """What is found in the images that example 05 renders."""
    specification = importlib.util.spec_from_file_location("from_images", PROJECT / "examples/05_from_images.py")
    assert specification is not None
    assert specification.loader is not None
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    module.main(folder)
    draw_pictures(folder / "tracked")
    shutil.copyfile(folder / "tracked/tracking.png", DOCS / "tracking.png")


PICTURES: dict[str, Callable[[Path], None]] = {"demo": demo, "explore": explore, "tracking": tracking}


def main(names: list[str]) -> None:
    """Make the pictures that are named, all by default."""
    for name in names or list(PICTURES):
        with TemporaryDirectory() as folder:
            PICTURES[name](Path(folder))
        print(f"{name}: made", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
