"""The queue of evaluations: next comes what is expected to change the posterior most, until nothing is worth it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial

from bcid.base.errors import InputError, SolveError
from bcid.comparison.candidates import Candidates
from bcid.comparison.contest import GLANCE, Contest, contest, glanced
from bcid.comparison.curvature import bent
from bcid.comparison.fit import Fit, fit
from bcid.comparison.hypothesis_table import HypothesisTable
from bcid.comparison.ranking import Ranking, rank
from bcid.comparison.rivals import Rival, added, best_first, promoted, sets_about
from bcid.comparison.state import State
from bcid.forms.effects.effect import Effect
from bcid.inference.hypotheses import Hypothesis
from bcid.inference.outcome import label
from bcid.search.settings import SETTINGS

Anchored = frozenset[str]
Task = Callable[[], None]
# Falls of the Brier score that agree in so many digits are equal: the draws tell no more.
_DIGITS = 3


class SearchQueue:
    """Evaluates hypotheses about anchors and effects; `run` is collective on the ranks of the predictor.

    Args:
        base: the model without added effects, compared with all steps, on a likely set.
        candidates: the effects that may be missing.
        starts: likely sets.
        effects: that may act together, at most.
        fitted: effects that are fitted in a few steps beside each model, see `contest`.
        sets: anchor sets that are compared in a few steps.

    Attributes:
        table: what is known of hypotheses.
    """

    def __init__(
        self, base: State, candidates: Candidates, starts: Sequence[Anchored], effects: int, fitted: int, sets: int
    ) -> None:
        self.base, self.model, self.predictor, self.candidates = base, base.model, base.predictor, candidates
        self.starts, self.most, self.few, self.sets = tuple(starts), effects, fitted, sets
        self.table = HypothesisTable(alike=candidates.alike)
        self.effects: dict[str, Effect] = {}
        # What the model without effects lacks on sets, as all steps show it.
        self.rankings: dict[Anchored, Ranking] = {}
        # Effects beside which further ones were sought.
        self.extended: set[tuple[str, ...]] = set()
        self.fits = self.failures = 0

    def run(self) -> HypothesisTable:
        """Evaluate until nothing is expected to change the posterior noticeably, or the budget ends."""
        self.extend(self.base, self.sets)
        while (task := self.next()) is not None:
            task()
        return self.table

    def next(self) -> Task | None:
        """The next evaluation.

        The most probable hypothesis is fitted to all steps first; then its tangents tell of others, and of these the one is fitted
        of which most is expected, then the first one without each of its patches and effects. At last effects are sought beside it.
        """
        best, changes = self.table.best(), self.table.changes()
        likely = max(changes, key=lambda h: round(changes[h], _DIGITS), default=None)
        worth = changes[likely] if likely and max(self.fits, self.failures) < SETTINGS.fits else 0.0
        if likely and worth >= 1.0:
            return partial(self.fit, likely)
        if not best.names and best.anchors not in self.rankings:
            return partial(self.ask_effects, best)
        if not self.table.sets_about(best.hypothesis):
            return partial(self.ask_sets, best)
        if likely and worth > SETTINGS.negligible:
            return partial(self.fit, likely)
        if best.hypothesis not in self.table.reduced:
            return partial(self.reduce, best)
        lesser = self.table.unopposed()
        if lesser is not None:
            return partial(self.fit, lesser)
        if best.names and len(best.names) < self.most and best.names not in self.extended:
            return partial(self.extend, best.fitted.state, 1)
        return None

    # -- evaluations
    # ---------------------------------------------------------------------------------------------------------------

    def fit(self, hypothesis: Hypothesis) -> None:
        """Fit a hypothesis to all steps."""
        self.predictor.progress.step("hypotheses fitted to all steps", self.fits, SETTINGS.fits)
        found = self.fitted(hypothesis)
        if found is None:
            self.failures += 1
            self.table.refuse(hypothesis)
            return
        self.fits += 1
        self.say_fitted(found)
        self.table.add([found], self.model)

    def ask_sets(self, rival: Rival) -> None:
        """What the tangent of a fitted hypothesis says of its effects on other sets."""
        self.table.add_sets(rival, sets_about(rival, self.model))

    def reduce(self, rival: Rival) -> None:
        """Compare a hypothesis in a few steps with the same less one of its patches, where its tangent speaks against these."""
        shown = self.table.sets_about(rival.hypothesis)
        least = shown[rival.anchors].total - SETTINGS.comparable
        unlikely = [anchors for anchors, evidence in shown.items() if evidence.total < least]
        found = rival.without_a_patch(unlikely, glanced(self.predictor), GLANCE, self.model)
        self.table.reduced[rival.hypothesis] = found

    def ask_effects(self, plain: Rival) -> None:
        """What a model without effects lacks, as all steps show it.

        A few steps may show nothing of what remembers, and the errors of another set may hide what an effect explains.
        """
        self.table.add_effects(plain, self.missing(plain).rows)

    def missing(self, plain: Rival) -> Ranking:
        """What a model without effects lacks; asked once for each set."""
        if plain.anchors not in self.rankings:
            wanted = list(self.effects.values())
            try:
                self.rankings[plain.anchors] = rank(plain.judged, wanted, strict=False)
            except SolveError as error:
                self.rankings[plain.anchors] = Ranking((), {effect.name: str(error) for effect in wanted})
        return self.rankings[plain.anchors]

    def extend(self, base: State, sets: int) -> None:
        """Compare sets and effects beside a model in a few steps."""
        progress = self.predictor.progress
        progress.say(f"weighing anchor sets and effects beside {base.model.name}")
        self.extended.add(tuple(term.effect.name for term in base.model.added(self.model)))
        self.fits = self.failures = 0
        missing = self.candidates.beside(base, self.model, self.starts if sets > 1 else ())
        # What the plain model lacks is known by the effects of the first extension.
        self.effects = {effect.name: effect for effect in missing} | self.effects
        among = self.candidates.among
        try:
            found = contest(base, self.model, missing, self.starts, sets, self.few, among, self.candidates)
        except SolveError as error:
            self.predictor.skip(f"sets and effects beside {base.model.name}: {error}")
            found = Contest([Rival.of(Fit.at(base), self.model, among)], {})
        if not self.table.full:
            self.begin(found)
        self.table.add_stage(found)
        self.predictor.drop([self.model, *(rival.fitted.state.model for rival in self.table.full)])

    def begin(self, stage: Contest) -> None:
        """Fit the model without effects to all steps, with its likeliest set, or that of the base where this fails."""
        plain = next((rival for rival in stage.rivals if not rival.names), None)
        found = promoted(plain, self.base, self.model) if plain else None
        if found is None:
            found = Rival.of(_curved(self.base), self.model, self.candidates.among)
        self.say_fitted(found)
        self.table.add([found], self.model)

    # -- how a hypothesis is fitted
    # ---------------------------------------------------------------------------------------------------------------

    def fitted(self, wanted: Hypothesis) -> Rival | None:
        """A hypothesis fitted to all steps, begun at the nearest that is known; None where that fails."""
        names, best = wanted.names, self.table.best()
        more = [name for name in best.names if name not in names]
        if wanted.anchors <= best.anchors and len(more) == 1 and len(names) < len(best.names):
            return promoted(best.without(more[0]), self.base, self.model, anchors=wanted.anchors)
        rough = self.table.roughly(wanted)
        if rough is not None:
            return promoted(rough, self.base, self.model)
        like = next((r for r in self.table.full if r.names == names), None)
        if like is not None:
            return promoted(like, self.base, self.model, anchors=wanted.anchors)
        parent = next((r for r in self.table.full if r.names == names[:-1]), None)
        return self._added(parent, wanted) if parent and names[-1] in self.effects else None

    def _added(self, parent: Rival, wanted: Hypothesis) -> Rival | None:
        """A fitted hypothesis with one effect more; None where that fails."""
        state = parent.fitted.state
        try:
            beside = State.of(self.predictor, state.model, wanted.anchors, None, state.free)
            found = added(beside, self.effects[wanted.names[-1]], self.model, self.candidates.among)
            if found is None or found.term.effect.sudden:
                return found
            # By the error of the mesh that the model without it has, a further effect may seem to act.
            own_errors = promoted(found, self.base, self.model)
            return best_first([found, own_errors] if own_errors else [found])[0]
        except (SolveError, InputError):
            return None

    def say_fitted(self, rival: Rival) -> None:
        """What is left of the measurement by a hypothesis."""
        state = rival.fitted.state
        anchors = label(state.anchors, self.predictor.scene.patches)
        self.predictor.progress.say(f"  {state.model.name}, anchors {anchors}: {state.rms * 1e3:.3g} mm")


def _curved(base: State) -> Fit:
    """The base with its free numbers fitted, and the curvature of what the scene may have wrong, as far as that is known."""
    found = Fit.at(base)
    with suppress(SolveError):
        found = fit(base, base.free) if base.free else found
    with suppress(SolveError):
        found = bent(found)
    return found
