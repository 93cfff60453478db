"""Places that measured points drive, on any number of ranks: the numbers of one rank, with a mesh that is shared out.

Run as ``mpirun -n N python -m pytest tests/parallel`` with N = 1, 2, 3.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from bcid import Measurement, Scene
from bcid.base.errors import InputError
from bcid.forms.forward import Forward
from bcid.forms.model import check_physics
from bcid.forms.solver.equilibrium import Settings
from bcid.scene.parts import Driven, Level
from bcid.search.answer.source import fitting

pytestmark = pytest.mark.parallel
WORLD = MPI.COMM_WORLD


@pytest.mark.parametrize("along", [(0, 1, 2), (0, 1)])
def test_a_driven_place_moves_alike_on_a_shared_mesh(project: Path, along: tuple[int, ...]) -> None:
    scene = Scene.read(project / "examples" / "scenes" / "cut.toml", physics=check_physics)
    measured = Measurement.read(project / "examples" / "measurements" / "cut-5")
    driven = {"surface": replace(scene.driven["surface"], along=along)}
    scene, seen = fitting(replace(scene, levels=(Level(1, 0.01),), driven=driven), measured, WORLD)
    # Nothing holds the block along an axis in which it is not driven.
    scene = scene if len(along) == 3 else replace(scene, held={"surface": (2,)})
    found = []
    for comm in (MPI.COMM_SELF, WORLD):
        forward = Forward(scene, 0, comm, settings=Settings(rtol=1e-12))
        found.append(forward.predict((), seen.actions).positions)
        forward.destroy()
    close = bool(np.abs(found[0] - found[1]).max() < 1e-10)
    moved = bool(np.abs(found[1][-1] - scene.rest).max() > 1e-3)
    assert all(WORLD.allgather(close and moved))


def test_too_few_points_are_refused_on_every_rank(project: Path) -> None:
    scene = Scene.read(project / "examples" / "scenes" / "cut.toml", physics=check_physics)
    measured = Measurement.read(project / "examples" / "measurements" / "cut-5")
    few = {"surface": Driven(markers=("p0", "p1", "p2"))}
    with pytest.raises(InputError, match="2 fiducials of those that drive it are seen; 3 or more are needed"):
        fitting(replace(scene, driven=few), measured.without(["p0"]), WORLD)
