"""What a killed compilation leaves behind stops nobody, and two processes that compile the same form do not meet."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

_COMPILE = """
import ufl
from mpi4py import MPI
from dolfinx import fem, mesh
from bcid.forms import compiled
domain = mesh.create_unit_cube(MPI.COMM_WORLD, 2, 2, 2)
space = fem.functionspace(domain, ("Lagrange", 1))
u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
print("begins", flush=True)
points = space.element.interpolation_points
compiled.form(ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx)
compiled.expression(ufl.grad(fem.Function(space)), points() if callable(points) else points)
print("compiled", flush=True)
"""


def compiling(cache: Path, *before: str) -> subprocess.Popen[str]:
    """A process that compiles a form and an expression into an own cache."""
    environment = os.environ | {"XDG_CACHE_HOME": str(cache)}
    given = [*before, sys.executable, "-c", _COMPILE]
    return subprocess.Popen(
        given, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    )


def killed(cache: Path) -> None:
    """Kill a process and its compiler when FFCx has begun a file."""
    process = compiling(cache)
    end = time.monotonic() + 60
    while not list(cache.rglob("libffcx*.c")):
        assert time.monotonic() < end
        assert process.poll() is None
        time.sleep(0.002)
    os.killpg(process.pid, signal.SIGKILL)
    process.communicate()
    assert not list(cache.rglob("*.c.cached"))


@pytest.mark.parametrize("ranks", [1, 2])
def test_form_after_killed_compilation_is_compiled(tmp_path: Path, ranks: int) -> None:
    killed(tmp_path)
    process = compiling(tmp_path, *(["mpirun", "-n", "2"] if ranks == 2 else []))
    said, errors = process.communicate(timeout=110)
    assert process.returncode == 0, errors[-2000:]
    assert said.count("compiled") == ranks


def test_form_two_processes_at_once_are_both_given_it(tmp_path: Path) -> None:
    both = [compiling(tmp_path) for _ in range(2)]
    for process in both:
        _, errors = process.communicate(timeout=110)
        assert process.returncode == 0, errors[-2000:]
