"""A trial of identification: see the truth as a laboratory would, and search for the anchors."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bcid.measurement import Measurement
from bcid.search.seeds import random_seeds
from validation.paper.algorithm1 import Candidate, Rule, SearchResult, in_stages, optimum
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


class Predicted:
    """The model that Algorithm 1 asks: what sets predict, against what was seen; see `algorithm1.MisfitModel`."""

    def __init__(self, store: Store, condition: Condition, seen: Array) -> None:
        self.store, self.condition, self.seen = store, condition, seen
        self._known: dict[tuple[int, Candidate], float] = {}

    def misfit(self, level: int, candidate: Candidate) -> float:
        key = level, candidate
        if key not in self._known:
            self._known[key] = rms(self.store.predicted(self.condition, level, candidate), self.seen)
        return self._known[key]

    def change(self, level: int, candidate: Candidate) -> float:
        coarse, fine = (self.store.predicted(self.condition, at, candidate) for at in (level, level + 1))
        return rms(coarse, np.where(np.isfinite(self.seen), fine, np.nan))


def rms(predicted: Array, seen: Array) -> float:
    """RMS residual over the coordinates that were seen, m; infinite where there is no prediction."""
    if not np.isfinite(predicted).all():
        return float("inf")
    return float(np.sqrt(np.nanmean((predicted - seen) ** 2)))


def climbed(store: Store, condition: Condition, number: int, measurement: Measurement) -> dict[str, Any]:
    """Algorithm 1 of the paper, and the best of all sets."""
    scene = store.read()
    order = [measurement.fiducial_names.index(name) for name in scene.fiducial_names]
    model = Predicted(store, condition, measurement.positions[:, order])
    patches = list(scene.patches)
    seeds = random_seeds(patches, condition.seeds, np.random.default_rng(number))
    last = condition.finest
    if condition.search == "single":
        found = in_stages(model, patches, seeds, Rule("last", 0.0, last), first=last)
    else:
        found = in_stages(model, patches, seeds, Rule(condition.stop, condition.tolerance, last))
    truth = condition.held(number)
    reference = optimum(model, store.sets(), condition.compared)
    return {
        "found": sorted(found.anchors),
        "right": found.anchors == truth,
        "why": _why(model, found, truth, reference, store.sets(), condition.compared),
        "best": sorted(reference),
        "best_right": reference == truth,
        "rms": found.stages[-1].rms,
        "stages": [{"level": s.level, "anchors": sorted(s.anchors), "rms": s.rms} for s in found.stages],
        "calls": {str(level): float(count) for level, count in found.calls.items()},
        "cpu_seconds": None,
    }


def _why(
    model: Predicted, found: SearchResult, truth: Candidate, reference: Candidate, sets: list[Candidate], compared: int
) -> str:
    """Why the answer is wrong, "" where it is right."""
    if found.anchors == truth:
        return ""
    last = found.stages[-1].level
    if last <= compared and optimum(model, sets, last) == truth:
        return SEARCH
    return MESH if reference == truth else DATA


def identified(store: Store, condition: Condition, number: int, measurement: Measurement) -> dict[str, Any]:
    """What `bcid identify` finds, with its own calls of the model; certified, so that it is the best of all sets."""
    from bcid.comparison.identify import identify
    from bcid.search.identify_options import IdentifyOptions

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
