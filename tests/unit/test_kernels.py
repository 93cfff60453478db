"""How element kernels are compiled."""

from __future__ import annotations

import math

import numpy as np
import ufl
from dolfinx import fem, jit
from mpi4py import MPI
from verify.problems import box

from bcid.base.compat import tune_kernels
from bcid.forms.mesh.body import Body


def test_kernels_may_reorder_sums_and_keep_what_is_not_a_number() -> None:
    tune_kernels()
    options = jit.get_options()["cffi_extra_compile_args"]
    assert "-fassociative-math" in options
    assert not {"-ffast-math", "-Ofast", "-ffinite-math-only"} & set(options)
    body = Body(MPI.COMM_SELF, box((1.0, 1.0, 1.0), (1, 1, 1)))
    u = fem.Function(body.space)
    for value in (math.nan, math.inf):
        u.x.array[:] = value
        assert not np.isfinite(fem.assemble_scalar(fem.form(u[0] * u[1] * ufl.Measure("dx", domain=body.domain))))
