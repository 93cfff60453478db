"""`bcid doctor`: does everything that bcid needs work on this machine?

Each check looks at one thing and says in words what to do where it is wrong. Nothing of what is checked is imported
before its check runs, and a check that fails in an unexpected way is itself a finding, not a crash. What could take the
process down with it (a renderer, a compiler, MPI ranks) is tried in a child process.
"""

from __future__ import annotations

import contextlib
import importlib
import importlib.util
import os
import platform
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

from bcid.base.errors import MachineError
from bcid.base.landlock import landlock
from bcid.base.scratch import trouble
from bcid.base.solver_wheel import prepare
from bcid.base.system_calls import seccomp

GET_DOLFINX = 'pip install "bcid[all]" (Python 3.12 or newer), or ./dev of the checkout, which makes an environment'

# BLAS libraries that are fast, by a part of the name of their file or of its folder.
FAST_BLAS = {
    "openblas": "OpenBLAS",
    "mkl": "Intel MKL",
    "blis": "BLIS",
    "armpl": "Arm Performance Libraries",
    "nvpl": "NVPL",
    "atlas": "ATLAS",
    "Accelerate": "Accelerate",
}

RENDER = """
import pyvista
plotter = pyvista.Plotter(off_screen=True, window_size=(200, 200))
plotter.add_mesh(pyvista.Sphere(), color="red")
image = plotter.screenshot(return_img=True)
assert image.std() > 1, "the picture is empty"
print(plotter.render_window.GetClassName())
"""

COMPILE = """
import sys
from mpi4py import MPI
import dolfinx, ufl
mesh = dolfinx.mesh.create_unit_interval(MPI.COMM_SELF, 2)
V = dolfinx.fem.functionspace(mesh, ("Lagrange", 1))
form = dolfinx.fem.form(ufl.TestFunction(V) * ufl.dx, jit_options={"cache_dir": sys.argv[1]})
assert abs(dolfinx.fem.assemble_vector(form).array.sum() - 1) < 1e-12
"""

MESH = """
import gmsh
gmsh.initialize(interruptible=False)
gmsh.option.setNumber("General.Terminal", 0)
gmsh.model.occ.addBox(0, 0, 0, 1, 1, 1)
gmsh.model.occ.synchronize()
gmsh.model.mesh.generate(3)
assert len(gmsh.model.mesh.getNodes()[0]) >= 8
print(gmsh.option.getString("General.Version").split()[0])
"""

RANKS = "from mpi4py import MPI; assert MPI.COMM_WORLD.allreduce(1) == 2"


@dataclass(frozen=True)
class Check:
    """What was found about one thing. Without an essential thing bcid cannot identify anything."""

    name: str
    ok: bool
    value: str
    advice: str = ""
    essential: bool = True

    def __str__(self) -> str:
        mark = "ok" if self.ok else "WRONG" if self.essential else "note"
        text = f"  {mark:<6} {self.name:<16} {self.value}"
        return text if self.ok or not self.advice else f"{text}\n  {'':<23} -> {self.advice}"


def first_line(text: object) -> str:
    lines = str(text).strip().splitlines()
    return lines[0] if lines else type(text).__name__


def version_of(distribution: str) -> str:
    try:
        return metadata.version(distribution)
    except metadata.PackageNotFoundError:
        return "of unknown version"


def child(code: str, *args: str, seconds: int = 120, launcher: tuple[str, ...] = ()) -> tuple[bool, str]:
    """Runs Python code in a child process: did it work, and its last line of output or of its error."""
    try:
        done = subprocess.run(
            [*launcher, sys.executable, "-c", code, *args],
            capture_output=True,
            text=True,
            errors="replace",
            timeout=seconds,
            stdin=subprocess.DEVNULL,
        )
    except subprocess.TimeoutExpired:
        return False, f"no answer within {seconds} s"
    except OSError as error:
        return False, str(error)
    if done.returncode < 0:
        return False, f"killed by signal {-done.returncode}"
    lines = (done.stdout if done.returncode == 0 else done.stderr or done.stdout).strip().splitlines()
    return done.returncode == 0, lines[-1].strip() if lines else ""


