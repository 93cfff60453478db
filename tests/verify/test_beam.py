"""A real silicone beam: the deflections that COMSOL predicts, and those that were measured.

Dubied, Michelis, Spielberg & Katzschmann, "Sim-to-Real for Soft Robots Using Differentiable FEM" (RA-L 2022), code and
data at github.com/srl-ethz/diffPD_sim2real (MIT): Dragon Skin 10, 100 x 30 x 30 mm, 1070 kg/m^3, E = 263824 Pa,
nu = 0.499, clamped at one end, released under its own weight, alone or with 0.51012 N on the free upper edge. What
reproduces COMSOL is the neo-Hookean law in the mixed formulation, with the hung weight as a dead load on the edge.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from verify.problems import move

from bcid.base.options import IdentifyOptions
from bcid.forms.forward import Forward
from bcid.forms.model import check_physics
from bcid.forms.simulate import recorded
from bcid.scene import Scene
from bcid.search.identify import identify

POINTS = {"top": (0.0, 0.015, 0.030), "side": (0.0, 0.0, 0.024), "other side": (0.0, 0.030, 0.006)}
WEIGHT = {"gravity": 0.0, "52 g": 0.51012}
# Static displacements, mm: of the three points in COMSOL, and of the three markers near them, mean of two runs.
COMSOL_UX = {"gravity": (1.0147, 0.5162, -0.9636), "52 g": (2.0836, 0.4671, -3.4292)}
COMSOL_UZ = {"gravity": (-6.774, -6.752, -6.691), "52 g": (-17.331, -16.841, -16.282)}
MEASURED_UZ = {"gravity": (-6.604, -6.571, -6.489), "52 g": (-17.209, -17.201, -16.669)}


@pytest.fixture(scope="module")
def beam(project: Path) -> Iterator[Forward]:
    scene = Scene.read(project / "examples" / "scenes" / "beam.toml", physics=check_physics)
    forward = Forward(replace(scene, fiducials=POINTS), level=2)
    yield forward
    forward.destroy()


@pytest.mark.parametrize("case", WEIGHT)
def test_deflections_under_gravity_and_a_hung_weight(beam: Forward, case: str) -> None:
    load = {"tip_edge": np.array([[0.0, 0.0, -WEIGHT[case]]])} if WEIGHT[case] else {}
    prediction = beam.predict(["clamp"], [move(np.zeros((1, 3)), grasp="", loads=load)])
    assert prediction.failure is None
    moved = 1e3 * (prediction.positions[-1] - beam.observer.rest)
    assert moved[:, 2] == pytest.approx(COMSOL_UZ[case], abs=0.1)
    assert moved[:, 0] == pytest.approx(COMSOL_UX[case], abs=0.05)
    # The markers were placed to about 1 mm, and two runs differ by up to 0.4 mm.
    assert moved[:, 2] == pytest.approx(MEASURED_UZ[case], abs=0.5)
    beam_weight = 1070 * 9.80709 * 0.1 * 0.03**2
    reaction = _reaction(beam)
    assert reaction == pytest.approx([0.0, 0.0, beam_weight + WEIGHT[case]], abs=1e-5)


def _reaction(forward: Forward) -> NDArray[np.float64]:
    """Force of the clamp on the body, N: what its nodes lack in balance."""
    equilibrium = forward.equilibrium
    equilibrium._assemble_forces(equilibrium.vector)
    held = np.zeros(len(equilibrium.internal))
    reacting = equilibrium.supports.reacting
    held[reacting] = equilibrium.internal[reacting]
    return np.asarray(held[equilibrium.body.displacement_dofs].reshape(-1, 3).sum(axis=0))


def test_identify_static_loads_without_a_grasp_ends_with_an_answer(project: Path) -> None:
    """Without any anchor the body has no equilibrium."""
    scene = Scene.read(project / "examples" / "scenes" / "beam.toml", physics=check_physics)
    rest = np.array([scene.fiducials[name] for name in scene.fiducial_names])
    actions = []
    for number, (case, load) in enumerate(WEIGHT.items()):
        hung = {"tip_edge": np.array([[0.0, 0.0, -load]])} if load else {}
        one = move(np.zeros((1, 3)), grasp="", loads=hung)
        actions.append(replace(one, name=case, frames=np.array([number])))
    sag = 1e-3 * np.array([[(COMSOL_UX[c][k], 0.0, MEASURED_UZ[c][k]) for k in range(3)] for c in WEIGHT])
    seen = recorded(scene, actions, rest + sag, 0.0, np.random.default_rng(0))
    found = identify(scene, seen, options=IdentifyOptions(level=1))
    assert found.anchored == ("clamp",)
    assert found.probability > 0.99
