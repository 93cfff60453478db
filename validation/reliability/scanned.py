"""Bodies as scanners and segmentations have them, written into files for the tests, in mm, and scenes on them."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from bcid.scene import Scene

Arrays = tuple[np.ndarray, np.ndarray]


def sphere(radius: float = 30.0, subdivisions: int = 4, centre: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Arrays:
    """Points and triangles of a sphere, outward."""
    import pyvista as pv

    mesh = pv.Icosphere(radius=radius, center=centre, nsub=subdivisions).clean()
    return np.asarray(mesh.points, dtype=float), mesh.faces.reshape(-1, 4)[:, 1:].astype(int)


def box(size: tuple[float, float, float] = (60.0, 40.0, 20.0), cells: int = 1) -> Arrays:
    """Points and triangles of a box from the origin on, outward; `cells` along each edge of a face."""
    import pyvista as pv

    mesh = pv.ImageData(dimensions=(cells + 1,) * 3, spacing=tuple(s / cells for s in size))
    skin = mesh.extract_surface(algorithm="dataset_surface").triangulate().clean()
    triangles = skin.faces.reshape(-1, 4)[:, 1:].astype(int)
    return np.asarray(skin.points, dtype=float), triangles


def volume(points: np.ndarray, triangles: np.ndarray) -> float:
    a, b, c = (points[triangles[:, i]] for i in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


def save(path: Path, points: np.ndarray, triangles: np.ndarray, **data: np.ndarray) -> Path:
    """An STL, PLY or OBJ by the suffix, ascii STL for `*.ascii.stl`; written by meshio, OBJ by hand."""
    import meshio

    if path.suffix == ".obj":
        lines = [
            f"v {' '.join(map(repr, map(float, [*p, *data.get('rgb', {i: ()})[i]])))}" for i, p in enumerate(points)
        ]
        lines += [f"f {' '.join(f'{n + 1}//{n + 1}' for n in row)}" for row in triangles]
        path.write_text("\n".join(["# made by hand", *lines]) + "\n", encoding="utf-8")
        return path
    mesh = meshio.Mesh(points, [("triangle", triangles)], point_data=data)
    options: dict[str, Any] = {"binary": ".ascii" not in path.suffixes} if path.suffix in (".stl", ".ply") else {}
    meshio.write(path, mesh, **options)
    return path


SCENE = """
format = "bcid-scene/1"
name = "scanned"
noise_sigma = "0.1 mm"
[geometry]
file = "{file}"
{more}
{levels}
[material]
law = "neo_hooke"
young = "15 kPa"
poisson = 0.35
[patches]
{patches}
[grasps]
{grasps}
[fiducials]
{fiducials}
"""
WHOLE = 'all = { box = ["-1 -1 -1 m", "1 1 1 m"] }'


def scene_text(
    file: str,
    sizes: tuple[float, ...] = (10.0,),
    patches: str = WHOLE,
    grasps: str = "",
    fiducials: str = 'a = "0 0 0 mm"',
    more: str = 'length_unit = "mm"',
    refined: bool = False,
) -> str:
    """A scene on a geometry, with elements of these sizes, mm, or so many refinements."""
    rungs = [f"refinements = {int(size)}" if refined else f'element_size = "{size} mm"' for size in sizes]
    levels = "\n".join(f"[[levels]]\n{rung}" for rung in rungs)
    return SCENE.format(file=file, more=more, levels=levels, patches=patches, grasps=grasps, fiducials=fiducials)


def scene_of(file: Path, **more: Any) -> Scene:
    """The scene, written beside the geometry and read."""
    path = file.with_name("scene.toml")
    path.write_text(scene_text(file.name, **more), encoding="utf-8")
    return Scene.read(path)


def image(path: Path, labels: np.ndarray, affine: np.ndarray, edit: Callable[[Any], None] = lambda _: None) -> Path:
    """A NIfTI image in mm."""
    import nibabel

    made = nibabel.Nifti1Image(labels, affine)
    made.header.set_xyzt_units("mm")
    edit(made.header)
    nibabel.save(made, path)
    return path
