"""A trial of identification: see the truth as a laboratory would, and search for the anchors."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bcid.base.errors import SolveError
from bcid.base.options import LAST, StageOptions, Stop
from bcid.measurement import Measurement
from bcid.search.hill_climbing import Candidate, random_seeds, rank
from bcid.search.stages import SearchStage, in_stages
from validation.paper.condition import Condition
from validation.paper.precompute import Store
from validation.paper.trial_errors import seen_positions

Array = NDArray[np.float64]
# Why an answer is wrong: the search ended beside the set that fits best on its last mesh; that mesh is too coarse; or no mesh
# helps, for another set fits better on the finest on which all are compared.
SEARCH, MESH, DATA = "search", "mesh", "data"


def maker(job: Mapping[str, Any]) -> Callable[[Mapping[str, Any]], dict[str, Any]]:
    """The function that makes a trial, for `validation.engine.dispatch`.

    `job` holds the `scene` file, the folder `predictions` and the `seed`; a task the `condition` and the `number`.
    """
    store = Store(Path(job["scene"]), Path(job["predictions"]), job["seed"])

    def trial(task: Mapping[str, Any]) -> dict[str, Any]:
        condition, number = Condition.from_json(task["condition"]), int(task["number"])
        measurement = measured(store, condition, number)
        search = identified if condition.search == "identify" else climbed
        found = search(store, condition, number, measurement)
        return found | {"anchors": sorted(condition.held(number))}

    return trial


def measured(store: Store, condition: Condition, number: int) -> Measurement:
    """What is seen in a trial, with the motion that was commanded."""
    scene = store.read()
    if condition.seen == "images":
        return store.film(condition, number)
    from bcid.forms.simulate import recorded

    true, middle = store.truth(condition, number), scene.rest.mean(axis=0)
    seen = seen_positions(condition, true, middle, number, store.seed)
    made = recorded(scene, condition.actions(), seen, 0.0, np.random.default_rng(0))
    return replace(made, noise_sigma=condition.noise or None)


class StoredMisfits:
    """Residuals of sets against what was seen in a trial, from stored predictions; see `bcid.search.hill_climbing.SetMisfits`.

    A similarity is one minus the residual in metres: the paper's threshold is a residual.
    """

    def __init__(self, store: Store, condition: Condition, seen: Array) -> None:
        self.store, self.condition, self.seen = store, condition, seen
        self.patches = list(store.read().patches)
        self.known: dict[tuple[int, Candidate], float] = {}

    def misfits(self, level: int, bounds: Mapping[Candidate, float]) -> dict[Candidate, float]:
        """All in full: a distinct set on a level is one call of the model."""
        for candidate in bounds:
            if (level, candidate) not in self.known:
                predicted = self.store.predicted(self.condition, level, candidate)
                self.known[level, candidate] = rms(predicted, self.seen)
        return {candidate: self.known[level, candidate] for candidate in bounds}

    def similarity(self, rms: float) -> float:
        return 1.0 - rms

    def change(self, level: int, candidate: Candidate) -> float:
        self.misfits(level + 1, {candidate: np.inf})
        coarse, fine = (self.store.predicted(self.condition, at, candidate) for at in (level, level + 1))
        return rms(coarse, np.where(np.isfinite(self.seen), fine, np.nan))

    def best(self, level: int) -> Candidate:
        """The best of all sets on a level, not counted: what no search can do better than."""
        other = StoredMisfits(self.store, self.condition, self.seen)
        found = other.misfits(level, dict.fromkeys(self.store.sets(), np.inf))
        return min(found, key=lambda candidate: rank(found, candidate))

    @property
    def calls(self) -> dict[str, float]:
        """Distinct sets that were asked for, by level."""
        levels = [level for level, _ in self.known]
        return {str(level): float(levels.count(level)) for level in sorted(set(levels))}


def rms(predicted: Array, seen: Array) -> float:
    """RMS residual over the coordinates that were seen, m; infinite where there is no prediction."""
    if not np.isfinite(predicted).all():
        return float("inf")
    return float(np.sqrt(np.nanmean((predicted - seen) ** 2)))


def climbed(store: Store, condition: Condition, number: int, measurement: Measurement) -> dict[str, Any]:
    """Algorithm 1 of the paper, and the best of all sets."""
    scene = store.read()
    order = [measurement.fiducial_names.index(name) for name in scene.fiducial_names]
    model = StoredMisfits(store, condition, measurement.positions[:, order])
    seeds = random_seeds(model.patches, condition.seeds, np.random.default_rng(number))
    last, single = condition.finest, condition.search == "single"
    stop = Stop(LAST) if single else Stop(condition.stop, 1.0 - condition.tolerance, condition.tolerance)
    stages = in_stages(model, StageOptions(coarsest=last if single else 0, stop=stop), last, seeds)
    if not stages:
        raise SolveError("the model has no solution for any set")
    truth, calls, found = condition.held(number), model.calls, stages[-1].anchors
    reference = model.best(condition.compared)
    return {
        "found": sorted(found),
        "right": found == truth,
        "why": _why(model, stages, truth, reference, condition.compared),
        "best": sorted(reference),
        "best_right": reference == truth,
        "rms": stages[-1].rms,
        "stages": [{"level": s.level, "anchors": sorted(s.anchors), "rms": s.rms} for s in stages],
        "calls": calls,
        "cpu_seconds": None,
    }


def _why(
    model: StoredMisfits, stages: Sequence[SearchStage], truth: Candidate, reference: Candidate, compared: int
) -> str:
    """Why the answer is wrong, "" where it is right."""
    last = stages[-1]
    if last.anchors == truth:
        return ""
    if last.level <= compared and model.best(last.level) == truth:
        return SEARCH
    return MESH if reference == truth else DATA


def identified(store: Store, condition: Condition, number: int, measurement: Measurement) -> dict[str, Any]:
    """What `bcid identify` finds, with its own calls of the model; certified, so that it is the best of all sets."""
    from bcid.base.options import IdentifyOptions
    from bcid.search.identify import identify

    scene = store.read()
    began = time.process_time()
    found = identify(scene, measurement, options=IdentifyOptions(level=condition.finest))
    seconds = time.process_time() - began
    right = frozenset(found.anchored) == condition.held(number)
    return {
        "found": sorted(found.anchored),
        "right": right,
        "why": "" if right else DATA if found.certified else SEARCH,
        "best": sorted(found.anchored) if found.certified else None,
        "best_right": right and found.certified,
        "probability": found.probability,
        "rms": found.rms,
        "stages": [],
        "calls": {str(level): count for level, count in found.evaluations.items()},
        "cpu_seconds": round(seconds, 3),
    }
