"""Patches that hold along a direction of their surface, on any number of ranks: the numbers of one rank.

Run as ``mpirun -n N python -m pytest tests/parallel`` with N = 1, 2, 3.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI
from verify.problems import straight

from bcid import Scene
from bcid.forms.forward import Forward
from bcid.forms.model import check_physics
from bcid.forms.solver.equilibrium import Settings
from bcid.scene.parts import Level

pytestmark = pytest.mark.parallel
WORLD = MPI.COMM_WORLD


@pytest.mark.parametrize("anchors", [{"foot", "slides"}, {"sticks"}])
def test_a_body_slides_alike_on_a_shared_mesh(project: Path, anchors: set[str]) -> None:
    scene = Scene.read(project / "examples" / "scenes" / "ramp.toml", physics=check_physics)
    scene = replace(scene, levels=(Level(2, 0.012),))
    found = []
    for comm in (MPI.COMM_SELF, WORLD):
        # At 1e-10 round-off of what stiff springs add, in another order on each run of three ranks, may be all that is left.
        forward = Forward(scene, 0, comm, settings=Settings(rtol=1e-8))
        found.append(forward.predict(anchors, [straight((0.004, 0.0, 0.002), 2, "jaw")]).positions)
        forward.destroy()
    close = bool(np.abs(found[0] - found[1]).max() < 1e-9)
    moved = bool(np.abs(found[1][-1] - scene.rest).max() > 1e-3)
    assert all(WORLD.allgather(close and moved))
