"""The hypotheses that were compared, and what is believed of all of them together."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from bcid.comparison.contest import Contest
from bcid.comparison.loosened import loosens
from bcid.comparison.ranking import Row
from bcid.comparison.rivals import UNLIKELY, Rival, best_first
from bcid.forms.model import Model
from bcid.inference.hypotheses import OTHERS, Hypothesis, HypothesisOdds, log_prior, moderated, with_others

Array = NDArray[np.float64]
Anchored = frozenset[str]


@dataclass
class Compared:
    """Hypotheses as far as they were compared.

    Attributes:
        own: those that were compared with all steps, each with the error of the mesh as its own ladder has it, the likeliest first.
        full: the same, all with what may be left of that error where it is largest among them.
        thin: those that were compared with a few steps; their logarithms are relative to the former.
        about: the one whose tangent was asked about other sets in all steps.
        shown: logarithms of the odds of these sets against it, as the tangent shows them.
        fewer: those that lack one of its patches and may be as likely although the tangent shows them as less likely.
        misses: by how much it showed too little of those that were fitted since.
        refused: hypotheses that cannot be followed to the end.
        promised: logarithms of evidence and of prior odds of effects that were not worth a fit.
        alike: whether effects are ways to write the same, see `HypothesisOdds`.
        _left: what may be left of the error of the mesh that `full` was compared with.
        _allowing: each of `own`, by its identity, and the same in `full`: none is weighed twice with the same.
    """

    own: list[Rival] = field(default_factory=list)
    full: list[Rival] = field(default_factory=list)
    thin: list[Rival] = field(default_factory=list)
    about: Rival | None = None
    shown: dict[Anchored, float] = field(default_factory=dict)
    fewer: list[Anchored] = field(default_factory=list)
    misses: list[float] = field(default_factory=list)
    promised: dict[Hypothesis, tuple[float, float]] = field(default_factory=dict)
    refused: set[Hypothesis] = field(default_factory=set)
    alike: bool = False
    _left: Array | None = None
    _allowing: dict[int, tuple[Rival, Rival]] = field(default_factory=dict)

    def like(self, rival: Rival) -> Rival | None:
        """The same effects on the same set, compared with all steps."""
        return next((r for r in self.own if (r.names, r.anchors) == (rival.names, rival.anchors)), None)

    def add(self, rivals: Iterable[Rival], begun: Model) -> None:
        """What was compared with all steps; of what comes twice the latest counts. `begun` is the model without added effects."""
        self.own = best_first({(r.names, r.anchors): r for r in (*self.own, *rivals)}.values())
        left = _most_left([r for r in self.own if r.log > self.own[0].log - UNLIKELY])
        self._allowing = {id(r): (r, self._with(r, left, begun)) for r in self.own}
        self.full, self._left = best_first(allowed for _, allowed in self._allowing.values()), left

    def _with(self, rival: Rival, left: Array, begun: Model) -> Rival:
        """A hypothesis with what may be left of the error of the mesh with another; what is known is not weighed again."""
        _, known = self._allowing.get(id(rival), (rival, None))
        return known if known is not None and self._left is left else rival.allowing(left, begun)

    def add_roughly(self, contest: Contest, also: Sequence[Rival], own: tuple[str, ...]) -> None:
        """What was compared with a few steps.

        It keeps its distance from what was compared `also` with all, with the same effects or those of the model that was looked
        beside (`own`).
        """
        full = {(r.names, r.anchors): r for r in self.full}
        pairs = [(rough, full[rough.names, rough.anchors]) for rough in also if (rough.names, rough.anchors) in full]
        # An effect that all steps could not show has no place among the others.
        pairs = [pair for pair in pairs if all(math.isfinite(rival.log) for rival in pair)]
        if not pairs:
            return
        alone = next((pair for pair in pairs if pair[1].names == own), pairs[0])
        alike = {fine.names: (rough, fine) for rough, fine in reversed(pairs)}
        done = {id(rough) for rough in also}
        for rival in contest.rivals:
            if id(rival) not in done:
                rough, fine = alike.get(rival.names, alone)
                self.thin.append(rival.shifted(fine.log - rough.log))
        shift = alone[1].log - alone[0].log
        self.promised |= {h: (log + shift, prior) for h, (log, prior) in contest.promised.items()}

    @property
    def power(self) -> float:
        """Of the likelihood, that counts.

        The error of the mesh has a shape along an action that is guessed. Where it is not small beside the noise, a power of the
        likelihood counts (the coarsened posterior of Miller & Dunson, J. Am. Stat. Assoc. 114, 2019), the noise's part of both.
        """
        state = self.full[0].fitted.state
        return state.noise**2 / (state.noise**2 + state.errors.guessed_rms**2) / self.full[0].evidence.left

    @property
    def odds(self) -> HypothesisOdds:
        """What is believed of all hypotheses, of those that were looked at and of effects that act together."""
        power = self.power
        logs = _logs([rival.weights for rival in self.full], power)
        others = self._unfitted(logs, power)
        for hypothesis, log in _logs([*(rival.weights for rival in self.thin), self.promised], power).items():
            others.setdefault(hypothesis, log)
        for hypothesis, log in others.items():
            logs.setdefault(hypothesis, log)
        return HypothesisOdds.of(with_others(logs), self.alike)

    def _unfitted(self, fitted: dict[Hypothesis, float], power: float) -> dict[Hypothesis, float]:
        """Logarithms of the odds of the sets that were not fitted to all steps.

        What acts with them is believed to be what acts with those that were.
        """
        if self.about is None:
            return {}
        here = float(logsumexp([log for h, log in fitted.items() if h.anchors == self.about.anchors]))
        acting: dict[tuple[str, bool], list[float]] = {}
        for h, log in fitted.items():
            acting.setdefault((h.effect, h.unknown), []).append(log)
        shares = {what: float(logsumexp(logs)) for what, logs in acting.items()}
        whole = logsumexp(list(shares.values()))
        apart = {anchors: power * moderated(log, self.misses) for anchors, log in self.shown.items()}
        here -= self._too_many(apart.values())
        return {
            Hypothesis(anchors, *what): float(here + log + share - whole)
            for anchors, log in apart.items()
            for what, share in shares.items()
        }

    def _too_many(self, apart: Iterable[float]) -> float:
        """By how much less likely sets must be, with these logarithms of odds, than each of them alone seems.

        A tangent that misses by much says little of any of many sets. But they were fitted in the order in which it shows them:
        that one of the others wins where n have lost is no likelier than Laplace's rule of succession has it, odds of 1 to n + 1.
        """
        told = [miss for miss in self.misses if math.isfinite(miss)]
        if not told or self.about is None or self.about.anchors != self.full[0].anchors:
            return 0.0
        return max(0.0, float(logsumexp(list(apart) or [-math.inf])) + math.log(len(told) + 1))

    def unconfirmed(self, least: float = 0.0) -> Hypothesis | None:
        """The likeliest hypothesis, if it was not compared with all steps and can be: if it says what acts.

        With `least` only where its verdict has more than that probability.
        """
        odds = self.odds
        told = odds.best
        likely = odds.verdicts[told.verdict] > least
        return None if told.effect == OTHERS or not likely or self._fitted(told) else told

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
        if self.about is not None and (self.about.names, self.about.anchors) == (best.names, best.anchors):
            lesser += [Hypothesis(anchors, "+".join(best.names)) for anchors in self.fewer]
        return next((h for h in lesser if not self._fitted(h) and h not in self.refused), None)

    def _fitted(self, hypothesis: Hypothesis) -> bool:
        """Whether it was compared with all steps."""
        return any(hypothesis in rival.logs for rival in self.full)

    def confirm(self, told: Hypothesis, rival: Rival, begun: Model) -> None:
        """Take what was found of a hypothesis for what was thought of it, and of others that rest on the same think likewise."""
        name, evidence = told.effect, rival.evidence
        rough = next((r for r in self.thin if told in r.logs), None)
        apart = 0.0
        if rough is not None:
            self.thin = [r for r in self.thin if told not in r.logs]
            apart = rival.log - rough.log
        elif told in self.promised:
            apart = evidence.plain - self.promised[told][0]
        elif told.anchors in self.shown:
            self.misses.append(rival.log - self._at(rival.names) - self.shown[told.anchors])
        self.thin = [r.shifted(apart) if r.names == rival.names else r for r in self.thin]
        self.promised = {h: (e + apart if h.effect == name else e, prior) for h, (e, prior) in self.promised.items()}
        self.add([rival], begun)

    def _at(self, names: tuple[str, ...]) -> float:
        """Logarithm of the evidence of some effects on the set whose tangent was asked about others."""
        assert self.about is not None
        here = self.about.anchors
        return next((r.log for r in self.full if (r.names, r.anchors) == (names, here)), self.about.log)

    def promise(self, rival: Rival, rows: Iterable[Row]) -> None:
        """Take what all steps show of effects beside one without any for what a few steps promised of them."""
        for row in rows:
            hypothesis = Hypothesis(rival.anchors, row.effect)
            if math.isfinite(row.gain) and not self._fitted(hypothesis):
                self.promised[hypothesis] = rival.evidence.plain + row.gain, log_prior(1, False, rival.known)

    def refuse(self, hypothesis: Hypothesis) -> None:
        """Take out one that cannot be followed to the end: where it was only shown, its set."""
        self.refused.add(hypothesis)
        thin = [rival for rival in self.thin if hypothesis not in rival.logs]
        if len(thin) < len(self.thin):
            self.thin = thin
        elif self.promised.pop(hypothesis, None) is None:
            self.shown.pop(hypothesis.anchors, None)

    def best(self) -> Rival:
        """The likeliest of the hypotheses that were compared with all steps."""
        full = {h: p for h, p in self.odds.probabilities.items() if any(h in r.logs for r in self.full)}
        told = HypothesisOdds(full, self.alike).best
        return next(r for r in self.full if told in r.logs)


def _logs(weights: Iterable[Mapping[Hypothesis, tuple[float, float]]], power: float) -> dict[Hypothesis, float]:
    """Logarithms of odds from evidence, of which a power counts, and prior; of a hypothesis that comes twice the first."""
    found: dict[Hypothesis, float] = {}
    for hypothesis, (evidence, prior) in (item for some in weights for item in some.items()):
        found.setdefault(hypothesis, power * evidence + prior)
    return found


def _most_left(rivals: Sequence[Rival]) -> Array:
    """What may be left of the error of the mesh where it is largest, (frames, fiducials, 3), m.

    Hypotheses are compared with that: what an unknown force does on a mesh is no more exact than what a known one does, and none
    gains by being seen more exactly.
    """
    return max((rival.fitted.state.errors for rival in rivals), key=lambda errors: errors.mesh_rms).mesh.left