def check_python() -> Check:
    value = f"{platform.python_version()} ({sys.executable})"
    return Check("Python", sys.version_info >= (3, 11), value, "bcid needs Python 3.11 or later")


def check_dolfinx() -> Iterator[Check]:
    try:
        prepare()
        version = str(importlib.import_module("dolfinx").__version__)
    except ImportError as error:
        yield Check("DOLFINx", False, first_line(error), GET_DOLFINX)
        return
    supported = version.split(".")[:2] in (["0", "9"], ["0", "10"], ["0", "11"])
    yield Check("DOLFINx", supported, version, "bcid is tested with 0.9, 0.10 and 0.11", essential=False)
    parts = {"Basix": "fenics-basix", "FFCx": "fenics-ffcx", "UFL": "fenics-ufl"}
    yield Check("its parts", True, ", ".join(f"{name} {version_of(dist)}" for name, dist in parts.items()))


def check_petsc() -> Iterator[Check]:
    try:
        petsc = importlib.import_module("petsc4py.PETSc")
    except ImportError as error:
        yield Check("PETSc", False, first_line(error), GET_DOLFINX)
        return
    version = ".".join(map(str, petsc.Sys.getVersion()))
    value = f"{version} ({petsc.ScalarType.__name__}, {petsc.IntType.__name__})"
    real = not issubclass(petsc.ScalarType, complex)
    yield Check("PETSc", real, value, "this is the build for complex numbers; bcid needs the one for real numbers")
    # Tried rather than asked for: the list of packages that PETSc gives is not complete in all builds.
    for name, kind, essential, advice in [
        ("MUMPS", "lu", True, "bcid's direct solver; install a PETSc that has it"),
        ("CHOLMOD", "cholesky", False, "factorisations are slower without it"),
    ]:
        try:
            factorise(petsc, kind, name.lower())
            yield Check(name, True, "works")
        except petsc.Error as error:
            yield Check(name, False, f"not in this PETSc (error {error.ierr})", advice, essential)


def factorise(petsc: Any, kind: str, solver: str) -> None:
    """Solves a system of two equations with one of PETSc's solvers."""
    matrix = petsc.Mat().createAIJ((2, 2), nnz=1, comm=petsc.COMM_SELF)
    for row in range(2):
        matrix.setValue(row, row, 2.0)
    matrix.assemble()
    matrix.setOption(petsc.Mat.Option.SPD, True)
    ksp = petsc.KSP().create(petsc.COMM_SELF)
    ksp.setOperators(matrix)
    ksp.getPC().setType(kind)
    if kind != solver:
        ksp.getPC().setFactorSolverType(solver)
    right, left = matrix.createVecs()
    left.set(1.0)
    ksp.solve(left, right)
    for thing in (ksp, matrix, right, left):
        thing.destroy()


def blas_in(maps: str) -> dict[str, bool]:
    """The BLAS libraries in the text of /proc/PID/maps: what and where, and whether it is fast."""
    found = {}
    for path in sorted({Path(line[line.index("/") :].strip()) for line in maps.splitlines() if "/" in line}):
        if "blas" not in path.name and "mkl" not in path.name:
            continue
        # Debian's libblas.so.3 lies in a folder named after the library that it passes calls on to.
        where = f"{path.parent.name}/{path.name}"
        name = next((name for part, name in FAST_BLAS.items() if part in where), None)
        if name or path.name.startswith(("libblas.", "libcblas.", "librefblas.")):
            found[f"{name or 'reference BLAS'} ({path})"] = name is not None
    return found


def check_blas() -> Check:
    for module in ("numpy", "petsc4py.PETSc"):
        if importlib.util.find_spec(module.split(".")[0]):
            importlib.import_module(module)
    try:
        found = blas_in(Path("/proc/self/maps").read_text(errors="replace"))
    except OSError:
        return Check("BLAS", True, "cannot be told on this system", essential=False)
    advice = (
        "solves take three times as long; install OpenBLAS (Debian: libopenblas0-serial; conda: libblas=*=*openblas)"
    )
    if not found:
        return Check("BLAS", True, "none loaded as a library of its own", essential=False)
    # The slow one is what has to be said; otherwise the library that does the work, not the one that passes calls on.
    slow = [text for text, fast in found.items() if not fast]
    shown = slow or [text for text in found if "/libblas." not in text and "/liblapack." not in text] or list(found)
    return Check("BLAS", not slow, "; ".join(shown), advice, essential=False)


