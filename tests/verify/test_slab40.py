"""C1 and C6: the same answer as seven independent codes, whatever the number of load steps.

The reference (tests/data/README.md) was computed with DOLFINx, NGSolve, FElupe, scikit-fem, GetFEM, JAX-FEM and a NumPy
code, which agree on the whole field to 2e-15 of its maximum.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from verify.problems import out_of_balance, pull_and_lift

from bcid.forms.solver.status import Status
from bcid.forms.solver.trajectory import follow


@pytest.mark.parametrize("name", ["small", "medium", pytest.param("large", marks=pytest.mark.slow)])
def test_the_whole_field_is_that_of_seven_other_codes(slab40: Callable[..., Any], name: str) -> None:
    slab = slab40(name, rtol=1e-10)
    result = follow(slab.equilibrium, pull_and_lift(), lambda _k, _pose: None)
    assert (result.status, result.steps) == (Status.CONVERGED, 41)
    error = np.abs(slab.displacement() - slab.field).max() / np.abs(slab.field).max()
    assert error <= 1e-9
    assert out_of_balance(slab.equilibrium) <= 1e-10
    slab.equilibrium.destroy()


def test_the_number_of_load_steps_does_not_matter(slab40: Callable[..., Any]) -> None:
    slab = slab40("small", rtol=1e-10)
    fields = []
    for steps in (5, 20, 80):
        assert follow(slab.equilibrium, pull_and_lift(steps), lambda _k, _pose: None).status is Status.CONVERGED
        fields.append(slab.displacement())
    for field in fields[1:]:
        assert np.abs(field - fields[0]).max() <= 1e-7 * np.abs(fields[0]).max()
    slab.equilibrium.destroy()
