"""Fields for ParaView: VTKHDF files, each with all frames."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
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
    solid = _Grids(_TETRA, "displacement")
    solid.shape(body["points"].values * 1e3, body["cells"].values[:, :4])
    for displacement in body["displacement"].values:
        solid.frame(displacement * 1e3)
    fiducials = _Grids(_VERTEX, "residual")
    for predicted, measured in zip(prediction["predicted"].values, prediction["measured"].values, strict=True):
        measured = completed(measured, predicted)
        seen = np.isfinite(predicted).all(axis=1) & np.isfinite(measured).all(axis=1)
        fiducials.shape(predicted[seen] * 1e3, np.arange(seen.sum())[:, None])
        fiducials.frame((measured - predicted)[seen] * 1e3)
    patches = _polydata(_patches(body, anchored))
    return {"body.vtkhdf": solid.file(), "fiducials.vtkhdf": fiducials.file(), "patches.vtp": patches}


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


class _Grids:
    """Unstructured grids of one kind of cell, one per frame, with a vector at every point.

    What a frame has in common with the one before is kept once. The layout is that of VTK's file format documentation,
    "VTKHDF File Format", version 2.0, temporal unstructured grid.

    Args:
        kind: VTK's number of the cells.
        name: of the vector.
    """

    def __init__(self, kind: int, name: str) -> None:
        self.kind, self.name = kind, name
        self._parts: list[tuple[NDArray[Any], NDArray[Any]]] = []
        self._values: list[NDArray[Any]] = []
        self._part_of: list[int] = []

    def shape(self, points: NDArray[Any], cells: NDArray[Any]) -> None:
        """Points, shape (points, 3), and cells, shape (cells, nodes), of the frames that follow."""
        self._parts.append((points, cells))

    def frame(self, values: NDArray[Any]) -> None:
        """One more frame: the vector at the points of the last shape, shape (points, 3)."""
        self._values.append(values)
        self._part_of.append(len(self._parts) - 1)

    def file(self) -> bytes:
        """The content of the file."""
        import h5py

        with io.BytesIO() as stream:
            with h5py.File(stream, "w", libver=("earliest", "v110")) as made:
                root = made.create_group("VTKHDF", track_order=True)
                root.attrs["Version"] = np.array([2, 0])
                root.attrs["Type"] = np.bytes_(b"UnstructuredGrid")
                self._put(root, self._geometry())
                self._put(root.create_group("PointData"), {self.name: np.concatenate(self._values)})
                steps = root.create_group("Steps")
                steps.attrs["NSteps"] = len(self._values)
                self._put(steps, self._steps())
                offsets = _starts([len(values) for values in self._values])
                self._put(steps.create_group("PointDataOffsets"), {self.name: offsets})
            return stream.getvalue()

    @staticmethod
    def _put(group: Any, arrays: Mapping[str, NDArray[Any]]) -> None:
        for name, values in arrays.items():
            packed = {"compression": "gzip", "shuffle": True} if values.size else {}
            group.create_dataset(name, data=values, maxshape=(None, *values.shape[1:]), chunks=True, **packed)

    def _geometry(self) -> dict[str, NDArray[Any]]:
        """All parts one behind the other; each part has one more offset than cells."""
        sizes = [(len(points), len(cells), cells.size) for points, cells in self._parts]
        counts = np.array(sizes, dtype=np.int64).reshape(-1, 3)
        return {
            "NumberOfPoints": counts[:, 0],
            "NumberOfCells": counts[:, 1],
            "NumberOfConnectivityIds": counts[:, 2],
            "Points": np.concatenate([points for points, _ in self._parts]),
            "Connectivity": np.concatenate([cells.ravel() for _, cells in self._parts]).astype(np.int64),
            "Offsets": np.concatenate([np.arange(len(c) + 1) * c.shape[1] for _, c in self._parts]).astype(np.int64),
            "Types": np.full(counts[:, 1].sum(), self.kind, dtype=np.uint8),
        }

    def _steps(self) -> dict[str, NDArray[Any]]:
        """Where in the arrays each frame begins."""
        part = np.array(self._part_of, dtype=np.int64)
        points = _starts([len(points) for points, _ in self._parts])[part]
        cells = _starts([len(cells) for _, cells in self._parts])[part]
        ids = _starts([cells.size for _, cells in self._parts])[part]
        return {
            "Values": np.arange(len(part), dtype=float),
            "PartOffsets": part,
            "NumberOfParts": np.ones_like(part),
            "PointOffsets": points,
            "CellOffsets": cells[:, None],
            "ConnectivityIdOffsets": ids[:, None],
        }


def _starts(sizes: Sequence[int]) -> NDArray[np.int64]:
    return np.concatenate([[0], np.cumsum(sizes)[:-1]]).astype(np.int64)
