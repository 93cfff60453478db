"""The posterior after pulls: the search of `bcid explain` over all of them as one measurement."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from bcid.base.errors import SolveError
from bcid.base.progress import Progress, Silent
from bcid.comparison.candidates import Known
from bcid.comparison.first_state import first_state
from bcid.comparison.fitted_hypothesis import FittedHypothesis, best_first
from bcid.comparison.full_search import FullSearch
from bcid.comparison.hypothesis_table import HypothesisTable
from bcid.comparison.loosened import loosens
from bcid.exploration.fitted_numbers import FittedNumbers
from bcid.exploration.joined import joined
from bcid.exploration.posterior_summary import PosteriorSummary
from bcid.exploration.predictions import PullPredictor
from bcid.forms.effects.effect import Effect
from bcid.forms.gripper_force import ForceScale
from bcid.forms.model import Model
from bcid.inference.hypotheses import Hypothesis, effects, entropy, patches
from bcid.measurement import Measurement
from bcid.predict.kept_actions import KeptActions
from bcid.predict.predictor import Predictor
from bcid.predict.store import PredictionStore
from bcid.scene import Scene
from bcid.search.seeds import all_candidates, random_seeds
from bcid.search.settings import SETTINGS

Array = NDArray[np.float64]
Anchored = frozenset[str]
# All sets of so many patches are hypotheses before the first pull; of more patches so many random ones.
_ENUMERATED, _RANDOM = 10, 64
# Sets that are evaluated in a few steps, at most, and effects that are fitted to them, each on so many sets.
_SETS, _ON_SETS = 8, 3
# The least probable sets, which hold no more than this of the probability together, are not predicted for further pulls, unless
# something is rather missing than not. By Markov's inequality they would come to hold 5 % with no more than 20 times this.
_NEGLIGIBLE, _DOUBTED = 1e-3, 0.5
# What these pulls do not show may show in those to come: it keeps its chance.
_UNSEEN = 0.0


class PullPosterior:
    """Probabilities of anchor sets and effects after pulls. `after` is collective, with the same result on all ranks.

    Args:
        scene: the scene.
        working: predicts pulls on the working level.
        level: fine level (see `Predictor`).
        known: effects that may act, one at a time.
        random_state: of the sets to begin with, where there are too many to look at all.
        store: keeps predictions.
        progress: told what goes on (give it on rank 0 only).

    Attributes:
        seen: the pulls that could be compared.
        failure: why the latest of them could not be compared with any set; "" where they could.
    """

    def __init__(
        self,
        scene: Scene,
        working: PullPredictor,
        level: int | None = None,
        known: Sequence[Effect] = (),
        random_state: int = 0,
        store: PredictionStore | None = None,
        progress: Progress | None = None,
    ) -> None:
        self.scene, self.working, self.level, self.known, self.store = scene, working, level, tuple(known), store
        self.progress = progress or Silent()
        self.names = tuple(effect.name for effect in known)
        self.seen: list[Measurement] = []
        self.failure = ""
        self._random_state = random_state
        # At most one, which those that were made anew share.
        self._predictors: list[Predictor] = []
        # Likely sets after the pulls before.
        self._likely: list[Anchored] = []
        self._excluded: set[Anchored] = set()

    def anew(self) -> PullPosterior:
        """The same before any pull; meshes and forward models are shared."""
        other = PullPosterior(
            self.scene, self.working, self.level, self.known, self._random_state, self.store, self.progress
        )
        other._predictors = self._predictors
        return other

    def before(self, fine: bool) -> PosteriorSummary:
        """What is believed before any pull; `fine`: whether a finer level tells the error of the mesh."""
        names = list(self.scene.patches)
        if len(names) <= _ENUMERATED:
            sets = all_candidates(names)
        else:
            sets = random_seeds(names, _RANDOM, np.random.default_rng(self._random_state))
        return PosteriorSummary.before([frozenset(s) for s in dict.fromkeys(sets)], names, self.names, fine)

    def after(self, pull: Measurement) -> PosteriorSummary | None:
        """What is believed after one pull more; None where no set can be followed in it; collective."""
        self.seen.append(pull)
        whole = joined(self.seen, self.scene)
        if self._predictors and self._predictors[0].forces != ForceScale.of(self.scene, whole):
            self._predictors.pop().destroy()
        if not self._predictors:
            self._predictors.append(Predictor(self.scene, whole, self.working.comm, self.level, store=self.store))
            self._predictors[0].repeated = KeptActions()
        predictor = self._predictors[0].repeating(whole)
        predictor.progress = self.progress
        model = Model.of(self.scene)
        try:
            table = self._searched(predictor, model, whole)
            if self._excluded and _missing(table) > _DOUBTED:
                # Where something is missing odds are not worth as much.
                self._excluded = set()
                table = self._searched(predictor, model, whole)
        except SolveError as error:
            # With it no later pull could be compared either.
            self.seen.pop()
            self.failure = str(error)
            return None
        self.failure, self._likely = "", table.sets[: SETTINGS.first_sets]
        self._exclude(table)
        found = self._summary(table, model)
        predictor.drop([model])
        return found

    def _searched(self, predictor: Predictor, model: Model, whole: Measurement) -> HypothesisTable:
        """What is known of hypotheses after all pulls."""
        acting = [e for e in self.known if not (e.needs and e.needs(self.scene, whole))]
        base, sets = first_state(predictor, model, self._likely)
        fits = _ON_SETS * len(acting)
        return FullSearch(base, Known(tuple(acting)), sets, 1, fits, _SETS, _UNSEEN, self._predicted).run()

    def _exclude(self, table: HypothesisTable) -> None:
        """Note the least probable sets, which hold a negligible part of the probability together."""
        shares: dict[Anchored, float] = {}
        for h, p in table.odds.probabilities.items():
            shares[h.anchors] = shares.get(h.anchors, 0.0) + p
        order = sorted(shares, key=lambda s: (shares[s], -len(s), sorted(s)))
        count = int(np.searchsorted(np.cumsum([shares[s] for s in order]), _NEGLIGIBLE))
        self._excluded = (self._excluded - shares.keys()) | set(order[:count])

    def _predicted(self, sets: Sequence[Anchored]) -> dict[Anchored, Array]:
        """Where the markers go with sets in all pulls, each (frames, rows, 3), m, but for those that the pulls before exclude."""
        actions, wanted = [pull.actions[0] for pull in self.seen], [s for s in sets if s not in self._excluded]
        found = iter(self.working.predict([(anchors, action) for anchors in wanted for action in actions]))
        rows = self._predictors[0].data.mask.shape[1]
        whole = {anchors: np.concatenate([next(found).positions[:, :rows] for _ in actions]) for anchors in wanted}
        return {anchors: positions for anchors, positions in whole.items() if np.isfinite(positions).all()}

    def _summary(self, table: HypothesisTable, model: Model) -> PosteriorSummary:
        probabilities: dict[Hypothesis, float] = {}
        for h, p in table.odds.probabilities.items():
            probabilities[h.known] = probabilities.get(h.known, 0.0) + p
        probabilities = dict(sorted(probabilities.items(), key=lambda item: (-item[1], item[0].order)))
        rivals = best_first([*table.full, *table.rough])
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

    def destroy(self) -> None:
        """Free the PETSc objects."""
        for predictor in self._predictors:
            predictor.destroy()


def _numbers(
    probabilities: Iterable[Hypothesis], rivals: Sequence[FittedHypothesis], begun: Model
) -> dict[Hypothesis, FittedNumbers]:
    """Numbers of hypotheses with an effect: as they were fitted, or with another set where that is the best that is known."""
    found: dict[Hypothesis, FittedNumbers] = {}
    for h in (h for h in probabilities if h.names):
        same = [r for r in rivals if r.names == h.names and _acts_on(r, h.anchors)]
        rival = next((r for r in same if r.anchors == h.anchors), next(iter(same), None))
        if rival is not None:
            found[h] = FittedNumbers(rival, begun)
    return found


def _acts_on(rival: FittedHypothesis, anchors: Anchored) -> bool:
    """Whether the patches that its effect holds by springs, or lets go, are among some."""
    return {term.place for term in rival.fitted.state.model.terms if term.place and loosens(term.effect)} <= anchors


def _missing(table: HypothesisTable) -> float:
    """Probability that something unknown acts."""
    return min(1.0, math.fsum(p for h, p in table.odds.probabilities.items() if h.unknown))


def _mesh_error(rival: FittedHypothesis) -> float:
    """RMS error that the mesh leaves, as part of the motion."""
    data, errors = rival.fitted.state.predictor.data, rival.fitted.state.errors
    moved = data.vector(np.broadcast_to(data.rest, data.mask.shape))
    motion = data.rms(data.values - moved)
    return errors.mesh_rms / max(motion, 1e-12) if errors.mesh.known else 0.0
