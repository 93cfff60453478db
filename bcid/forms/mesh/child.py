"""Child process that makes or reads a mesh: ``python -m bcid.forms.mesh.child FILE OUT.npz SIZE FINEST MOST [NAME=NUMBER ...]``.

It runs apart because gmsh may abort on damaged files, and runs scripts. Says in one line why a file cannot be used; exits with 1.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from bcid.base.confined import serve
from bcid.base.errors import InputError
from bcid.forms.mesh.check import MOST_CELLS
from bcid.forms.mesh.foreign_mesh import with_meshio
from bcid.forms.mesh.gmsh_mesh import with_gmsh
from bcid.forms.mesh.label_image import body_of_labels
from bcid.forms.mesh.mend import mended
from bcid.forms.mesh.references import refuse_references
from bcid.forms.mesh.remesh import solid
from bcid.forms.mesh.surface_file import read_surface
from bcid.scene.geometry_file import IMAGE, SURFACE, kind_of, sized

Arrays = dict[str, Any]
_GMSH = (".geo", ".msh")
_LIBRARIES = {
    SURFACE: ("gmsh", "meshio", "scipy.sparse.csgraph", "scipy.spatial"),
    IMAGE: (
        "gmsh",
        "nibabel",
        "vtkmodules.vtkFiltersCore",
        "scipy.ndimage",
        "scipy.optimize",
        "scipy.sparse.csgraph",
        "scipy.spatial",
    ),
}
# Address space, bytes, of a child that meshes so many.
_MESHING_SPACE = 2_000_000_000 + 2_000 * MOST_CELLS


def main() -> int:
    """Read the arguments, write the arrays."""
    source = Path(sys.argv[1])
    libraries = ["gmsh"] if source.suffix in _GMSH else ["meshio", "h5py"]
    return serve(_read, _LIBRARIES.get(kind_of(source), libraries), _MESHING_SPACE if sized(source) else None)


def _read(source: Path, arguments: Sequence[str]) -> Arrays:
    size, finest, most = map(float, arguments[:3])
    numbers = dict(entry.split("=", 1) for entry in arguments[3:])
    if source.suffix in _GMSH:
        return with_gmsh(source, size, finest, numbers, most)
    if kind_of(source) == SURFACE:
        return solid(mended(read_surface(source)), size, finest, most)
    if kind_of(source) == IMAGE:
        _require("nibabel", "vtkmodules")
        surface, voxels = body_of_labels(source, [int(label) for label in numbers["label"].split(",")])
        return solid(mended(surface), size, finest, most) | voxels
    refuse_references(source)
    return with_meshio(source)


def _require(*packages: str) -> None:
    missing = [name for name in packages if find_spec(name) is None]
    if missing:
        raise InputError(
            f"label images are read with nibabel and VTK; {missing[0]} is not here: pip install 'bcid[mesh]'"
        )


if __name__ == "__main__":
    sys.exit(main())
