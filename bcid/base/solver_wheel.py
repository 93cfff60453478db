"""DOLFINx as a wheel (dolfinx-solver-real) must be prepared before its bindings are imported."""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec


def prepare() -> None:
    """Let the wheel load MPI first, and refuse a second PETSc; nothing is done where it is not installed.

    Raises:
        ImportError: another petsc4py would be taken for the wheel's own; the message says which to remove.
    """
    if find_spec("dolfinx_solver") is not None:
        import_module("dolfinx_solver")
