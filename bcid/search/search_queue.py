"""The queue of evaluations: next comes what is expected to change the posterior most, until nothing is worth it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from functools import partial

from bcid.base.errors import SolveError
from bcid.forms.effects.effect import Effect
from bcid.inference.hypotheses import Hypothesis
from bcid.search.fitting.fitted_hypothesis import FittedHypothesis
from bcid.search.fitting.ranking import Ranking, rank
from bcid.search.fitting.state import State
from bcid.search.hypothesis_table import HypothesisTable
from bcid.search.set_tangents import sets_about
from bcid.search.settings import SETTINGS

Anchored = frozenset[str]
Task = Callable[[], object]
# Falls of the Brier score that agree in so many digits are equal: the draws tell no more.
_DIGITS = 3


class SearchQueue(ABC):
    """Evaluates hypotheses about anchors and effects at one fidelity; `run` is collective on the ranks of the predictor.

    Args:
        base: a model on a likely set, at that fidelity.
        table: takes what becomes known.

    Attributes:
        effects: that may be missing, by name.
        rankings: what models lack, by hypothesis.
    """

    def __init__(self, base: State, table: HypothesisTable) -> None:
        self.base, self.predictor, self.table = base, base.predictor, table
        self.model = base.model
        self.effects: dict[str, Effect] = {}
        self.rankings: dict[Hypothesis, Ranking] = {}

    def run(self) -> HypothesisTable:
        """Evaluate until nothing is expected to change the posterior noticeably, or the budget ends."""
        while (task := self.next()) is not None:
            task()
        return self.table

    def next(self) -> Task | None:
        """The next evaluation.

        The most probable hypothesis is evaluated first; then its tangents tell of others, and of these those are evaluated by which
        the Brier score of the answer may fall most for what they cost.
        """
        best, changes = self.table.best(), self.table.changes()
        changes = {h: change for h, change in changes.items() if self.affordable(h)}
        leader = next((h for h, change in changes.items() if change >= 1.0), None)
        if leader is not None:
            return partial(self.evaluate, [leader])
        worth = {h: round(change / self.cost(h), _DIGITS) for h, change in changes.items()}
        likely = sorted((h for h in worth if worth[h] > SETTINGS.negligible), key=lambda h: -worth[h])
        if (question := self.question(best, likely)) is not None:
            return question
        return partial(self.evaluate, self.batch(likely)) if likely else self.last(best)

    @abstractmethod
    def cost(self, hypothesis: Hypothesis) -> float:
        """Predictions that its evaluation takes, as a part of those of a fit to all steps."""

    @abstractmethod
    def affordable(self, hypothesis: Hypothesis) -> bool:
        """Whether the budget allows a hypothesis to be evaluated."""

    def batch(self, likely: Sequence[Hypothesis]) -> Sequence[Hypothesis]:
        """Of what is worth an evaluation so many as are evaluated before the queue is ordered anew."""
        return likely[:1]

    @abstractmethod
    def question(self, best: FittedHypothesis, likely: Sequence[Hypothesis]) -> Task | None:
        """What tangents are asked next, where the most probable hypothesis is known and others are worth an evaluation."""

    @abstractmethod
    def last(self, best: FittedHypothesis) -> Task | None:
        """What comes once no hypothesis waits."""

    @abstractmethod
    def evaluated(self, wanted: Hypothesis) -> FittedHypothesis | None:
        """A hypothesis at the fidelity of the queue; None where it cannot be followed."""

    # -- evaluations
    # ---------------------------------------------------------------------------------------------------------------

    def evaluate(self, wanted: Sequence[Hypothesis]) -> None:
        """Evaluate hypotheses."""
        found = []
        for hypothesis in wanted:
            one = self.evaluated(hypothesis)
            if one is None:
                self.table.refuse(hypothesis)
            else:
                found.append(one)
        self.table.add(found, self.model)

    def ask_sets(self, rival: FittedHypothesis) -> None:
        """What the tangent of an evaluated hypothesis says of its effects on other sets."""
        state = rival.judged
        found = sets_about(state, self.model, rival.jacobian(state.errors))
        self.table.add_sets(rival, found or {rival.anchors: rival.evidence})

    def ask_effects(
        self, rival: FittedHypothesis, effects: Mapping[str, Effect], like: Ranking | None = None
    ) -> Ranking:
        """What a model lacks, by its own sensitivities or those of another ranking; asked once for each hypothesis."""
        if rival.hypothesis not in self.rankings:
            wanted = list(effects.values())
            try:
                found = rank(rival.judged, wanted, strict=False, like=like)
            except SolveError as error:
                found = Ranking((), {name: str(error) for name in effects})
            self.rankings[rival.hypothesis] = found
            self.table.add_effects(rival, found.rows)
        return self.rankings[rival.hypothesis]
