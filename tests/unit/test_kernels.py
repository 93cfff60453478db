"""How element kernels are compiled."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import ufl
from dolfinx import fem, jit
from mpi4py import MPI
from verify.problems import box

from bcid.base.compat import tune_kernels
from bcid.forms import compiled
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


def test_what_is_compiled_is_kept_in_folders_below_the_one_that_was_asked_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(jit.DOLFINX_DEFAULT_JIT_OPTIONS, "cache_dir", (tmp_path, ""))
    body = Body(MPI.COMM_SELF, box((1.0, 1.0, 2.0), (1, 1, 1)))
    one = fem.Constant(body.domain, 1.0)
    volume = one * ufl.Measure("dx", domain=body.domain)
    assert fem.assemble_scalar(compiled.form(volume)) == pytest.approx(2.0)
    found = compiled.expression(3.0 * one, np.array([[0.2, 0.2, 0.2]])).eval(body.domain, np.array([0], np.int32))
    assert found == pytest.approx(np.array([[3.0]]))
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted([volume.signature()[:2], "expressions"])
