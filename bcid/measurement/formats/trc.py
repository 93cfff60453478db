"""TRC tables of OpenSim and Motion Analysis: markers over time, separated by tabs, or by commas after a spreadsheet.

Source: OpenSim documentation, "Marker (.trc) Files".
"""

from __future__ import annotations

from pathlib import Path

from bcid.base.errors import InputError
from bcid.measurement.formats.foreign import Export, Foreign, How, length_unit, whole


def read(path: Path, _how: How) -> Foreign:
    """The markers of a TRC file."""
    export = Export.read(path, "\t", "a TRC file")
    if len(export.rows) > 1 and export.rows[1][1][0].startswith("DataRate,"):
        export = Export.read(path, ",", "a TRC file")
    export.need(5)
    rows = export.rows
    about = dict(zip(rows[1][1], rows[2][1], strict=False))
    if not {"NumFrames", "NumMarkers", "Units"} <= set(about):
        raise InputError(f"{path}:2: expected NumFrames, NumMarkers and Units; this is not a whole TRC header")
    labels = [cell for cell in rows[3][1][2:] if cell]
    count, frames = (int(export.number(about[key], key, 3)) for key in ("NumMarkers", "NumFrames"))
    if len(labels) != count:
        raise InputError(f"{path}:4: names {len(labels)} markers, but the header states NumMarkers = {count}")
    export.distinct(labels)
    width = 2 + 3 * count
    values = export.numbers(rows[5:], width)
    if len(values) < frames:
        raise InputError(f"{path}: states {frames} frames and holds {len(values)}: it is cut off; export it again")
    points = {label: whole(values[:, 2 + 3 * i : 5 + 3 * i]) for i, label in enumerate(labels)}
    return Foreign("TRC", values[:, 1], points, unit=length_unit(about["Units"]))
