"""A scene before anything is solved: the body from two sides, patches in colour and named, grasps and fiducials."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray

from bcid.base.run_folder import writing
from bcid.report.figure import COLOURS, PLACES, cropped, save, short, styled
from bcid.report.scene3d import BodyPicture

# Of patches, in turns: those of Okabe & Ito that neither the grasps nor the tissue have, and lighter ones of them.
_PATCHES = [
    "#0072b2",
    "#009e73",
    "#cc79a7",
    "#56b4e9",
    "#f0e442",
    "#d55e00",
    "#7aa6c9",
    "#7fc9b0",
    "#e0b5cf",
    "#8c6d31",
]
# So many entries fit below the picture.
_ENTRIES = 24


def draw_scene(
    target: Path,
    body: xr.Dataset,
    fiducials: Mapping[str, NDArray[np.float64]],
    title: str,
    places: Mapping[str, str],
    lines: Sequence[str],
) -> Path:
    """Write the picture of a scene; returns `target`.

    Args:
        target: the PNG file.
        body: as a run's `body.nc`, at rest.
        fiducials: positions by name, shape (3,), m.
        title: above the picture.
        places: what the legend says of patches and grasps, by their names in `body`.
        lines: small, below the title.

    Raises:
        MachineError: it cannot be written.
    """
    names = [str(name) for name in body["place_name"].values]
    patches = [name for name in names if name.startswith("patch ")]
    colours = {name: _PATCHES[i % len(_PATCHES)] for i, name in enumerate(patches)}
    colours |= {name: PLACES[kind] for name in names if (kind := name.partition(" ")[0]) in PLACES}
    shown = {names[number] for number in np.unique(body["place"].values)}
    hidden = {name for name in places if name not in shown and not name.startswith("region ")}
    known = {name: f"{text} (beneath another)" if name in hidden else text for name, text in places.items()}
    with styled(), writing(target):
        figure = _figure(body, {name: place * 1e3 for name, place in fiducials.items()}, colours)
        figure.text(0.02, 0.955, title, fontsize=17, weight="bold", va="center")
        figure.text(0.02, 0.915, "   ".join(lines), fontsize=11, color="#565c64", va="center")
        _legend(figure, colours, known, len(fiducials))
        return save(figure, target)


def _figure(body: xr.Dataset, marks: Mapping[str, NDArray[np.float64]], colours: Mapping[str, str]) -> Figure:
    """From two sides; places of marks in mm."""
    figure = Figure(figsize=(14, 7.9), facecolor="white")
    for column, (behind, side) in enumerate(((False, "from above"), (True, "from behind and below"))):
        axes = figure.add_axes((0.01 + 0.495 * column, 0.14, 0.485, 0.71))
        scene = BodyPicture(body, None, (1500, 1300), behind)
        scene.add_places(colours)
        scene.add_marks(marks)
        axes.imshow(cropped([scene.image()])[0])
        axes.set_axis_off()
        axes.set_title(side, fontsize=11, color="#565c64")
    return figure


def _legend(figure: Figure, colours: Mapping[str, str], places: Mapping[str, str], fiducials: int) -> None:
    entries = [
        Patch(color=colours[name], label=f"{short(name)}: {text}") for name, text in places.items() if name in colours
    ]
    if len(entries) > _ENTRIES:
        rest = len(entries) - _ENTRIES + 1
        entries = [*entries[: _ENTRIES - 1], Patch(color="white", label=f"and {rest} more")]
    count = f"{fiducials} fiducial{'s' if fiducials != 1 else ''}"
    mark = Line2D([], [], marker="o", color=COLOURS.measured, linestyle="", markersize=6, label=count)
    columns = min(5, len(entries) + 1)
    figure.legend(
        handles=[*entries, mark], loc="lower center", ncols=columns, bbox_to_anchor=(0.5, 0.015), fontsize=10.5
    )
