"""Every example runs, and its numbers are the ones it promises."""

import importlib.util
from pathlib import Path
from types import ModuleType

import pytest

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"


def load(name: str) -> ModuleType:
    specification = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    assert specification is not None
    assert specification.loader is not None
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module


def test_01_identify(capsys: pytest.CaptureFixture[str]) -> None:
    found = load("01_identify").main()
    assert found.anchored == ("3", "4")
    assert found.probability > 0.999
    assert found.rms == pytest.approx(0.304e-3, rel=0.01)
    assert "anchored: 3 4" in capsys.readouterr().out


def test_every_example_has_a_test() -> None:
    tested = Path(__file__).read_text(encoding="utf-8")
    assert all(f'load("{path.stem}")' in tested for path in EXAMPLES.glob("[0-9]*.py"))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "anchored"), [("slab-12-semicircle", "12"), ("slab-1234-semicircle", "1234"), ("slab-27-five", "27")]
)
def test_the_lab_measurements_are_identified(name: str, anchored: str) -> None:
    """Made by an independent code; the fourth is the example's."""
    from bcid import Measurement, Scene, identify

    scene = Scene.read(EXAMPLES / "scenes/slab.toml")
    found = identify(scene, Measurement.read(EXAMPLES / "measurements" / name))
    assert found.anchored == tuple(anchored)
    assert found.probability > 0.999
    assert found.rms < 1.1 * found.noise
    assert sum(found.evaluations.values()) < 260
