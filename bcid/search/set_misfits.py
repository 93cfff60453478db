"""Residuals of anchor sets on mesh levels, spread over ranks: what hill climbing asks."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bcid.base.collective import Comm
from bcid.base.errors import SHORT_OF_MEMORY, MachineError, SolveError, evaluating
from bcid.base.options import StageOptions
from bcid.base.progress import Progress, Silent
from bcid.base.scheduler import spread
from bcid.forms.forward import Forward
from bcid.forms.gripper_force import ForceScale
from bcid.forms.mesh.patches import divided, first_level
from bcid.forms.model import Model
from bcid.forms.solver.equilibrium import Settings
from bcid.forms.solver.status import Status
from bcid.inference.continuation import ContinuationError
from bcid.inference.hypotheses import label
from bcid.inference.misfit import Misfit
from bcid.measurement import Measurement
from bcid.predict.forward_models import ForwardModels
from bcid.scene import Scene
from bcid.search.hill_climbing import Candidate
from bcid.search.stages import SearchStage, in_stages

Array = NDArray[np.float64]


@dataclass(frozen=True)
class SetMisfit:
    """What is known of a set on a level.

    Attributes:
        rms: RMS residual, weighted by the noise, m; a lower bound where it is not complete.
        complete: whether it was followed to the end.
        share: of the steps of all actions that were followed.
        failure: why the model has no solution, in words; "" where it has.
        came: frames that it was followed to.
        seconds: time spent.
    """

    rms: float
    complete: bool
    share: float
    failure: str
    came: NDArray[np.bool_]
    seconds: float


class MeasuredMisfits:
    """Residuals of a scene's anchor sets against a measurement. All methods are collective; no result depends on the ranks.

    A large mesh is shared by a team of ranks, and the teams share the sets.

    Args:
        scene: the scene.
        measurement: what to compare with; must fit the scene. Forces depend on how stiff the body is, and do not count here.
        comm: an MPI communicator.
        model: the model, by default the scene's.
        settings: accuracy and patience of the solver.
        progress: told how far a batch is (rank 0).
        per_rank: a mesh with more unknowns than this is shared by a team of ranks, as far as there are any.

    Attributes:
        known: what was evaluated, by level and set.
        misfit: how a prediction is compared.
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
        self.scene, self.measurement, self.comm = scene, measurement, comm
        self.model, self.settings = model or Model.of(scene), settings or Settings()
        self.progress, self.misfit = progress or Silent(), Misfit(scene, measurement)
        self.known: dict[tuple[int, Candidate], SetMisfit] = {}
        self._models = ForwardModels(scene, comm, self.settings, ForceScale.of(scene, measurement), per_rank)
        self._spent: dict[int, float] = {}
        self._positions: dict[tuple[int, Candidate], Array] = {}

    @property
    def patches(self) -> list[str]:
        """Names of the candidate patches, in the scene's order."""
        return list(self.scene.patches)

    def forward(self, level: int) -> Forward:
        """The forward model of a level on this rank's team."""
        return self._models.of(self.model, level)

    def misfits(self, level: int, bounds: Mapping[Candidate, float]) -> dict[Candidate, float]:
        """See `bcid.search.hill_climbing.SetMisfits`."""
        forward = self.forward(level)
        asked = [c for c, bound in bounds.items() if not self._enough(level, c, bound)]

        def one(number: int) -> SetMisfit:
            candidate = asked[number]
            self.progress.step(f"level {level}: anchor sets", number, len(asked))
            try:
                with evaluating("anchors " + label(candidate, self.patches)):
                    return self._evaluated(forward, candidate, bounds[candidate])
            except SolveError as error:
                # It costs this set alone.
                nowhere = np.zeros(self.misfit.frames, dtype=bool)
                return SetMisfit(math.inf, False, 0.0, str(error), nowhere, 0.0)

        for candidate, found in zip(
            asked, spread(self.comm, len(asked), one, self._models.team(self.model, level)), strict=True
        ):
            self.known[level, candidate] = found
            self._spent[level] = self._spent.get(level, 0.0) + found.share
        return {c: k.rms if (k := self.known[level, c]).complete else math.inf for c in bounds}

    def _enough(self, level: int, candidate: Candidate, bound: float) -> bool:
        """Whether what is known of a set answers a question with this bound."""
        known = self.known.get((level, candidate))
        return known is not None and (known.complete or bool(known.failure) or known.rms > bound)

    def _evaluated(self, forward: Forward, candidate: Candidate, bound: float) -> SetMisfit:
        """Of one set; collective on the team."""
        start, sums = time.perf_counter(), np.zeros(self.misfit.frames)

        def watch(frame: int, predicted: Array) -> bool:
            # A frame that comes again replaces what was seen before.
            sums[frame] = self.misfit.frame(frame, predicted)[0]
            return self.misfit.weighted_rms(float(sums.sum())) <= bound

        found = forward.predict(candidate, self.measurement.actions, watch)
        came = np.asarray(np.isfinite(found.positions).all(axis=(1, 2)))
        failure = found.failure
        if failure and failure.status is Status.OUT_OF_MEMORY:
            # This says nothing of the set: it must not pass for one that cannot be.
            raise MachineError(SHORT_OF_MEMORY)
        rms = self.misfit.weighted_rms(float(sums[came].sum()))
        complete = bool(came.all()) and not failure and not found.stopped
        share, seconds = float(came.mean()), time.perf_counter() - start
        return SetMisfit(rms, complete, share, str(failure.reason) if failure else "", came, seconds)

    def similarity(self, rms: float) -> float:
        """See `bcid.search.hill_climbing.SetMisfits`."""
        return self.misfit.similarity(rms)

    def change(self, level: int, candidate: Candidate) -> float:
        """See `bcid.search.hill_climbing.SetMisfits`."""
        coarse, fine = (self.positions(at, candidate) for at in (level, level + 1))
        complete = np.isfinite(coarse).all() and np.isfinite(fine).all()
        return self.misfit.distance(coarse, fine) if complete else math.inf

    def positions(self, level: int, candidate: Candidate) -> Array:
        """What a set predicts, shape (frames, fiducials or more rows, 3), m; NaN where it was not come to."""
        key = level, candidate
        if key not in self._positions:
            found = self.forward(level).predict(candidate, self.measurement.actions)
            self._spent[level] = self._spent.get(level, 0.0) + 1.0
            self._positions[key] = self.comm.bcast(found.positions)
        return self._positions[key]

    def failures(self, level: int) -> dict[Candidate, SetMisfit]:
        """Sets that the model has no solution for."""
        return {c: found for (at, c), found in self.known.items() if at == level and found.failure}

    def evaluations(self) -> dict[int, float]:
        """Forward trajectories computed per level, in whole-trajectory equivalents."""
        return dict(sorted(self._spent.items()))

    def destroy(self) -> None:
        """Free meshes and solvers of this process."""
        self._models.destroy()


