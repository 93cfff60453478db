"""Anchors and effects together: sets are looked at best first, each alone, with an unknown force, and with every effect.

Without the effect that is missing, a wrong set may fit better than the true one, and without the true set a wrong effect may
explain more than the missing one. An unknown force in the place of what is missing lets the true set be seen all the same. A few
steps of each action are enough for that (`State.thinned`).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from bcid.base.errors import SolveError
from bcid.comparison.loosened import Loosened, loosened, loosens
from bcid.comparison.parameter_priors import of_state
from bcid.comparison.ranking import Ranking, Row, rank
from bcid.comparison.state import State
from bcid.forms.effects.effect import Effect
from bcid.forms.model import Model
from bcid.inference.criteria import SEEN
from bcid.inference.evidence import Numbers
from bcid.inference.hypotheses import Hypothesis, log_prior
from bcid.inference.priors import PRIORS
from bcid.inference.unknown_force import Evidence
from bcid.search.settings import SETTINGS

Array = NDArray[np.float64]
Anchored = frozenset[str]
_NOTHING = Evidence(-math.inf, -math.inf, 0.0)


@dataclass(frozen=True)
class Look:
    """What is known of a set on a few steps.

    Attributes:
        state: the model with it.
        evidence: of it, with and without an unknown force.
        ranking: what it lacks, where it was asked.
    """

    state: State
    evidence: Evidence
    ranking: Ranking | None = None


@dataclass(frozen=True)
class Promise:
    """A set with an effect, as the sensitivities tell before it is fitted.

    Attributes:
        look: at the set.
        row: the effect; None where the model is left as it is.
        evidence: logarithm; of the model as it is with or without something unknown besides, each as likely as it is believed.
        log_prior: logarithm of the prior odds; 0 where `evidence` has it.
    """

    look: Look
    row: Row | None
    evidence: float
    log_prior: float = 0.0

    @property
    def log(self) -> float:
        """Of both."""
        return self.evidence + self.log_prior

    @property
    def anchors(self) -> Anchored:
        """The set."""
        return self.look.state.anchors


@dataclass(frozen=True)
class Promised:
    """What a tangent says of a hypothesis.

    Attributes:
        hypothesis: without a discrepancy besides.
        about: the one whose tangent it is.
        log: logarithm of its evidence.
        log_prior: logarithm of its prior odds.
    """

    hypothesis: Hypothesis
    about: Hypothesis
    log: float
    log_prior: float


@dataclass(frozen=True)
class Kept:
    """What a tangent said of a hypothesis that was looked at later.

    Attributes:
        hypothesis, about: the hypothesis, and the one whose tangent it is.
        low, high: logarithm of its evidence by the tangent, and as it was found to be.
        base: the same of the one whose tangent it is.
    """

    hypothesis: Hypothesis
    about: Hypothesis
    low: float
    high: float
    base: float


def weighed(state: State, begun: Model, jacobian: Array | None = None, least: float = SEEN) -> Evidence:
    """Evidence of a model whose free numbers were unknown, beside the model that it was begun from; collective.

    Where their `jacobian` is not known (see `Fit`), it is computed.
    """
    numbers = of_state(state, begun, jacobian, least)
    return _NOTHING if numbers is None else state.evidence(numbers)


def _all_sets(about: Anchored, patches: Sequence[str], cheap: bool) -> list[Anchored]:
    """All sets of a few patches where they are cheap; else those that differ from one by three patches, or two of many, at most."""
    toggled = (
        len(patches)
        if cheap and len(patches) <= SETTINGS.few_patches
        else 3
        if len(patches) <= SETTINGS.few_patches
        else 2
    )
    return [about ^ frozenset(s) for count in range(toggled + 1) for s in combinations(patches, count)]


def _evidences(state: State, known: Numbers, moves: Sequence[Array]) -> list[Evidence]:
    """Of sets that move the fiducials elsewhere by (frames, fiducials, 3), m, than the one of a state.

    How far they move them in each action is known to first order only; and the `known` numbers of the model may be others then.
    """
    data = state.predictor.data
    shifts = np.column_stack([data.vector(moved) for moved in moves])
    inside = data.action[:, None] == np.arange(len(data.actions))
    pulled = (data.vector(state.predicted) - data.vector(np.broadcast_to(data.rest, data.mask.shape))) ** 2
    sizes = np.sqrt((inside.T @ shifts**2) / np.maximum(inside.T @ pulled, 1e-300)[:, None])
    parts = shifts[:, :, None] * inside[:, None, :]
    columns = state.errors.whiten(parts.reshape(len(data), -1)).reshape(parts.shape)
    nowhere, found, (small, large) = np.zeros(len(data.actions)), [], PRIORS.tangent_error
    apart, positive = np.concatenate([nowhere, known.apart]), np.concatenate([nowhere > 0, known.positive])
    for shift, own, size in zip(shifts.T, np.moveaxis(columns, 1, 0), sizes.T, strict=True):
        bent = np.broadcast_to(small + large * np.minimum(size, 1.0) ** 2, (len(known.widths), len(size)))
        numbers = Numbers(np.hstack([own, known.columns]), apart, np.hstack([bent, known.widths]), positive)
        found.append(Evidence.of(state.errors, state.residual - shift, state.forces, numbers))
    return found


class HypothesisSearch:
    """Looks at sets with a model, each once. Methods are collective on the ranks of the predictor.

    Args:
        base: the model on a few steps, with a set to begin with.
        begun: the model without the effects that were added.
        known: the effects that may be missing.
        most: sets whose evidence is computed.
        least: how well an effect must be seen, see `bcid.comparison.parameter_priors.visible`.
        among: of how many effects these were chosen; they are all by default.
    """

    def __init__(
        self,
        base: State,
        begun: Model,
        known: Sequence[Effect],
        most: int,
        least: float = SEEN,
        among: int | None = None,
    ) -> None:
        self.base, self.begun, self.known, self.most, self.least = base, begun, list(known), most, least
        self.among = len(self.known) if among is None else among
        self.looks: dict[Anchored, Look | None] = {}
        self._shown: dict[Anchored, dict[Anchored, Evidence]] = {}
        self._ranked: set[Anchored] = set()
        self._loose: dict[tuple[str, Anchored], Row] = {}
        # Logarithms of the evidence of all sets whose anchors give or come off, as the tangent of one shows them.
        self._given: dict[tuple[str, Anchored], float] = {}
        self._loosened_about = base.anchors
        self._patches = list(base.predictor.scene.patches)

    def run(self, starts: Iterable[Anchored] = ()) -> list[Promise]:
        """Sets and effects, the likeliest first."""
        self.widened(starts)
        self._settle()
        self._rank_sets()
        # With an effect another set may be the likeliest: those around it compete too.
        top = self.promises()[0].anchors
        if top != self.best_sets()[0] and self._look_at(self._likely(top)):
            self._rank_sets()
        self._loosen(self.best_sets()[0])
        return self.promises()

    def sets(self) -> list[Anchored]:
        """Some sets that are likely without effects, the likeliest first."""
        self.around()
        return self.best_sets()

    def lost(self) -> list[Anchored]:
        """Sets that could not be followed, though shown to be likelier than the likeliest that was; the likeliest first."""
        best = self.best_sets()[0]
        shown = self.shown(best)
        return [s for s in self._likely(best) if shown[s] > shown[best] and s in self.looks and self.looks[s] is None]

    def widened(self, starts: Iterable[Anchored]) -> list[Anchored]:
        """The same, of sets to begin with and those that are likely about the likeliest, until it stays that."""
        self.look()
        for anchors in starts:
            self._look(anchors)
        self._widen()
        return self.best_sets()

    def alone(self) -> list[Promise]:
        """The set that was begun with, and effects."""
        self.look()
        self._rank(self.base.anchors)
        self._loosen(self.base.anchors)
        return self.promises()

    def around(self) -> list[Promise]:
        """The set that was begun with, and those that are likely about it."""
        self.look()
        self._look_at(self._likely(self.base.anchors))
        return self.promises()

    def promises(self) -> list[Promise]:
        """What is known, the likeliest first."""
        added, known = len(self.base.model.added(self.begun)), self.among
        found = []
        for look in self.looks.values():
            if look is None:
                continue
            plain, forced = look.evidence.plain, look.evidence.forced
            alone = np.logaddexp(plain + log_prior(added, False, known), forced + log_prior(added, True, known))
            found.append(Promise(look, None, float(alone)))
            for row in self._rows(look):
                found.append(Promise(look, row, plain + row.gain, log_prior(added + 1, False, known)))
        return sorted(found, key=lambda p: (-p.log, len(p.anchors), sorted(p.anchors), p.row.effect if p.row else ""))

    def giving(self) -> dict[Hypothesis, Promised]:
        """All sets whose anchors give or come off, the model being as it is besides.

        Many sets may be as likely so, with a patch each that hardly holds, and together they are likelier than the best of them.
        """
        own = [term.effect.name for term in self.base.model.added(self.begun)]
        prior = log_prior(len(own) + 1, False, self.among)
        about = Hypothesis(self._loosened_about, "+".join(own))
        found = {}
        for (effect, anchors), evidence in self._given.items():
            h = Hypothesis(anchors, "+".join([*own, effect]))
            found[h] = Promised(h, about, evidence, prior)
        return found

    def kept(self) -> list[Kept]:
        """What tangents said of the sets that were looked at."""
        effect = "+".join(term.effect.name for term in self.base.model.added(self.begun))
        found = []
        for about, shown in self._shown.items():
            here = self.looks[about]
            for anchors, look in self.looks.items():
                if look is not None and here is not None and anchors in shown and anchors != about:
                    base, h = here.evidence.total, Hypothesis(anchors, effect)
                    low = base + shown[anchors].total - shown[about].total
                    found.append(Kept(h, Hypothesis(about, effect), low, look.evidence.total, base))
        return found

    def _rows(self, look: Look) -> list[Row]:
        """What a set may lack; that anchors give or come off, as far as that was looked at, only where they do so best."""
        rows = list(look.ranking.rows) if look.ranking else []
        given = {effect for effect, _ in self._loose}
        others = [row for row in rows if row.effect not in given]
        return others + [row for (_, anchors), row in self._loose.items() if anchors == look.state.anchors]

    # -- looking
    # ------------------------------------------------------------------------------------------------------------

    def look(self) -> None:
        """At the set that was begun with."""
        self._look(self.base.anchors)

    def _widen(self) -> None:
        """Look at the sets that are likely about the likeliest one, until it stays that and there are no others."""
        while len(self.looks) < self.most and self._look_at(self._likely(self.best_sets()[0])):
            pass

    def _look_at(self, sets: Sequence[Anchored]) -> bool:
        """Look at the first of some sets; whether there were any to look at."""
        fresh = [s for s in sets if s not in self.looks][: min(SETTINGS.batch, max(self.most - len(self.looks), 0))]
        for anchors in fresh:
            self._look(anchors)
        return bool(fresh)

    def _likely(self, about: Anchored) -> list[Anchored]:
        """The sets that may be as likely as one that was looked at, as its tangent shows them, the likeliest first."""
        found = self.shown(about)
        near = [s for s in found if found[s] > found[about] - SETTINGS.unlikely]
        return sorted(near, key=lambda s: (-found[s], len(s), sorted(s)))

    def shown(self, about: Anchored) -> dict[Anchored, float]:
        """Logarithms of the evidence of sets, with or without a discrepancy; see `evidences`."""
        return {anchors: evidence.total for anchors, evidence in self.evidences(about).items()}

    def evidences(self, about: Anchored) -> dict[Anchored, Evidence]:
        """Evidence of all sets, or those near by, as the tangent of one that was looked at shows them."""
        if about not in self._shown:
            look = self.looks[about]
            assert look is not None
            state = look.state
            sets = [s for s in _all_sets(about, self._patches, state.predictor.thin) if self._acts(s)]
            try:
                moves = state.predictor.moves(state.model, about, state.prediction, sets)
            except SolveError:
                # Without its tangent a set tells nothing of others.
                self._shown[about] = {about: look.evidence}
                return self._shown[about]
            known = of_state(state, self.begun, None, self.least) or Numbers.none(len(state.predictor.data))
            found = _evidences(state, known, moves)
            self._shown[about] = dict(zip(sets, found, strict=True))
        return self._shown[about]

    def _settle(self) -> None:
        """Take the errors of the likeliest set for all, where that is not the one that was begun with."""
        top = self.best_sets()[0]
        look = self.looks[top]
        if look is None or top == self.base.anchors:
            return
        try:
            own = look.state.with_own_errors()
        except SolveError:
            return
        for anchors, other in self.looks.items():
            if other is not None:
                state = own if anchors == top else other.state.with_errors(own.errors.mesh, own.errors.nuisances)
                self.looks[anchors] = Look(state, weighed(state, self.begun, least=self.least))

    def best_sets(self) -> list[Anchored]:
        """Those that were looked at, the likeliest first."""
        totals = {s: look.evidence.total for s, look in self.looks.items() if look is not None}
        return sorted(totals, key=lambda s: (-totals[s], len(s), sorted(s)))

    def _acts(self, anchors: Anchored) -> bool:
        """Whether the model's effects can act where they do, with other anchors."""
        added = self.base.model.added(self.begun)
        scene = self.base.predictor.scene
        return all(t.effect.places is None or t.place in t.effect.places(scene, anchors) for t in added)

    def _look(self, anchors: Anchored) -> None:
        if anchors in self.looks:
            return
        state = self.base
        state.predictor.progress.step("anchor sets weighed with an unknown force", len(self.looks), self.most)
        self.looks[anchors] = None
        try:
            found = state if anchors == state.anchors else state.of_set(anchors)
        except SolveError:
            return
        self.looks[anchors] = Look(found, weighed(found, self.begun, least=self.least))

    def _rank_sets(self) -> None:
        """What every set lacks: with sensitivities of its own where it is likely then, with those of the best otherwise."""
        best = self.best_sets()[0]
        own = self._rank(best)
        for anchors in self.best_sets():
            if anchors not in self._ranked:
                self._rank(anchors, own)
        while len(self._ranked) < SETTINGS.sensitive_sets:
            promises = self.promises()
            near = [p.anchors for p in promises if p.row and p.log > promises[0].log - SETTINGS.unlikely]
            fresh = next((s for s in near if s not in self._ranked), None)
            if fresh is None:
                break
            self._rank(fresh)

    def _loosen(self, about: Anchored) -> None:
        """Look at the sets that fit best when anchors give or come off, as the tangent of one shows them."""
        look, self._loosened_about = self.looks[about], about
        for effect in (e for e in self.known if loosens(e)):
            if look is None or not look.ranking or effect.name in look.ranking.excluded:
                continue
            close = _all_sets(about, self._patches, False)
            every = _all_sets(about, self._patches, len(self._patches) <= SETTINGS.loosened_patches)
            parts = [s for s in close if len(s ^ about) <= 2 and self._acts(s)]
            try:
                found = loosened(look.state, effect, [s for s in every if self._acts(s)], parts)
            except SolveError:
                continue
            best = {one.anchors: one for one in reversed(found)}
            ways: dict[Anchored, list[float]] = {}
            for one in found:
                ways.setdefault(one.anchors, []).append(one.gain)
            self._given |= {(effect.name, s): look.evidence.plain + float(logsumexp(all_)) for s, all_ in ways.items()}
            # Where nothing is missing other sets must be as likely.
            least = -SETTINGS.unlikely if look.evidence.plain > look.evidence.forced else -np.inf
            near = list(dict.fromkeys(one.anchors for one in found if one.gain > least))[: SETTINGS.loosened_sets]
            for anchors in dict.fromkeys([about, *near]):
                self._look(anchors)
                if anchors in best and self.looks[anchors] is not None:
                    self._rank(anchors, look.ranking if anchors not in self._ranked else None)
                    with suppress(SolveError):
                        self._loose[effect.name, anchors] = self._row(look, best[anchors])

    def _row(self, about: Look, found: Loosened) -> Row:
        """What it would explain that a set gives or comes off, as the tangent of another one shows it."""
        look, effect = self.looks[found.anchors], found.term.effect.name
        assert look is not None
        rows = look.ranking.rows if look.ranking else ()
        if all(r.effect != effect for r in rows):
            # The ranking of another set, none of whose places it has.
            rows = rank(look.state, [found.term.effect], strict=False, least=self.least).rows
        row = next((r for r in rows if r.effect == effect), None)
        if row is None:
            raise SolveError(f"{effect}: its sensitivities cannot be computed with these anchors")
        gain = about.evidence.plain + found.gain - look.evidence.plain
        return replace(row, term=found.term, score=look.state.chi2 - found.chi2, explained=found.moved, gain=gain)

    def _rank(self, anchors: Anchored, like: Ranking | None = None) -> Ranking | None:
        """What a set lacks, with its own sensitivities or those of another."""
        look = self.looks[anchors]
        if look is not None and anchors not in self._ranked:
            if like is None:
                self._ranked.add(anchors)
            with suppress(SolveError):
                found = rank(look.state, self.known, strict=False, least=self.least, like=like)
                self.looks[anchors] = replace(look, ranking=found)
        look = self.looks[anchors]
        return look.ranking if look else None