def check_mpi() -> Iterator[Check]:
    try:
        mpi = importlib.import_module("mpi4py.MPI")
    except ImportError as error:
        yield Check("MPI", False, first_line(error), GET_DOLFINX)
        return
    library = first_line(mpi.Get_library_version()).split(",")[0].strip("\0 ")
    ranks = mpi.COMM_WORLD.size
    yield Check(
        "MPI", True, f"{library}, mpi4py {version_of('mpi4py')}, {ranks} {'rank' if ranks == 1 else 'ranks'} here"
    )
    if ranks > 1:
        return
    if not shutil.which("mpirun"):
        advice = "install the mpirun of the MPI that mpi4py uses; without it bcid runs on one core"
        yield Check("mpirun", False, "not found", advice, essential=False)
        return
    # Ranks are started without the variables that MPI, already loaded here, has left for its children.
    clean = (
        "env",
        *(f"-u{name}" for name in os.environ if name.startswith(("PMIX_", "PMI_", "OMPI_COMM_", "OMPI_UNIVERSE_"))),
    )
    ok, said = child(RANKS, launcher=(*clean, "mpirun", "-n", "2"), seconds=60)
    advice = "mpirun belongs to another MPI than mpi4py, or ranks cannot reach each other; bcid works on one core"
    yield Check("mpirun", ok, "two ranks reach each other" if ok else said, advice, essential=False)


def check_gmsh() -> Check:
    ok, said = child(MESH)
    return Check("gmsh", ok, said if ok else said or "does not work", GET_DOLFINX)


def check_compiler() -> Iterator[Check]:
    name = os.environ.get("CC", "").split()[:1] or ["cc"]
    compiler = next((found for found in map(shutil.which, [*name, "cc", "gcc", "clang"]) if found), None)
    advice = "FFCx compiles forms when they are first used; install gcc (conda: c-compiler)"
    yield Check("C compiler", compiler is not None, compiler or "not found", advice)
    if compiler is None or not importlib.util.find_spec("dolfinx"):
        return
    with tempfile.TemporaryDirectory() as folder:
        ok, said = child(COMPILE, folder)
    yield Check("compiling forms", ok, "works" if ok else said, "is there Python.h (Debian: python3-dev)? " + advice)


def check_barriers() -> Iterator[Check]:
    """Files of others are read by children that give up their rights, where kernel and libraries know how to take them."""
    version, missing = landlock(), seccomp()
    found = f"version {version}: readers of files of others open nothing else" if version else "not in this kernel"
    advice = "readers of files of others may read your other files; take Linux 5.13 or newer with Landlock"
    yield Check("Landlock", version > 0, found, advice, essential=False)
    found = missing or "libseccomp: they make no sockets and processes, and change no file"
    advice = "readers of files of others may open sockets and start processes; install libseccomp and pyseccomp"
    yield Check("system calls", not missing, found, advice, essential=False)


def check_scratch() -> Check:
    found = trouble()
    return Check("temporary folder", not found, found or tempfile.gettempdir(), "MPI and the compiler write there")


def check_form_cache() -> Iterator[Check]:
    if not importlib.util.find_spec("dolfinx"):
        return
    jit = importlib.import_module("dolfinx.jit")
    folder = Path(jit.get_options()["cache_dir"])
    above = next(p for p in (folder, *folder.parents) if p.exists())
    ok = os.access(above, os.W_OK | os.X_OK)
    yield Check("form cache", ok, str(folder), f"{above} cannot be written to; set XDG_CACHE_HOME to a folder that can")


