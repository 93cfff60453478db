"""Every anchor set, followed until it has lost: the certificate of an identification, by the posterior's own likelihood."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bcid.base.errors import SolveError, evaluating
from bcid.base.scheduler import spread
from bcid.forms.forward import Forward
from bcid.forms.model import Model
from bcid.inference.discrepancy import Evidence, EvidenceCells
from bcid.inference.error_covariance import ErrorCovariance
from bcid.inference.evidence import LinearParameters, LowRankDiscrepancy
from bcid.inference.hypotheses import label
from bcid.predict.predictor import Predictor
from bcid.search.fitting.fitted_hypothesis import FittedHypothesis
from bcid.search.fitting.parameter_priors import of_state
from bcid.search.fitting.state import State
from bcid.search.set_tangents import every_set, neighbours
from bcid.search.settings import SETTINGS

Array = NDArray[np.float64]
Frames = NDArray[np.bool_]
Anchored = frozenset[str]


@dataclass(frozen=True)
class FollowedSet:
    """What is known of a set.

    Attributes:
        evidence: of it; where it was not followed to the end, that of the set that it is compared with, changed by what the frames
            say that it was followed in.
        positions: predicted, shape (frames, rows, 3), m; NaN where it was not followed.
        frames: those that it was followed in, or that show nothing, shape (frames,).
        failure: why it could not be followed any further; "" where it could.
        seconds: time spent.
    """

    evidence: Evidence
    positions: Array
    frames: Frames
    failure: str = ""
    seconds: float = 0.0

    @property
    def complete(self) -> bool:
        """Whether it was followed in all that was seen."""
        return bool(self.frames.all())


class FollowedSets:
    """Follows anchor sets in all steps on the working mesh, each until it has lost against a fitted one.

    A set has lost when the frames that it was followed in are `SearchSettings.odds` times less likely with it, and so many times
    more as there are sets. This is a sequential test (Wald, Ann. Math. Stat. 16, 1945, 117): were it the true set, the probability
    that it is stopped is below 1 / `odds` for all sets together, whatever the frames to come hold (Ville's inequality).

    Args:
        predictor: of the measurement; sets are spread over its ranks.
        every: whether all sets are followed; else those that differ from the fitted one by no more patches than tangents tell of.

    Attributes:
        found: what is known of each set.
    """

    def __init__(self, predictor: Predictor, every: bool) -> None:
        self.predictor, self.every = predictor, every
        self.found: dict[Anchored, FollowedSet] = {}

    @property
    def failed(self) -> list[Anchored]:
        """Those that could not be followed to the end."""
        return [anchors for anchors, found in self.found.items() if found.failure]

    def evidences(
        self, rival: FittedHypothesis, begun: Model, excluded: frozenset[Anchored] = frozenset()
    ) -> dict[Anchored, Evidence]:
        """Of the effects of a fitted hypothesis on other sets and on its own, with its numbers and errors; collective.

        Returns:
            By set; nothing where its numbers are not visible, or where an effect changes the picture.
        """
        state, predictor = rival.judged, self.predictor
        numbers = of_state(state, begun, rival.jacobian(state.errors))
        if numbers is None or any(term.effect.observe for term in state.model.terms):
            return {}
        sets = every_set(state, begun) if self.every else neighbours(state, begun, True)
        sets = [s for s in sets if s not in excluded]
        test, forward = _Test(state, numbers, math.log(SETTINGS.odds * len(sets))), predictor.forward(state.model)
        forward.equilibrium.settings = predictor.settings
        # Those that differ least take longest.
        order = sorted(sets, key=lambda s: (len(s ^ state.anchors), sorted(s)))

        def one(number: int) -> FollowedSet:
            predictor.progress.step("anchor sets followed until they have lost", number, len(order))
            return self._followed(forward, test, order[number])

        self.found = dict(zip(order, spread(predictor.comm, len(order), one), strict=True))
        predictor.count("working", sum(float(f.frames.mean()) for f in self.found.values()))
        return {anchors: found.evidence for anchors, found in self.found.items()}

    def _followed(self, forward: Forward, test: _Test, anchors: Anchored) -> FollowedSet:
        """One set; local to the process."""
        predictor, begun = self.predictor, time.perf_counter()
        positions = np.full(predictor.data.mask.shape, np.nan)

        def watch(frame: int, predicted: Array) -> bool:
            positions[frame] = predicted
            return not test.seen[frame] or test.beyond(positions) > -test.lost

        actions = [a.until(last + 1) for a, last in zip(predictor.actions, predictor.last_seen(), strict=True)]
        failure = ""
        try:
            with evaluating("anchors " + label(anchors, predictor.whole.patches), predictor.skip):
                prediction = forward.predict(anchors, actions, watch)
            positions[: len(prediction.positions)] = prediction.positions
            failure = prediction.failure.reason if prediction.failure else ""
        except SolveError as error:
            positions[:], failure = np.nan, str(error)
        evidence, frames = test.evidence(positions), test.followed(positions)
        return FollowedSet(evidence, positions, frames, failure, time.perf_counter() - begun)


@dataclass(frozen=True)
class _Part:
    """Some frames of a measurement, as the set that others are compared with explains them.

    Attributes:
        errors: as if the other frames had not been measured.
        forces, misfits: discrepancies, in units of these errors.
        numbers: what is unknown of the model, likewise.
        own: evidence of the set.
    """

    errors: ErrorCovariance
    forces: list[LowRankDiscrepancy]
    misfits: list[LowRankDiscrepancy]
    numbers: LinearParameters
    own: EvidenceCells

    def cells(self, residual: Array) -> EvidenceCells:
        """Evidence of a residual (n,), m, in these frames."""
        return EvidenceCells.of(self.errors, residual, self.forces, self.misfits, self.numbers)


class _Test:
    """Compares sets with the one of a state, in the frames that they were followed in.

    In the frames to come a set is taken to do as well as that one, with each size of what is missing for itself: what is missing
    may show only there, and a set that is wrong by as much has not lost before.

    Args:
        state: the set that others are compared with.
        numbers: what is unknown of its model, in units of its errors.
        lost: nats from which on a set has lost.
    """

    def __init__(self, state: State, numbers: LinearParameters, lost: float) -> None:
        self.state, self.numbers, self.lost = state, numbers, lost
        # Frames that show something.
        self.seen = np.asarray(state.predictor.data.mask.any(axis=(1, 2)))
        self._parts: dict[bytes, _Part] = {}
        self._whole = self._part(np.ones(len(self.seen), dtype=bool)).own

    def followed(self, positions: Array) -> Frames:
        """Frames with a prediction, and those that show nothing, shape (frames,)."""
        return np.asarray(np.isfinite(positions).all(axis=(1, 2)) | ~self.seen)

    def beyond(self, positions: Array) -> float:
        """By how many nats the data are likelier with a set at these positions (frames, rows, 3), m; NaN where not followed."""
        return self.evidence(positions).total - self._evidence(self._whole).total

    def evidence(self, positions: Array) -> Evidence:
        """Of a set with these positions, in other frames as the one that it is compared with."""
        part, data = self._part(self.followed(positions)), self.state.predictor.data
        apart = np.nan_to_num(positions - self.state.prediction.positions)
        here = part.cells(self.state.residual - data.vector(apart))
        return self._evidence(self._whole.beside(here, part.own))

    def _evidence(self, cells: EvidenceCells) -> Evidence:
        return cells.evidence(self.state.errors.log_volume)

    def _part(self, frames: Frames) -> _Part:
        key = frames.tobytes()
        if key not in self._parts:
            self._parts[key] = self._made(frames)
        return self._parts[key]

    def _made(self, frames: Frames) -> _Part:
        state = self.state
        errors = state.errors if frames.all() else state.errors.masked(~frames[state.predictor.data.frame])
        numbers = replace(self.numbers, columns=self._rescaled(errors, self.numbers.columns))
        forces, misfits = (
            [self._in_units(errors, one) for one in some] for some in (state.forces, state.errors.misfits)
        )
        own = EvidenceCells.of(errors, state.residual, forces, misfits, numbers)
        return _Part(errors, forces, misfits, numbers, own)

    def _in_units(self, errors: ErrorCovariance, discrepancy: LowRankDiscrepancy) -> LowRankDiscrepancy:
        """A discrepancy with the same sizes in units of other errors."""
        columns = self._rescaled(errors, discrepancy.basis * np.sqrt(discrepancy.squares))
        return replace(LowRankDiscrepancy.of(columns, discrepancy.sizes), inflation=discrepancy.inflation)

    def _rescaled(self, errors: ErrorCovariance, columns: Array) -> Array:
        """Columns (n, k) in units of other errors."""
        if errors is self.state.errors:
            return columns
        back = [self.state.errors.unwhiten(column) for column in columns.T]
        return errors.whiten(np.column_stack(back)) if back else columns
