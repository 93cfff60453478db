"""Two sets of anchors, fitted to a small measurement, of which Poisson's ratio tells which one it is."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from bcid.forms import effect_trial as trial
from bcid.forms.simulate import recorded
from bcid.inference.data import Data
from bcid.inference.discrepancy import Evidence
from bcid.inference.error_covariance import ErrorCovariance
from bcid.inference.evidence import LinearParameters, LowRankDiscrepancy
from bcid.inference.hypotheses import HypothesisOdds
from bcid.inference.mesh_error import MeshError
from bcid.inference.nuisances import NuisanceModes
from bcid.measurement import Action
from bcid.search.answer.scene_sensitivity import SceneInput, WeighedHypothesis
from bcid.search.fitting.fitted_hypothesis import FittedHypothesis

Array = NDArray[np.float64]
POISSON = SceneInput("poisson", "Poisson's ratio", 0.03)
SIGMA = 0.2e-3
STEPS = 8


def data() -> Data:
    """A pull of markers that do not move, with noise."""
    scene, number = trial.scene(), np.arange(STEPS)
    turns = np.tile([1.0, 0.0, 0.0, 0.0], (STEPS, 1))
    action = Action("1", number, number, "gripper", number[:, None] * np.array([1e-3, 0, 0]), turns)
    still = np.tile(scene.rest, (STEPS, 1, 1))
    noisy = still + SIGMA * np.random.default_rng(4).normal(size=still.shape)
    measurement = recorded(scene, [action], noisy, 0.0, np.random.default_rng(0))
    return Data(scene, measurement.__class__(**{**vars(measurement), "noise_sigma": SIGMA}))


def force(errors: ErrorCovariance) -> LowRankDiscrepancy:
    """That may act besides, in units of errors."""
    columns = SIGMA * np.random.default_rng(3).normal(size=(len(errors.data), 2))
    return LowRankDiscrepancy.of(errors.whiten(columns), np.array([0.5, 2.0]))


@dataclass(frozen=True)
class Sets:
    """The set that is true where Poisson's ratio is off by two standard deviations, and one where it is not.

    Attributes:
        data: of the measurement.
        column: what a standard deviation of Poisson's ratio does, (n,), m.
        fitted: both.
    """

    data: Data
    column: Array
    fitted: tuple[WeighedHypothesis, WeighedHypothesis]

    @classmethod
    def of(cls, tau: float = 1.0, off: float = 2.0, value: float = 0.0, apart: float = 0.0) -> Sets:
        """With a share of its standard deviation, by how many it is off with the first, and a value that the scene has for it.

        What the second set predicts differs besides by `apart` of the noise.
        """
        seen = data()
        column = 0.8 * SIGMA * np.random.default_rng(7).normal(size=len(seen))
        noise = seen.values - seen.vector(np.broadcast_to(seen.rest, seen.mask.shape))
        other = apart * SIGMA * np.random.default_rng(9).normal(size=len(seen))
        residuals = (noise + (off - value) * column, noise - value * column + other)
        first, second = (_fitted(seen, tau * column, r, a) for r, a in zip(residuals, "12", strict=True))
        return cls(seen, column, (first, second))

    @property
    def explanation(self) -> Any:
        """As `explain` gives it."""
        rivals = tuple(one.rival for one in self.fitted)
        odds = HypothesisOdds.of({h: log for rival in rivals for h, log in rival.logs.items()})
        best = rivals[1].fitted
        return SimpleNamespace(
            rivals=rivals, odds=odds, refuted=False, rungs=(SimpleNamespace(fitted=best),), noise=None, open=True,
            last=SimpleNamespace(state=best.state),
        )  # fmt: skip


def _fitted(seen: Data, column: Array, residual: Array, anchors: str) -> WeighedHypothesis:
    modes = NuisanceModes(np.zeros((len(seen), 3)), column[:, None], ("poisson",), {"poisson": 0.03})
    errors = ErrorCovariance(seen, seen.sigma, MeshError.unknown(seen.mask.shape), modes)
    state = SimpleNamespace(
        errors=errors, residual=residual, scaled=errors.whiten(residual), forces=[force(errors)], anchors=frozenset(anchors),
        predictor=SimpleNamespace(data=seen), predicted=seen.measured,
    )  # fmt: skip
    evidence = Evidence.of(errors, residual, [force(errors)])
    rival = FittedHypothesis((), cast("Any", SimpleNamespace(state=state)), evidence, 20)
    return WeighedHypothesis(rival, rival.hypothesis, LinearParameters.none(len(seen)), {POISSON: 0})
