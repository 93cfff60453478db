"""The surface of a label in a NIfTI image, in the frame of its affine. For the child process alone.

The label, 1 inside and 0 outside, is blurred by one voxel, and the surface drawn at the level that keeps its volume: the steps
between voxels go, and the body neither shrinks nor grows (marching cubes; Schroeder, Maynard, Geveci, Flying Edges, LDAV 2015).
"""

from __future__ import annotations

import gzip
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.optimize import brentq

from bcid.base.errors import InputError
from bcid.base.unpacked import refuse_large
from bcid.forms.mesh.fields import of_triangles
from bcid.forms.mesh.surface_file import TriangleSurface

Mask = NDArray[np.bool_]

# Standard deviation of the blur, voxels, and how much around the label is looked at: to where the blur is nothing.
_BLUR, _AROUND = 1.0, 5
# Most bytes of an image, unpacked: 512 x 512 x 1,900 voxels of two bytes.
_LARGEST = 1_000_000_000
# How a file of the second version begins: with the length of its header.
_NIFTI2 = ((540).to_bytes(4, "little"), (540).to_bytes(4, "big"))
# Islands and cavities with less than this part of the label are specks.
_SPECK = 1e-2
# The field that tells which label the body touches.
FIELD = "label"


def surface_of_label(source: Path, label: int) -> TriangleSurface:
    """The surface of a label, see `body_of_labels`."""
    return body_of_labels(source, [label])[0]


def body_of_labels(source: Path, labels: Sequence[int]) -> tuple[TriangleSurface, dict[str, NDArray[Any]]]:
    """The surface of some labels together, in the unit of the image, with the labels that it touches as the field "label".

    Returns:
        besides, "voxels": the labels inside of it, shape (x, y, z), in voxels outside that of the nearest inside; and "frame": from
        these voxels to space, shape (4, 4), in the unit of the image. Of one label alone there is nothing to tell.

    Raises:
        InputError: no image of labels in space, no frame, no such label, or a body in several pieces.
    """
    image, affine = _read(source)
    for label in labels:
        if not (image == label).any():
            known, counts = np.unique(image, return_counts=True)
            shown = ", ".join(f"{k:g} ({n} voxels)" for k, n in list(zip(known, counts, strict=True))[:20])
            where = "geometry.label" if label == labels[0] else "[regions]"
            raise InputError(f"label {label} is not in the image; it has {shown}: choose one of them in {where}")
    box = ndimage.find_objects(np.isin(image, labels).astype(np.uint8))[0]
    around = _surrounded(image, box)
    mask, notes = _one_piece(np.isin(around, labels))
    points, triangles = _contour(mask)
    touched = _touched(around, mask, points[triangles].mean(axis=1))
    frame = affine.copy()
    frame[:3, 3] += affine[:3, :3] @ np.array([cut.start - _AROUND for cut in box])
    placed = points @ frame[:3, :3].T + frame[:3, 3]
    # A frame that mirrors the voxels, as most do (x to the left), turns the triangles.
    triangles = triangles if np.linalg.det(affine[:3, :3]) > 0 else triangles[:, ::-1]
    surface = TriangleSurface(placed, triangles, {FIELD: of_triangles(touched)}, notes=tuple(notes))
    return surface, {"voxels": _continued(around, labels), "frame": frame} if len(labels) > 1 else {}


def _continued(around: NDArray[Any], labels: Sequence[int]) -> NDArray[np.int32]:
    """The image with the nearest of some labels where it has others: the smooth surface encloses parts of those too."""
    inside = np.isin(around, labels)
    nearest = ndimage.distance_transform_edt(~inside, return_distances=False, return_indices=True)
    return np.asarray(around[tuple(nearest)], dtype=np.int32)


def _read(source: Path) -> tuple[NDArray[Any], NDArray[np.float64]]:
    """Labels (x, y, z) and the affine from voxels to space."""
    try:
        image = _declared_part(source)
        labels = np.asarray(image.dataobj)
    except MemoryError:
        raise InputError("the image takes more memory than is there; crop it to the body first") from None
    except InputError:
        raise
    except Exception as error:
        raise InputError(f"is no NIfTI image, or truncated: {error}") from None
    labels = (
        labels.reshape(labels.shape[:3]) if labels.ndim > 3 and labels.size == np.prod(labels.shape[:3]) else labels
    )
    if labels.ndim != 3:
        raise InputError(f"has {labels.ndim} dimensions ({labels.shape}); a label image has three")
    if not np.issubdtype(labels.dtype, np.integer) and not (labels == np.round(labels)).all():
        raise InputError("holds values that are no whole numbers: it is no image of labels; segment it first")
    if not (image.header["qform_code"] or image.header["sform_code"]):
        raise InputError(
            "states no frame (qform_code and sform_code are 0), so that nobody knows where its voxels are; set its affine, as "
            "3D Slicer and FSL's fslorient do"
        )
    affine = np.asarray(image.affine, dtype=float)
    if not np.isfinite(affine).all() or not abs(np.linalg.det(affine[:3, :3])) > 0:
        raise InputError("has an affine that is not finite, or flat; set its sform once more")
    return labels, affine


