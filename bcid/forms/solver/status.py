"""How a solve ended, by name, in words, and from PETSc's reasons."""

from __future__ import annotations

from enum import StrEnum

from petsc4py import PETSc

from bcid.base import compat


class Status(StrEnum):
    """How a solve ended. Only `CONVERGED` may be used as a prediction."""

    CONVERGED = "converged"
    UNSTABLE = "unstable"
    INVERTED = "inverted"
    LINE_SEARCH = "line_search"
    MAX_ITERATIONS = "max_iterations"
    LINEAR_SOLVER = "linear_solver"
    NOT_FINITE = "not_finite"
    OUT_OF_MEMORY = "out_of_memory"
    JUMPED = "jumped"
    DIVERGED = "diverged"
    FAILED = "failed"


WORDS = {
    Status.CONVERGED: "the equilibrium was found",
    Status.UNSTABLE: "no stable equilibrium was found (a pivot of the tangent is not positive): it buckles, or nothing holds it",
    Status.INVERTED: "an element is turned inside out (det F <= 0)",
    Status.LINE_SEARCH: "PETSc's line search found no smaller residual",
    Status.MAX_ITERATIONS: "Newton's method needed too many iterations",
    Status.LINEAR_SOLVER: "the tangent could not be factorised",
    Status.NOT_FINITE: "the residual is not a number (an element was turned inside out)",
    Status.OUT_OF_MEMORY: "the factorisation ran out of memory",
    Status.JUMPED: "the state found holds more energy than the gripper has put in: the motion does not lead there",
    Status.DIVERGED: "Newton's method diverged",
    Status.FAILED: "the evaluation failed",
}
REASONS = {
    PETSc.SNES.ConvergedReason.DIVERGED_LINE_SEARCH: Status.LINE_SEARCH,
    PETSc.SNES.ConvergedReason.DIVERGED_MAX_IT: Status.MAX_ITERATIONS,
    PETSc.SNES.ConvergedReason.DIVERGED_LINEAR_SOLVE: Status.LINEAR_SOLVER,
    compat.snes_not_finite(): Status.NOT_FINITE,
    PETSc.SNES.ConvergedReason.DIVERGED_FUNCTION_DOMAIN: Status.NOT_FINITE,
}
