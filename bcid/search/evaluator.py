"""Evaluating candidates on all ranks: whoever is free takes the next, none idles as a manager, and all know every result.

The searches run in lock-step on every rank and see the same results in the same order, so that the answer never depends
on how many ranks there are: a candidate's outcome depends on nothing but the candidate, its level and its bound. A large
mesh is shared by a team of ranks, and the teams share the candidates.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from bcid.base.collective import Comm
from bcid.base.errors import SHORT_OF_MEMORY, MachineError, SolveError, evaluating
from bcid.base.progress import Progress, Silent
from bcid.base.scheduler import spread
from bcid.forms.forward import Forward, Prediction, Watch
from bcid.forms.gripper_force import ForceScale
from bcid.forms.model import Model
from bcid.forms.solver.equilibrium import Settings
from bcid.forms.solver.status import Status
from bcid.inference.misfit import Misfit
from bcid.inference.outcome import Candidate, Outcome, label
from bcid.measurement import Measurement
from bcid.predict.forward_models import ForwardModels
from bcid.scene import Scene

Array = NDArray[np.float64]
# What was computed is shared, and can be stored, at the latest after so many candidates per team.
_BATCH = 64
# Relative accuracy of a rough solution, and by how much more a set must lose for it to be told from that.
_ROUGH = 1e-3
_RESERVE = 1.05


class Evaluator:
    """Evaluates anchor sets on mesh levels, spread over the ranks of `comm`, each at most once.

    Args:
        scene: the scene.
        measurement: what to compare with; must fit the scene.
        comm: an MPI communicator.
        model: the model, by default the scene's.
        settings: accuracy and patience of the solver.
        progress: told how far a batch is (rank 0).
        per_rank: a mesh with more unknowns than this is shared by a team of ranks, as far as there are any.

    Attributes:
        outcomes: everything evaluated so far, by level and candidate; equal on all ranks. They are those of positions: forces
            depend on how stiff the body is, and count where sets are weighed.
    """

    def __init__(
        self,
        scene: Scene,
        measurement: Measurement,
        comm: Comm,
        model: Model | None = None,
        settings: Settings | None = None,
        progress: Progress | None = None,
        per_rank: int = 150_000,
    ) -> None:
        measurement = replace(measurement, remarks=tuple(measurement.check(scene)))
        self.scene, self.measurement, self.comm = scene, measurement, comm
        self.model = model or Model.of(scene)
        self.settings = settings or Settings()
        self.progress = progress or Silent()
        for text in measurement.remarks:
            self.progress.say(f"look at this first: {text}")
        self.misfit = Misfit(scene, measurement)
        self.actions = measurement.actions
        self.outcomes: dict[tuple[int, Candidate], Outcome] = {}
        # The undeformed state costs nothing to compute.
        loaded = bool(self.model.terms)
        free = [a.frames[:1] for a in self.actions if not (loaded or a.loads or a.boundary or a.translation[0].any())]
        self._costly = np.ones(self.misfit.frames, dtype=bool)
        self._costly[np.concatenate([np.zeros(0, dtype=int), *free])] = False
        self._models = ForwardModels(scene, comm, self.settings, ForceScale.of(scene, measurement), per_rank)
        self._told: set[int] = set()
        self._positions: dict[tuple[int, Candidate], Array] = {}
        self._kept: dict[int, tuple[float, Candidate, Prediction]] = {}

    @property
    def patches(self) -> list[str]:
        """Names of the candidate patches, in the scene's order."""
        return list(self.scene.patches)

    def forward(self, level: int) -> Forward:
        """The forward model of a level on this rank's team, built on first use; collective."""
        forward = self._models.of(self.model, level)
        if level not in self._told:
            self._told.add(level)
            together = f", shared by {forward.comm.size} ranks" if forward.comm.size > 1 else ""
            self.progress.say(f"level {level}: {forward.describe}{together}")
        return forward

    def evaluate(self, level: int, bounds: Mapping[Candidate, float]) -> dict[Candidate, Outcome]:
        """Outcomes of candidates on a level; collective, the same on every rank.

        Args:
            level: the mesh level.
            bounds: each candidate with the chi-square above which its exact value is of no interest: its evaluation
                stops there. Those that are likely to take long should come first.
        """
        forward = self.forward(level)
        todo = [c for c, bound in bounds.items() if not self._enough(self.outcomes.get((level, c)), bound)]
        size = _BATCH * (self.comm.size // forward.comm.size)
        for i in range(0, len(todo), size):
            self._work(level, {c: bounds[c] for c in todo[i : i + size]})
        return {c: self.outcomes[level, c] for c in bounds}

    def _work(self, level: int, bounds: Mapping[Candidate, float]) -> None:
        """Evaluate a batch of candidates: every team takes the next when it is free. Collective."""
        forward, candidates = self.forward(level), list(bounds)
        mine: list[Outcome] = []

        def one(number: int) -> tuple[Outcome, Array]:
            candidate = candidates[number]
            try:
                with evaluating("anchors " + label(candidate, self.patches)):
                    outcome, predicted = self._evaluate(forward, candidate, bounds[candidate])
            except SolveError as caught:
                # It costs this candidate alone.
                outcome, predicted = _failed(candidate, level, str(caught), self.misfit.frames), np.zeros(0)
            mine.append(outcome)
            self._report(level, mine)
            return outcome, predicted if outcome.complete else np.zeros(0)

        for outcome, predicted in spread(self.comm, len(candidates), one, self._models.team(self.model, level)):
            if outcome.complete:
                self._positions[level, outcome.candidate] = predicted
            self._add(outcome)
        # Whatever the number of ranks, one prediction is kept on a level: that of the best set.
        best = self._best(level)
        if best is None or self._kept.get(level, (0.0, None))[1] != best.candidate:
            self._kept.pop(level, None)

    def _report(self, level: int, mine: list[Outcome]) -> None:
        """How far this level is, as far as this rank can tell before the batch is shared."""
        done, best = sum(at == level for at, _ in self.outcomes) + len(mine), self._best(level, mine)
        note = f"best so far {label(best.candidate, self.patches)} with {best.rms * 1e3:.3g} mm" if best else ""
        self.progress.step(f"level {level}: anchor sets", done, 0, note)

    def _best(self, level: int, also: Sequence[Outcome] = ()) -> Outcome | None:
        """What fits best of all that was compared in full on a level, and of others."""
        here = [o for (at, _), o in self.outcomes.items() if at == level]
        return min((o for o in [*here, *also] if o.complete), key=lambda o: o.chi2, default=None)

    @staticmethod
    def _enough(outcome: Outcome | None, bound: float) -> bool:
        """Whether an outcome answers a question with this bound."""
        return outcome is not None and (outcome.complete or outcome.failed or outcome.chi2 > bound)

    def _add(self, outcome: Outcome) -> None:
        """Take an outcome as evaluated; the work of an earlier evaluation, with a smaller bound, adds up."""
        key = outcome.level, outcome.candidate
        earlier = self.outcomes.get(key)
        if earlier is not None:
            share, seconds = outcome.share + earlier.share, outcome.seconds + earlier.seconds
            outcome = replace(outcome, share=share, seconds=seconds)
        self.outcomes[key] = outcome

    def _evaluate(self, forward: Forward, candidate: Candidate, bound: float) -> tuple[Outcome, Array]:
        """Outcome and predicted positions of one candidate; collective on the team."""
        start = time.perf_counter()
        # Chi-square and squares by frame: one that comes again replaces what was seen before.
        sums = np.zeros((2, self.misfit.frames))

        def watch(frame: int, predicted: Array) -> bool:
            sums[:, frame] = self.misfit.frame(frame, predicted)
            return bool(sums[0].sum() <= limit)

        limit, share = _RESERVE * bound, 0.0
        for prediction in self._passes(forward, candidate, watch):
            reached = np.asarray(np.isfinite(prediction.positions).all(axis=(1, 2)))
            share = max(share, float(reached[self._costly].mean()))
            chi2, squares = (float(value) for value in np.where(reached, sums, 0.0).sum(axis=1))
            by_frame = tuple(map(float, np.where(reached, sums[0], np.nan)))
            if prediction.stopped:
                break
            sums[:], limit = 0.0, bound
        failure = prediction.failure
        if failure and failure.status is Status.OUT_OF_MEMORY:
            # This says nothing of the candidate: it must not pass for one that cannot be.
            raise MachineError(SHORT_OF_MEMORY)
        complete = bool(reached.all()) and not failure
        if complete and chi2 < self._kept.get(forward.level, (math.inf,))[0]:
            self._kept[forward.level] = chi2, candidate, prediction
        outcome = Outcome(
            candidate,
            forward.level,
            math.inf if failure else chi2,
            math.inf if failure else self.misfit.rms(squares),
            complete,
            share,
            failure.status if failure else Status.CONVERGED,
            failure.reason if failure else "",
            time.perf_counter() - start,
            by_frame,
        )
        return outcome, prediction.positions

    def predict(self, level: int, candidate: Candidate) -> Prediction:
        """Full prediction of one candidate; collective. The best of each level is kept, others are computed again."""
        forward, holder = self.forward(level), self._holders(level).get(candidate)
        root = 0 if holder is None else holder
        mine: Prediction | None = None
        if self.comm.rank // forward.comm.size == root // forward.comm.size:
            if holder is None:
                *_, mine = self._passes(forward, candidate)
            else:
                mine = self._kept[level][2]
            mine = replace(mine, states=None)
        result: Prediction = self.comm.bcast(mine, root=root)
        return result

    def _holders(self, level: int) -> dict[Candidate, int]:
        """The candidates whose predictions are kept, each with the first rank that has it; collective."""
        mine = self._kept[level][1] if level in self._kept else None
        kept: list[Candidate | None] = self.comm.allgather(mine)
        return {candidate: kept.index(candidate) for candidate in kept if candidate is not None}

    def _passes(self, forward: Forward, candidate: Candidate, watch: Watch | None = None) -> Iterator[Prediction]:
        """The prediction of a candidate, first rough, then accurate from there; collective on the team.

        Most rivals lose by far, which the rough one tells. Whatever is predicted goes this way, so that what has to be
        predicted again is the same to the last bit.
        """
        known = None
        for rtol in (_ROUGH, None):
            prediction = forward.predict(candidate, self.actions, watch, keep=True, rtol=rtol, known=known)
            known = prediction.states
            yield prediction

    def positions(self, level: int, candidate: Candidate) -> Array:
        """Predicted values of one candidate, shape (frames, rows, 3), m; collective."""
        key = level, candidate
        if key not in self._positions:
            self._positions[key] = self.predict(level, candidate).positions
        return self._positions[key]

    def refinement(self, coarse: int, fine: int) -> float:
        """How many times smaller the elements of a level are than a coarser one's, going by the unknowns; collective."""
        unknowns = [self.forward(level).body.unknowns for level in (coarse, fine)]
        return float((unknowns[1] / unknowns[0]) ** (1 / 3))

    def evaluations(self) -> dict[int, float]:
        """Forward trajectories computed per level, in whole-trajectory equivalents."""
        counts: dict[int, float] = {}
        for (level, _), outcome in sorted(self.outcomes.items(), key=lambda item: (item[0][0], sorted(item[0][1]))):
            counts[level] = counts.get(level, 0.0) + outcome.share
        return counts

    def destroy(self) -> None:
        """Free meshes and solvers of this process."""
        self._models.destroy()


def _failed(candidate: Candidate, level: int, reason: str, frames: int) -> Outcome:
    """Of a candidate whose evaluation failed otherwise than by a solve: nothing is known of it."""
    nowhere = (math.nan,) * frames
    return Outcome(candidate, level, math.inf, math.inf, False, 0.0, Status.FAILED, reason, by_frame=nowhere)
