"""Anchors and effects together: sets are looked at best first, each alone, with an unknown force, and with every effect.

Without the effect that is missing, a wrong set may fit better than the true one, and without the true set a wrong effect may
explain more than the missing one. An unknown force in the place of what is missing lets the true set be seen all the same. A few
steps of each action are enough for that (`State.thinned`).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product

import numpy as np
from numpy.typing import NDArray

from bcid.base.errors import SolveError
from bcid.comparison.priors import of_state
from bcid.comparison.ranking import Ranking, Row, rank
from bcid.comparison.state import State
from bcid.forms.effects.effect import Effect
from bcid.forms.model import Model
from bcid.inference.criteria import SEEN
from bcid.inference.data import Data
from bcid.inference.hypotheses import log_prior
from bcid.inference.likelihood import Errors
from bcid.inference.unknown_force import Evidence, courses
from bcid.search.climb import neighbours

Array = NDArray[np.float64]
Anchored = frozenset[str]
# A set is weighed when its prediction, with the errors of the set that was begun with, is not exp(_FAR) times less likely than the
# best; so many at a time.
_FAR, _BATCH = 12.0, 4
# Effects are looked at with so many of the likeliest sets.
_RANKED = 5
# So many exchanges of two patches are looked at.
_EXCHANGED = 6
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
        log: logarithm of the evidence and of the prior.
    """

    look: Look
    row: Row | None
    log: float

    @property
    def anchors(self) -> Anchored:
        """The set."""
        return self.look.state.anchors


def weighed(state: State, begun: Model, jacobian: Array | None = None, least: float = SEEN) -> Evidence:
    """Evidence of a model whose free numbers were unknown, beside the model that it was begun from; collective.

    Where their `jacobian` is not known (see `Fit`), it is computed.
    """
    numbers = of_state(state, begun, jacobian, least)
    return _NOTHING if numbers is None else state.evidence(numbers)


