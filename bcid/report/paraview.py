"""Fields for ParaView: one .vtu per frame and a .pvd that strings them together."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr

if TYPE_CHECKING:
    import pyvista as pv


def write_paraview(folder: Path, body: xr.Dataset, prediction: xr.Dataset, anchored: Sequence[str] = ()) -> Path:
    """Write `body.pvd` (solid, displacement in mm), `fiducials.pvd` (measured and predicted points) and `patches.vtp` (the
    boundary at rest: which named place a triangle belongs to, and whether it is anchored); returns the first.
    """
    import pyvista as pv

    folder.mkdir(parents=True, exist_ok=True)
    points, cells = body["points"].values * 1e3, body["cells"].values
    grid = pv.UnstructuredGrid({pv.CellType.TETRA: cells[:, :4]}, points)
    bodies, fiducials = [], []
    for frame in range(body.sizes["frame"]):
        grid.point_data["displacement"] = body["displacement"].values[frame] * 1e3
        bodies.append(_save(grid, folder / f"body_{frame:04d}.vtu"))
        predicted, measured = (prediction[name].values[frame] * 1e3 for name in ("predicted", "measured"))
        seen = np.isfinite(predicted).all(axis=1) & np.isfinite(measured).all(axis=1)
        cloud = pv.PolyData(predicted[seen]).cast_to_unstructured_grid() if seen.any() else pv.UnstructuredGrid()
        if seen.any():
            cloud.point_data["residual"] = (measured - predicted)[seen]
        fiducials.append(_save(cloud, folder / f"fiducials_{frame:04d}.vtu"))
    _patches(body, anchored).save(folder / "patches.vtp", binary=True)
    _collection(folder / "fiducials.pvd", fiducials)
    return _collection(folder / "body.pvd", bodies)


def _patches(body: xr.Dataset, anchored: Sequence[str]) -> pv.PolyData:
    from bcid.report.scene3d import surface

    mesh = surface(body)
    names = [str(name) for name in body["place_name"].values]
    held = np.array([name.startswith("patch ") and name.removeprefix("patch ") in anchored for name in names])
    mesh.cell_data["anchored"] = held[body["place"].values].astype(np.uint8)
    mesh.field_data["place_name"] = [name.encode("ascii", "replace").decode() or "none" for name in names]
    return mesh


def _save(grid: pv.UnstructuredGrid, target: Path) -> str:
    grid.save(target, binary=True)
    return target.name


def _collection(target: Path, names: list[str]) -> Path:
    entries = "\n".join(f'    <DataSet timestep="{i}" file="{name}"/>' for i, name in enumerate(names))
    head = '<?xml version="1.0"?>\n<VTKFile type="Collection" version="0.1">\n  <Collection>'
    text = f"{head}\n{entries}\n  </Collection>\n</VTKFile>\n"
    partial = target.with_name(f".{target.name}.partial")
    partial.write_text(text, encoding="utf-8")
    partial.replace(target)
    return target
