"""The hypotheses of an explanation with what is known of their evidence, at whatever fidelity, and their posterior."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bcid.base.tails import chi2_limit
from bcid.base.units import WIDE
from bcid.forms.model import Model
from bcid.inference.discrepancy import Evidence
from bcid.inference.hypotheses import Hypothesis, HypothesisOdds, log_prior
from bcid.inference.posterior import Evaluation, Fidelity, FidelityStep, Pair, Posterior, toggles
from bcid.inference.priors import PRIORS
from bcid.inference.thresholds import THRESHOLDS
from bcid.search.fitting.fitted_hypothesis import FittedHypothesis, best_first
from bcid.search.fitting.loosened import loosens, slackens
from bcid.search.fitting.ranking import Row
from bcid.search.settings import SETTINGS
from bcid.search.stage_evidence import StageEvidence

Array = NDArray[np.float64]
Anchored = frozenset[str]


@dataclass(frozen=True)
class TangentEvidence:
    """What the tangent of a hypothesis that was evaluated says of others.

    Attributes:
        sets: evidence of its effects on other sets, and on its own.
        fidelity: of these.
        effects: logarithms of the evidence of further effects on its set.
        springs: the same of sets some patches of which give or come off.
        known: how many effects may act.
    """

    sets: Mapping[Anchored, Evidence] = field(default_factory=dict)
    fidelity: Fidelity = Fidelity.TANGENT
    effects: Mapping[str, float] = field(default_factory=dict)
    springs: Mapping[Hypothesis, float] = field(default_factory=dict)
    known: int = 1


@dataclass
class HypothesisTable:
    """Hypotheses as far as they were evaluated at a fidelity, in all steps or in a few, and below it.

    Attributes:
        own: those that were evaluated, each with the error of the mesh as its own hierarchy has it, the likeliest first.
        full: the same, all with what may be left of that error where it is largest among them.
        coarse: tables of a lower fidelity, in the order of the stages in which they were made.
        tangents: what the tangent of a hypothesis says of others.
        reduced: by hypothesis, sets that lack one of its patches and may be as likely although its tangent shows them less so.
        refused: hypotheses that cannot be followed to the end.
        alike: whether effects are ways to write the same, see `HypothesisOdds`.
        excluded: sets of which nothing but a fit tells.
        _left: what may be left of the error of the mesh that `full` was compared with.
        _allowing: each of `own`, by its identity, and the same in `full`: none is weighed twice with the same.
        _odds, _posterior: of all that is known; None where something has come since.
    """

    own: list[FittedHypothesis] = field(default_factory=list)
    full: list[FittedHypothesis] = field(default_factory=list)
    coarse: list[HypothesisTable] = field(default_factory=list)
    tangents: dict[Hypothesis, TangentEvidence] = field(default_factory=dict)
    reduced: dict[Hypothesis, list[Anchored]] = field(default_factory=dict)
    refused: set[Hypothesis] = field(default_factory=set)
    alike: bool = False
    excluded: frozenset[Anchored] = frozenset()
    _left: Array | None = None
    _allowing: dict[int, tuple[FittedHypothesis, FittedHypothesis]] = field(default_factory=dict)
    _odds: HypothesisOdds | None = field(default=None, init=False)
    _posterior: Posterior | None = field(default=None, init=False)

    # -- what is known
    # -----------------------------------------------------------------------------------------------------------

    def add(self, rivals: Iterable[FittedHypothesis], begun: Model) -> None:
        """What was compared with all steps; of what comes twice the latest counts. `begun` is the model without added effects."""
        self.own = best_first({r.hypothesis: r for r in (*self.own, *rivals)}.values())
        left = _most_left([r for r in self.own if r.log > self.own[0].log - SETTINGS.unlikely])
        self._allowing = {id(r): (r, self._with(r, left, begun)) for r in self.own}
        self.full, self._left = best_first(allowed for _, allowed in self._allowing.values()), left
        self.reconsider()

    def _with(self, rival: FittedHypothesis, left: Array, begun: Model) -> FittedHypothesis:
        """A hypothesis with what may be left of the error of the mesh with another; what is known is not weighed again."""
        _, known = self._allowing.get(id(rival), (rival, None))
        return known if known is not None and self._left is left else rival.allowing(left, begun)

    def add_sets(
        self, rival: FittedHypothesis, sets: Mapping[Anchored, Evidence], fidelity: Fidelity = Fidelity.TANGENT
    ) -> None:
        """What the tangent of a hypothesis says of other sets, or what these predict with its errors."""
        self._note(rival, sets=dict(sets), fidelity=fidelity)

    def add_effects(self, rival: FittedHypothesis, rows: Iterable[Row]) -> None:
        """What the tangent of a hypothesis says of effects."""
        plain = rival.evidence.plain
        self._note(rival, effects={row.effect: plain + row.gain for row in rows if math.isfinite(row.gain)})

    def add_springs(self, rival: FittedHypothesis, springs: Mapping[Hypothesis, float]) -> None:
        """Logarithms of the evidence of sets some patches of which give or come off, as the tangent of a hypothesis shows them."""
        self._note(rival, springs=dict(springs))

    def _note(self, rival: FittedHypothesis, **what: Any) -> None:
        before = self.tangents.get(rival.hypothesis, TangentEvidence(known=rival.known))
        self.tangents[rival.hypothesis] = replace(before, **what)
        self.reconsider()

    def refuse(self, hypothesis: Hypothesis) -> None:
        """Note that one cannot be followed to the end."""
        self.refused.add(hypothesis)
        self.reconsider()

    def add_stage(self, stage: HypothesisTable) -> None:
        """What was evaluated at a lower fidelity."""
        self.coarse.append(stage)
        self.reconsider()

    def reconsider(self) -> None:
        """Weigh everything anew, after a table of a lower fidelity has changed."""
        self._odds = self._posterior = None

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

    def _without_slack(self, rival: FittedHypothesis) -> Hypothesis | None:
        """The same with a patch free whose springs may have no stiffness; None where all patches hold.

        Springs that may as well be infinitely stiff have a large standard error too: the likelier of both ends tells.
        """
        for term in rival.fitted.state.model.terms:
            if term.place and slackens(term.effect):
                (name,) = term.values
                effects = "+".join(n for n in rival.names if n != term.effect.name)
                free, rigid = (self._of(Hypothesis(a, effects)) for a in (rival.anchors - {term.place}, rival.anchors))
                loose = term.values[name] < WIDE * rival.fitted.stderr.get(term.full(name), 0.0)
                if loose and free is not None and (rigid is None or free.log > rigid.log):
                    return free.hypothesis
        return None

    def _of(self, hypothesis: Hypothesis) -> FittedHypothesis | None:
        """A hypothesis as it was compared with all steps."""
        return next((r for r in self.full if r.hypothesis == hypothesis), None)

    @property
    def neglected(self) -> float:
        """Probability of the hypotheses that were not compared with all steps."""
        found = self.odds.probabilities.items()
        return min(1.0, math.fsum(p for h, p in found if not self._compared(h)))

    def posterior(self) -> Posterior:
        """Of all hypotheses, each by the best that is known of it."""
        if self._posterior is None:
            self._posterior = self._by_best()
        return self._posterior

    def _by_best(self) -> Posterior:
        full = {r.hypothesis: r for r in self.full}
        ceiling, stages = self._ceiling(), [StageEvidence(s.posterior(), s.full, full) for s in self.coarse]
        pairs = [*(pair for stage in stages for pair in stage.pairs()), *self._pairs(full, ceiling)]
        found = {h: Evaluation(log, prior) for r in self.full for h, (log, prior) in r.weights.items()}
        lower: dict[Hypothesis, list[Evaluation]] = {}
        below = [one for stage in stages for one in stage.evaluations()]
        for h, one in [*below, *self._by_tangents(full, ceiling)]:
            if h.known not in full and h.anchors not in self.excluded and math.isfinite(one.log):
                lower.setdefault(h, []).append(self._unfollowed(one) if h.known in self.refused else one)
        logs = {h: r.log_evidence for h, r in full.items()}
        found |= {h: min(some, key=lambda one: one.order(logs)) for h, some in lower.items()}
        finite = {h: one for h, one in found.items() if math.isfinite(one.log)}
        return Posterior(finite, pairs, ceiling)

    def _unfollowed(self, one: Evaluation) -> Evaluation:
        """A hypothesis that cannot be followed to the end: that solves fail says no more than how often they do.

        Their rate is that of this run, beside one hypothesis of which the true one's rate is known. Of the frames that it does not
        reach a hypothesis predicts what the best one does.
        """
        failed = len(self.refused)
        rate = (PRIORS.failures + failed) / (1 + self._followed_count() + failed)
        best = max(max(r.evidence.plain, r.evidence.forced) for r in self.full)
        return replace(one.at_most(best), log_prior=one.log_prior + math.log(rate))

    def _followed_count(self) -> int:
        """How many hypotheses could be followed in all steps."""
        shared = (t.sets for t in self.tangents.values() if t.fidelity == Fidelity.SHARED)
        sets = {anchors for some in shared for anchors in some}
        return len(self.full) + len(sets - {h.anchors for h in self.refused} - {r.anchors for r in self.full})

    def _ceiling(self) -> float:
        """Logarithm of the evidence of a hypothesis that leaves noise alone, or of the best; none where no noise is stated."""
        state = self.full[0].judged
        data = state.predictor.data
        if not data.stated:
            return math.inf
        noise = -0.5 * chi2_limit(1 - THRESHOLDS.surprise, len(data)) - state.errors.log_volume
        return max(noise, *(max(r.evidence.plain, r.evidence.forced) for r in self.full))

    def _by_tangents(
        self, full: Mapping[Hypothesis, FittedHypothesis], ceiling: float
    ) -> Iterator[tuple[Hypothesis, Evaluation]]:
        """What tangents of hypotheses that were compared with all steps say of others."""
        for about, tangent in self.tangents.items():
            if about in full:
                yield from self._linearised(tangent, full[about], ceiling)

    def _linearised(
        self, tangent: TangentEvidence, about: FittedHypothesis, ceiling: float
    ) -> Iterator[tuple[Hypothesis, Evaluation]]:
        """Other sets with the same effects, further effects on the same set, and patches that give or come off."""
        here = tangent.sets.get(about.anchors)
        for anchors, there in tangent.sets.items() if here else ():
            assert here is not None
            apart = {False: there.plain - here.plain, True: there.forced - here.forced}
            for h, (log, prior) in about.weights.items() if anchors != about.anchors else ():
                other = Hypothesis(anchors, h.effect, h.unknown)
                changed = toggles(tangent.fidelity, other, h, apart[h.unknown])
                nats = wrong_by(tangent, here, there) if h.unknown else PRIORS.error_nats
                step = FidelityStep(log, log, changed, _room(tangent, ceiling - log), nats)
                yield other, Evaluation(log + apart[h.unknown], prior, (step,), h.known)
        for effect, log in tangent.effects.items():
            h = Hypothesis(about.anchors, "+".join([*about.names, effect]))
            yield h, self._of_effects(h, about, log, tangent.known, ceiling)
        for h, log in tangent.springs.items():
            yield h, self._of_effects(h, about, log, tangent.known, ceiling)

    @staticmethod
    def _of_effects(h: Hypothesis, about: FittedHypothesis, log: float, known: int, ceiling: float) -> Evaluation:
        """A hypothesis with further effects, by the tangent of one without them and without a discrepancy."""
        base = about.evidence.plain
        changed = toggles(Fidelity.TANGENT, h, about.hypothesis, log - base)
        step = FidelityStep(base, base, changed, ceiling - base)
        return Evaluation(log, log_prior(len(h.names), False, known), (step,), about.hypothesis)

    def _pairs(self, full: Mapping[Hypothesis, FittedHypothesis], ceiling: float) -> list[Pair]:
        """Hypotheses that were compared with all steps, and of which a tangent in all steps had told."""
        found = list[Pair]()
        for h, tangent in self.tangents.items():
            about = full.get(h)
            here = None if about is None else tangent.sets.get(about.anchors)
            for r in self.full if about else ():
                assert about is not None
                there = tangent.sets.get(r.anchors)
                if here and there and r.names == about.names:
                    low, base = there.total - here.total, about.log_evidence
                    changed = toggles(tangent.fidelity, r.hypothesis, h, low)
                    nats = wrong_by(tangent, here, there)
                    found.append(Pair(changed, low, r.log_evidence - base, _room(tangent, ceiling - base), nats))
                logs = [tangent.springs.get(r.hypothesis)]
                if r.anchors == about.anchors and r.names[:-1] == about.names and r.names:
                    logs.append(tangent.effects.get(r.effect))
                base = about.evidence.plain
                for low in (log - base for log in logs if log is not None):
                    changed = toggles(Fidelity.TANGENT, r.hypothesis, h, low)
                    found.append(Pair(changed, low, r.evidence.plain - base, ceiling - base))
        return found

    # -- what to compare next
    # -----------------------------------------------------------------------------------------------------------

    def changes(self) -> dict[Hypothesis, float]:
        """By how much the Brier score may fall once a hypothesis below the full fidelity is compared with all steps.

        That is the variance of whether it is true (Brier, Mon. Weather Rev. 78, 1950, 1); of the most probable one with a set, or
        with effects, that no hypothesis was compared with, of whether that set, or these effects, are true. It is one where a
        hypothesis is more probable than each that was compared so: no answer is reported from a few steps or a tangent. Of those
        that may explain all the one with the largest evidence comes first, whatever the ceiling leaves of it.
        """
        shares: dict[Hypothesis, float] = {}
        for h, p in self.odds.probabilities.items():
            shares[h.known] = shares.get(h.known, 0.0) + p
        likeliest = min(shares, key=lambda h: (-shares[h], h.order))
        found = self.posterior().evaluations
        logs = {h: one.log + one.log_prior for h, one in found.items() if not h.unknown}
        waiting = [h for h in shares if h not in self.refused and not self._fitted(h)]
        waiting.sort(key=lambda h: (-logs.get(h, -math.inf), h.order))
        shares |= self._open(shares, waiting)
        return {h: 1.0 if h == likeliest else shares[h] * (1 - shares[h]) for h in waiting}

    def _open(self, shares: Mapping[Hypothesis, float], waiting: Iterable[Hypothesis]) -> dict[Hypothesis, float]:
        """Probability of each hypothesis that waits, or of all with its set, or its effects, if it stands for these."""
        found = {h: shares[h] for h in waiting}
        for part in (_set_of, _effect_of):
            known = {part(r.hypothesis) for r in self.full}
            groups: dict[Any, list[Hypothesis]] = {}
            for h in shares:
                if part(h) not in known and h in found:
                    groups.setdefault(part(h), []).append(h)
            for some in groups.values():
                first = max(some, key=lambda h: shares[h])
                found[first] = max(found[first], min(math.fsum(shares[h] for h in some), 0.5))
        return found

    def sets_about(self, hypothesis: Hypothesis) -> Mapping[Anchored, Evidence]:
        """What its tangent says of other sets, and of its own; nothing where it was not asked."""
        return self.tangents[hypothesis].sets if hypothesis in self.tangents else {}

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
        return next((h for h in lesser if not self._compared(h) and h not in self.refused), None)

    def doubtful(self) -> Hypothesis | None:
        """Where something unknown is likeliest, what is to be fitted before that is said; None where nothing counts.

        The likeliest known effects, of which a tangent tells little where much is to be explained; then the likeliest set of which
        only the errors of another tell: a discrepancy explains so much there that it matters which set its columns are of.
        """
        known = self.posterior().evaluations
        if not self.odds.best.unknown:
            return None
        waiting = [
            h
            for h, p in self.odds.probabilities.items()
            if p > SETTINGS.counting and h.known not in self.refused and not self._fitted(h.known)
        ]
        effects = [h for h in waiting if h.names and not h.unknown]
        sets = [h.known for h in waiting if h.unknown and known[h].fidelity == Fidelity.SHARED]
        return next(iter([*effects, *sets]), None)

    def _fitted(self, hypothesis: Hypothesis) -> bool:
        """Whether it was compared with all steps."""
        return self._of(hypothesis) is not None

    def _compared(self, hypothesis: Hypothesis) -> bool:
        """Whether it was compared with all steps, be it with the errors of another set."""
        known = self.posterior().evaluations.get(hypothesis)
        return self._fitted(hypothesis.known) or (known is not None and known.fidelity == Fidelity.SHARED)

    def best(self) -> FittedHypothesis:
        """The likeliest of the hypotheses that were compared with all steps."""
        full = {h: r for r in reversed(self.full) for h in r.weights}
        chosen = HypothesisOdds({h: p for h, p in self.odds.probabilities.items() if h in full}, self.alike).best
        return full[chosen]

    def roughly(self, hypothesis: Hypothesis) -> FittedHypothesis | None:
        """A hypothesis as it was fitted to a few steps, in the latest stage in which it was."""
        rivals = (r for stage in self.coarse[::-1] for r in stage.full)
        return next((r for r in rivals if r.hypothesis == hypothesis), None)

    @property
    def sets(self) -> list[Anchored]:
        """Sets that were evaluated without effects, the most probable first."""
        return [r.anchors for r in self.full if not r.names]

    @property
    def lost(self) -> list[Anchored]:
        """Sets that could not be followed though tangents show them to be likelier than each that was; the likeliest first."""
        best, logs = self.full[0], dict[Anchored, float]()
        for about, tangent in self.tangents.items():
            here = tangent.sets.get(about.anchors)
            for h in self.refused if here else ():
                if h.effect == about.effect and h.anchors in tangent.sets:
                    assert here is not None
                    logs[h.anchors] = (
                        tangent.sets[h.anchors].total - here.total + (self._of(about) or best).log_evidence
                    )
        return sorted((s for s in logs if logs[s] > best.log_evidence), key=lambda s: (-logs[s], len(s), sorted(s)))

    @property
    def rough(self) -> list[FittedHypothesis]:
        """Hypotheses that were compared with a few steps and not with all."""
        full = {r.hypothesis for r in self.full}
        found = {r.hypothesis: r for stage in self.coarse for r in stage.full if r.hypothesis not in full}
        return best_first(found.values())


def wrong_by(tangent: TangentEvidence, here: Evidence, there: Evidence) -> float:
    """How many nats the errors of one set may cost another: of what a discrepancy explains they leave the square of a part.

    That part is what a movement is off by that is told with another set (`Priors.tangent_error`): the columns of the errors are
    such movements.
    """
    if tangent.fidelity != Fidelity.SHARED:
        return PRIORS.error_nats
    explained = max(one.forced - one.plain for one in (here, there))
    return PRIORS.error_nats + PRIORS.tangent_error[0] ** 2 * max(explained, 0.0)


def _room(tangent: TangentEvidence, room: float) -> float:
    """By how much more evidence a set may have; without a tangent nothing is left to be explained."""
    return room if tangent.fidelity == Fidelity.TANGENT else math.inf


def _set_of(h: Hypothesis) -> Anchored:
    return h.anchors


def _effect_of(h: Hypothesis) -> str:
    return h.effect


def _most_left(rivals: Sequence[FittedHypothesis]) -> Array:
    """What may be left of the error of the mesh where it is largest, (frames, fiducials, 3), m.

    Hypotheses are compared with that: what an unknown force does on a mesh is no more exact than what a known one does, and none
    gains by being seen more exactly.
    """
    return max((rival.fitted.state.errors for rival in rivals), key=lambda errors: errors.mesh_rms).mesh.left
