"""bcid looks at all single toggles of a set: ``python -m validation.bench.bcid_toggles SIZE_MM DEGREE MEASUREMENT CENTRE``.

The first is computed whole, each of the others until it is worse than the best one that is complete.
"""

from __future__ import annotations

from validation.bench.peers.problem import Clock, memory

# isort: split
import json
import math
import sys
import time

from mpi4py import MPI

import bcid
from bcid.search.climb import neighbours
from bcid.search.evaluator import Evaluator
from validation.bench.bench_slab import decoded, encoded, measurement, with_level


def main() -> None:
    """Evaluate the neighbours."""
    size, degree, name, centre = sys.argv[1:]
    clock = Clock("bcid", f"bcid {bcid.__version__}")
    evaluator = Evaluator(with_level(float(size), int(degree)), measurement(name), MPI.COMM_SELF)
    forward = evaluator.forward(0)
    clock.start()
    bound = math.inf
    outcomes = []
    before = time.process_time()
    for candidate in neighbours(decoded(centre), evaluator.patches):
        outcome = evaluator.evaluate(0, {candidate: bound})[candidate]
        if outcome.complete:
            bound = min(bound, outcome.chi2)
        now = time.process_time()
        outcomes.append((outcome, now - before))
        before = now
    clock.stop()
    plain = [
        {
            "candidate": encoded(o.candidate),
            "chi2": o.chi2 if math.isfinite(o.chi2) else None,
            "complete": o.complete,
            "share": o.share,
            "wall_s": o.seconds,
            "cpu_s": spent,
            "why": o.reason,
        }
        for o, spent in outcomes
    ]
    record = clock.record | {"outcomes": plain, "unknowns": forward.body.unknowns, "rss_mb": memory()}
    record |= {"iterations": forward.equilibrium.iterations, "factorisations": forward.equilibrium.factor.count}
    print(json.dumps(record), flush=True)
    evaluator.destroy()


if __name__ == "__main__":
    main()
