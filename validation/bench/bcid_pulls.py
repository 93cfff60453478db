"""bcid predicts pulls of the exploration study: ``[mpirun -n 2] python -m validation.bench.bcid_pulls EVERY FIRST [GRASP]``.

With every so many of all sets, from the first one on, and for all pulls or those of one grasp; with force, strain and stability.
"""

from __future__ import annotations

from validation.bench.peers.problem import Clock, memory

# isort: split
import json
import sys

from mpi4py import MPI

import bcid
from bcid.base.shipped import shipped
from bcid.exploration.loop import paired
from bcid.exploration.moves import limits_of, moves
from bcid.predict.pull_predictor import PullPredictor
from bcid.scene import Scene
from bcid.search.hill_climbing import all_candidates
from validation.bench.bench_slab import EXPLAINED


def main() -> None:
    """Predict them, the ranks together, as the study does before its trials."""
    every, first, *grasps = sys.argv[1:]
    comm = MPI.COMM_WORLD
    clock = Clock("bcid", f"bcid {bcid.__version__}")
    scene = Scene.read(shipped(EXPLAINED))
    limits, sets = limits_of(scene), all_candidates(list(scene.patches))
    pulls = [m for m in moves(scene) if m.amplitude == limits.amplitudes[0] and m.grasp in (grasps or scene.grasps)]
    some = sets[int(first) :: int(every)]
    predictor = PullPredictor(paired(scene, None, comm), 0, comm)
    forward = predictor.forward()
    comm.barrier()
    clock.start()
    found = predictor.predict([(a, m.action(limits)) for m in pulls for a in some], detailed=True)
    comm.barrier()
    clock.stop()
    # A rank that waits uses its core: the busiest tells how long the study waits.
    processor, resident = comm.allgather(clock.record["cpu_s"]), comm.allgather(memory())
    count = comm.allreduce(forward.equilibrium.factor.count)
    if comm.rank == 0:
        record = clock.record | {"cpu_s": max(processor), "rss_mb": max(resident), "ranks": comm.size}
        record |= {"predictions": len(found), "failed": sum(one.failed for one in found), "factorisations": count}
        record |= {"sets": len(some), "all_sets": len(sets), "pulls": len(pulls)}
        print(json.dumps(record), flush=True)
    predictor.destroy()


if __name__ == "__main__":
    main()
