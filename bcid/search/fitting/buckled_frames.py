"""Where a body buckles two states exist, and imperfections choose: what follows is no evidence for or against a model.

Along an action the smallest eigenvalue of the tangent falls towards zero where the body is about to buckle, and its
eigenvector is the way in which it will. From the step that has gone furthest that way (the action may lead back) the state
on the other side is sought: the deflection along that vector is reversed, and the equilibrium next to it found. If that is
another one, and stable, the measurement may have gone either way, and the steps from the critical one on are left out.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bcid.forms.forward import Forward
from bcid.forms.model import Model
from bcid.forms.solver.buckling import APART, NEAR_BUCKLING, smallest_eigenvalue, stable_state
from bcid.forms.solver.supports import Pose
from bcid.forms.solver.trajectory import poses
from bcid.inference.data import Data
from bcid.measurement import Action, Measurement
from bcid.predict.kept_predictions import MeasurementPrediction
from bcid.predict.predictor import Predictor

Array = NDArray[np.float64]
# A finer mesh is a little softer: it is asked about actions in which the coarser one comes below this part.
_NEAR = 0.7
# Two states are different when a fiducial is so many times the noise (or this part of the body's size) apart.
_APART = 5.0


@dataclass(frozen=True)
class Buckling:
    """An action in which the body buckles.

    Attributes:
        action: its name.
        step: the first step that is left out.
        distance: largest distance of a fiducial between the two states where they are furthest apart, m.
        other: whether the measurement is nearer to the state that was not followed.
    """

    action: str
    step: int
    distance: float
    other: bool

    def __str__(self) -> str:
        where = "near the other one" if self.other else "near the one followed"
        return (
            f"action {self.action} buckles: two states exist, up to {self.distance * 1e3:.2g} mm apart, and the "
            f"measurement is {where}; its steps from {self.step} on are left out"
        )


def buckled(predictor: Predictor, model: Model, anchors: Iterable[str]) -> list[Buckling]:
    """The actions in which the body buckles, on the working or the fine level; collective.

    The fine level is only asked about actions in which the working level becomes softer.
    """
    if not model.reversible:
        return []
    anchors = frozenset(anchors)
    found: dict[str, Buckling] = {}
    actions = list(predictor.actions)
    for level in (predictor.level, *([predictor.finer] if predictor.finer else [])):
        if not actions:
            break
        prediction = predictor.predict(model, anchors, level, keep=True)
        paths = [
            (a, _softened(predictor, model, anchors, level, a, prediction))
            for a in predictor.mine(predictor.actions)
            if a in actions
        ]
        mine = [(a, path) for a, path in paths if path is not None]
        others = [
            _of_action(predictor, anchors, a, path, prediction) for a, path in mine if path.smallest < NEAR_BUCKLING
        ]
        near = {a.name for a, path in mine if path.smallest < _NEAR}
        shared = predictor.comm.allgather(([one for one in others if one], near))
        for one in (one for part, _ in shared for one in part):
            known = found.get(one.action, one)
            found[one.action] = replace(known, step=min(one.step, known.step))
        names = {name for _, part in shared for name in part}
        actions = [a for a in actions if a.name in names]
    return [found[name] for name in predictor.data.actions if name in found]


def leave_out(predictor: Predictor, model: Model, anchors: Iterable[str]) -> list[Buckling]:
    """Compare a predictor from now on with what was seen before the body buckles; collective.

    Returns:
        The actions of which something was left out.
    """
    found = [one for one in buckled(predictor, model, anchors) if predictor.data.mask[_later(predictor, one)].any()]
    if found:
        left_out = (*predictor.left_out, *map(str, found))
        predictor.look_at(_before(predictor, found), left_out)
    for one in found:
        predictor.progress.say(str(one))
    return found


def _before(predictor: Predictor, found: Sequence[Buckling]) -> Measurement:
    """The measurement with nothing seen from where the body buckles."""
    data = predictor.measurement.data.copy(deep=True)
    for one in found:
        data["position"][{"frame": _later(predictor, one)}] = np.nan
    return replace(predictor.measurement, data=data)


def _later(predictor: Predictor, one: Buckling) -> NDArray[np.bool_]:
    """The frames from where the body buckles, shape (frames,)."""
    data = predictor.measurement.data
    return np.asarray((data["action"].values.astype(str) == one.action) & (data["step"].values >= one.step))


@dataclass(frozen=True)
class _Path:
    """What an action does to the body: poses, states, the smallest eigenvalue (N/m) and its eigenvector in each step."""

    forward: Forward
    poses: list[Pose]
    states: list[Array]
    sizes: list[float]
    modes: list[Array]

    @property
    def furthest(self) -> int:
        """The step in which the body has gone furthest the way in which it is softest."""
        mode = self.modes[int(np.argmin(self.sizes))]
        return int(np.argmax([abs(mode @ (state - self.states[0])) for state in self.states]))

    @property
    def critical(self) -> int:
        """The step up to there in which the body is softest."""
        return int(np.argmin(self.sizes[: self.furthest + 1]))

    @property
    def smallest(self) -> float:
        """The smallest eigenvalue, as part of that at rest."""
        return self.sizes[self.critical] / self.sizes[0]


def _softened(
    predictor: Predictor,
    model: Model,
    anchors: frozenset[str],
    level: int,
    action: Action,
    prediction: MeasurementPrediction,
) -> _Path | None:
    """How soft the body becomes in an action; None when it could not be followed."""
    kept = prediction.parts[action.name].states if action.name in prediction.parts else None
    if not kept:
        return None
    forward = predictor.forward(model, level)
    driven = model.driven(action)
    forward.equilibrium.hold(anchors, driven.grasp)
    states = [kept[int(frame)] for frame in action.frames if int(frame) in kept]
    found = _Path(forward, poses(driven)[: len(states)], states, [], [])
    for pose, state in zip(found.poses, states, strict=True):
        forward.equilibrium.set_state(pose, state)
        size, mode = smallest_eigenvalue(forward.equilibrium)
        found.sizes.append(size)
        found.modes.append(mode)
    return found


def _of_action(
    predictor: Predictor, anchors: frozenset[str], action: Action, path: _Path, prediction: MeasurementPrediction
) -> Buckling | None:
    """Whether there is another state in the furthest step of an action that softens the body."""
    forward, critical, furthest = path.forward, path.critical, path.furthest
    if critical == 0:
        return None
    forward.equilibrium.hold(anchors, action.grasp)
    last = int(action.frames[furthest])
    mode, end = path.modes[critical], path.states[furthest]
    bent = float(mode @ (end - path.states[critical - 1]))
    other = stable_state(forward.equilibrium, forward.fiducials, path.poses[furthest], end - 2 * bent * mode)
    if other is None:
        return None
    followed = prediction.positions[last][: len(other)]
    distance = float(np.linalg.norm(other - followed, axis=1).max())
    noise = float(np.nanmean(predictor.data.sigma)) if predictor.data.stated else 0.0
    if distance < max(_APART * noise, APART * forward.mesh.size):
        return None
    nearer = _squares(predictor.data, last, other) < _squares(predictor.data, last, followed)
    return Buckling(action.name, int(action.steps[critical]), distance, bool(nearer))


def _squares(data: Data, frame: int, places: Array) -> float:
    """Sum of squares by which fiducials at places (fiducials, 3), m, miss what was seen in a frame, m^2."""
    apart = data.measured[frame].copy()
    apart[: len(places)] -= places
    return float(np.sum(data.seen.take_frame(frame, apart) ** 2))
