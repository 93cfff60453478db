"""Measurements made by an independent code: with the true anchors the residual is the noise that was added, 0.3 mm.

They were computed with quadratic elements of 6 mm, E = 15 kPa, nu = 0.35; white noise was added to every coordinate.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bcid import Measurement, Scene
from bcid.forms.forward import Forward
from bcid.scene import Level


@pytest.fixture(scope="module")
def fine(project: Path) -> Iterator[Forward]:
    scene = Scene.read(project / "examples" / "scenes" / "slab.toml")
    forward = Forward(replace(scene, levels=(Level(2, 0.006),)))
    yield forward
    forward.destroy()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "anchors"), [("slab-12-semicircle", "12"), ("slab-34-complex", "34"), ("slab-1234-semicircle", "1234")]
)
def test_the_residual_with_the_true_anchors_is_the_noise(
    fine: Forward, measurement_folder: Callable[[str], Path], name: str, anchors: str
) -> None:
    measurement = Measurement.read(measurement_folder(name))
    measurement.check(fine.scene)
    prediction = fine.predict(anchors, measurement.actions)
    assert prediction.complete
    residual = prediction.positions - measurement.positions
    assert np.sqrt(np.nanmean(residual**2)) * 1e3 == pytest.approx(0.30, rel=0.05)
    # No frame, fiducial or axis stands out: a discrepancy hidden by the average would.
    for axes in ((1, 2), (0, 2), (0, 1)):
        assert np.sqrt(np.nanmean(residual**2, axis=axes)).max() * 1e3 < 0.45
