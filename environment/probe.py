"""Prints ``own`` if this Python has DOLFINx, ``wheels`` if it can take it, and what identifies it. Importing would take seconds."""

import platform
import shutil
import sys
import sysconfig
from importlib.util import find_spec
from pathlib import Path

glibc = [int(n) for n in platform.libc_ver()[1].split(".")[:2] if n.isdigit()]
headers = Path(sysconfig.get_path("include"), "Python.h").is_file()
system = platform.machine() == "x86_64" and glibc >= [2, 34] and headers and (shutil.which("cc") or shutil.which("gcc"))
# A venv made from a venv does not see the packages of the first one.
own = sys.version_info >= (3, 11) and sys.prefix == sys.base_prefix
if own and all(map(find_spec, ("dolfinx", "petsc4py", "mpi4py", "gmsh"))):
    print("own", sys.prefix, sys.version)
elif sys.version_info >= (3, 12) and system and all(map(find_spec, ("venv", "ensurepip"))):
    print("wheels", sys.prefix, sys.version)
else:
    sys.exit(1)
