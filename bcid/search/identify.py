"""The anchored patches: the posterior of anchor sets, without effects."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from bcid.base.collective import Comm
from bcid.base.options import ExplainOptions, IdentifyOptions
from bcid.base.progress import Progress, Silent
from bcid.forms.mesh.patches import divided
from bcid.forms.model import Model
from bcid.forms.solver.equilibrium import Settings
from bcid.inference.thresholds import THRESHOLDS
from bcid.measurement import Measurement
from bcid.predict.predictor import Predictor
from bcid.predict.store import PredictionStore
from bcid.scene import Scene
from bcid.search.answer.anchor_answer import AnchorAnswer
from bcid.search.answer.identification import Identification
from bcid.search.candidates import Known
from bcid.search.fitting.state import State, detailed
from bcid.search.followed_sets import FollowedSets
from bcid.search.full_search import FullSearch
from bcid.search.hypothesis_table import HypothesisTable
from bcid.search.searched import searched
from bcid.search.set_misfits import staged_sets
from bcid.search.settings import SETTINGS

Array = NDArray[np.float64]
Anchored = frozenset[str]


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
        staged = staged_sets(scene, measurement, comm, options.stages, model, settings, progress, start)
    predictor = Predictor(scene, measurement, comm, options.level, settings, progress, store)
    try:
        few = len(scene.patches) <= SETTINGS.few_patches
        follows = None if options.exhaustive == "no" else few or options.exhaustive == "yes"
        table, followed = posterior(predictor, model or Model.of(scene), staged.likely if staged else start, follows)
        best = table.best()
        found, state = AnchorAnswer(table, best, followed, staged).identification(), best.fitted.state
        # The residual that is drawn is the one that is reported.
        prediction = replace(detailed(state), positions=state.predicted)
        found = replace(found, prediction=prediction, outliers=outliers(state))
    finally:
        predictor.destroy()
    found = replace(found, remarks=measurement.remarks, seconds=time.perf_counter() - begun)
    if not found.outliers:
        return found
    # Outliers have misled the search as well.
    again = identify(scene, measurement.without(found.outliers), comm, options, model, settings, progress, start, store)
    return replace(again, remarks=found.remarks, outliers=(*found.outliers, *again.outliers))


def posterior(
    predictor: Predictor, model: Model, likely: Sequence[Anchored], every: bool | None
) -> tuple[HypothesisTable, FollowedSets | None]:
    """Of anchor sets, and of a discrepancy in the place of what the model may lack; collective.

    Args:
        predictor: of the measurement.
        model: without added effects.
        likely: sets to begin with, the likeliest first.
        every: whether every set is followed until it has lost; None to follow none: then tangents and few steps tell of sets that
            are not fitted.

    Returns:
        The table, and the sets that were followed; None where that was not asked for.

    Raises:
        ContinuationError: no set can be followed to the end.
    """

    def search(base: State, sets: Sequence[Anchored]) -> FullSearch:
        followed = None if every is None else FollowedSets(predictor, every)
        return FullSearch(base, Known(()), sets, effects=0, fitted=0, sets=ExplainOptions().sets, others=followed)

    found = searched(predictor, model, likely, search)
    return found.table, found.others if isinstance(found.others, FollowedSets) else None


def outliers(state: State) -> tuple[str, ...]:
    """Fiducials that do not go with the body, whatever acts smoothly on it: names that were swapped, marks that came off.

    An outlier may be anywhere: its values have a density of one per size of the body. Of its share of chi-square
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
    found = np.flatnonzero(taken > lost - math.log(THRESHOLDS.outlier))
    seen = np.unique(data.fiducial[data.of_position])
    return tuple(names[i] for i in found) if 0 < len(found) <= len(seen) / 4 else ()
