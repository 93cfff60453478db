"""Whatever an evaluation of a hypothesis raises costs that hypothesis alone: the run ends, and says what it skipped."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import bcid
from bcid import ExplainOptions, Measurement, Scene
from bcid.base.errors import InputError
from bcid.base.options import IdentifyOptions
from bcid.forms import effects
from bcid.forms.forward import Forward
from bcid.forms.model import Model, Term, check_physics
from bcid.forms.sensitivity import Sensitivity
from bcid.forms.set_tangent import SetTangent, SetTangents
from bcid.forms.simulate import simulate
from bcid.measurement import Action
from bcid.scene import Level

ANCHORED = ("3", "4")
ERRORS: tuple[Callable[[], Exception], ...] = (
    lambda: InputError("an incompressible body (poisson = 0.5) needs the mixed formulation"),
    lambda: RuntimeError("a failure inside of a library"),
    lambda: AssertionError(),
    lambda: np.linalg.LinAlgError("singular matrix"),
    lambda: ZeroDivisionError("float division by zero"),
)
EVALUATIONS: dict[str, tuple[type, str]] = {
    "prediction": (Forward, "predict"),
    "sensitivities": (Sensitivity, "of"),
    "tangents of sets": (SetTangents, "of"),
    "other sets": (SetTangent, "all_moved"),
    "fields": (Forward, "detail"),
}


@pytest.fixture(scope="module")
def slab(project: Path) -> Scene:
    scene = Scene.read(project / "examples" / "scenes" / "slab.toml", physics=check_physics)
    patches = {name: scene.patches[name] for name in "1234"}
    return replace(scene, patches=patches, levels=tuple(Level(1, size) for size in (0.05, 0.03)), noise_sigma=0.2e-3)


@pytest.fixture(scope="module")
def measurement(slab: Scene) -> Measurement:
    steps, still = np.arange(4), np.tile([1.0, 0.0, 0.0, 0.0], (4, 1))
    pulls = [
        Action(str(k + 1), k * 4 + steps, steps, grasp, 0.003 * steps[:, None] * np.array(way, float), still)
        for k, (grasp, way) in enumerate({"I": (1, 0, 0), "III": (0, 1, 0)}.items())
    ]
    gravity = Term(effects.effect("gravity"), {"weight": 1500.0})
    return simulate(slab, ANCHORED, pulls, level=1, noise=0.2e-3, model=Model.of(slab) + gravity)


def broken(monkeypatch: pytest.MonkeyPatch, what: str, first: int, every: int) -> None:
    """From the call `first` on every so many calls of an evaluation raise, each time something else."""
    where, name = EVALUATIONS[what]
    sound, calls = getattr(where, name), count()

    def faulty(*arguments: Any, **named: Any) -> Any:
        number = next(calls) - first
        if number >= 0 and number % every == 0:
            raise ERRORS[number // every % len(ERRORS)]()
        return sound(*arguments, **named)

    monkeypatch.setattr(where, name, faulty)


@pytest.mark.parametrize("what", EVALUATIONS)
def test_explain_evaluation_raises_run_ends_and_lists_it(
    slab: Scene, measurement: Measurement, monkeypatch: pytest.MonkeyPatch, what: str
) -> None:
    broken(monkeypatch, what, first=5 if what == "prediction" else 0, every=4)
    found = bcid.explain(slab, measurement, options=ExplainOptions(only=("gravity", "fibres", "soft_anchor")))

    assert found.verdict in ("gravity", "none", "unknown", "fibres", "soft_anchor") or "+" in found.verdict
    assert found.skipped
    assert "skipped" in found.summary or "Not evaluated" in found.summary


@pytest.mark.parametrize("what", ["prediction", "sensitivities"])
def test_identify_evaluation_raises_run_ends_with_an_answer(
    slab: Scene, measurement: Measurement, monkeypatch: pytest.MonkeyPatch, what: str
) -> None:
    broken(monkeypatch, what, first=5, every=4)
    found = bcid.identify(slab, measurement, options=IdentifyOptions(exhaustive="no"))

    assert 0 <= found.probability <= 1
    assert what != "prediction" or found.failures
