"""Evaluating candidates on all ranks: every rank takes a share, none idles as a manager, and all know every result.

The searches run in lock-step on every rank and see the same results in the same order, so that the answer never depends
on how many ranks there are: a candidate's outcome depends on nothing but the candidate, its level and its bound.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bcid.collective import agree
from bcid.errors import BcidError, InputError
from bcid.forms.forward import Forward, Prediction
from bcid.forms.mesh import level_mesh
from bcid.forms.model import Model
from bcid.forms.solve import Settings, Status
from bcid.measurement import Measurement
from bcid.progress import Progress, Silent
from bcid.scene import Scene
from bcid.search.misfit import Misfit

Array = NDArray[np.float64]
Candidate = frozenset[str]


def label(candidate: Iterable[str], order: Iterable[str]) -> str:
    """A candidate in words, patches in the scene's order: "{1 2}"."""
    chosen = set(candidate)
    return "{" + " ".join(name for name in order if name in chosen) + "}"


@dataclass(frozen=True)
class Outcome:
    """What is known of one candidate on one level.

    Attributes:
        chi2: sum of squared residuals in units of noise; a lower bound when `complete` is False; infinite when the
            model failed.
        rms: RMS residual per coordinate, m; a lower bound when `complete` is False.
        complete: whether all frames were compared.
        share: fraction of the trajectory that was computed, 0 to 1.
        status, reason: how the forward model ended, and why in words.
        seconds: time spent.
    """

    candidate: Candidate
    level: int
    chi2: float
    rms: float
    complete: bool
    share: float
    status: Status = Status.CONVERGED
    reason: str = ""
    seconds: float = 0.0

    def to_json(self) -> dict[str, Any]:
        """As JSON: infinite numbers become null."""
        plain = asdict(self) | {"candidate": sorted(self.candidate)}
        return {k: None if isinstance(v, float) and not math.isfinite(v) else v for k, v in plain.items()}

    @classmethod
    def from_json(cls, content: Mapping[str, Any]) -> Outcome:
        """What `to_json` gave; numbers survive exactly. `InputError` when it is damaged."""
        try:
            numbers = {
                k: math.inf if content[k] is None else float(content[k]) for k in ("chi2", "rms", "share", "seconds")
            }
            status = Status(content["status"])
            complete, reason = bool(content["complete"]), str(content["reason"])
            candidate = frozenset(str(name) for name in content["candidate"])
            outcome = cls(candidate, int(content["level"]), complete=complete, status=status, reason=reason, **numbers)
        except (KeyError, TypeError, ValueError) as error:
            raise InputError(
                f"a stored outcome of the run is damaged ({error!r}); start it anew with --overwrite"
            ) from None
        if any(not value >= 0 for value in numbers.values()):
            raise InputError(f"a stored outcome of the run is damaged ({numbers}); start it anew with --overwrite")
        return outcome

    @property
    def failed(self) -> bool:
        """Whether the forward model found no acceptable equilibrium."""
        return self.status is not Status.CONVERGED


