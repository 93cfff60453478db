"""What a working mesh leaves, and what its fine mesh says of that, for plain bodies of the hidden study.

./dev python -m validation.accuracy.mesh_errors [CASES]

Positions of the fiducials in all actions of a case (12 by default, the three bodies in turns, fine and coarse ladders) without
anything hidden in them; RMS distances, mm, from those of cubic elements on a finer mesh. For a pair of meshes with elements of
one degree, three times and once as large as those of the ladder's last level, and for the pair by which `explain` goes: unknowns
of both, what the working mesh has wrong, what is left once that is extrapolated, and what is allowed for as left.
"""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from bcid import Scene
from bcid.base.errors import SolveError
from bcid.base.shipped import shipped
from bcid.forms.mesh import level_mesh
from bcid.forms.model import check_physics
from bcid.inference.mesh_error import MeshError, gain
from bcid.predict.levels import pair
from bcid.scene import Level
from validation.synthetic.cases import Case
from validation.synthetic.drawing import CaseChoice, draw
from validation.synthetic.truth import rms, true_positions

Array = NDArray[np.float64]
# Cubic elements of this size, m, tell the truth.
TRUE = {"slab": 0.010, "gallbladder": 0.004, "finger": 0.005}
COARSE = 1.4


def main() -> None:
    """A line for each pair of meshes."""
    print(f"{'':34} {'unknowns':>13} {'working':>9} {'left':>9} {'allowed':>9}")
    for index in range(int(sys.argv[1]) if len(sys.argv) > 1 else 12):
        for attempt in range(4):
            case = replace(draw(CaseChoice(seed=1), index, attempt), hidden=())
            try:
                _tell(case)
                break
            except SolveError:
                continue


def _tell(case: Case) -> None:
    """Both pairs of meshes of a case."""
    scene = Scene.read(shipped(case.body.scene), physics=check_physics)
    last = scene.levels[-1]
    assert last.element_size is not None
    if case.conditions.mesh == "coarse":
        last = replace(last, element_size=COARSE * last.element_size)
    scene = replace(scene, levels=(scene.levels[0], last))
    true = true_positions(scene, case, Level(3, TRUE[case.body.name]), ())
    assert last.element_size is not None
    alike = (replace(last, element_size=3 * last.element_size), last)
    for name, levels in (("one degree", alike), ("two degrees", pair(scene, 1, MPI.COMM_SELF))):
        working, fine = (true_positions(scene, case, level, ()) for level in levels)
        counts = [level_mesh(scene, level).unknowns(level.degree) for level in levels]
        told = MeshError.between(working, fine, gain((counts[1] / counts[0]) ** (1 / 3), levels[1].degree))
        off, left, allowed = rms(working - true), rms(working + told.correction - true), rms(told.left)
        which = f"{case.body.name}, {case.conditions.mesh}, {name}" if name == "one degree" else f"  {name}"
        print(
            f"{which:34} {counts[0]:6} {counts[1]:6} {off * 1e3:9.4f} {left * 1e3:9.4f} {allowed * 1e3:9.4f}",
            flush=True,
        )


if __name__ == "__main__":
    main()
