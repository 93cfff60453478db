"""An effect may use a named surface and what a gripper holds in one form."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import ufl
from mpi4py import MPI

from bcid.forms.effects.effect import BodyEffect
from bcid.forms.forward import Forward
from bcid.forms.model import Model, Term, check_physics
from bcid.forms.parameter import Amount
from bcid.measurement import Action
from bcid.scene import Level, Scene


def test_effect_named_surface_and_grip_in_one_form_is_solved(project: Path) -> None:
    """A shear on the support in the plane, and the same on what the grasp holds."""

    def work(point: Any, c: Any) -> Any:
        push = -c["shear"] * ufl.inner(ufl.as_vector([1.0, 0.0, 0.0]), point.v)
        return push * point.surface("bottom") + push * point.grip("I")

    shear = Amount("shear", "Pa", "shear stress on both surfaces", neutral=0.0)
    both = BodyEffect("sheared", (shear,), "shear on two surfaces", work=work)
    scene = Scene.read(project / "examples" / "scenes" / "slab.toml", physics=check_physics)
    scene = replace(scene, levels=(Level(1, 0.05),))
    still = np.tile([1.0, 0.0, 0.0, 0.0], (2, 1))
    action = Action("1", np.arange(2), np.arange(2), "II", np.zeros((2, 3)), still)
    moved = []
    for amount in (0.0, 20.0):
        forward = Forward(scene, 0, MPI.COMM_SELF, Model.of(scene) + Term(both, {"shear": amount}))
        prediction = forward.predict(["3", "4"], [action])
        assert prediction.failure is None
        moved.append(prediction.positions[-1])
        forward.destroy()
    assert (moved[1] - moved[0])[:, 0].max() > 1e-5
