"""bcid identifies a measurement with its default options: ``mpirun -n 2 python -m bcid.bench.bcid_identification MEASUREMENT``.

``SEEDS FINEST`` behind it make it smaller, without a certificate.
"""

from __future__ import annotations

from bcid.bench.peers.problem import Clock, memory

# isort: split
import json
import sys

from mpi4py import MPI

import bcid
from bcid.bench.bench_slab import encoded, measurement, scene
from bcid.search import evaluator as evaluator
from bcid.search.identify import identify
from bcid.search.identify_options import IdentifyOptions


def main() -> None:
    """One identification."""
    name, *smaller = sys.argv[1:]
    comm = MPI.COMM_WORLD
    clock = Clock("bcid", f"bcid {bcid.__version__}")
    options = (
        IdentifyOptions(certify="no", seeds=int(smaller[0]), finest=int(smaller[1])) if smaller else IdentifyOptions()
    )
    slab, seen = scene(), measurement(name)
    comm.barrier()
    clock.start()
    # Every batch whole, for the replay: of what is kept in between nothing is needed.
    evaluator._BATCH = 10**6
    batches: list[list[float]] = []
    found = identify(slab, seen, comm, options, keep=lambda outcomes: batches.append([o.seconds for o in outcomes]))
    comm.barrier()
    clock.stop()
    processor = comm.allgather(clock.record["cpu_s"])
    resident = comm.allgather(memory())
    if comm.rank > 0:
        return
    record = clock.record | {"cpu_s": sum(processor), "rss_mb": max(resident), "ranks": comm.size}
    record |= {"answer": encoded(found.anchored), "certified": found.certified, "probability": found.probability}
    record |= {"evaluations": {str(k): v for k, v in found.evaluations.items()}, "finest": found.levels[-1]}
    record["batches"] = batches
    print(json.dumps(record), flush=True)


if __name__ == "__main__":
    main()
