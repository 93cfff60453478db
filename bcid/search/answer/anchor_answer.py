"""What a posterior says of the anchors, as an identification reports it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bcid.forms.forward import Prediction
from bcid.inference import nuisance_text
from bcid.inference.hypotheses import label, patches
from bcid.inference.thresholds import THRESHOLDS
from bcid.results.identification_record import AnchorSet
from bcid.search.answer.identification import Identification, adequate, not_converged
from bcid.search.fitting.fitted_hypothesis import FittedHypothesis, best_first
from bcid.search.fitting.state import State
from bcid.search.followed_sets import FollowedSet, FollowedSets
from bcid.search.hypothesis_table import HypothesisTable
from bcid.search.set_misfits import StagedSets
from bcid.search.settings import SETTINGS

Array = NDArray[np.float64]
Anchored = frozenset[str]
# So many other sets are reported.
_REPORTED = 8


@dataclass(frozen=True)
class AnchorAnswer:
    """What is reported of a posterior over sets; collective on the ranks of the predictor.

    Attributes:
        table: all hypotheses with what is known of them.
        best: the one whose anchors are reported.
        followed: what was followed until it had lost, if anything was.
        staged: what the search in stages found, if there was one.
    """

    table: HypothesisTable
    best: FittedHypothesis
    followed: FollowedSets | None = None
    staged: StagedSets | None = None

    def identification(self) -> Identification:
        """The anchors of the hypothesis, with probabilities over all effects."""
        odds, best = self.table.odds, self.best
        state, counts = best.fitted.state, self.counts
        predictor, errors = state.predictor, state.likeliest_errors
        level, spent = predictor.fine_level, sum(predictor.trajectories.values())
        evaluations = dict(self.staged.evaluations) if self.staged else {}
        evaluations[level] = evaluations.get(level, 0.0) + spent
        failures = {h.anchors: "cannot be followed" for h in sorted(self.table.refused, key=lambda h: h.order)}
        failures |= {c: f.failure for c, f in self.found.items() if f.failure}
        noise, stiffness = state.noise if predictor.data.stated else None, best.fitted.stiffness
        alternatives, discrepancy = self.alternatives(), odds.verdicts["unknown"]
        return Identification(
            anchored=self.names(best.anchors),
            probability=odds.held_by(best.anchors),
            patches=patches(odds.probabilities, predictor.whole.patches),
            rms=state.rms,
            noise_rms=noise,
            discretisation_rms=state.errors.mesh_rms if state.errors.mesh.known else None,
            certified=not counts["failed"] and not counts["not"],
            evaluations={level: round(count, 3) for level, count in sorted(evaluations.items())},
            evaluated=counts,
            alternatives=alternatives,
            classes=self.classes(state),
            levels=tuple(sorted({*(self.staged.levels if self.staged else ()), level})),
            stages=self.stages(),
            prediction=Prediction(state.predicted, ()),
            failures={label(c, predictor.whole.patches): reason for c, reason in failures.items()},
            not_converged=not_converged(alternatives),
            remarks=(),
            discrepancy_probability=discrepancy,
            outliers=(),
            adequate=adequate(state.rms, noise, discrepancy),
            input_uncertainties=nuisance_text.rows(errors.told(state.residual)),
            stiffness=stiffness.record() if stiffness else None,
        )

    @property
    def found(self) -> Mapping[Anchored, FollowedSet]:
        """What was followed until it had lost."""
        return self.followed.found if self.followed else {}

    @property
    def fitted(self) -> dict[Anchored, FittedHypothesis]:
        """What was compared with a few steps, or with all of them."""
        return {r.anchors: r for r in best_first([*self.table.full, *self.table.rough])[::-1]}

    @property
    def counts(self) -> dict[str, int]:
        """What became of all sets."""
        every = 2 ** len(self.best.fitted.state.predictor.whole.patches)
        full = {r.anchors for r in self.table.full} | {c for c, f in self.found.items() if f.complete}
        failed = {h.anchors for h in self.table.refused} - full
        stopped = self.found.keys() - full - failed
        counts = {"in full": len(full), "stopped": len(stopped), "failed": len(failed)}
        return counts | {"not": every - sum(counts.values())}

    def stages(self) -> tuple[str, ...]:
        """How the answer was found, in words."""
        state = self.best.fitted.state
        order = state.predictor.whole.patches
        few = len({r.anchors for r in self.table.rough} - {r.anchors for r in self.table.full})
        lines = [f"{few} sets compared in a few steps of each action"] if few else []
        if self.found:
            lines.append(f"{len(self.found)} sets followed until they had lost")
        sets = ", ".join(f"{label(r.anchors, order)} {r.fitted.state.rms * 1e3:.3g} mm" for r in self.table.full)
        lines.append(f"compared in all steps: {sets}; noise {state.noise * 1e3:.3g} mm")
        return (*(self.staged.words if self.staged else ()), *lines)

    def names(self, anchors: Anchored) -> tuple[str, ...]:
        """The patches of a set in the scene's order."""
        return tuple(p for p in self.best.fitted.state.predictor.whole.patches if p in anchors)

    def alternatives(self) -> tuple[AnchorSet, ...]:
        """The most probable other sets of which more is known than a tangent tells."""
        odds, fitted = self.table.odds, self.fitted
        order = sorted(
            {*fitted, *self.found} - {self.best.anchors}, key=lambda c: (-odds.held_by(c), len(c), sorted(c))
        )
        return tuple(self.alternative(c, fitted.get(c)) for c in order[:_REPORTED])

    def alternative(self, other: Anchored, fitted: FittedHypothesis | None) -> AnchorSet:
        """A set beside the reported one, in the frames that it was followed in."""
        probability, names, state = self.table.odds.held_by(other), self.names(other), self.best.fitted.state
        level, data = state.predictor.fine_level, state.predictor.data
        found = self.found.get(other)
        if found is None:
            assert fitted is not None
            here = fitted.fitted.state
            frames = len(here.predictor.data.mask)
            return AnchorSet(
                anchored=names,
                probability=probability,
                rms=here.rms,
                reported_rms=state.rms,
                frames=frames,
                level=level,
                stopped=False,
            )
        rows = data.of_position & found.frames[data.frame]
        apart = data.vector(np.nan_to_num(found.positions - state.prediction.positions))
        misses, own = (_rms(values[rows]) for values in (state.residual - apart, state.residual))
        stopped = not (found.complete or found.failure)
        return AnchorSet(
            anchored=names,
            probability=probability,
            rms=misses,
            reported_rms=own,
            frames=int(found.frames.sum()),
            level=level,
            stopped=stopped,
            failure=found.failure,
        )

    def classes(self, state: State) -> tuple[tuple[tuple[str, ...], ...], ...]:
        """The likely sets that can be followed to the end, in classes that the measured motions cannot tell apart.

        Two belong together when, if one of them were the true set, the data would be expected to favour it by less than
        `Thresholds.odds` to one: half the squared distance of their predictions, in units of their errors, is the expected
        logarithm of that ratio. Each class is built around its most probable set, which comes first; so do the more probable
        classes.
        """
        odds, predicted = self.table.odds, self.predictions()
        shares = {c: odds.held_by(c) for c in predicted}
        likely = [c for c in predicted if shares[c] * SETTINGS.odds > max(shares.values())]
        found: list[list[Anchored]] = []
        for candidate in sorted(likely, key=lambda c: (-shares[c], len(c), sorted(c))):
            for others in found:
                apart = np.nan_to_num(predicted[candidate] - predicted[others[0]])
                scaled = state.errors.whiten(state.predictor.data.vector(apart))
                if 0.5 * float(scaled @ scaled) <= math.log(THRESHOLDS.odds):
                    others.append(candidate)
                    break
            else:
                found.append([candidate])
        return tuple(tuple(self.names(c) for c in members) for members in found)

    def predictions(self) -> dict[Anchored, Array]:
        """Positions of sets that were followed in all steps, each (frames, rows, 3), m."""
        found = {c: f.positions for c, f in self.found.items() if f.complete}
        return found | {r.anchors: r.fitted.state.prediction.positions for r in self.table.full}


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2))) if len(values) else 0.0
