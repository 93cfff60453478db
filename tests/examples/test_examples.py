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


def test_02_explain(capsys: pytest.CaptureFixture[str]) -> None:
    """The weight that the measurement was made with is found within its error."""
    found = load("02_explain").main()
    assert found.verdict == "gravity"
    assert [sorted(rung.state.anchors) for rung in found.rungs] == [["3", "4"]] * 2
    assert [rung.adequacy.adequate for rung in found.rungs] == [False, True]
    assert found.rungs[0].state.rms == pytest.approx(1.41e-3, rel=0.01)
    assert found.last.state.rms == pytest.approx(0.211e-3, rel=0.02)
    weight = found.last.fitted.values["gravity.weight"]
    assert weight == pytest.approx(1260, abs=3 * found.last.fitted.stderr["gravity.weight"])
    assert "missing: gravity" in capsys.readouterr().out


@pytest.mark.slow
def test_the_measurement_to_be_explained_is_made_again(tmp_path: Path) -> None:
    load("make_slab_34_heavy").main(tmp_path / "made")
    shipped = EXAMPLES / "measurements/slab-34-heavy"
    for file in shipped.iterdir():
        assert (tmp_path / "made" / file.name).read_bytes() == file.read_bytes()


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