class HypothesisSearch:
    """Looks at sets with a model, each once. Methods are collective on the ranks of the predictor.

    Args:
        base: the model on a few steps, with a set to begin with.
        begun: the model without the effects that were added.
        known: the effects that may be missing.
        most: sets whose evidence is computed.
        least: how well an effect must be seen, see `bcid.comparison.priors.visible`.
    """

    def __init__(self, base: State, begun: Model, known: Sequence[Effect], most: int, least: float = SEEN) -> None:
        self.base, self.begun, self.known, self.most, self.least = base, begun, list(known), most, least
        self.looks: dict[Anchored, Look | None] = {}
        self._glances: dict[Anchored, float] = {}
        self._patches = list(base.predictor.scene.patches)

    def run(self, starts: Iterable[Anchored]) -> list[Promise]:
        """Sets and effects, the likeliest first."""
        self._look(self.base.anchors)
        self._near(starts)
        self._climb()
        self._remesh()
        for anchors in self._best_sets()[:_RANKED]:
            self._rank(anchors)
        # With an effect another set may be the likeliest: those around it compete too.
        top = self.promises()[0].anchors
        if top != self._best_sets()[0]:
            self._near(neighbours(top, self._patches))
            for anchors in self._best_sets()[:_RANKED]:
                self._rank(anchors)
        return self.promises()

    def alone(self) -> list[Promise]:
        """The set that was begun with, and effects."""
        self._look(self.base.anchors)
        self._rank(self.base.anchors)
        return self.promises()

    def around(self) -> list[Promise]:
        """The set that was begun with, and those around it."""
        self._look(self.base.anchors)
        self._near(neighbours(self.base.anchors, self._patches))
        self._near(self._exchanged(self.base.anchors))
        return self.promises()

    def promises(self) -> list[Promise]:
        """What is known, the likeliest first."""
        count = len(self.base.model.added(self.begun))
        found = []
        for look in self.looks.values():
            if look is None:
                continue
            plain, forced = look.evidence.plain, look.evidence.forced
            alone = np.logaddexp(plain + log_prior(count, False), forced + log_prior(count, True))
            found.append(Promise(look, None, float(alone)))
            for row in look.ranking.rows if look.ranking else ():
                found.append(Promise(look, row, plain + row.gain + log_prior(count + 1, False, len(self.known))))
        return sorted(found, key=lambda p: (-p.log, len(p.anchors), sorted(p.anchors), p.row.effect if p.row else ""))

    # -- looking
    # ------------------------------------------------------------------------------------------------------------

    def _climb(self) -> None:
        """From the likeliest set to the likeliest around it, until none is."""
        done: set[Anchored] = set()
        while (top := self._best_sets()[0]) not in done:
            done.add(top)
            self._near(neighbours(top, self._patches))
            if self._best_sets()[0] == top:
                self._near(self._exchanged(top))

    def _remesh(self) -> None:
        """Take the error of the mesh of the likeliest set for all, where that is not the one that was begun with."""
        top = self._best_sets()[0]
        look, predictor = self.looks[top], self.base.predictor
        if look is None or top == self.base.anchors or not self.base.errors.mesh.known:
            return
        mesh = predictor.mesh_error(look.state.model, top, look.state.prediction)
        if not mesh.known:
            return
        for anchors, other in self.looks.items():
            if other is not None:
                state = other.state.with_mesh(mesh)
                self.looks[anchors] = Look(state, weighed(state, self.begun, least=self.least))

    def _near(self, sets: Iterable[Anchored]) -> None:
        """Weigh those of some sets that a glance does not rule out."""
        fresh = [s for s in dict.fromkeys(sets) if s not in self.looks and s not in self._glances]
        for number, anchors in enumerate(fresh):
            self.base.predictor.progress.step("anchor sets at a glance", number, len(fresh))
            self._glances[anchors] = self._glance(anchors)
        best = self._best_sets()[0]
        if best not in self._glances:
            self._glances[best] = self._glance(best)
        near = [s for s in self._glances if s not in self.looks and self._glances[s] > self._glances[best] - _FAR]
        near.sort(key=lambda s: (-self._glances[s], len(s), sorted(s)))
        for anchors in near[: min(_BATCH, max(self.most - len(self.looks), 0))]:
            self._look(anchors)

    def _exchanged(self, anchors: Anchored) -> list[Anchored]:
        """Sets in which a patch is exchanged for another: the pairs of which each alone costs least."""
        known = self._glances
        pairs = product(sorted(anchors), (p for p in self._patches if p not in anchors))
        cost = {(a, b): known.get(anchors - {a}, -math.inf) + known.get(anchors | {b}, -math.inf) for a, b in pairs}
        likely = sorted((pair for pair in cost if math.isfinite(cost[pair])), key=lambda pair: (-cost[pair], pair))
        return [anchors - {a} | {b} for a, b in likely[:_EXCHANGED]]

    def _best_sets(self) -> list[Anchored]:
        totals = {s: look.evidence.total for s, look in self.looks.items() if look is not None}
        return sorted(totals, key=lambda s: (-totals[s], len(s), sorted(s)))

    def _glance(self, anchors: Anchored) -> float:
        """Logarithm of the density of the data about a set's prediction, with the errors of the set that was begun with."""
        state, predictor = self.base, self.base.predictor
        if not self._acts(anchors):
            return -math.inf
        prediction = predictor.predict(state.model, anchors, keep=True, patient=False)
        if prediction.failure:
            # Halving its steps takes long: that is only done for a set that does well as far as it came.
            if self._behind(prediction.positions) > _FAR:
                return -math.inf
            prediction = predictor.predict(state.model, anchors, keep=True)
            if prediction.failure:
                return -math.inf
        return self._density(predictor.data, prediction.positions)

    def _density(self, data: Data, positions: Array) -> float:
        """Of the data, or some of them, about predicted positions, with the errors of the set that was begun with."""
        state = self.base
        residual = data.values - data.vector(positions + state.errors.mesh.correction)
        if data is state.predictor.data:
            return Evidence.of(state.errors, residual, state.force).total
        rows = np.isin(state.predictor.data.frame, np.unique(data.frame))
        moved = self._size * courses(data, state.slopes[rows])
        modes = state.errors.nuisances.at(rows).beside(moved)
        return Errors(data, state.errors.sigma[rows], state.errors.mesh, modes).log_likelihood(residual)

    @cached_property
    def _size(self) -> float:
        """The likeliest size of an unknown force with the set that was begun with."""
        return self.base.evidence().size

    def _behind(self, positions: Array) -> float:
        """By how much less likely a set is than the one that was begun with, as far as it was followed; 0 where that is nowhere."""
        frames = np.asarray(np.isfinite(positions).all(axis=(1, 2)))
        data = self.base.predictor.data.within(frames)
        if not len(data):
            return 0.0
        return self._density(data, self.base.prediction.positions) - self._density(data, positions)

    def _acts(self, anchors: Anchored) -> bool:
        """Whether the model's effects can act where they do, with other anchors."""
        added = self.base.model.added(self.begun)
        scene = self.base.predictor.scene
        return all(t.effect.places is None or t.place in t.effect.places(scene, anchors) for t in added)

    def _look(self, anchors: Anchored) -> None:
        state = self.base
        state.predictor.progress.step("anchor sets weighed with an unknown force", len(self.looks), self.most)
        self.looks[anchors] = None
        try:
            found = State.of(state.predictor, state.model, anchors, state.errors.mesh, state.free)
        except SolveError:
            return
        self.looks[anchors] = Look(found, weighed(found, self.begun, least=self.least))

    def _rank(self, anchors: Anchored) -> None:
        """What a set lacks."""
        look = self.looks[anchors]
        if look is not None and look.ranking is None:
            self.looks[anchors] = replace(look, ranking=rank(look.state, self.known, strict=False, least=self.least))
