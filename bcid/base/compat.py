"""The differences between DOLFINx 0.9, 0.10 and 0.11, found by feature, not by version."""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bcid.base.collective import Comm
from bcid.base.errors import MachineError
from bcid.base.scratch import require

# What GCC and Clang need to vectorise a sum.
_REORDERED = ("-fno-math-errno", "-fno-trapping-math", "-fassociative-math", "-fno-signed-zeros", "-freciprocal-math")
# Where the exceptions of a C compiler that is missing or fails come from.
_COMPILERS = ("cffi", "distutils", "setuptools")


@contextmanager
def compiling() -> Iterator[None]:
    """Turns a failure to compile forms, or to store or load what was compiled, into a `MachineError`."""
    try:
        yield
    except Exception as error:
        if not isinstance(error, OSError | ImportError) and type(error).__module__.partition(".")[0] not in _COMPILERS:
            raise
        require()
        reason = str(error).strip().splitlines()[-1:] or [type(error).__name__]
        raise MachineError(
            f"the forms could not be compiled: {reason[0][:300]}; a C compiler and a cache folder that can be written "
            "are needed: `bcid doctor` tells more"
        ) from None


@cache
def tune_kernels() -> None:
    """Let the C compiler use vectors for element kernels, where this machine has them, unless the user has chosen options.

    Sums may be reordered and products fused, which changes results by round-off; infinities and NaN keep their meaning.
    """
    from dolfinx import jit

    known = getattr(jit, "DOLFINX_DEFAULT_JIT_OPTIONS", {})
    value, about = known.get("cffi_extra_compile_args", ([], ""))
    known["cffi_extra_compile_args"] = ([*value, *_REORDERED, *_vectors()], about)


def _vectors() -> list[str]:
    """Compiler options for the vectors of this processor, as Linux tells of them."""
    try:
        flags = next(line for line in Path("/proc/cpuinfo").read_text().splitlines() if line.startswith("flags"))
    except (OSError, StopIteration):
        return []
    return [f"-m{name}" for name in ("avx2", "fma")] if {"avx2", "fma"} <= set(flags.split()) else []


def make_mesh(comm: Comm, cells: NDArray[np.int64], points: NDArray[np.float64], element: Any) -> Any:
    """Distributed mesh from `cells` (n, 4) and `points` (m, 3); collective, each rank gives its own share."""
    import ufl
    from dolfinx import mesh

    tune_kernels()
    domain = ufl.Mesh(element)
    names = list(inspect.signature(mesh.create_mesh).parameters)
    if names.index("x") < names.index("e"):
        return mesh.create_mesh(comm, cells, points, domain)
    return mesh.create_mesh(comm, cells, domain, points)


def geometry_dofmap(mesh: Any) -> NDArray[np.int32]:
    """Geometry nodes of every cell, shape (cells, 4)."""
    maps = getattr(mesh.geometry, "dofmaps", None)
    return mesh.geometry.dofmap if maps is None or callable(maps) else maps[0]


def create_vector(form: Any) -> Any:
    """PETSc vector that a compiled linear `form` assembles into; collective."""
    from dolfinx import fem
    from dolfinx.fem import petsc

    extract = getattr(fem, "extract_function_spaces", None)
    if extract is None or "L" in inspect.signature(petsc.create_vector).parameters:
        return petsc.create_vector(form)
    return petsc.create_vector(extract(form))


def interpolation_points(space: Any) -> NDArray[np.float64]:
    """Reference points at which a function is evaluated to interpolate it into `space`."""
    points = space.element.interpolation_points
    return np.asarray(points() if callable(points) else points)


def collapsed(part: Any) -> tuple[Any, NDArray[np.int32]]:
    """A part of a mixed space as a space of its own, and where its dofs stand in the whole, shape (dofs,)."""
    space, into = part.collapse()
    # From 0.11 on the map comes as a list of one array.
    return space, np.asarray(into, dtype=np.int32).ravel()


def snes_not_finite() -> int:
    """PETSc's reason for a residual that is not a number; its name changed in PETSc 3.25."""
    from petsc4py import PETSc

    reasons = PETSc.SNES.ConvergedReason
    names = ("DIVERGED_FNORM_NAN", "DIVERGED_FUNCTION_NANORINF")
    return int(next(getattr(reasons, name) for name in names if hasattr(reasons, name)))
