"""Fields for ParaView: VTKHDF files, each with all frames."""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from bcid.report.figure import completed

if TYPE_CHECKING:
    import pyvista as pv

# VTK's numbers for a vertex and a tetrahedron.
_VERTEX, _TETRA = 1, 10


def paraview_files(body: xr.Dataset, prediction: xr.Dataset, anchored: Sequence[str] = ()) -> dict[str, bytes]:
    """Contents by name: `body.vtkhdf` (solid, displacement in mm), `fiducials.vtkhdf` (predicted points and their residuals,
    mm), both by frame, and `patches.vtp` (the boundary at rest: which named place a triangle belongs to, and whether it is
    anchored)."""
    solid = [(body["points"].values * 1e3, body["cells"].values[:, :4])]
    moves = list(body["displacement"].values * 1e3)
    points, residuals = [], []
    for predicted, measured in zip(prediction["predicted"].values, prediction["measured"].values, strict=True):
        measured = completed(measured, predicted)
        seen = np.isfinite(predicted).all(axis=1) & np.isfinite(measured).all(axis=1)
        points.append((predicted[seen] * 1e3, np.arange(seen.sum())[:, None]))
        residuals.append((measured - predicted)[seen] * 1e3)
    return {
        "body.vtkhdf": _grids(_TETRA, solid, "displacement", moves),
        "fiducials.vtkhdf": _grids(_VERTEX, points, "residual", residuals),
        "patches.vtp": _polydata(_patches(body, anchored)),
    }


def _patches(body: xr.Dataset, anchored: Sequence[str]) -> pv.PolyData:
    from bcid.report.scene3d import surface

    mesh = surface(body)
    names = [str(name) for name in body["place_name"].values]
    held = np.array([name.startswith("patch ") and name.removeprefix("patch ") in anchored for name in names])
    mesh.cell_data["anchored"] = held[body["place"].values].astype(np.uint8)
    mesh.field_data["place_name"] = [name.encode("ascii", "replace").decode() or "none" for name in names]
    return mesh


def _polydata(mesh: pv.PolyData) -> bytes:
    from vtkmodules.vtkIOXML import vtkXMLPolyDataWriter

    writer = vtkXMLPolyDataWriter()
    writer.SetInputData(mesh)
    writer.SetDataModeToBinary()
    writer.SetWriteToOutputString(True)
    writer.Write()
    return str(writer.GetOutputString()).encode()


def _grids(
    kind: int, parts: Sequence[tuple[NDArray[Any], NDArray[Any]]], name: str, frames: list[NDArray[Any]]
) -> bytes:
    """A file of unstructured grids of one kind of cell, one per frame, with a vector at every point.

    The layout is that of VTK's file format documentation, "VTKHDF File Format", version 2.0, temporal unstructured grid.

    Args:
        kind: VTK's number of the cells.
        parts: points, shape (points, 3), and cells, shape (cells, nodes), of every frame; or once, where all have the same.
        name: of the vector.
        frames: the vector at the points of each frame, shape (points, 3).
    """
    import h5py

    counts = np.array([(len(points), len(cells), cells.size) for points, cells in parts], dtype=np.int64)
    part = np.arange(len(frames)) if len(parts) > 1 else np.zeros(len(frames), dtype=np.int64)
    starts = _starts(counts)[part]
    # Each part has one more offset than cells.
    offsets = [np.arange(len(cells) + 1) * cells.shape[1] for _, cells in parts]
    arrays = {
        "NumberOfPoints": counts[:, 0],
        "NumberOfCells": counts[:, 1],
        "NumberOfConnectivityIds": counts[:, 2],
        "Points": np.concatenate([points for points, _ in parts]),
        "Connectivity": np.concatenate([cells.ravel() for _, cells in parts]).astype(np.int64),
        "Offsets": np.concatenate(offsets).astype(np.int64),
        "Types": np.full(counts[:, 1].sum(), kind, dtype=np.uint8),
        f"PointData/{name}": np.concatenate(frames),
        "Steps/Values": np.arange(len(frames), dtype=float),
        "Steps/PartOffsets": part,
        "Steps/NumberOfParts": np.ones_like(part),
        "Steps/PointOffsets": starts[:, 0],
        "Steps/CellOffsets": starts[:, 1:2],
        "Steps/ConnectivityIdOffsets": starts[:, 2:],
        f"Steps/PointDataOffsets/{name}": _starts(np.array([len(values) for values in frames])),
    }
    with io.BytesIO() as stream:
        with h5py.File(stream, "w", libver=("earliest", "v110")) as made:
            root = made.create_group("VTKHDF", track_order=True)
            root.attrs["Version"] = np.array([2, 0])
            root.attrs["Type"] = np.bytes_(b"UnstructuredGrid")
            root.create_group("Steps").attrs["NSteps"] = len(frames)
            for key, values in arrays.items():
                packed = {"compression": "gzip", "shuffle": True} if values.size else {}
                root.create_dataset(key, data=values, maxshape=(None, *values.shape[1:]), chunks=True, **packed)
        return stream.getvalue()


def _starts(sizes: NDArray[np.int64]) -> NDArray[np.int64]:
    """Where each begins behind those before it."""
    return np.cumsum(sizes, axis=0) - sizes
