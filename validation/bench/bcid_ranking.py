"""What ranking the missing effects of the demo costs beside a forward trajectory: ``python -m validation.bench.bcid_ranking``."""

from __future__ import annotations

from validation.bench.peers.problem import Clock, memory

# isort: split
import json
import sys

from mpi4py import MPI

import bcid
from bcid import Scene
from bcid.base.shipped import shipped
from bcid.forms import effects
from bcid.forms.model import Model
from bcid.predict.predictor import Predictor
from bcid.search.fitting.ranking import rank
from bcid.search.fitting.state import State
from validation.bench.bcid_trajectory import seconds
from validation.bench.bench_slab import DEMO, EXPLAINED, measurement

ANCHORED = frozenset("34")
REPEATS = 2
"""Of a ranking, once its forms are compiled."""


def main() -> None:
    """Time a trajectory on the working level, and rankings of all effects and of those without history or place."""
    clock = Clock("bcid", f"bcid {bcid.__version__}")
    scene = Scene.read(shipped(EXPLAINED))
    level = 0 if "quick" in sys.argv[1:] else None
    predictor = Predictor(scene, measurement(DEMO), MPI.COMM_SELF, level=level)
    state = State.of(predictor, Model.of(scene), ANCHORED)
    forward = predictor.forward(state.model)
    clock.start()
    every = [effect for effect in effects.catalogue() if not effect.only_named]
    plain = [e for e in every if not (e.memory or e.uses_past or e.places or e.around or e.ahead)]
    rank(state, every, strict=False)
    record = {
        "level": forward.describe,
        "frames": len(predictor.data.mask),
        "trajectory_s": seconds(lambda: forward.predict(ANCHORED, predictor.actions, keep=True)),
        "all": {"effects": len(every), "cpu_s": seconds(lambda: rank(state, every, strict=False), count=REPEATS)},
        "plain": {"effects": len(plain), "cpu_s": seconds(lambda: rank(state, plain, strict=False), count=REPEATS)},
    }
    clock.stop()
    print(json.dumps(clock.record | record | {"rss_mb": memory()}), flush=True)


if __name__ == "__main__":
    main()
