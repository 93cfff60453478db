"""Recordings that name their markers: motion capture, pose estimation, image correlation, robots, arrays."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bcid.base.errors import InputError, Problems, nearest
from bcid.measurement.formats.foreign import Foreign, How
from bcid.measurement.mapped_table import Tracks
from bcid.measurement.mapping import BOUNDS, Mapping

Array = NDArray[np.float64]
# Of the largest displacement (RMS), that of a frame in which the body is not at rest.
_AT_REST = 0.2
# What files call the unit of their pixels; nothing where they state none.
_PIXELS = ("", "px", "pixel", "pixels")


def read_points_of(mapping: Mapping) -> Tracks:
    """The tracks of the markers that a mapping chooses, in the file's units.

    Raises:
        InputError: the file is damaged, states another unit, or lacks what the mapping names.
    """
    seen = read_foreign(mapping)
    problems = Problems(f"recording {mapping.file}")
    if mapping.pixel is not None:
        if seen.unit not in _PIXELS:
            problems.add(
                mapping.path, f"pixels: {mapping.file.name} states '{seen.unit}', not pixels; leave [pixels] out"
            )
    elif seen.unit in _PIXELS[1:]:
        problems.add(mapping.path, f"{mapping.file.name} states pixels; say how long one is, by [pixels] with length")
    elif seen.unit not in ("", mapping.units.length):
        problems.add(
            mapping.path, f"length_unit is '{mapping.units.length}', but {mapping.file.name} states '{seen.unit}'"
        )
    if not mapping.fiducials:
        _all(mapping, seen)
    positions = {}
    for name, label in mapping.markers.items():
        if label in seen.points:
            positions[name] = _trusted(seen, label, mapping.table["points"])
        elif label in seen.empty:
            problems.add(mapping.file, f"holds no data for point '{label}' (fiducial {name})")
        else:
            problems.add(mapping.file, f"has no point '{label}' (fiducial {name}); {nearest(label, seen.points)}")
    problems.add_unknown(mapping.path, mapping.align, mapping.markers, "align.{}: is no marker; {}".format)
    pose = _named(mapping, "pose", seen.bodies, problems)
    wrench = _named(mapping, "wrench", seen.wrenches, problems)
    problems.raise_if_any()
    action = str(mapping.table.get("action", "1"))
    times = [float(time) / mapping.time for time in seen.times]
    tracks = Tracks([action] * seen.frames, list(range(seen.frames)), times, positions, pose=pose, wrench=wrench)
    return _from_reference(mapping, seen, tracks) if mapping.from_reference else tracks


def displaced_at_first(seen: Foreign) -> bool:
    """Whether the first frame of a file of displacements shows a body that is no longer where they count from."""
    labels = [label for label in seen.points if label in seen.rest]
    if not labels or not seen.displacements:
        return False
    moved = np.stack([seen.points[label] - seen.rest[label] for label in labels])
    if not np.isfinite(moved[:, 0]).any():
        return False
    sizes = np.sqrt(np.nanmean(moved**2, axis=(0, 2)))
    return bool(sizes[0] > _AT_REST * np.nanmax(sizes))


def _from_reference(mapping: Mapping, seen: Foreign, tracks: Tracks) -> Tracks:
    """The same with the state from which displacements count as the first frame, one interval before the others."""
    lost = [label for label in mapping.markers.values() if not np.isfinite(seen.rest.get(label, np.nan)).all()]
    if lost or not seen.displacements:
        what = f"has no position at rest of point '{lost[0]}'" if lost else "holds no displacements"
        raise InputError(
            f'{mapping.file}: {what}, and frames.rest = "reference" needs it; give the number of the frame in which the body rests'
        )
    if tracks.pose is not None:
        raise InputError(
            f'{mapping.path}: frames.rest = "reference": columns.pose has no pose of that state; give grasps = "grasps.csv" instead'
        )
    before = tracks.times[0] - (tracks.times[1] - tracks.times[0] if len(tracks.times) > 1 else 1.0)
    positions = {
        name: np.vstack([np.where(np.isfinite(at).any(axis=0), seen.rest[mapping.markers[name]], np.nan), at])
        for name, at in tracks.positions.items()
    }
    # Nothing pulls at rest; what the sensor shows then is not known.
    wrench = None if tracks.wrench is None else np.vstack([np.full(6, np.nan), tracks.wrench])
    steps = list(range(len(tracks.steps) + 1))
    return Tracks([tracks.actions[0], *tracks.actions], steps, [before, *tracks.times], positions, wrench=wrench)


def read_foreign(mapping: Mapping) -> Foreign:
    """What the file of a mapping holds, read as the mapping says."""
    table = mapping.table
    clock = next(iter(mapping.markers.values()), "")
    how = How(table["arrays"], mapping.columns, mapping.time, table.get("rate"), clock)
    assert mapping.format.read is not None
    return mapping.format.read(mapping.files, how)


def _all(mapping: Mapping, seen: Foreign) -> None:
    """Make every n-th point a fiducial under its own label."""
    known = set(mapping.markers.values())
    chosen = [label for label in seen.points if label not in known][:: mapping.table["points"].get("every", 1)]
    mapping.fiducials = chosen
    mapping.markers = {label: label for label in chosen} | mapping.markers


def _trusted(seen: Foreign, label: str, bounds: dict[str, Any]) -> Array:
    """Positions of a marker, NaN where what the file says of their quality is beyond the bounds of [points]."""
    positions = seen.points[label]
    for key, (kind, least) in BOUNDS.items():
        if key in bounds and label in seen.quality.get(kind, {}):
            quality = seen.quality[kind][label]
            good = quality >= bounds[key] if least else quality <= bounds[key]
            positions = np.where(good[:, None], positions, np.nan)
    return positions


def _named(mapping: Mapping, key: str, given: dict[str, Array], problems: Problems) -> Array | None:
    """The poses or wrenches of the label in columns.pose or columns.wrench."""
    label = mapping.columns.get(key)
    if label is None or label in given:
        return None if label is None else given[label]
    what = "rigid body" if key == "pose" else "wrench"
    problems.add(mapping.file, f"has no {what} '{label}' (columns.{key}); {nearest(str(label), given)}")
    return None


def with_rest(seen: Foreign) -> Foreign:
    """The same with a rest position of every point that is seen: where the file has none, that of its first frame."""
    first = {label: at[0] for label, at in seen.points.items() if np.isfinite(at[0]).all()}
    return replace(seen, rest=first | seen.rest)
