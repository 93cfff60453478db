"""What the turnable view of a body is drawn from: its surface, places, markers and frames, packed for the page."""

from __future__ import annotations

import base64
from typing import Any

import numpy as np
import xarray as xr
from matplotlib import colormaps
from matplotlib.colors import to_hex
from numpy.typing import NDArray

from bcid.base.units import percent
from bcid.report.diagnosis_picture import LONGEST, diagonal, worst_frame
from bcid.report.figure import completed, round_length
from bcid.report.found import Found
from bcid.report.identification_picture import telling_frame
from bcid.report.residual import residuals_of

Array = NDArray[np.float64]

# Bytes that the displacements of one body may take in a page, before base64; further frames are interpolated.
_BUDGET = 900_000
# A surface with more nodes is shown as a picture only.
_NODES = 40_000
# Edges where the surface turns by more than this are drawn, degrees.
_SHARP = 60.0
_SCALES = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)


def view_data(found: Found) -> dict[str, Any] | None:
    """The view's data, lengths in mm, arrays in base64; None where a run has no body, or one too fine for a page.

    Raises:
        ValueError, KeyError: `body.nc` or the positions are damaged.
    """
    if found.body is None or found.positions is None or not (found.diagnosis or found.identification):
        return None
    residual = residuals_of(found)
    body, positions = found.body, found.positions
    triangles = body["triangles"].values[:, :3].astype(int)
    nodes, corners = np.unique(triangles, return_inverse=True)
    if len(nodes) > _NODES:
        return None
    corners = corners.reshape(triangles.shape)
    points = body["points"].values[nodes] * 1e3
    if body.sizes["frame"] != len(residual.actions) or not np.isfinite(points).all():
        raise ValueError("body.nc and the positions do not belong together")
    place, places = body["place"].values.astype(int), _places(found, body)
    # Patches have an outline of their own, all that is no patch shares one.
    outlined = np.array([i if entry["kind"] == "patch" else 0 for i, entry in enumerate(places)])
    measured = completed(positions["measured"].values, positions["predicted"].values) * 1e3
    start, scale = _shown_first(found, next(iter(residual.models.values())), body, positions)
    return {
        "up": [float(v) for v in str(body.attrs.get("up", "0 1 0")).split()][:3],
        "points": _packed(points, "<f4"),
        "triangles": _packed(corners, "<u4"),
        "place": _packed(place, "<u2"),
        "edges": _packed(_edges(points, corners, outlined[place]), "<u4"),
        "places": places,
        "shades": [shade(i / 15) for i in range(16)],
        "energy": _energy(body, nodes, residual.actions),
        "displacement": _displacement(body["displacement"].values[:, nodes] * 1e3, residual.actions),
        "actions": residual.actions.tolist(),
        "steps": residual.steps.tolist(),
        "grasps": [str(name) for name in positions["grasp"].values],
        "fiducials": residual.fiducials,
        "measured": _packed(measured, "<f4"),
        "models": [{"name": n, "predicted": _packed(measured - v, "<f4")} for n, v in residual.models.items()],
        "start": start,
        "scale": scale,
        "scales": sorted({*_SCALES, scale}),
    }


def _shown_first(found: Found, missed: Array, body: xr.Dataset, positions: xr.Dataset) -> tuple[int, float]:
    """The frame that tells most, and how much longer than they are arrows (mm) are drawn in it."""
    frame = worst_frame(missed) if found.diagnosis else telling_frame(positions)
    longest = np.max(np.linalg.norm(missed[frame], axis=1), initial=0.0, where=np.isfinite(missed[frame]).all(axis=1))
    return frame, max(1.0, round_length(LONGEST * diagonal(body) / longest if longest > 0 else 1.0))


def _packed(values: NDArray[Any], kind: str) -> str:
    return base64.b64encode(np.ascontiguousarray(values, dtype=kind).tobytes()).decode("ascii")


def _places(found: Found, body: xr.Dataset) -> list[dict[str, Any]]:
    """Of each number in `place`: what it is called, what it is, and what is believed of it."""
    anchored = found.anchored
    probabilities = found.identification.patches if found.identification else {}
    made = []
    for full in (str(name) for name in body["place_name"].values):
        kind, _, name = full.partition(" ")
        entry: dict[str, Any] = {"kind": kind if kind in ("patch", "grasp", "held", "driven") else "", "name": name}
        if kind == "patch":
            entry["anchored"] = name in anchored
            probability = probabilities.get(name)
            if probability is not None:
                entry |= {"chance": percent(probability), "shade": shade(float(probability))}
        made.append(entry)
    return made


def shade(share: float) -> str:
    """Colour of a number from 0 to 1 (cividis), as "#00224e"."""
    return to_hex(colormaps["cividis"](min(max(share, 0.0), 1.0)))


def _edges(points: Array, triangles: NDArray[np.int64], place: NDArray[np.int64]) -> NDArray[np.int64]:
    """Node pairs of edges where the surface turns sharply, or where another place begins; shape (edges, 2)."""
    corner = points[triangles]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    sides = np.sort(np.vstack([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]), axis=1)
    owner = np.tile(np.arange(len(triangles)), 3)
    pairs, number, count = np.unique(sides, axis=0, return_inverse=True, return_counts=True)
    order = np.argsort(number.ravel(), kind="stable")
    begin = np.concatenate([[0], np.cumsum(count)[:-1]])
    one, other = owner[order[begin]], owner[order[begin + count - 1]]
    # Orientation may differ from triangle to triangle: a fold by nearly half a turn counts as flat.
    flat = np.abs(np.sum(normal[one] * normal[other], axis=1)) > np.cos(np.radians(_SHARP))
    return np.asarray(pairs[(count != 2) | ~flat | (place[one] != place[other])])


def _kept(frames: int, nodes: int, actions: NDArray[np.str_]) -> NDArray[Any]:
    """The frames that fit into a page, ends of actions among them."""
    most = max(2, _BUDGET // (nodes * 6))
    if frames <= most:
        return np.arange(frames)
    ends = np.flatnonzero(np.r_[True, actions[1:] != actions[:-1]] | np.r_[actions[1:] != actions[:-1], True])
    return np.unique(np.r_[ends, np.linspace(0, frames - 1, most).round().astype(int)])


def _energy(body: xr.Dataset, nodes: NDArray[np.int64], actions: NDArray[np.str_]) -> dict[str, Any] | None:
    """Strain energy density, J/m^3, of the frames that are kept, in 255 parts of what 99 % stay below; None if it is not known."""
    if "energy" not in body:
        return None
    values = np.nan_to_num(body["energy"].values[:, nodes])
    most = float(np.quantile(values[values > 0], 0.99)) if (values > 0).any() else 1.0
    parts = np.clip(np.round(values[_kept(len(values), len(nodes), actions)] / most * 255), 0, 255)
    return {"most": most, "numbers": _packed(parts, "u1")}


def _displacement(values: Array, actions: NDArray[np.str_]) -> dict[str, Any]:
    """Displacements (frames, nodes, 3) as 16-bit numbers of the frames that are kept."""
    kept = _kept(len(values), values.shape[1], actions)
    low, high = values.min(axis=(0, 1)), values.max(axis=(0, 1))
    step = np.maximum((high - low) / 65535, 1e-12)
    numbers = np.clip(np.round((np.nan_to_num(values[kept]) - low) / step), 0, 65535)
    return {"frames": kept.tolist(), "low": low.tolist(), "step": step.tolist(), "numbers": _packed(numbers, "<u2")}
