"""The mixed formulation does not lock where plain linear elements do, and is the same model where nothing locks."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from mpi4py import MPI
from verify.problems import box, gradually, scene_of

from bcid.forms import materials
from bcid.forms.mesh.body import Body
from bcid.forms.model import Anchors, Model, traction
from bcid.forms.solver.equilibrium import Equilibrium
from bcid.forms.solver.status import Status

LENGTH, HEIGHT, YOUNG, SHEAR_LOAD = 0.1, 0.01, 15e3, 0.05
Bend = Callable[[int, str, float, tuple[int, int, int]], float]


@pytest.fixture(scope="module")
def bend() -> Bend:
    """Deflection of a slender cantilever under a small traction on its end, in units of Timoshenko's beam."""

    def run(degree: int, formulation: str, poisson: float, divisions: tuple[int, int, int]) -> float:
        model = Model(materials.law("neo_hooke"), {"young": YOUNG, "poisson": poisson}, formulation)
        model = model + traction("x1", (0.0, 0.0, -SHEAR_LOAD)) + Anchors({"x0"})
        mesh = box((LENGTH, HEIGHT, HEIGHT), divisions, mirrored=True)
        equilibrium = Equilibrium(Body(MPI.COMM_SELF, mesh, degree, model.mixed), model, scene_of(degree=degree))
        assert gradually(equilibrium, 1) is Status.CONVERGED
        end = np.abs(equilibrium.body.nodes[:, 0] - LENGTH) < 1e-9
        deflection = -equilibrium.displacement()[end, 2].mean()
        equilibrium.destroy()
        force, inertia = SHEAR_LOAD * HEIGHT**2, HEIGHT**4 / 12
        coefficient = 10 * (1 + poisson) / (12 + 11 * poisson)  # Cowper (1966), rectangular section
        shear = YOUNG / (2 * (1 + poisson)) * coefficient * HEIGHT**2
        return float(deflection / (force * LENGTH**3 / (3 * YOUNG * inertia) + force * LENGTH / shear))

    return run


def test_the_mixed_formulation_does_not_lock(bend: Bend) -> None:
    # A clamp that also hinders the contraction across makes a solid beam up to 3 % stiffer than Timoshenko's.
    coarse, fine = bend(2, "mixed", 0.4999, (10, 2, 2)), bend(2, "mixed", 0.4999, (20, 4, 4))
    assert 0.96 < fine < 1.0
    assert coarse == pytest.approx(fine, rel=0.02)
    assert bend(1, "displacement", 0.4999, (20, 2, 2)) < 0.65 * fine
    # Quadratic displacements alone come close, from the stiff side.
    assert 0.97 * fine < bend(2, "displacement", 0.4999, (20, 4, 4)) < fine


def test_an_incompressible_body_is_the_limit(bend: Bend) -> None:
    divisions = (10, 2, 2)
    assert bend(2, "mixed", 0.5, divisions) == pytest.approx(bend(2, "mixed", 0.49999, divisions), rel=1e-3)


@pytest.mark.parametrize("poisson", [0.2, 0.3, 0.4])
def test_both_formulations_agree_at_moderate_compressibility(bend: Bend, poisson: float) -> None:
    divisions = (20, 2, 2)
    assert bend(2, "mixed", poisson, divisions) == pytest.approx(bend(2, "displacement", poisson, divisions), rel=4e-3)