class Farm:
    """Evaluates anchor sets on mesh levels, spread over the ranks of `comm`, each at most once.

    Args:
        scene: the scene.
        measurement: what to compare with; must fit the scene.
        comm: an MPI communicator; each rank holds the meshes and solvers it needs privately.
        model: the model, by default the scene's.
        settings: accuracy and patience of the solver.
        progress: told how far a batch is (rank 0).
        keep: called with what was computed in each batch, on every rank, so that it can be stored.
        known: what `keep` was given by an interrupted search: it is taken when it is asked for, and not computed again.

    Attributes:
        outcomes: everything evaluated so far, by level and candidate; equal on all ranks.
    """

    def __init__(
        self,
        scene: Scene,
        measurement: Measurement,
        comm: Any,
        model: Model | None = None,
        settings: Settings | None = None,
        progress: Progress | None = None,
        keep: Callable[[list[Outcome]], None] | None = None,
        known: Iterable[Outcome] = (),
    ) -> None:
        measurement.check(scene)
        self.scene, self.measurement, self.comm = scene, measurement, comm
        self.model = model or Model.of(scene)
        self.settings = settings or Settings(rtol=1e-6)
        self.progress = progress or Silent()
        self.keep = keep
        self._stored: dict[tuple[int, Candidate], list[Outcome]] = {}
        for outcome in known:
            self._stored.setdefault((outcome.level, outcome.candidate), []).append(outcome)
        self.misfit = Misfit(scene, measurement)
        self.actions = measurement.actions
        self.outcomes: dict[tuple[int, Candidate], Outcome] = {}
        self._forwards: dict[int, Forward] = {}
        self._positions: dict[tuple[int, Candidate], Array] = {}
        self._kept: dict[int, tuple[float, Candidate, Prediction]] = {}

    @property
    def patches(self) -> list[str]:
        """Names of the candidate patches, in the scene's order."""
        return list(self.scene.patches)

    def forward(self, level: int) -> Forward:
        """This process's forward model of a level, built on first use; collective."""
        if level not in self._forwards:
            mesh = level_mesh(self.scene, self.scene.levels[level], self.comm)
            # One rank compiles the forms, the others find them in the cache: compiling at once would race for it.
            for turn in (0, 1):
                error = None
                if (self.comm.rank > 0) == turn:
                    try:
                        self._forwards[level] = Forward(self.scene, level, None, self.model, self.settings, mesh)
                    except BcidError as caught:
                        error = caught
                agree(self.comm, error)
            self.progress.say(f"level {level}: {self._forwards[level].describe}")
        return self._forwards[level]

    def evaluate(self, level: int, bounds: Mapping[Candidate, float]) -> dict[Candidate, Outcome]:
        """Outcomes of candidates on a level; collective, the same on every rank.

        Args:
            level: the mesh level.
            bounds: each candidate with the chi-square above which its exact value is of no interest: its evaluation
                stops there.
        """
        wanted = sorted(bounds, key=lambda c: (len(c), sorted(c)))
        forward = self.forward(level)
        for c in wanted:
            if not self._enough(self.outcomes.get((level, c)), bounds[c]):
                self._add(next((o for o in self._stored.get((level, c), []) if self._enough(o, bounds[c])), None))
        todo = [c for c in wanted if not self._enough(self.outcomes.get((level, c)), bounds[c])]
        mine = []
        error = None
        for candidate in todo[self.comm.rank :: self.comm.size]:
            try:
                mine.append(self._evaluate(forward, candidate, bounds[candidate]))
            except BcidError as caught:
                error = caught
                break
            self._report(level, mine)
        agree(self.comm, error)
        found = [outcome for outcomes in self.comm.allgather(mine) for outcome in outcomes]
        for outcome in found:
            self._add(outcome)
        if self.keep is not None and found:
            self.keep(found)
        return {c: self.outcomes[level, c] for c in wanted}

    def _report(self, level: int, mine: list[Outcome]) -> None:
        """How far this level is, as far as this rank can tell before the batch is shared."""
        here = [o for (at, _), o in self.outcomes.items() if at == level] + mine
        good = [o for o in here if o.complete]
        text = f"level {level}: {len(here)} of {2 ** len(self.patches)} anchor sets looked at"
        if good:
            best = min(good, key=lambda o: o.chi2)
            text += f", best so far {label(best.candidate, self.patches)} with {best.rms * 1e3:.3g} mm"
        self.progress.step(text)

    @staticmethod
    def _enough(outcome: Outcome | None, bound: float) -> bool:
        """Whether an outcome answers a question with this bound."""
        return outcome is not None and (outcome.complete or outcome.failed or outcome.chi2 > bound)

    def _add(self, outcome: Outcome | None) -> None:
        """Take an outcome as evaluated; the work of an earlier evaluation, with a smaller bound, adds up."""
        if outcome is None:
            return
        key = outcome.level, outcome.candidate
        earlier = self.outcomes.get(key)
        if earlier is not None:
            share, seconds = outcome.share + earlier.share, outcome.seconds + earlier.seconds
            outcome = replace(outcome, share=share, seconds=seconds)
        self.outcomes[key] = outcome

    def _evaluate(self, forward: Forward, candidate: Candidate, bound: float) -> Outcome:
        start = time.perf_counter()
        chi2 = squares = 0.0
        computed = 0

        def watch(frame: int, predicted: Array) -> bool:
            nonlocal chi2, squares, computed
            more, square = self.misfit.frame(frame, predicted)
            chi2, squares, computed = chi2 + more, squares + square, computed + 1
            return chi2 <= bound

        prediction = forward.predict(candidate, self.actions, watch, fields=True)
        failure = prediction.failure
        if prediction.complete and not failure and chi2 < self._kept.get(forward.level, (math.inf,))[0]:
            self._kept[forward.level] = chi2, candidate, prediction
        return Outcome(
            candidate,
            forward.level,
            math.inf if failure else chi2,
            math.inf if failure else self.misfit.rms(squares),
            prediction.complete and not failure,
            computed / self.misfit.frames,
            failure.status if failure else Status.CONVERGED,
            failure.reason if failure else "",
            time.perf_counter() - start,
        )

    def predict(self, level: int, candidate: Candidate) -> Prediction:
        """Full prediction of one candidate, with fields; collective. The best of each level is kept, others are computed again."""
        forward = self.forward(level)
        kept = self._kept.get(level)
        mine = kept[2] if kept is not None and kept[1] == candidate else None
        holders = [rank for rank, has in enumerate(self.comm.allgather(mine is not None)) if has]
        if not holders and self.comm.rank == 0:
            mine = forward.predict(candidate, self.actions, fields=True)
        result: Prediction = self.comm.bcast(mine, root=holders[0] if holders else 0)
        return result

    def positions(self, level: int, candidate: Candidate) -> Array:
        """Predicted fiducial positions of one candidate, shape (frames, fiducials, 3), m; collective."""
        key = level, candidate
        if key not in self._positions:
            self._positions[key] = self.predict(level, candidate).positions
        return self._positions[key]

    def evaluations(self) -> dict[int, float]:
        """Forward trajectories computed per level, in whole-trajectory equivalents."""
        counts: dict[int, float] = {}
        for (level, _), outcome in sorted(self.outcomes.items(), key=lambda item: (item[0][0], sorted(item[0][1]))):
            counts[level] = counts.get(level, 0.0) + outcome.share
        return counts

    def destroy(self) -> None:
        """Free meshes and solvers of this process."""
        for forward in self._forwards.values():
            forward.destroy()
        self._forwards.clear()
