"""The hypotheses of an explanation with what is known of their evidence, at whatever fidelity, and their posterior."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from bcid.base.tails import chi2_limit
from bcid.base.units import WIDE
from bcid.comparison.contest import Contest
from bcid.comparison.hypothesis_search import Promised
from bcid.comparison.loosened import loosens
from bcid.comparison.ranking import Row
from bcid.comparison.rivals import Rival, best_first
from bcid.forms.model import Model
from bcid.inference.criteria import FAILS_FOR_THE_TRUE, SURPRISE
from bcid.inference.hypotheses import Hypothesis, HypothesisOdds, log_prior
from bcid.inference.posterior import Evaluation, Fidelity, Pair, Posterior, Toggles, toggles
from bcid.inference.unknown_force import Evidence
from bcid.search.settings import SETTINGS

Array = NDArray[np.float64]
Anchored = frozenset[str]


@dataclass(frozen=True)
class TangentEvidence:
    """What the tangent of a hypothesis that was compared with all steps says of others.

    Attributes:
        about: that hypothesis.
        sets: evidence of its effects on other sets, and on its own.
        effects: logarithms of the evidence of further effects on its set.
        known: how many effects may act.
    """

    about: Hypothesis
    sets: Mapping[Anchored, Evidence] = field(default_factory=dict)
    effects: Mapping[str, float] = field(default_factory=dict)
    known: int = 1


@dataclass
class HypothesisTable:
    """Hypotheses as far as they were compared.

    Attributes:
        own: those that were compared with all steps, each with the error of the mesh as its own hierarchy has it, the likeliest
            first.
        full: the same, all with what may be left of that error where it is largest among them.
        coarse: those that were compared with a few steps, in the stages in which they were.
        tangents: what tangents in all steps say of others.
        reduced: by hypothesis, sets that lack one of its patches and may be as likely although its tangent shows them less so.
        refused: hypotheses that cannot be followed to the end.
        alike: whether effects are ways to write the same, see `HypothesisOdds`.
        _left: what may be left of the error of the mesh that `full` was compared with.
        _allowing: each of `own`, by its identity, and the same in `full`: none is weighed twice with the same.
        _odds: of all that is known; None where something has come since.
    """

    own: list[Rival] = field(default_factory=list)
    full: list[Rival] = field(default_factory=list)
    coarse: list[Contest] = field(default_factory=list)
    tangents: list[TangentEvidence] = field(default_factory=list)
    reduced: dict[Hypothesis, list[Anchored]] = field(default_factory=dict)
    refused: set[Hypothesis] = field(default_factory=set)
    alike: bool = False
    _left: Array | None = None
    _allowing: dict[int, tuple[Rival, Rival]] = field(default_factory=dict)
    _odds: HypothesisOdds | None = field(default=None, init=False)

    # -- what is known
    # -----------------------------------------------------------------------------------------------------------

    def add(self, rivals: Iterable[Rival], begun: Model) -> None:
        """What was compared with all steps; of what comes twice the latest counts. `begun` is the model without added effects."""
        self.own = best_first({r.hypothesis: r for r in (*self.own, *rivals)}.values())
        left = _most_left([r for r in self.own if r.log > self.own[0].log - SETTINGS.unlikely])
        self._allowing = {id(r): (r, self._with(r, left, begun)) for r in self.own}
        self.full, self._left = best_first(allowed for _, allowed in self._allowing.values()), left
        self._odds = None

    def _with(self, rival: Rival, left: Array, begun: Model) -> Rival:
        """A hypothesis with what may be left of the error of the mesh with another; what is known is not weighed again."""
        _, known = self._allowing.get(id(rival), (rival, None))
        return known if known is not None and self._left is left else rival.allowing(left, begun)

    def add_sets(self, rival: Rival, sets: Mapping[Anchored, Evidence]) -> None:
        """What the tangent of a hypothesis says of other sets."""
        self._replace(TangentEvidence(rival.hypothesis, sets=sets, known=rival.known))

    def add_effects(self, rival: Rival, rows: Iterable[Row]) -> None:
        """What the tangent of a hypothesis says of effects."""
        plain = rival.evidence.plain
        effects = {row.effect: plain + row.gain for row in rows if math.isfinite(row.gain)}
        self._replace(TangentEvidence(rival.hypothesis, effects=effects, known=rival.known))

    def _replace(self, tangent: TangentEvidence) -> None:
        def key(one: TangentEvidence) -> tuple[Hypothesis, bool]:
            return one.about, bool(one.sets)

        self.tangents = [one for one in self.tangents if key(one) != key(tangent)] + [tangent]
        self._odds = None

    def refuse(self, hypothesis: Hypothesis) -> None:
        """Note that one cannot be followed to the end."""
        self.refused.add(hypothesis)
        self._odds = None

    def add_stage(self, stage: Contest) -> None:
        """What was compared with a few steps."""
        self.coarse.append(stage)
        self._odds = None

    # -- the posterior
    # -----------------------------------------------------------------------------------------------------------

    @property
    def odds(self) -> HypothesisOdds:
        """Posterior probabilities of all hypotheses; a patch is attached where its stiffness is not zero."""
        if self._odds is None:
            self._odds = self._weighed()
        return self._odds

    def _weighed(self) -> HypothesisOdds:
        found = self.posterior().probabilities()
        slack = {r.hypothesis: self._without_slack(r) for r in self.full}
        for h in list(found):
            free = slack.get(h.known)
            if free is not None:
                same = replace(free, unknown=h.unknown)
                found[same] = found.get(same, 0.0) + found.pop(h)
        return HypothesisOdds(dict(sorted(found.items(), key=lambda item: (-item[1], item[0].order))), self.alike)

    def _without_slack(self, rival: Rival) -> Hypothesis | None:
        """The same with a patch free whose springs may have no stiffness; None where all patches hold.

        Springs that may as well be infinitely stiff have a large standard error too: the likelier of both ends tells.
        """
        for term in rival.fitted.state.model.terms:
            if term.place and loosens(term.effect) and term.effect.held is None:
                (name,) = term.values
                effects = "+".join(n for n in rival.names if n != term.effect.name)
                free, rigid = (self._of(Hypothesis(a, effects)) for a in (rival.anchors - {term.place}, rival.anchors))
                loose = term.values[name] < WIDE * rival.fitted.stderr.get(term.full(name), 0.0)
                if loose and free is not None and (rigid is None or free.log > rigid.log):
                    return free.hypothesis
        return None

    def _of(self, hypothesis: Hypothesis) -> Rival | None:
        """A hypothesis as it was compared with all steps."""
        return next((r for r in self.full if r.hypothesis == hypothesis), None)

    @property
    def neglected(self) -> float:
        """Probability of the hypotheses that were not compared with all steps."""
        found = self.odds.probabilities.items()
        return min(1.0, math.fsum(p for h, p in found if not self._fitted(h.known)))

    def posterior(self) -> Posterior:
        """Of all hypotheses, each at the fidelity with the smallest error."""
        full = {r.hypothesis: r for r in self.full}
        known = Posterior({}, self._pairs(full), self._ceiling())
        found = {h: Evaluation(log, 0.0, prior) for r in self.full for h, (log, prior) in r.weights.items()}
        lower: dict[Hypothesis, tuple[float, Evaluation]] = {}
        for h, one in self._below(full):
            if h.known in full or not math.isfinite(one.base + one.gain):
                continue
            if h.known in self.refused:
                one = self._unfollowed(one)
            variance = known.variance(one)
            if h not in lower or variance < lower[h][0]:
                lower[h] = variance, one
        found |= {h: one for h, (_, one) in lower.items()}
        finite = {h: one for h, one in found.items() if math.isfinite(one.base + one.gain)}
        return Posterior(finite, known.pairs, known.ceiling)

    def _unfollowed(self, one: Evaluation) -> Evaluation:
        """A hypothesis that cannot be followed to the end: that solves fail says no more than how often they do.

        Their rate is that of this run, beside one hypothesis of which the true one's rate is known. Of the frames that it does not
        reach a hypothesis predicts what the best one does.
        """
        rate = (FAILS_FOR_THE_TRUE + len(self.refused)) / (1 + len(self.full) + len(self.refused))
        best = max(max(r.evidence.plain, r.evidence.forced) for r in self.full)
        return replace(one, gain=min(one.gain, best - one.base), log_prior=one.log_prior + math.log(rate))

    def _ceiling(self) -> float:
        """Logarithm of the evidence of a hypothesis that leaves noise alone, or of the best; none where no noise is stated."""
        state = self.full[0].judged
        data = state.predictor.data
        if not data.stated:
            return math.inf
        noise = -0.5 * chi2_limit(1 - SURPRISE, len(data)) - state.errors.log_volume
        return max(noise, *(max(r.evidence.plain, r.evidence.forced) for r in self.full))

    def _below(self, full: Mapping[Hypothesis, Rival]) -> Iterator[tuple[Hypothesis, Evaluation]]:
        """What is known of hypotheses below the full fidelity."""
        for stage in self.coarse:
            yield from _Stage(stage, full).evaluations()
        for tangent in self.tangents:
            if tangent.about in full:
                yield from self._linearised(tangent, full[tangent.about])

    def _linearised(self, tangent: TangentEvidence, about: Rival) -> Iterator[tuple[Hypothesis, Evaluation]]:
        """Other sets, with whatever was compared on the same set; and further effects on it."""
        here = tangent.sets.get(about.anchors)
        acting = [r for r in self.full if r.anchors == about.anchors]
        for anchors, there in tangent.sets.items() if here else ():
            assert here is not None
            apart = {False: there.plain - here.plain, True: there.forced - here.forced}
            for r in acting if anchors != about.anchors else ():
                for h, (log, prior) in r.weights.items():
                    other = Hypothesis(anchors, h.effect, h.unknown)
                    gain = apart[h.unknown]
                    yield other, Evaluation(log, gain, prior, toggles(Fidelity.TANGENT, other, h, gain))
        for effect, log in tangent.effects.items():
            h = Hypothesis(about.anchors, "+".join([*about.names, effect]))
            prior = log_prior(len(h.names), False, tangent.known)
            base = _log(about)
            changed = toggles(Fidelity.TANGENT, h, about.hypothesis, log - base)
            yield h, Evaluation(base, log - base, prior, changed)

    def _pairs(self, full: Mapping[Hypothesis, Rival]) -> list[Pair]:
        """Hypotheses that are known at two fidelities."""
        found = [pair for stage in self.coarse for pair in _Stage(stage, full).pairs()]
        for tangent in self.tangents:
            about = full.get(tangent.about)
            here = None if about is None else tangent.sets.get(about.anchors)
            for r in self.full:
                there = tangent.sets.get(r.anchors)
                if about and here and there and r.names == about.names:
                    low = there.total - here.total
                    changed = toggles(Fidelity.TANGENT, r.hypothesis, tangent.about, low)
                    found.append(Pair(changed, low, _log(r) - _log(about)))
                if about and r.anchors == about.anchors and r.names[:-1] == about.names and r.names:
                    low = tangent.effects.get(r.effect, math.nan) - _log(about)
                    changed = toggles(Fidelity.TANGENT, r.hypothesis, tangent.about, low)
                    found.append(Pair(changed, low, r.evidence.plain - _log(about)))
        return found

    # -- what to compare next
    # -----------------------------------------------------------------------------------------------------------

    def changes(self) -> dict[Hypothesis, float]:
        """By how much the Brier score may fall once a hypothesis below the full fidelity is compared with all steps.

        That is the variance of whether it is true (Brier, Mon. Weather Rev. 78, 1950, 1). It is one where a hypothesis is more
        probable than each that was compared so: no answer is reported from a few steps or a tangent. Of those that may explain all
        the one with the largest evidence comes first, whatever the ceiling leaves of it.
        """
        shares: dict[Hypothesis, float] = {}
        for h, p in self.odds.probabilities.items():
            shares[h.known] = shares.get(h.known, 0.0) + p
        likeliest = min(shares, key=lambda h: (-shares[h], h.order))
        found = self.posterior().evaluations
        logs = {h: one.base + one.gain + one.log_prior for h, one in found.items() if not h.unknown}
        waiting = [h for h in shares if not self._fitted(h) and h not in self.refused]
        waiting.sort(key=lambda h: (-logs.get(h, -math.inf), h.order))
        return {h: 1.0 if h == likeliest else shares[h] * (1 - shares[h]) for h in waiting}

    def sets_about(self, hypothesis: Hypothesis) -> Mapping[Anchored, Evidence]:
        """What its tangent says of other sets, and of its own; nothing where it was not asked."""
        return next((one.sets for one in self.tangents if one.about == hypothesis and one.sets), {})

    def unopposed(self) -> Hypothesis | None:
        """The likeliest without one of its effects or patches, if that was not compared with all steps and may be.

        Without an effect on the same set; without a patch that gives or comes off also on the set that never had it.
        """
        best = self.best()
        held = {t.effect.name: t.place for t in best.fitted.state.model.terms if t.place and loosens(t.effect)}
        lesser = []
        for name in best.names[::-1]:
            others = "+".join(n for n in best.names if n != name)
            lesser += [
                Hypothesis(best.anchors - {place}, others) for place in ("", *([held[name]] if name in held else []))
            ]
        lesser += [Hypothesis(anchors, best.hypothesis.effect) for anchors in self.reduced.get(best.hypothesis, ())]
        return next((h for h in lesser if not self._fitted(h) and h not in self.refused), None)

    def _fitted(self, hypothesis: Hypothesis) -> bool:
        """Whether it was compared with all steps."""
        return self._of(hypothesis) is not None

    def best(self) -> Rival:
        """The likeliest of the hypotheses that were compared with all steps."""
        full = {h: p for h, p in self.odds.probabilities.items() if any(h in r.logs for r in self.full)}
        chosen = HypothesisOdds(full, self.alike).best
        return next(r for r in self.full if chosen in r.logs)

    def roughly(self, hypothesis: Hypothesis) -> Rival | None:
        """A hypothesis as it was fitted to a few steps, in the latest stage in which it was."""
        rivals = (r for stage in self.coarse[::-1] for r in stage.rivals)
        return next((r for r in rivals if r.hypothesis == hypothesis), None)

    @property
    def rough(self) -> list[Rival]:
        """Hypotheses that were compared with a few steps and not with all."""
        full = {r.hypothesis for r in self.full}
        found = {r.hypothesis: r for stage in self.coarse for r in stage.rivals if r.hypothesis not in full}
        return best_first(found.values())


def _log(rival: Rival) -> float:
    """Logarithm of the evidence with or without a discrepancy; all effects are as likely."""
    return rival.log - log_prior(len(rival.names), False, rival.known)


class _Stage:
    """Hypotheses that were compared with a few steps: each keeps its distance from the nearest that was compared with all."""

    def __init__(self, stage: Contest, full: Mapping[Hypothesis, Rival]) -> None:
        self.stage, self._full = stage, full
        both = [(rough, full[rough.hypothesis]) for rough in stage.rivals if rough.hypothesis in full]
        both = [pair for pair in both if all(math.isfinite(rival.log) for rival in pair)]
        # The likeliest first.
        self.both = sorted(both, key=lambda pair: (-pair[1].log, pair[1].hypothesis.order))

    def evaluations(self) -> Iterator[tuple[Hypothesis, Evaluation]]:
        """What the stage knows of hypotheses."""
        for rival in self.stage.rivals if self.both else ():
            rough, fine = self._nearest(rival.hypothesis)
            for h, (log, prior) in rival.weights.items():
                gain = log - _log(rough)
                changed = toggles(Fidelity.COARSE, h, fine.hypothesis, gain)
                yield h, Evaluation(_log(fine), gain, prior, changed)
        for one in self.stage.promised.values() if self.both else ():
            rough, fine = self._nearest(one.about)
            gain = one.log - _log(rough)
            yield one.hypothesis, Evaluation(_log(fine), gain, one.log_prior, self._promised(one, fine, gain))

    @staticmethod
    def _promised(one: Promised, fine: Rival, gain: float) -> Toggles:
        """In which what a tangent of the stage promises differs from a hypothesis that was compared with all steps."""
        coarse = toggles(Fidelity.COARSE, one.about, fine.hypothesis, gain)
        return (*toggles(Fidelity.TANGENT, one.hypothesis, one.about, gain), *coarse)

    def pairs(self) -> Iterator[Pair]:
        """What it was off, against the likeliest hypothesis that was compared with all steps; and what its tangents were."""
        for rough, fine in self.both[1:]:
            base_rough, base = self.both[0]
            low, high = _log(rough) - _log(base_rough), _log(fine) - _log(base)
            yield Pair(toggles(Fidelity.COARSE, fine.hypothesis, base.hypothesis, low), low, high)
        for told in self.stage.promised.values() if self.both else ():
            if fitted := self._full.get(told.hypothesis):
                rough, fine = self._nearest(told.about)
                low, high = told.log - _log(rough), fitted.evidence.plain - _log(fine)
                yield Pair(self._promised(told, fine, low), low, high)
        for one in self.stage.kept:
            low, high = one.low - one.base, one.high - one.base
            yield Pair(toggles(Fidelity.TANGENT, one.hypothesis, one.about, low), low, high)

    def _nearest(self, h: Hypothesis) -> tuple[Rival, Rival]:
        """Of those that were compared with all steps the one that differs least from a hypothesis: in the stage, and in all."""
        return min(self.both, key=lambda pair: len(toggles(Fidelity.COARSE, h, pair[1].hypothesis, 0.0)))


def _most_left(rivals: Sequence[Rival]) -> Array:
    """What may be left of the error of the mesh where it is largest, (frames, fiducials, 3), m.

    Hypotheses are compared with that: what an unknown force does on a mesh is no more exact than what a known one does, and none
    gains by being seen more exactly.
    """
    return max((rival.fitted.state.errors for rival in rivals), key=lambda errors: errors.mesh_rms).mesh.left
