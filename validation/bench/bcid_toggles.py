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
from bcid.search.hill_climbing import neighbours
from bcid.search.set_misfits import MeasuredMisfits, SetMisfit
from validation.bench.bench_slab import decoded, encoded, measurement, with_level


def main() -> None:
    """Evaluate the neighbours."""
    size, degree, name, centre = sys.argv[1:]
    clock = Clock("bcid", f"bcid {bcid.__version__}")
    model = MeasuredMisfits(with_level(float(size), int(degree)), measurement(name), MPI.COMM_SELF)
    forward, misfit = model.forward(0), model.misfit
    clock.start()
    bound = math.inf
    outcomes: dict[str, tuple[SetMisfit, float]] = {}
    before = time.process_time()
    for candidate in neighbours(decoded(centre), model.patches):
        bound = min(bound, model.misfits(0, {candidate: bound})[candidate])
        now = time.process_time()
        outcomes[encoded(candidate)] = model.known[0, candidate], now - before
        before = now
    clock.stop()
    plain = [
        {
            "candidate": name,
            "chi2": None if one.failure else misfit.values * (one.rms / (misfit.noise or 1.0)) ** 2,
            "complete": one.complete,
            "share": one.share,
            "wall_s": one.seconds,
            "cpu_s": spent,
            "why": one.failure,
        }
        for name, (one, spent) in outcomes.items()
    ]
    record = clock.record | {"outcomes": plain, "unknowns": forward.body.unknowns, "rss_mb": memory()}
    record |= {"iterations": forward.equilibrium.iterations, "factorisations": forward.equilibrium.factor.count}
    print(json.dumps(record), flush=True)
    model.destroy()


if __name__ == "__main__":
    main()
