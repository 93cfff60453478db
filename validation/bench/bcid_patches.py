"""bcid with the slab's patches halved HALVINGS times: ``mpirun -n 2 python -m validation.bench.bcid_patches HALVINGS SIZE_MM``.

Identifies on one level of linear elements, with halves from the answer for the wholes. The last identification is timed; the true
set is all pieces of patches 1 and 2.
"""

from __future__ import annotations

from validation.bench.peers.problem import Clock, memory

# isort: split
import json
import sys

from mpi4py import MPI

import bcid
from bcid.base.options import IdentifyOptions
from bcid.forms.mesh.patches import half_names, halves
from bcid.search.identify import identify
from validation.bench.bench_slab import encoded, measurement, with_level


def main() -> None:
    """One identification."""
    halvings, size = int(sys.argv[1]), float(sys.argv[2])
    comm = MPI.COMM_WORLD
    clock = Clock("bcid", f"bcid {bcid.__version__}")
    scene = with_level(size, 1)
    seen = measurement("slab-12-semicircle")
    options = IdentifyOptions()
    start: list[frozenset[str]] = []
    for _ in range(halvings):
        found = identify(scene, seen, comm, options, start=start)
        start = [frozenset(half for name in found.anchored for half in half_names(name))]
        scene = halves(scene, list(scene.patches), comm)
    comm.barrier()
    clock.start()
    found = identify(scene, seen, comm, options, start=start)
    comm.barrier()
    clock.stop()
    processor = comm.allgather(clock.record["cpu_s"])
    if comm.rank > 0:
        return
    record = clock.record | {"cpu_s": sum(processor), "rss_mb": memory(), "ranks": comm.size}
    truth = {name for name in scene.patches if name.split(".")[0] in ("1", "2")}
    record |= {"patches": len(scene.patches), "answer": encoded(found.anchored), "rms_mm": found.rms * 1e3}
    record |= {"wrong": len(truth ^ set(found.anchored)), "trajectories": sum(found.evaluations.values())}
    record |= {"sets": sum(found.evaluated[what] for what in ("in full", "stopped", "failed"))}
    print(json.dumps(record), flush=True)


if __name__ == "__main__":
    main()