def _declared_part(source: Path) -> Any:
    """The image of a file of which only as much is unpacked as its header declares."""
    import nibabel

    with gzip.open(source) if source.suffix.lower() == ".gz" else source.open("rb") as stream:
        head = stream.read(nibabel.Nifti2Header.template_dtype.itemsize)
        kind = nibabel.Nifti2Image if head[:4] in _NIFTI2 else nibabel.Nifti1Image
        header = kind.header_class(head[: kind.header_class.template_dtype.itemsize])
        voxels = math.prod(map(int, header["dim"][1 : 1 + int(header["dim"][0])])) * header.get_data_dtype().itemsize
        end = float(header["vox_offset"]) + voxels
        refuse_large(end, "its header declares", "crop it to the body", _LARGEST)
        return kind.from_bytes(head + stream.read(max(0, int(end) - len(head))))


def _surrounded(labels: NDArray[Any], box: tuple[slice, ...]) -> NDArray[Any]:
    """The labels in a box and around it; beyond the image they are 0."""
    wide = [slice(max(0, cut.start - _AROUND), cut.stop + _AROUND) for cut in box]
    found = labels[tuple(wide)]
    before = [_AROUND - (cut.start - w.start) for cut, w in zip(box, wide, strict=True)]
    full = [cut.stop - cut.start + 2 * _AROUND for cut in box]
    return np.pad(found, [(b, f - b - n) for b, f, n in zip(before, full, found.shape, strict=True)])


def _one_piece(mask: Mask) -> tuple[Mask, list[str]]:
    """The label without specks, and what was left out or filled."""
    notes = []
    number, count = ndimage.label(mask)
    sizes = np.bincount(number.ravel())[1:]
    largest = int(sizes.argmax())
    others = np.delete(sizes, largest)
    if (others > _SPECK * sizes[largest]).any():
        shown = ", ".join(map(str, np.sort(sizes)[::-1][:8]))
        raise InputError(
            f"the label has {count} pieces (of {shown} voxels): a scene has one body; keep one, or give the others labels of "
            "their own (3D Slicer: Islands)"
        )
    if count > 1:
        notes.append(f"{count - 1} speck(s) of the label, together {int(others.sum())} voxels, were left out")
    mask = number == largest + 1
    holes, count = ndimage.label(~mask)
    sizes = np.bincount(holes.ravel())[1:]
    small = np.flatnonzero(sizes <= _SPECK * mask.sum()) + 1
    if len(small):
        notes.append(f"{len(small)} cavity or cavities of together {int(sizes[small - 1].sum())} voxels were filled")
        mask = mask | np.isin(holes, small)
    return mask, notes


def _contour(mask: Mask) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Points (n, 3), in voxels, and triangles (k, 3) of the level of the blurred mask that encloses as much as its voxels do."""
    blurred = ndimage.gaussian_filter(mask.astype(np.float64), _BLUR)
    wanted = int(mask.sum())
    # Levels that more and fewer voxels lie above: the one that is looked for is between.
    counts = np.clip([round(1.1 * wanted), round(0.9 * wanted)], 1, blurred.size - 1)
    low, high = -np.partition(-blurred.ravel(), counts)[counts]

    def excess(level: float) -> float:
        points, triangles = _at_level(blurred, level)
        a, b, c = (points[triangles[:, i]] for i in range(3))
        return abs(float(np.einsum("ij,ij->", a, np.cross(b, c)))) / 6 - wanted

    if excess(low) > 0 > excess(high):
        return _at_level(blurred, float(brentq(excess, low, high, rtol=1e-5, xtol=1e-5)))
    return _at_level(blurred, (low + high) / 2)


def _at_level(blurred: NDArray[np.float64], level: float) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    from vtkmodules.util.numpy_support import numpy_to_vtk, vtk_to_numpy
    from vtkmodules.vtkCommonDataModel import vtkImageData
    from vtkmodules.vtkFiltersCore import vtkFlyingEdges3D

    image = vtkImageData()
    image.SetDimensions(*blurred.shape)
    image.GetPointData().SetScalars(numpy_to_vtk(blurred.ravel(order="F"), deep=True))
    contour = vtkFlyingEdges3D()
    contour.SetInputData(image)
    contour.SetValue(0, level)
    contour.ComputeNormalsOff()
    contour.Update()
    found = contour.GetOutput()
    points = vtk_to_numpy(found.GetPoints().GetData()).astype(float)
    return points, vtk_to_numpy(found.GetPolys().GetConnectivityArray()).astype(np.int64).reshape(-1, 3)


def _touched(around: NDArray[Any], mask: Mask, middles: NDArray[np.float64]) -> NDArray[Any]:
    """The label on the outer side of each triangle: that of the voxel nearest to its middle that is not the body's."""
    nearest = ndimage.distance_transform_edt(mask, return_distances=False, return_indices=True)
    voxel = tuple(np.clip(np.round(middles).astype(int), 0, np.array(mask.shape) - 1).T)
    return around[tuple(nearest[i][voxel] for i in range(3))]