@dataclass(frozen=True)
class StagedSets:
    """What a search in stages found.

    Attributes:
        stages: the last holds the answer.
        words: what happened on each level.
        evaluations: forward trajectories per level, in whole-trajectory equivalents.
    """

    stages: tuple[SearchStage, ...]
    words: tuple[str, ...]
    evaluations: Mapping[int, float]

    @property
    def levels(self) -> tuple[int, ...]:
        """The levels that were climbed on."""
        return tuple(stage.level for stage in self.stages)

    @property
    def likely(self) -> tuple[Candidate, ...]:
        """The sets that the climbs of the last stage ended on, the best first."""
        return self.stages[-1].maxima


def staged_sets(
    scene: Scene,
    measurement: Measurement,
    comm: Comm,
    options: StageOptions,
    model: Model | None = None,
    settings: Settings | None = None,
    progress: Progress | None = None,
    start: Sequence[Candidate] = (),
) -> StagedSets:
    """The sets that climbing in stages ends on; collective on `comm`.

    Args:
        scene: body, candidate patches (divided ones are replaced by their pieces), mesh hierarchy.
        measurement, comm, model, settings, progress: as for `MeasuredMisfits`.
        options: how to search.
        start: sets to climb from on the first level, instead of random ones.

    Raises:
        InputError: scene, measurement or options do not fit each other.
        ContinuationError: the forward model failed for every set.
    """
    scene, words = divided(scene, comm), list[str]()
    options.check(scene)
    level, passed = first_level(scene, options.coarsest, options.last(scene), comm)
    misfits = MeasuredMisfits(scene, measurement, comm, model, settings, progress)

    def say(text: str) -> None:
        words.append(text)
        misfits.progress.say(text)

    try:
        for reason in passed:
            say(f"not used: {reason}")
        stages = in_stages(misfits, replace(options, coarsest=level), options.last(scene), start, say)
        if not stages:
            failed = list(misfits.failures(level).values())
            message = (
                f"level {level}: the forward model failed for every anchor set tried; the first: {failed[0].failure}"
            )
            raise ContinuationError(message, "no anchor set can be followed", _furthest([one.came for one in failed]))
        return StagedSets(tuple(stages), tuple(words), misfits.evaluations())
    finally:
        misfits.destroy()


def _furthest(frames: Sequence[NDArray[np.bool_]]) -> NDArray[np.bool_]:
    """The frames that half of the sets came to, or, where each fails in another action, those that one set came to."""
    came = np.array(frames)
    half = np.asarray(came.mean(axis=0) >= 0.5)
    return np.asarray(came[came.sum(axis=1).argmax()]) if half.all() else half
