"""What ranking the missing effects costs, in forward trajectories of the working level (CPU seconds of one process).

./dev python benchmarks/ranking.py
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

from mpi4py import MPI

from bcid import Measurement, Scene
from bcid.comparison.predictor import Predictor
from bcid.comparison.ranking import rank
from bcid.comparison.state import State
from bcid.forms import effects
from bcid.forms.model import Model

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"


def seconds(work: Callable[[], object], repeats: int = 2) -> float:
    """Least CPU time of some repetitions, after one that compiles."""
    work()
    found = []
    for _ in range(repeats):
        start = time.process_time()
        work()
        found.append(time.process_time() - start)
    return min(found)


def main() -> None:
    """Print the ratios."""
    scene = Scene.read(EXAMPLES / "scenes/slab_explain.toml")
    predictor = Predictor(scene, Measurement.read(EXAMPLES / "measurements/slab-34-heavy"), MPI.COMM_SELF)
    model, anchors = Model.of(scene), frozenset("34")
    state = State.of(predictor, model, anchors)
    forward = predictor.forward(model)
    trajectory = seconds(lambda: forward.predict(anchors, predictor.actions, keep=True))
    plain = [
        name
        for name in effects.names()
        if not (effects.effect(name).memory or effects.effect(name).uses_past or effects.effect(name).places)
        and name != "inclusion"
    ]
    print(f"working level: {forward.describe}; a trajectory of {len(predictor.data.mask)} frames: {trajectory:.2f} s")
    for text, only in (("without history or place", plain), ("all", effects.names())):
        ranking = seconds(lambda only=only: rank(state, effects.catalogue(only)))
        print(f"ranking {text} ({len(only)} effects): {ranking:.2f} s, {ranking / trajectory:.1f} trajectories")


if __name__ == "__main__":
    main()
