"""How many pulls the noise alone asks for: an observer to whom nothing is uncertain but the set, beside an exploration study.

./dev python -m validation.exploration.ideal_observer RUN

RUN is a finished `bcid-validate exploration`. The observer knows the noise and what every set does in every pull exactly (the
predictions of the study), so that its belief is Bayes' rule for white noise and nothing else, with the budget and the certainty
of the study. It makes the pull that tells the likely sets best apart, of those that the study made with these anchors, and does
not look further ahead. What it needs more than once is luck: 200 trials of each row, beside those of the study with pulls by
information, of one and three grasps.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from statistics import mean, median
from typing import Any

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from scipy.spatial.distance import pdist, squareform
from scipy.special import softmax

from bcid import Scene
from bcid.base.run_folder import RunFolder
from bcid.base.shipped import shipped
from bcid.exploration.loop import DECIDED, paired
from bcid.exploration.moves import limits_of, moves
from bcid.forms.model import check_physics
from bcid.inference.hypotheses import label
from bcid.inference.thresholds import THRESHOLDS
from bcid.predict.pull_predictor import PullPredictor
from bcid.predict.store import PredictionStore
from bcid.search.hill_climbing import all_candidates
from validation.engine.work import read_result
from validation.exploration.exploration_study import SCENE
from validation.exploration.exploration_trials import ANCHORS, BUDGET

Array = NDArray[np.float64]
TRIALS = 200
# Per coordinate and frame, of what cannot be followed: far beyond any noise, m.
FAR = 1.0


@dataclass(frozen=True)
class Observer:
    """Knows what every set predicts for some pulls, shape (pulls, sets, values), m; `true` is the number of the true set."""

    predicted: Array
    true: int

    @cached_property
    def apart(self) -> Array:
        """Squared distances of the predictions of all pairs of sets in each pull, shape (pulls, sets, sets), m^2."""
        return np.array([squareform(pdist(pull, "sqeuclidean")) for pull in self.predicted])

    def choose(self, belief: Array, noise: float) -> int:
        """The pull after which the wrong set is likeliest least often: the least Bhattacharyya bound (Kailath 1967) of all pairs.

        Of Gaussians that are d noises apart the bound falls as exp(-d^2 / 8): what is told for sure need not be told better.
        """
        return int(np.argmin(np.einsum("i,j,kij->k", belief, belief, np.exp(-self.apart / (8 * noise**2)))))

    def trial(self, noise: float, random: np.random.Generator) -> tuple[int, bool, bool]:
        """How many pulls, whether it was decided, and whether the likeliest set is right."""
        logs = np.zeros(self.predicted.shape[1])
        for count in range(1, int(BUDGET) + 1):
            pull = self.predicted[self.choose(softmax(logs), noise)]
            seen = pull[self.true] + noise * random.standard_normal(pull.shape[1])
            logs = logs - 0.5 * ((seen - pull) ** 2).sum(axis=1) / noise**2
            if softmax(logs).max() >= THRESHOLDS.credible:
                return count, True, int(np.argmax(logs)) == self.true
        return int(BUDGET), False, int(np.argmax(logs)) == self.true


def _told(name: str, trials: Sequence[tuple[int, bool, bool]]) -> str:
    """Median and mean of pulls, and parts of the trials: decided, right, decided and wrong."""
    counts = [count for count, _, _ in trials]
    decided, right = (float(np.mean([trial[k] for trial in trials])) for k in (1, 2))
    wrong = float(np.mean([one and not other for _, one, other in trials]))
    many = f"{name:12} {len(trials):7} {median(counts):7g} {mean(counts):6.1f}"
    return f"{many} {decided:9.0%} {right:7.0%} {wrong:9.1%}"


def main(run: Path) -> None:
    """A line for the observer, and one for the study, of each noise and set of anchors."""
    study = [read_result(file)["result"] for file in sorted((run / "results").glob("*.json"))]
    stated: dict[str, Any] = RunFolder.open(run).record["inputs"]["extent"]
    scene = Scene.read(shipped(SCENE), physics=check_physics)
    known = PredictionStore(run.resolve() / "predictions", MPI.COMM_SELF, shared=True)
    predictor = PullPredictor(paired(scene, None, MPI.COMM_SELF), 0, MPI.COMM_SELF, known)
    sets = all_candidates(list(scene.patches))
    limits = limits_of(scene)
    print(f"{'':22} {'':12} {'trials':>7} {'median':>7} {'mean':>6} {'decided':>9} {'right':>7} {'falsely':>9}")
    for anchors in ANCHORS:
        of_set = [trial for trial in study if trial and tuple(trial["anchors"]) == anchors and not trial["hidden"]]
        made = {move for trial in of_set for move in trial["moves"]}
        pulls = [move.action(limits) for move in moves(scene) if str(move) in made]
        predicted = np.array([[p.positions.ravel() for p in predictor.predict((s, a) for s in sets)] for a in pulls])
        observer = Observer(np.nan_to_num(predicted, nan=FAR), sets.index(frozenset(anchors)))
        for noise in (noise for noise in stated["noises"] if noise > 0):
            random = np.random.default_rng(0)
            found = [observer.trial(noise, random) for _ in range(TRIALS)]
            mine = [
                (trial["pulls"], trial["reason"] == DECIDED, trial["right"])
                for trial in of_set
                if trial["noise"] == noise and trial["strategy"] == "information" and not trial["felt"]
            ]
            head = f"{label(anchors, anchors):10} {1e3 * noise:g} mm"
            print(f"{head:22} {_told('observer', found)}\n{'':22} {_told('study', mine)}")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
