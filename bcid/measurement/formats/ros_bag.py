"""ROS 1 bags, ROS 2 bags (sqlite3) and MCAP, read by rosbags: ``python -m bcid.measurement.formats.ros_bag FILE OUT.npz``.

Read are tf2_msgs/TFMessage, and of geometry_msgs PoseStamped, TransformStamped, PointStamped, PoseArray and WrenchStamped, and of
visualization_msgs Marker and MarkerArray. Poses are taken as they are written: no chain of tf is followed. ROS is in m, s and N.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bcid.base.confined import serve
from bcid.base.errors import InputError
from bcid.measurement.formats.foreign import Foreign, How, fetched, needed, whole

Array = NDArray[np.float64]
# Label, kind ("point", "pose", "wrench") and numbers of what a message holds.
_Said = Iterator[tuple[str, str, list[float]]]

BODY = "metadata.yaml"
_DELETED = (2, 3)


def read(path: Path, how: How) -> Foreign:
    """Markers, poses and wrenches of a bag, at the times of the marker `how.clock`, or of the one that is seen most often.

    What else was recorded is taken from the message nearest in time, within half of the interval of its topic or of the clock's.
    """
    folder = path.is_dir()
    module = "bcid.measurement.formats.ros_bag"
    data = fetched(module, path / BODY if folder else path, "ROS bag", in_place=folder)
    topics, labels, kinds = ([str(one) for one in data[key]] for key in ("topics", "labels", "kinds"))
    streams = [(data[f"t{i}"], data[f"v{i}"]) for i in range(len(labels))]
    seen = {label: i for i, label in enumerate(labels) if kinds[i] != "wrench"}
    if not seen:
        told = ", ".join(topics) or "nothing"
        raise InputError(f"{path}: holds no marker, pose or tf of a type that is read, but {told}; see docs/formats.md")
    # Markers before poses: a robot tells its own more often than any camera sees one.
    most = max(seen, key=lambda label: (kinds[seen[label]] == "point", len(streams[seen[label]][0])))
    clock = streams[seen.get(how.clock, seen[most])][0]
    at = {label: _sampled(*streams[i], clock) for label, i in seen.items()}
    points = {label: whole(values[:, :3]) for label, values in at.items()}
    bodies = {label: values for label, values in at.items() if kinds[seen[label]] == "pose"}
    wrenches = {label: _sampled(*streams[i], clock) for i, label in enumerate(labels) if kinds[i] == "wrench"}
    notes = tuple(f"not read: {topic}" for topic in data["unread"])
    return Foreign("ROS bag", clock - clock[0], points, bodies, wrenches, unit="m", notes=notes)


def _sampled(times: Array, values: Array, clock: Array) -> Array:
    """Values at the times of the clock, shape (frames, columns); NaN where no message is near."""
    nearest = np.searchsorted((times[1:] + times[:-1]) / 2, clock)
    reach = max(_interval(times), _interval(clock)) / 2 + 1e-9
    near = np.abs(times[nearest] - clock) <= reach
    return np.where(near[:, None], values[nearest], np.nan)


def _interval(times: Array) -> float:
    return float(np.median(np.diff(times))) if len(times) > 1 else 0.0


# -- in the child


def _streams(source: Path, _arguments: Sequence[str]) -> dict[str, Any]:
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise needed("rosbags") from None
    streams: dict[tuple[str, str], list[tuple[float, list[float]]]] = {}
    bag = source.parent if source.name == BODY else source
    with AnyReader([bag], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
        topics = {f"{c.topic} ({_short(c.msgtype)})": c for c in reader.connections}
        known = [c for c in reader.connections if _short(c.msgtype) in _READERS]
        for connection, stamp, raw in reader.messages(connections=known) if known else ():
            message = reader.deserialize(raw, connection.msgtype)
            for label, kind, numbers in _READERS[_short(connection.msgtype)](connection.topic, message):
                streams.setdefault((label, kind), []).append((_time(message, stamp), numbers))
    return _made(streams, topics)


def _made(streams: dict[tuple[str, str], list[tuple[float, list[float]]]], topics: dict[str, Any]) -> dict[str, Any]:
    unread = [topic for topic, connection in topics.items() if _short(connection.msgtype) not in _READERS]
    made: dict[str, Any] = {"topics": np.array(list(topics), dtype=str), "unread": np.array(unread, dtype=str)}
    made["labels"] = np.array([label for label, _ in streams], dtype=str)
    made["kinds"] = np.array([kind for _, kind in streams], dtype=str)
    for i, rows in enumerate(streams.values()):
        rows.sort(key=lambda row: row[0])
        made[f"t{i}"] = np.array([time for time, _ in rows])
        made[f"v{i}"] = np.array([numbers for _, numbers in rows], dtype=float)
    return made


def _short(message_type: str) -> str:
    """geometry_msgs/PoseStamped of ROS 1 and geometry_msgs/msg/PoseStamped of ROS 2 are the same."""
    return message_type.replace("/msg/", "/")


def _time(message: Any, stamp: int) -> float:
    """When it was measured, s: by its header, else when it was recorded."""
    first = next(iter(getattr(message, "transforms", ())), None) or next(iter(getattr(message, "markers", ())), None)
    header = getattr(message, "header", None) or getattr(first, "header", None)
    measured = header.stamp.sec + 1e-9 * header.stamp.nanosec if header is not None else 0.0
    return float(measured) or stamp * 1e-9


def _xyz(vector: Any) -> list[float]:
    return [vector.x, vector.y, vector.z]


def _pose(position: Any, turn: Any) -> list[float]:
    return [*_xyz(position), turn.w, turn.x, turn.y, turn.z]


def _transform(one: Any) -> tuple[str, str, list[float]]:
    return one.child_frame_id, "pose", _pose(one.transform.translation, one.transform.rotation)


def _marker(topic: str, one: Any) -> _Said:
    """A marker, or the points that one holds."""
    label = "/".join(part for part in (topic, one.ns, str(one.id)) if part)
    if one.action in _DELETED:
        return
    if len(one.points):
        for i, point in enumerate(one.points):
            yield f"{label}/{i}", "point", _xyz(point)
    else:
        yield label, "point", _xyz(one.pose.position)


_READERS: dict[str, Callable[[str, Any], _Said]] = {
    "tf2_msgs/TFMessage": lambda _, m: map(_transform, m.transforms),
    "tf/tfMessage": lambda _, m: map(_transform, m.transforms),
    "geometry_msgs/TransformStamped": lambda _, m: iter([_transform(m)]),
    "geometry_msgs/PoseStamped": lambda topic, m: iter([(topic, "pose", _pose(m.pose.position, m.pose.orientation))]),
    "geometry_msgs/PointStamped": lambda topic, m: iter([(topic, "point", _xyz(m.point))]),
    "geometry_msgs/PoseArray": lambda topic, m: (
        (f"{topic}/{i}", "pose", _pose(p.position, p.orientation)) for i, p in enumerate(m.poses)
    ),
    "geometry_msgs/WrenchStamped": lambda topic, m: iter(
        [(topic, "wrench", [*_xyz(m.wrench.force), *_xyz(m.wrench.torque)])]
    ),
    "visualization_msgs/Marker": _marker,
    "visualization_msgs/MarkerArray": lambda topic, m: (said for one in m.markers for said in _marker(topic, one)),
}


if __name__ == "__main__":
    sys.exit(serve(_streams, ["rosbags.highlevel"]))
