"""What the arrays of a body must be before a library draws them: an index out of range ends the process, not the command."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from bcid.base.errors import InputError

if TYPE_CHECKING:
    from pathlib import Path

    import xarray as xr

# Largest coordinate, m, and largest of all other numbers, in any unit.
_FURTHEST, _LARGEST = 1e6, 1e30
# Arrays of indices: how many each row has, and the dimension that they number.
_INDICES = {"triangles": (3, "node"), "cells": (4, "node"), "place": (None, "place_number")}


def refuse_unsound(data: xr.Dataset, path: Path) -> None:
    """Refuse arrays that no run writes.

    Args:
        data: what a NetCDF file of a run holds; that of a body has `points`, shape (nodes, 3), in m.
        path: the file, for the message.

    Raises:
        InputError: a number is infinite or absurd, or the body has shapes, indices or points that cannot be.
    """
    for name in data.variables:
        values = data[name].values
        if values.dtype.kind == "f" and bool((np.abs(values) > _LARGEST).any()):
            raise InputError(f"{path}: is damaged: {name} holds numbers beyond {_LARGEST:g}; repeat the run")
    trouble = _trouble(data) if {"points", "triangles"} & {str(name) for name in data.variables} else ""
    if trouble:
        raise InputError(f"{path}: is damaged: {trouble}; repeat the run")


def _trouble(body: xr.Dataset) -> str:
    """What is wrong with the arrays of a body; "" where nothing is."""
    missing = {"points", "triangles", "place", "place_name"} - {str(name) for name in body.variables}
    if missing:
        return f"{', '.join(sorted(missing))} missing"
    points = body["points"].values
    if points.ndim != 2 or points.shape[1] != 3:
        return f"points have shape {points.shape}; expected (nodes, 3)"
    for name in ("points", "displacement"):
        if name in body and not (np.abs(body[name].values) <= _FURTHEST).all():
            return f"{name} holds numbers that are not finite or beyond {_FURTHEST:g} m"
    if "displacement" in body and body["displacement"].shape[1:] != points.shape:
        return f"displacement has shape {body['displacement'].shape}; expected (frames, {len(points)}, 3)"
    if body["place"].shape != body["triangles"].shape[:1]:
        return f"place has shape {body['place'].shape}; expected one number for each triangle"
    sizes = {"node": len(points), "place_number": body["place_name"].size}
    for name, (width, numbered) in _INDICES.items():
        if name in body:
            trouble = _index_trouble(name, body[name].values, width, sizes[numbered])
            if trouble:
                return trouble
    return ""


def _index_trouble(name: str, indices: np.ndarray, width: int | None, size: int) -> str:
    if indices.dtype.kind not in "iu" or indices.ndim != (1 if width is None else 2):
        return f"{name} is no array of whole numbers"
    if width is not None and indices.shape[1] != width:
        return f"{name} has rows of {indices.shape[1]}; expected {width}"
    if indices.size and not 0 <= indices.min() <= indices.max() < size:
        return f"{name} holds {indices.min()} to {indices.max()}; expected 0 to {size - 1}"
    return ""
