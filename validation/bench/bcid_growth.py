"""bcid pulls a slab of many sizes: ``-m validation.bench.bcid_growth ALONG ACROSS STEPS``, or ``bandwidth`` for the machine's.

The slab40 problem on a regular mesh of ALONG x ALONG x ACROSS bricks, STEPS steps of 0.5 mm, out-of-balance force 1e-6.
"""

from __future__ import annotations

from validation.bench.peers.problem import Array, Clock, memory

# isort: split
import json
import sys
import time
from itertools import permutations
from typing import Any

import numpy as np
from petsc4py import PETSc

import bcid
from bcid.forms.mesh import BodyMesh
from bcid.forms.solver.equilibrium import Equilibrium, Settings
from bcid.forms.solver.status import Status
from bcid.forms.solver.trajectory import follow
from validation.bench.bcid_trajectory import MM, equilibrium, motion, residual, seconds

SIZE = np.array([100.0, 100.0, 10.0]) * MM


def slab(along: int, across: int) -> BodyMesh:
    """Bricks of six tetrahedra; groups "fixed" and "patch" are the nodes of the face x = 0 and of the grasp."""
    divisions = np.array([along, along, across])
    grid = np.stack(np.meshgrid(*(np.arange(n + 1) for n in divisions), indexing="ij"), axis=-1)
    number = np.arange(grid[..., 0].size).reshape(grid.shape[:3])

    def corner(shift: Array) -> Any:
        i, j, k = shift
        return number[i : i + along, j : j + along, k : k + across].ravel()

    cells = []
    for order in permutations(range(3)):
        shifts = np.vstack([np.zeros(3, int), np.cumsum(np.eye(3, dtype=int)[list(order)], axis=0)])
        nodes = [corner(shift) for shift in shifts]
        # Odd orders of the axes would give tetrahedra turned inside out.
        if np.linalg.det(np.eye(3)[list(order)]) < 0:
            nodes[2], nodes[3] = nodes[3], nodes[2]
        cells.append(np.column_stack(nodes))
    points = grid.reshape(-1, 3) / divisions * SIZE
    x, y, z = points.T
    eps = 1e-9
    on_top_or_below = (z < eps) | (z > SIZE[2] - eps)
    grasp = (x > 80 * MM - eps) & (np.abs(y - 50 * MM) < 10 * MM + eps) & on_top_or_below
    groups = {"fixed": np.flatnonzero(x < eps)[:, None], "patch": np.flatnonzero(grasp)[:, None]}
    return BodyMesh(points, np.vstack(cells), groups)


def factor_seconds(eq: Equilibrium, most: float = 30.0) -> float:
    """Median CPU seconds of a numeric factorisation of the present tangent."""
    times: list[float] = []
    while len(times) < 3 and sum(times) < most:
        # PETSc does not factorise a matrix again that has not changed.
        eq.tangent.matrix.stateIncrease()
        start = time.process_time()
        eq.factor.refresh()
        times.append(time.process_time() - start)
    return float(np.median(times))


def factor_nonzeros(eq: Equilibrium) -> float:
    """Non-zeros of the Cholesky factor of the present tangent, as CHOLMOD counts them, or MUMPS where there is no CHOLMOD."""
    try:
        return _nonzeros(eq, "cholmod")
    except PETSc.Error:
        return _nonzeros(eq, "mumps")


def _nonzeros(eq: Equilibrium, package: str) -> float:
    pc = PETSc.PC().create(eq.tangent.matrix.comm)
    try:
        pc.setOptionsPrefix("bench_")
        pc.setType("cholesky")
        pc.setFactorSolverType(package)
        PETSc.Options()["bench_mat_cholmod_factor"] = "SUPERNODAL"
        pc.setFromOptions()
        pc.setOperators(eq.tangent.matrix)
        pc.setUp()
        return float(pc.getFactorMatrix().getInfo()["nz_used"])
    finally:
        pc.destroy()
        PETSc.Options().delValue("bench_mat_cholmod_factor")


def bandwidth(count: int = 10_000_000, repeats: int = 5) -> dict[str, float]:
    """Memory bandwidth of one core, bytes per CPU second: a triad as in STREAM, and reading alone, best of several."""
    a, b, c = np.zeros(count), np.full(count, 1.0), np.full(count, 2.0)

    def best(what: Any) -> float:
        times = []
        for _ in range(repeats):
            start = time.process_time()
            what()
            times.append(time.process_time() - start)
        return min(times)

    def triad() -> None:
        # NumPy makes two passes of it: five arrays go by.
        np.multiply(c, 3.0, out=a)
        np.add(a, b, out=a)

    return {"triad_Bps": 5 * 8 * count / best(triad), "read_Bps": 2 * 8 * count / best(lambda: float(b @ c))}


def main() -> None:
    """One pull, and what its parts cost."""
    if sys.argv[1] == "bandwidth":
        print(json.dumps(bandwidth()))
        return
    along, across, steps = map(int, sys.argv[1:])
    clock = Clock("bcid", f"bcid {bcid.__version__}")
    mesh = slab(along, across)
    eq = equilibrium(mesh, Settings(rtol=1e-6))
    clock.start()
    result = follow(eq, motion(np.arange(steps + 1)[:, None] * [0.5 * MM, 0, 0]), lambda _k, _pose: None)
    clock.stop()
    if result.status is not Status.CONVERGED:
        raise RuntimeError(result.reason)
    direct = eq.body.unknowns <= eq.settings.direct_up_to
    record = clock.record | {"steps": steps, "iterations": result.iterations, "factorisations": result.factorisations}
    record |= {"unknowns": eq.body.unknowns, "nodes": len(mesh.points), "cells": len(mesh.cells), "direct": direct}
    record |= {"residual_s": seconds(lambda: residual(eq)), "rss_mb": memory()}
    if direct:
        eq.verify()
        record["triangular_s"] = seconds(lambda: eq.factor.solve(eq.vector, eq.correction))
        record |= {"factor_s": factor_seconds(eq), "factor_nonzeros": factor_nonzeros(eq)}
    print(json.dumps(record), flush=True)


if __name__ == "__main__":
    main()
