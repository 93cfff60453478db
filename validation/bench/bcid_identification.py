"""bcid identifies a measurement by default: ``mpirun -n 2 python -m validation.bench.bcid_identification MEASUREMENT``.

``LEVEL`` behind it makes it smaller, without a certificate.
"""

from __future__ import annotations

from validation.bench.peers.problem import Clock, memory

# isort: split
import json
import sys

from mpi4py import MPI

import bcid
from bcid.base.progress import Silent
from bcid.forms.model import Model
from bcid.predict.predictor import Predictor
from bcid.search.identify import posterior
from validation.bench.bench_slab import encoded, measurement, scene


def main() -> None:
    """One identification."""
    name, *smaller = sys.argv[1:]
    comm = MPI.COMM_WORLD
    clock = Clock("bcid", f"bcid {bcid.__version__}")
    slab, seen = scene(), measurement(name)
    comm.barrier()
    clock.start()
    predictor = Predictor(slab, seen, comm, int(smaller[0]) if smaller else None, progress=Silent())
    table, followed = posterior(predictor, Model.of(slab), (), not smaller)
    assert followed is not None
    comm.barrier()
    clock.stop()
    processor = comm.allgather(clock.record["cpu_s"])
    resident = comm.allgather(memory())
    if comm.rank > 0:
        return
    record = clock.record | {"cpu_s": sum(processor), "rss_mb": max(resident), "ranks": comm.size}
    best = table.best()
    record |= {"answer": encoded(best.anchors), "probability": table.odds.held_by(best.anchors)}
    whole = len(followed.found) == 2 ** len(slab.patches) and not followed.failed
    spent = {str(predictor.fine_level): sum(predictor.trajectories.values())}
    record |= {"certified": whole, "evaluations": spent, "finest": predictor.fine_level}
    record["batches"] = [[found.seconds for found in followed.found.values()]]
    print(json.dumps(record), flush=True)


if __name__ == "__main__":
    main()
