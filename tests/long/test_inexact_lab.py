"""Two measurements of an independent code in which everything that a scene states is slightly wrong: `tests/data/lab2`."""

from __future__ import annotations

from pathlib import Path

from bcid import Measurement, Scene
from bcid.base.options import IdentifyOptions
from bcid.search.answer.identification import Identification
from bcid.search.identify import identify


def identified(project: Path, body: str, *start: frozenset[str]) -> Identification:
    """On the second level, beginning with these sets."""
    folder = project / "tests" / "data" / "lab2"
    scene, measurement = Scene.read(folder / f"scenes/{body}.toml"), Measurement.read(folder / f"nuisance-{body}")
    return identify(scene, measurement, options=IdentifyOptions(level=1), start=start)


def test_a_body_of_which_nothing_is_hidden_is_explained(project: Path) -> None:
    """The best set misses by 2.8 times the noise, and yet nothing is missing."""
    assert (found := identified(project, "block")).noise_rms
    assert found.anchored == ("1", "6")
    assert found.probability > 0.99
    assert found.rms > 2.5 * found.noise_rms
    assert found.adequate
    assert found.discrepancy_probability is not None
    assert found.discrepancy_probability < 0.5
    assert not any(one.exceeds_prior for one in found.input_uncertainties)


def test_the_anchors_are_seen_although_gravity_is_missing(project: Path) -> None:
    """Others fit the measurement better; weighed with an unknown force in the place of gravity, the true ones are found."""
    found = identified(project, "organ", frozenset("45"))
    assert found.anchored == ("1", "4")
    assert found.probability > 0.95
    assert not found.adequate
    assert not any(one.exceeds_prior for one in found.input_uncertainties)