def check_wheels() -> Iterator[Check]:
    for name, essential, loss in [
        ("numpy", True, "install it"),
        ("scipy", True, "install it"),
        ("xarray", True, "install it: measurements and results are kept with it"),
        ("pyvista", False, "no 3-D pictures in reports"),
        ("matplotlib", False, "no diagrams in reports"),
        ("h5py", False, "no fields for ParaView, no MAT 7.3, HDF5 and DeepLabCut recordings in HDF5"),
        ("meshio", False, "only meshes that gmsh reads, and STL and OBJ surfaces"),
        ("nibabel", False, "no label images (NIfTI)"),
        ("ezc3d", False, "no C3D files of motion capture systems"),
        ("rosbags", False, "no ROS bags"),
        ("cv2", False, "no tracking in images (pip install opencv-python-headless)"),
    ]:
        found = importlib.util.find_spec(name) is not None
        distribution = "opencv-python-headless" if name == "cv2" else name
        yield Check(name, found, version_of(distribution) if found else "not found", loss, essential)


def check_rendering() -> Iterator[Check]:
    if importlib.util.find_spec("pyvista"):
        ok, said = child(RENDER)
        advice = (
            "reports come without 3-D pictures; install libegl1 (Debian) or libegl (conda), and take VTK 9.4 or later"
        )
        yield Check("rendering", ok, f"off screen, {said}" if ok else said, advice, essential=False)


def check_threads() -> Check:
    value = os.environ.get("OMP_NUM_THREADS", "not set")
    return Check(
        "OMP_NUM_THREADS", value == "1", value, "set it to 1 under mpirun: ranks fight for cores", essential=False
    )


def check_machine() -> Iterator[Check]:
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    yield Check("cores", True, str(cores))
    memory = available_memory()
    if memory is not None:
        value = f"{memory / 2**30:.1f} GiB available"
        yield Check("memory", memory > 2**30, value, "fine meshes need more than 1 GiB per rank", essential=False)
    free = shutil.disk_usage(Path.cwd()).free
    yield Check("disk", free > 2**30, f"{free / 2**30:.1f} GiB free here", "studies may need more", essential=False)


def available_memory() -> int | None:
    """Bytes that this process may still get: of the machine, or of its control group if that is less."""
    limits = []
    try:
        for line in Path("/proc/meminfo").read_text().splitlines():
            if line.startswith("MemAvailable:"):
                limits.append(int(line.split()[1]) * 1024)
        group = Path("/sys/fs/cgroup")
        limits.append(int((group / "memory.max").read_text()) - int((group / "memory.current").read_text()))
    except (OSError, ValueError):  # no such file on this system, or no limit ("max")
        pass
    return min(limits, default=None)


CHECKS: list[Callable[[], Check | Iterable[Check]]] = [
    check_python,
    check_scratch,
    check_barriers,
    check_dolfinx,
    check_petsc,
    check_blas,
    check_mpi,
    check_gmsh,
    check_compiler,
    check_form_cache,
    check_wheels,
    check_rendering,
    check_threads,
    check_machine,
]


def findings() -> Iterator[Check]:
    """All checks, one after the other, as they come."""
    for check in CHECKS:
        try:
            found = check()
            yield from [found] if isinstance(found, Check) else found
        except Exception as error:  # a broken installation can raise anything
            name = check.__name__.removeprefix("check_").replace("_", " ")
            yield Check(
                name, False, f"{type(error).__name__}: {first_line(error)}", "this part of the installation is broken"
            )


def report() -> list[Check]:
    return list(findings())


def main() -> int:
    """Prints all findings; the exit code is that of a fault of the machine if something essential is missing."""
    shown = True
    if importlib.util.find_spec("mpi4py"):
        with contextlib.suppress(ImportError):
            shown = importlib.import_module("mpi4py.MPI").COMM_WORLD.rank == 0
    found = []
    for check in findings():
        found.append(check)
        if shown:
            print(check, flush=True)
    wrong = [check.name for check in found if check.essential and not check.ok]
    notes = [check.name for check in found if not check.essential and not check.ok]
    if shown:
        print()
        print(f"bcid cannot work here: {', '.join(wrong)}" if wrong else "Everything that bcid needs works.")
        if notes:
            print(f"It could be better: {', '.join(notes)}")
    return MachineError.exit_code if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
