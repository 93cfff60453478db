"""Foreign recordings, read through a mapping file into what a measurement holds."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bcid.base.errors import InputError, Problems, nearest
from bcid.measurement.alignment import align
from bcid.measurement.c3d import read_points
from bcid.measurement.contents import AXES, Contents
from bcid.measurement.folder import frames_dataset
from bcid.measurement.mapped_table import read_table
from bcid.measurement.mapping import Mapping, read_mapping
from bcid.measurement.tracks import Tracks, select

Array = NDArray[np.float64]

# Coordinates above this, in length_unit, are taken for it, so that they can be turned.
_FAR = 1e100


def read_mapped(path: Path) -> Contents:
    """Measurement from a mapping file and the recording it names.

    Raises:
        InputError: with every problem of the mapping, or of the recording.
    """
    mapping = read_mapping(path)
    recording = _read_c3d(mapping) if mapping.file.suffix.lower() == ".c3d" else read_table(mapping)
    select(recording, mapping.frames, mapping.file)
    if not recording.actions:
        raise InputError(f"{path}: frames: no frame of {mapping.file.name} is left; check first, last and every")
    _to_body_frame(recording, mapping)
    return _contents(recording, mapping)


def _read_c3d(mapping: Mapping) -> Tracks:
    points = read_points(mapping.file)
    problems = Problems(f"recording {mapping.file}")
    if points.unit not in ("", mapping.units.length):
        problems.add(
            mapping.path, f"length_unit is '{mapping.units.length}', but {mapping.file.name} states '{points.unit}'"
        )
    positions = {}
    for name, label in mapping.markers.items():
        if label not in points.labels:
            problems.add(mapping.file, f"has no point '{label}' (fiducial {name}); {nearest(label, points.labels)}")
            continue
        if points.labels.index(label) >= points.positions.shape[1]:
            problems.add(mapping.file, f"holds no data for point '{label}' (fiducial {name})")
            continue
        xyz = points.positions[:, points.labels.index(label)].T
        positions[name] = np.where(np.isfinite(xyz).all(axis=1, keepdims=True), xyz, np.nan)
    problems.raise_if_any()
    count = points.positions.shape[2]
    action = str(mapping.table.get("action", "1"))
    times = [i / points.rate / mapping.time for i in range(count)]
    return Tracks([action] * count, list(range(count)), times, positions)


def _to_body_frame(recording: Tracks, mapping: Mapping) -> None:
    """Rigid motion that takes the markers of `align`, in the first frame, to where they are said to be."""
    if not mapping.align:
        return
    names = [name for name in mapping.align if name in recording.positions]
    here = np.array([recording.positions[name][0] for name in names]).reshape(-1, 3)
    there = np.array([mapping.align[name] for name in names]).reshape(-1, 3)
    if len(names) < 3 or not np.isfinite(here).all():
        raise InputError(f"{mapping.path}: align: its markers must all be seen in the first frame")
    try:
        fit = align(here, there, names)
    except InputError as error:
        raise InputError(f"{mapping.path}: align: {error}") from None
    recording.remarks += fit.remarks
    recording.aligned = fit.rms * mapping.length
    for name, values in recording.positions.items():
        recording.positions[name] = np.clip(values, -_FAR, _FAR) @ fit.turn.T + fit.shift


def _contents(recording: Tracks, mapping: Mapping) -> Contents:
    names = mapping.fiducials
    frames = list(zip(recording.actions, recording.steps, strict=True))
    starts = {action: time for (action, step), time in zip(frames, recording.times, strict=True) if step == 0}
    times = [(time - starts[a]) * mapping.time for (a, _), time in zip(frames, recording.times, strict=True)]
    positions = np.stack([recording.positions[name] for name in names], axis=1) * mapping.length
    if not np.isfinite(positions).any():
        raise InputError(f"{mapping.file}: no fiducial was seen in any of the chosen frames")
    data = frames_dataset(frames, times, names, positions)
    grasp = str(mapping.table.get("grasp", ""))
    if recording.grasps or grasp:
        data["grasp"] = ("frame", recording.grasps or [grasp] * len(frames))
    if recording.translation is not None:
        data["translation"] = (("frame", "axis"), recording.translation * mapping.length)
    if recording.rotation is not None:
        norms = np.linalg.norm(recording.rotation, axis=1, keepdims=True)
        if (abs(norms - 1) > 1e-3).any():
            raise InputError(f"{mapping.file}: columns.rotation: expected unit quaternions (w, x, y, z)")
        data["rotation"] = (("frame", "quaternion"), recording.rotation / norms)
    sigma = mapping.table.get("noise_sigma")
    description = str(mapping.table.get("description", ""))
    noise = None if sigma is None else sigma * mapping.length
    known = Contents(data.assign_coords(axis=AXES), noise, None, mapping.units, description, str(mapping.path))
    return replace(known, remarks=tuple(recording.remarks), aligned=recording.aligned)
