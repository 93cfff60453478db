"""The posterior after pulls: the search of `bcid explain` over all of them as one measurement."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bcid.base.errors import SolveError
from bcid.base.progress import Progress, Silent
from bcid.exploration.fitted_numbers import FittedNumbers
from bcid.exploration.joined import JoinedPredictors
from bcid.exploration.posterior_summary import PosteriorSummary
from bcid.forms.effects.effect import Effect
from bcid.forms.model import Model
from bcid.inference.discrepancy import Evidence
from bcid.inference.hypotheses import Hypothesis, HypothesisOdds, effects, entropy, patches
from bcid.measurement import Action, Measurement
from bcid.predict.predictor import Predictor
from bcid.predict.pull_predictor import PullPredictor
from bcid.scene import Scene
from bcid.search.candidates import Known
from bcid.search.fitting.fitted_hypothesis import FittedHypothesis, best_first
from bcid.search.fitting.state import State
from bcid.search.full_search import FullSearch
from bcid.search.hill_climbing import all_candidates, random_seeds
from bcid.search.hypothesis_table import HypothesisTable
from bcid.search.searched import searched
from bcid.search.set_tangents import neighbours, sets_predicted
from bcid.search.settings import SETTINGS

Array = NDArray[np.float64]
Anchored = frozenset[str]


class PullPosterior:
    """Probabilities of anchor sets and effects after pulls. `after` is collective, with the same result on all ranks.

    Args:
        scene: the scene.
        working: predicts pulls on the working level.
        predictors: of all pulls.
        known: effects that may act, one at a time.
        random_state: of the sets to begin with, where there are too many to look at all.
        progress: told what goes on (give it on rank 0 only).

    Attributes:
        seen: the pulls that could be compared.
        failure: why the latest of them could not be compared with any set; "" where they could.
    """

    def __init__(
        self,
        scene: Scene,
        working: PullPredictor,
        predictors: JoinedPredictors,
        known: Sequence[Effect] = (),
        random_state: int = 0,
        progress: Progress | None = None,
    ) -> None:
        self.scene, self.working, self.predictors, self.known = scene, working, predictors, tuple(known)
        self.random_state, self.progress = random_state, progress or Silent()
        self.names = tuple(effect.name for effect in known)
        self.seen: list[Measurement] = []
        self.failure = ""
        # Likely sets after the pulls before, and those that are no hypotheses any more.
        self._likely: list[Anchored] = []
        self._excluded: frozenset[Anchored] = frozenset()

    def anew(self) -> PullPosterior:
        """The same before any pull; meshes and forward models are shared."""
        return PullPosterior(self.scene, self.working, self.predictors, self.known, self.random_state, self.progress)

    def before(self, fine: bool) -> PosteriorSummary:
        """What is believed before any pull; `fine`: whether a finer level tells the error of the mesh."""
        names = list(self.scene.patches)
        if len(names) <= SETTINGS.few_patches:
            sets = all_candidates(names)
        else:
            sets = random_seeds(names, SETTINGS.random_sets, np.random.default_rng(self.random_state))
        return PosteriorSummary.before([frozenset(s) for s in dict.fromkeys(sets)], names, self.names, fine)

    def after(self, pull: Measurement) -> PosteriorSummary | None:
        """What is believed after one pull more; None where no set can be followed in it; collective."""
        self.seen.append(pull)
        predictor, model = self.predictors.of(self.seen), Model.of(self.scene)
        predictor.progress = self.progress
        try:
            table = self._searched(predictor, model)
            if self._excluded and _missing(table) > 0.5:
                # Where something is rather missing than not odds are not worth as much.
                self._excluded = frozenset()
                table = self._searched(predictor, model)
        except SolveError as error:
            # With it no later pull could be compared either.
            self.seen.pop()
            self.failure = str(error)
            return None
        self.failure, self._likely = "", table.sets[: SETTINGS.first_sets]
        self._excluded |= negligible(table.odds)
        found = self._summary(table, model)
        predictor.drop([model])
        return found

    def _searched(self, predictor: Predictor, model: Model) -> HypothesisTable:
        """What is known of hypotheses after all pulls."""
        acting = [e for e in self.known if not e.not_applicable(self.scene, predictor.measurement)]
        actions, rows = tuple(pull.actions[0] for pull in self.seen), predictor.data.mask.shape[1]
        fits, count = SETTINGS.sets_of_effect * len(acting), SETTINGS.first_sets

        def search(base: State, likely: Sequence[Anchored]) -> FullSearch:
            sets, excluded = PossibleSets(self.working, actions, rows), self._excluded - {base.anchors, *likely}
            return FullSearch(base, Known(tuple(acting)), likely, 1, fits, count, sets, excluded)

        return searched(predictor, model, self._likely, search).table

    def _summary(self, table: HypothesisTable, model: Model) -> PosteriorSummary:
        probabilities: dict[Hypothesis, float] = {}
        for h, p in table.odds.probabilities.items():
            probabilities[h.known] = probabilities.get(h.known, 0.0) + p
        probabilities = dict(sorted(probabilities.items(), key=lambda item: (-item[1], item[0].order)))
        # Evidences of all steps and of a few are of other data.
        rivals = [*table.full, *best_first(table.rough)]
        best = table.best()
        state = best.fitted.state
        return PosteriorSummary(
            probabilities,
            patches(probabilities, self.scene.patches),
            effects(probabilities, self.names),
            entropy(probabilities.values()),
            state.rms,
            math.sqrt(state.chi2 / len(state.predictor.data)),
            _missing(table),
            _mesh_error(best),
            _numbers(probabilities, rivals, model),
            best.fitted.stiffness,
            tuple(self.seen),
        )


def _numbers(
    probabilities: Iterable[Hypothesis], rivals: Sequence[FittedHypothesis], begun: Model
) -> dict[Hypothesis, FittedNumbers]:
    """Numbers of hypotheses with an effect: as they were fitted, or with another set where that is the best that is known."""
    found: dict[Hypothesis, FittedNumbers] = {}
    # Many sets share the fit of one of them.
    known: dict[int, FittedNumbers | None] = {}
    for h in (h for h in probabilities if h.names):
        same = [r for r in rivals if r.names == h.names and r.acts_on(h.anchors)]
        rival = next((r for r in same if r.anchors == h.anchors), next(iter(same), None))
        if rival is None:
            continue
        if id(rival) not in known:
            known[id(rival)] = FittedNumbers.of(rival, begun)
        if (numbers := known[id(rival)]) is not None:
            found[h] = numbers
    return found


def _missing(table: HypothesisTable) -> float:
    """Probability that something unknown acts."""
    return min(1.0, math.fsum(p for h, p in table.odds.probabilities.items() if h.unknown))


def _mesh_error(rival: FittedHypothesis) -> float:
    """RMS error that the mesh leaves, as part of the motion."""
    data, errors = rival.fitted.state.predictor.data, rival.fitted.state.errors
    moved = data.vector(np.broadcast_to(data.rest, data.mask.shape))
    motion = data.rms(data.values - moved)
    return errors.mesh_rms / max(motion, 1e-12) if errors.mesh.known else 0.0


@dataclass(frozen=True)
class PossibleSets:
    """What sets predict for all pulls, for `bcid.search.full_search`.

    Attributes:
        working: predicts pulls.
        actions: of all pulls.
        rows: of the measurement: fiducials, and the gripper where its force is measured.
    """

    working: PullPredictor
    actions: tuple[Action, ...]
    rows: int

    def evidences(
        self, rival: FittedHypothesis, begun: Model, excluded: frozenset[Anchored]
    ) -> dict[Anchored, Evidence]:
        """See `bcid.search.full_search.SetEvaluator`."""
        state = rival.judged
        sets = [anchors for anchors in neighbours(state, begun, True) if anchors not in excluded]
        predicted = self._predicted(sets, state.model)
        return sets_predicted(state, begun, predicted, rival.jacobian(state.errors))

    @property
    def failed(self) -> Collection[Anchored]:
        """None is known: a set that cannot be followed in a pull may be so in others."""
        return ()

    def _predicted(self, sets: Sequence[Anchored], model: Model) -> dict[Anchored, Array]:
        """Where the markers go in all pulls, each (frames, rows, 3), m, of the sets that can be followed; collective."""
        tasks = [(anchors, action) for anchors in sets for action in self.actions]
        own = model.constants() == self.working.model.constants()
        found = iter(self.working.predict(tasks, models=None if own else [model] * len(tasks)))
        whole = {s: np.concatenate([next(found).positions[:, : self.rows] for _ in self.actions]) for s in sets}
        return {anchors: positions for anchors, positions in whole.items() if np.isfinite(positions).all()}


def negligible(odds: HypothesisOdds) -> frozenset[Anchored]:
    """The least probable sets, which hold no more than a negligible probability together.

    By Markov's inequality they would come to hold 5 % with no more than 20 times that.
    """
    shares: dict[Anchored, float] = {}
    for h, p in odds.probabilities.items():
        shares[h.anchors] = shares.get(h.anchors, 0.0) + p
    order = sorted(shares, key=lambda s: (shares[s], -len(s), sorted(s)))
    count = int(np.searchsorted(np.cumsum([shares[s] for s in order]), SETTINGS.counting))
    return frozenset(order[:count])
