"""What the figures share: how they are saved, cropped and framed, and what their legends say of the body."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from numpy.typing import NDArray

from bcid.base.run_folder import write_whole

Array = NDArray[np.float64]
Image = NDArray[np.uint8]
# Inches of a small chart.
_WIDTH = 4.6
# White that stays around what is drawn, pixels.
_MARGIN = 12
# Names on an axis are cut to so many letters.
_LETTERS = 22
# So many names fit below a small chart.
_NAMES = 24
# Of actions along an axis of frames.
_BEGINS = 10
# Colours of two series; the light one is hatched or dashed besides.
DARK, LIGHT, GREY = "#0072b2", "#9ccbe8", "#444444"
_STYLE: dict[Any, Any] = {
    # Names may hold dollar signs, which are no formulas.
    "text.parse_math": False,
    "font.size": 10,
    "axes.edgecolor": "#8a9099",
    "axes.labelcolor": "#333333",
    "xtick.color": "#333333",
    "ytick.color": "#333333",
    "xtick.labelsize": 10,
    "ytick.labelsize": 10,
    "axes.linewidth": 0.8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "hatch.linewidth": 0.9,
    "legend.fontsize": 10,
    "legend.frameon": False,
    "pdf.fonttype": 42,
}


@dataclass(frozen=True)
class Palette:
    """Colours that stay apart in print and for colour-blind readers (Okabe & Ito)."""

    tissue: str = "#f3d9cd"
    anchored: str = "#0072b2"
    free: str = "#b9bec6"
    grasp: str = "#e69f00"
    held: str = "#4d5661"
    driven: str = "#7b5ea7"
    region: str = "#b98b7d"
    measured: str = "#222222"
    predicted: str = "#d55e00"
    named: str = "#565c64"
    outline: str = "#9aa0a6"
    edge: str = "#6b5a52"


COLOURS = Palette()
# Of kinds of places that have one colour.
PLACES = {kind: getattr(COLOURS, kind) for kind in ("grasp", "held", "driven", "region")}
# Of what is drawn as a field.
MAP = "cividis"


def round_length(most: float) -> float:
    """The largest of 1, 2, 5, 10, ... times a power of ten that is not larger; 1 where there is none."""
    if not (np.isfinite(most) and most > 0):
        return 1.0
    power = 10.0 ** np.floor(np.log10(most))
    return float(power * max(step for step in (1, 2, 5) if step * power <= most * (1 + 1e-9)))


def completed(measured: Array, predicted: Array) -> Array:
    """Measured positions (..., 3); coordinates that were not measured beside others of a point are as predicted, for pictures."""
    seen = np.isfinite(measured)
    return np.where(~seen & seen.any(axis=-1, keepdims=True), predicted, measured)


def save(figure: Figure, target: Path) -> Path:
    """Write a figure as PNG, whole; returns `target`.

    Raises:
        MachineError: it cannot be written.
    """
    return write_whole(target, encoded(figure, "png"))


def encoded(figure: Figure, kind: str, dpi: int = 150, letters: str = "path") -> bytes:
    """A figure as "png", "svg" (with `letters` as outlines, or "none": as text) or "pdf": the same bytes for the same figure."""
    unsaid = {"png": ["Software"], "svg": ["Date", "Creator"], "pdf": ["Creator", "Producer", "CreationDate"]}[kind]
    stream = BytesIO()
    with mpl.rc_context({"svg.fonttype": letters, "svg.hashsalt": "bcid"}):
        figure.savefig(stream, format=kind, dpi=dpi, metadata=dict.fromkeys(unsaid))
    return stream.getvalue()


@contextmanager
def styled() -> Iterator[None]:
    """The style in which figures are drawn and saved."""
    with mpl.rc_context(_STYLE):
        yield


def chart(draw: Callable[[Axes], None], height: float = 3.2, columns: int = 4) -> Figure:
    """A small figure of one chart, `height` in inches, with its legend below: two fit side by side in a report, one on a phone."""
    figure = Figure(figsize=(_WIDTH, height), facecolor="white", layout="constrained")
    axes = figure.add_subplot()
    draw(axes)
    _legend_below(figure, axes, columns)
    return figure


def _legend_below(figure: Figure, axes: Axes, columns: int) -> None:
    """Say below a small figure what its marks are, in as many columns as there is room for."""
    handles, labels = axes.get_legend_handles_labels()
    style: dict[str, Any] = {"loc": "outside lower center", "columnspacing": 1.4, "handlelength": 1.8}
    for count in range(columns if handles else 0, 0, -1):
        legend = figure.legend(handles, labels, ncols=count, **style)
        if count == 1 or legend.get_window_extent().width < figure.bbox.width:
            break
        legend.remove()


def short(name: object) -> str:
    """A name as it fits on an axis."""
    text = str(name)
    return text if len(text) <= _LETTERS else f"{text[: _LETTERS - 1]}…"


def head(figure: Figure, title: str, text: str) -> None:
    """Title and a sentence, at the top of a picture; in smaller letters where they are longer than it is wide."""
    inches, margin = figure.get_figwidth(), 0.28
    large, small = (19, 12.5) if inches > 10 else (16, 11)
    room = (inches - 2 * margin) * figure.dpi
    lines = [figure.text(margin / inches, 0.935, title, fontsize=large, weight="bold")]
    lines.append(figure.text(margin / inches, 0.885, text, fontsize=small, color=GREY))
    for line in lines:
        line.set_fontsize(float(line.get_fontsize()) * room / max(room, line.get_window_extent().width))


def name_ticks(axes: Axes, names: Sequence[object]) -> None:
    """Names below an axis: all of them, upright if they are crowded, or every so many."""
    step = max(1, -(-len(names) // _NAMES))
    shown = [short(name) for name in names[::step]]
    crowded = sum(len(name) + 1 for name in shown) > 44
    axes.set_xticks(range(0, len(names), step), shown, rotation=90 if crowded else 0)


def name_frames(axes: Axes, actions: NDArray[np.str_], **line: Any) -> None:
    """Names of actions below an axis of frames, where they begin, with lines between them."""
    names = list(dict.fromkeys(actions.tolist()))
    begins = [int(np.flatnonzero(actions == name)[0]) for name in names]
    for begin in begins[1:]:
        axes.axvline(begin - 0.5, **line)
    few = max(1, -(-len(begins) // _BEGINS))
    axes.set_xticks(begins[::few], [short(name) for name in names[::few]], ha="left")
    axes.set_xlabel("frames of action")


def cropped(images: list[Image]) -> list[Image]:
    """Images (height, width, 3) of one size without the white border that all of them have."""
    ink = np.any([np.any(image < 250, axis=2) for image in images], axis=0)
    rows, columns = np.flatnonzero(ink.any(axis=1)), np.flatnonzero(ink.any(axis=0))
    if len(rows) == 0:
        return images
    top, left = max(rows[0] - _MARGIN, 0), max(columns[0] - _MARGIN, 0)
    return [image[top : rows[-1] + _MARGIN, left : columns[-1] + _MARGIN] for image in images]


def body_entries(grasp: str, body: xr.Dataset) -> list[Patch]:
    """Legend entries of what a body (`body.nc`) has of patches and what is known to be held, and of the grasp if one is named."""
    kinds = {str(name).partition(" ")[0] for name in body["place_name"].values}
    entries = [("patch", COLOURS.anchored, "anchored patch"), ("patch", COLOURS.free, "free candidate patch")]
    entries += [("grasp", COLOURS.grasp, f"grasp {grasp}")] if grasp else []
    entries += [("held", COLOURS.held, "known to be held"), ("driven", COLOURS.driven, "driven by measured points")]
    entries.append(("region", COLOURS.region, "region of the body"))
    return [Patch(color=colour, label=text) for kind, colour, text in entries if kind in kinds]
