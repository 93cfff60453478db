"""The anchored patches: the posterior of anchor sets, without effects."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bcid.base.collective import Comm
from bcid.base.progress import Progress, Silent
from bcid.comparison.candidates import Known
from bcid.comparison.explain import ExplainOptions
from bcid.comparison.first_state import first_state
from bcid.comparison.fitted_hypothesis import FittedHypothesis
from bcid.comparison.followed_sets import FollowedSet, FollowedSets
from bcid.comparison.full_search import FullSearch
from bcid.comparison.hypothesis_table import HypothesisTable
from bcid.comparison.state import State
from bcid.comparison.state_fields import detailed
from bcid.forms.mesh.patches import divided
from bcid.forms.model import Model
from bcid.forms.solver.equilibrium import Settings
from bcid.inference.hypotheses import patches
from bcid.inference.outcome import label
from bcid.inference.stiffness import Stiffness
from bcid.measurement import Measurement
from bcid.predict.predictor import Predictor
from bcid.predict.store import PredictionStore
from bcid.scene import Scene
from bcid.search.climb import ODDS
from bcid.search.identification import Alternative, Identification
from bcid.search.identify_options import IdentifyOptions
from bcid.search.staged_search import StagedSets, staged_search

Array = NDArray[np.float64]
Anchored = frozenset[str]
# How often a fiducial goes astray.
_ASTRAY = 0.01
# Odds from which on two sets count as told apart.
_TELLING = 20.0
# So many other sets are reported.
_REPORTED = 8


def identify(
    scene: Scene,
    measurement: Measurement,
    comm: Comm | None = None,
    options: IdentifyOptions | None = None,
    model: Model | None = None,
    settings: Settings | None = None,
    progress: Progress | None = None,
    start: Sequence[Anchored] = (),
    store: PredictionStore | None = None,
) -> Identification:
    """Find the anchored patches; collective on `comm`, with the same result for any number of ranks.

    Args:
        scene: body, candidate patches (divided ones are replaced by their pieces), mesh ladder.
        measurement: fiducial trajectories and gripper motion; must fit the scene.
        comm: MPI communicator over which anchor sets are spread; COMM_SELF by default.
        options: how to search.
        model: the model; by default the scene's.
        settings: accuracy and patience of the solver.
        progress: told what is going on (give it on rank 0 only).
        start: sets to begin with; by default a few steps show them.
        store: keeps what the posterior was computed from, and knows what an interrupted run has computed.

    Raises:
        InputError: scene, measurement or options do not fit each other.
        ContinuationError: no set can be followed to the end.
    """
    from mpi4py import MPI

    options, comm, begun = options or IdentifyOptions(), comm or MPI.COMM_SELF, time.perf_counter()
    progress, scene = progress or Silent(), divided(scene, comm)
    options.check(scene)
    measurement = replace(measurement, remarks=tuple(measurement.check(scene)))
    for text in measurement.remarks:
        progress.say(f"look at this first: {text}")
    staged = None
    if options.stages is not None:
        staged = staged_search(scene, measurement, comm, options.stages, model, settings, progress, start)
    predictor = Predictor(scene, measurement, comm, options.level, settings, progress, store)
    try:
        followed = None if options.certify == "no" else FollowedSets(predictor, options.certifies(scene))
        table = posterior(predictor, model or Model.of(scene), staged.likely if staged else start, followed)
        found = _Answer(table, followed, staged).identification()
    finally:
        predictor.destroy()
    found = replace(found, remarks=measurement.remarks, seconds=time.perf_counter() - begun)
    if not found.astray:
        return found
    # Whoever goes astray has led the search astray as well.
    again = identify(scene, measurement.without(found.astray), comm, options, model, settings, progress, start, store)
    return replace(again, remarks=found.remarks, astray=(*found.astray, *again.astray))


def posterior(
    predictor: Predictor, model: Model, likely: Sequence[Anchored], followed: FollowedSets | None
) -> HypothesisTable:
    """Of anchor sets, and of a discrepancy in the place of what the model may lack; collective.

    Args:
        predictor: of the measurement.
        model: without added effects.
        likely: sets to begin with, the likeliest first.
        followed: follows every set until it has lost; without it tangents and few steps tell of sets that are not fitted.

    Raises:
        ContinuationError: no set can be followed to the end.
    """
    base, sets = first_state(predictor, model, likely)
    return FullSearch(base, Known(()), sets, effects=0, fitted=0, sets=ExplainOptions().sets, others=followed).run()


@dataclass(frozen=True)
class _Answer:
    """What is reported of a posterior over sets; collective on the ranks of the predictor.

    Attributes:
        table: all sets with what is known of them.
        followed: what was followed until it had lost, if anything was.
        staged: what the search in stages found, if there was one.
    """

    table: HypothesisTable
    followed: FollowedSets | None
    staged: StagedSets | None

    def identification(self) -> Identification:
        """The most probable set that was compared with all steps."""
        odds, best = self.table.odds, self.table.best()
        state, counts = best.fitted.state, self.counts
        predictor, errors = state.predictor, state.likeliest_errors
        level, spent = predictor.fine_level, sum(predictor.trajectories.values())
        evaluations = dict(self.staged.evaluations) if self.staged else {}
        evaluations[level] = evaluations.get(level, 0.0) + spent
        failures = {h.anchors: "cannot be followed" for h in sorted(self.table.refused, key=lambda h: h.order)}
        failures |= {c: f.failure for c, f in self.found.items() if f.failure}
        return Identification(
            anchored=self.names(best.anchors),
            probability=odds.held_by(best.anchors),
            patches=patches(odds.probabilities, predictor.whole.patches),
            rms=state.rms,
            noise=state.noise if predictor.data.stated else None,
            discretisation=state.errors.mesh_rms if state.errors.mesh.known else None,
            certified=not counts["failed"] and not counts["not"],
            evaluations=dict(sorted(evaluations.items())),
            looked_at=counts,
            alternatives=self.alternatives(best),
            classes=self.classes(state),
            levels=tuple(sorted({*(self.staged.levels if self.staged else ()), level})),
            stages=self.stages(best),
            # The residual that is drawn is the one that is reported.
            prediction=replace(detailed(state), positions=state.predicted),
            failures={label(c, predictor.whole.patches): reason for c, reason in failures.items()},
            seconds=0.0,
            missing=odds.verdicts["unknown"],
            nuisances=tuple(errors.told(state.residual)),
            stiffness=Stiffness.of(errors, state.residual, state.model, predictor.whole),
            astray=astray(state),
        )

    @property
    def found(self) -> Mapping[Anchored, FollowedSet]:
        """What was followed until it had lost."""
        return self.followed.found if self.followed else {}

    @property
    def fitted(self) -> dict[Anchored, FittedHypothesis]:
        """What was compared with a few steps, or with all of them."""
        return {r.anchors: r for r in (*self.table.rough, *self.table.full)}

    @property
    def counts(self) -> dict[str, int]:
        """What became of all sets."""
        every = 2 ** len(self.table.best().fitted.state.predictor.whole.patches)
        full = {r.anchors for r in self.table.full} | {c for c, f in self.found.items() if f.complete}
        failed = {h.anchors for h in self.table.refused} - full
        stopped = self.found.keys() - full - failed
        counts = {"in full": len(full), "stopped": len(stopped), "failed": len(failed)}
        return counts | {"not": every - sum(counts.values())}

    def stages(self, best: FittedHypothesis) -> tuple[str, ...]:
        """How the answer was found, in words."""
        state, order = best.fitted.state, best.fitted.state.predictor.whole.patches
        few = len({r.anchors for r in self.table.rough} - {r.anchors for r in self.table.full})
        lines = [f"{few} sets compared in a few steps of each action"] if few else []
        if self.found:
            lines.append(f"{len(self.found)} sets followed until they had lost")
        sets = ", ".join(f"{label(r.anchors, order)} {r.fitted.state.rms * 1e3:.3g} mm" for r in self.table.full)
        lines.append(f"compared in all steps: {sets}; noise {state.noise * 1e3:.3g} mm")
        return (*(self.staged.stages if self.staged else ()), *lines)

    def names(self, anchors: Anchored) -> tuple[str, ...]:
        """The patches of a set in the scene's order."""
        return tuple(p for p in self.table.best().fitted.state.predictor.whole.patches if p in anchors)

    def alternatives(self, best: FittedHypothesis) -> tuple[Alternative, ...]:
        """The most probable other sets of which more is known than a tangent tells."""
        odds, fitted = self.table.odds, self.fitted
        order = sorted({*fitted, *self.found} - {best.anchors}, key=lambda c: (-odds.held_by(c), len(c), sorted(c)))
        return tuple(self.alternative(c, fitted.get(c), best) for c in order[:_REPORTED])

    def alternative(self, other: Anchored, fitted: FittedHypothesis | None, best: FittedHypothesis) -> Alternative:
        """A set beside the reported one, in the frames that it was followed in."""
        probability, names, state = self.table.odds.held_by(other), self.names(other), best.fitted.state
        level, data = state.predictor.fine_level, state.predictor.data
        found = self.found.get(other)
        if found is None:
            assert fitted is not None
            here = fitted.fitted.state
            return Alternative(names, probability, here.rms, level, False, state.rms, len(here.predictor.data.mask))
        rows = data.of_position & found.frames[data.frame]
        apart = data.vector(np.nan_to_num(found.positions - state.prediction.positions))
        misses, own = (_rms(values[rows]) for values in (state.residual - apart, state.residual))
        stopped = not (found.complete or found.failure)
        return Alternative(names, probability, misses, level, stopped, own, int(found.frames.sum()), found.failure)

    def classes(self, state: State) -> tuple[tuple[tuple[str, ...], ...], ...]:
        """The likely sets that can be followed to the end, in classes that the measured motions cannot tell apart.

        Two belong together when, if one of them were the true set, the data would be expected to favour it by less than `_TELLING`
        to one: half the squared distance of their predictions, in units of their errors, is the expected logarithm of that ratio.
        Each class is built around its most probable set, which comes first; so do the more probable classes.
        """
        odds, predicted = self.table.odds, self.predictions()
        shares = {c: odds.held_by(c) for c in predicted}
        likely = [c for c in predicted if shares[c] * ODDS > max(shares.values())]
        found: list[list[Anchored]] = []
        for candidate in sorted(likely, key=lambda c: (-shares[c], len(c), sorted(c))):
            for others in found:
                apart = np.nan_to_num(predicted[candidate] - predicted[others[0]])
                scaled = state.errors.whiten(state.predictor.data.vector(apart))
                if 0.5 * float(scaled @ scaled) <= math.log(_TELLING):
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


def astray(state: State) -> tuple[str, ...]:
    """Fiducials that do not go with the body, whatever acts smoothly on it: names that were swapped, marks that came off.

    One that is astray may be anywhere: its values have a density of one per size of the body. Of its share of chi-square
    r^T C^-1 r the others have taken what they explain. More than every fourth are no mistake of single ones.
    """
    data, errors = state.predictor.data, state.likeliest_errors
    shares = state.residual * errors.rough(state.residual) / errors.sigma**2
    size = float(np.linalg.norm(np.ptp(state.predictor.forward(state.model).mesh.points, axis=0)))
    names = state.predictor.whole.fiducial_names
    taken, lost = (
        np.bincount(data.fiducial[data.of_position], values[data.of_position], minlength=len(names))
        for values in (0.5 * shares, np.log(size / errors.sigma))
    )
    found = np.flatnonzero(taken > lost - math.log(_ASTRAY))
    seen = np.unique(data.fiducial[data.of_position])
    return tuple(names[i] for i in found) if 0 < len(found) <= len(seen) / 4 else ()
