"""What an identification found."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from bcid.forms.forward import Prediction
from bcid.inference import nuisance_text
from bcid.inference.error_covariance import NuisanceEstimate
from bcid.inference.stiffness import Stiffness
from bcid.inference.thresholds import THRESHOLDS


@dataclass(frozen=True)
class Identification:
    """The anchored patches and how sure that is; lengths in m.

    Attributes:
        anchored: names of the anchored patches, in the scene's order.
        probability: of this set among all visited ones.
        patches: probability that each patch is anchored.
        rms, noise: RMS residual of the set, with what a finer mesh says taken out of the prediction, and the stated noise (None if
            unknown).
        discretisation: RMS of what may be left of the error of the mesh; None where nothing is known of it.
        certified: whether every set was followed to the end or until it had lost, and the model could be solved for each.
        evaluations: forward trajectories per level, in whole-trajectory equivalents.
        looked_at: how many sets were followed to the end, stopped when they had lost, failed, or were not followed.
        alternatives: the next best sets, best first.
        classes: the likely sets, in classes that these data cannot tell apart; the first holds the
            reported set.
        levels: of the ladder, that were used; the working mesh goes by the last.
        stages: what happened on each level, in words.
        prediction: of the reported set on the working mesh, positions with what a finer mesh says of its error taken out.
        failures: sets for which the forward model found no acceptable equilibrium, with the reason.
        seconds: time spent.
        remarks: what is odd about the measurement.
        missing: probability that something is missing in the model (see `bcid.inference.discrepancy`); None where that was not
            asked.
        astray: fiducials that do not go with the body, and were left out.
        nuisances: what the data say of each thing that the scene may have slightly wrong.
        stiffness: how stiff the body is, where forces are measured.
    """

    anchored: tuple[str, ...]
    probability: float
    patches: dict[str, float]
    rms: float
    noise: float | None
    discretisation: float | None
    certified: bool
    evaluations: dict[int, float]
    looked_at: dict[str, int]
    alternatives: tuple[Alternative, ...]
    classes: tuple[tuple[tuple[str, ...], ...], ...]
    levels: tuple[int, ...]
    stages: tuple[str, ...]
    prediction: Prediction
    failures: dict[str, str]
    seconds: float
    remarks: tuple[str, ...] = ()
    missing: float | None = None
    astray: tuple[str, ...] = ()
    nuisances: tuple[NuisanceEstimate, ...] = ()
    stiffness: Stiffness | None = None

    @property
    def unfollowed(self) -> list[Alternative]:
        """The sets that could not be followed to the end and may be the one all the same."""
        return [other for other in self.alternatives if other.failure and other.probability > THRESHOLDS.surprise]

    @property
    def explains(self) -> bool:
        """Whether the reported set may be all there is: nothing more is certainly missing."""
        if self.missing is not None:
            return self.missing < THRESHOLDS.credible
        return self.noise is None or self.rms <= THRESHOLDS.residual * self.noise

    def to_json(self, length: float = 1e-3) -> dict[str, Any]:
        """The content of `identification.json`; lengths are given in units of `length` (m)."""
        others = [
            asdict(a) | {"anchored": list(a.anchored), "rms": a.rms / length, "best_rms": a.best_rms / length}
            for a in self.alternatives
        ]
        return {
            "anchored": list(self.anchored),
            "probability": self.probability,
            "patches": self.patches,
            "rms": self.rms / length,
            "noise_rms": None if self.noise is None else self.noise / length,
            "discretisation_rms": None if self.discretisation is None else self.discretisation / length,
            "certified": self.certified,
            "evaluations": {str(level): round(count, 3) for level, count in self.evaluations.items()},
            "looked_at": self.looked_at,
            "alternatives": others,
            "classes": [[list(names) for names in members] for members in self.classes],
            "levels": list(self.levels),
            "stages": list(self.stages),
            "failures": self.failures,
            "unfollowed": [list(other.anchored) for other in self.unfollowed],
            "remarks": list(self.remarks),
            "missing": self.missing,
            "astray": list(self.astray),
            "explains": self.explains,
            "nuisances": nuisance_text.to_json(self.nuisances),
            "stiffness": self.stiffness.to_json() if self.stiffness else None,
        }


@dataclass(frozen=True)
class Alternative:
    """A set that was considered: its probability and RMS residual (m) on the finest level it was evaluated on.

    `rms` and `best_rms`, that of the reported set, are over the `frames` in which both are known. `stopped` says that its
    evaluation ended as soon as it had lost, `failure` why it could not be followed any further ("": it could).
    """

    anchored: tuple[str, ...]
    probability: float
    rms: float
    level: int
    stopped: bool
    best_rms: float
    frames: int
    failure: str = ""
