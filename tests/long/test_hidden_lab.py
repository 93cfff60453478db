"""Measurements of the lab with a hidden effect, computed by an independent finite element code (noise 0.2 mm).

Reduced to two of their five pulls; `bcid explain` with the whole measurement is the README's command.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from bcid import Measurement, Scene
from bcid.predict.predictor import Predictor
from bcid.search.answer.explanation import Explanation
from bcid.search.explain import explain

# Of two grasps, in two directions.
PULLS = "14"


def explained(project: Path, folder: Path) -> Explanation:
    scene = Scene.read(project / "examples" / "scenes" / "slab_explain.toml")
    whole = Measurement.read(folder)
    frames = np.concatenate([action.frames for action in whole.actions if action.name in PULLS])
    predictor = Predictor(scene, replace(whole, data=whole.data.isel(frame=frames)), MPI.COMM_SELF)
    try:
        return explain(predictor)
    finally:
        predictor.destroy()


def test_hidden_fibres_are_named_and_measured(project: Path, measurement_folder: Callable[[str], Path]) -> None:
    found = explained(project, measurement_folder("hidden-a"))
    assert found.verdict == "fibres"
    assert found.last.state.anchors == {"3", "4"}
    assert found.last.fitted.values["fibres.k1"] == pytest.approx(5000.0, rel=0.15)
    assert found.last.fitted.values["fibres.angle"] == pytest.approx(30.0, rel=0.15)
    assert found.last.held_out is not None
    # The noise of the other actions is in what they tell of the scene: nothing of that is wrong here.
    assert found.last.held_out < 1.1 * found.last.state.noise


def test_where_nothing_is_hidden_nothing_is_found(project: Path, measurement_folder: Callable[[str], Path]) -> None:
    found = explained(project, measurement_folder("hidden-d"))
    assert found.verdict == "none"
    assert found.last.state.anchors == {"3", "4"}
    assert found.last.adequacy.adequate
