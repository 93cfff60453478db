"""What a few steps say of the evidence in all steps."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace

import numpy as np

from bcid.inference.hypotheses import Hypothesis
from bcid.inference.posterior import Evaluation, Fidelity, FidelityStep, Pair, Posterior, toggles, with_error
from bcid.search.fitting.fitted_hypothesis import FittedHypothesis


class StageEvidence:
    """What a few steps say: each hypothesis keeps its distance from the nearest that was compared with all of them.

    Args:
        known: what is known of hypotheses in a few steps.
        fitted: those that were fitted to a few steps.
        full: those that were fitted to all.
    """

    def __init__(
        self,
        known: Posterior,
        fitted: Iterable[FittedHypothesis],
        full: Mapping[Hypothesis, FittedHypothesis],
    ) -> None:
        self._known, self._full = known, full
        both = [(rough, full[rough.hypothesis]) for rough in fitted if rough.hypothesis in full]
        both = [pair for pair in both if all(math.isfinite(rival.log) for rival in pair)]
        # The likeliest first.
        self._both = sorted(both, key=lambda pair: (-pair[1].log, pair[1].hypothesis.order))

    def evaluations(self) -> Iterator[tuple[Hypothesis, Evaluation]]:
        """What the stage knows of hypotheses, from a few steps or from their tangents."""
        for h, one in self._known.evaluations.items() if self._both else ():
            rough, fine = self._nearest(h)
            low, high = rough.log_evidence, fine.log_evidence
            changed = toggles(Fidelity.COARSE, h, fine.hypothesis, one.log - low)
            yield h, replace(one, steps=(*one.steps, FidelityStep(low, high, changed)))

    def pairs(self) -> Iterator[Pair]:
        """What it was off, against the likeliest hypothesis that was compared with all steps; and what its tangents were."""
        own = list[Pair]()
        for rough, fine in self._both[1:]:
            base_rough, base = self._both[0]
            low, high = rough.log_evidence - base_rough.log_evidence, fine.log_evidence - base.log_evidence
            changed = toggles(Fidelity.COARSE, fine.hypothesis, base.hypothesis, low)
            own.append(Pair(changed, low, high))
        yield from own
        yield from self._known.pairs
        errors = Posterior({}, own)
        for h, one in self._known.evaluations.items() if self._both else ():
            if h in self._full and one.about:
                # What a few steps would show of it, by what they were off with others.
                rough, fine = self._nearest(h)
                gain = self._full[h].evidence.plain - fine.log_evidence
                error = errors.expected(toggles(Fidelity.COARSE, h, fine.hypothesis, gain))
                there = rough.log_evidence + float(with_error(np.array(gain), np.array(-error)))
                yield Pair(one.toggles, one.start - one.steps[0].low, there - one.steps[0].low, one.steps[0].room)

    def _nearest(self, h: Hypothesis) -> tuple[FittedHypothesis, FittedHypothesis]:
        """Of those that were compared with all steps the one that differs least from a hypothesis: in the stage, and in all."""
        return min(self._both, key=lambda pair: len(toggles(Fidelity.COARSE, h, pair[1].hypothesis, 0.0)))
