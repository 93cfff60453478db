"""What the figures share: how they are saved, cropped and framed, and what their legends say of the body."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bcid.base.run_folder import write_whole
from bcid.report.scene3d import COLOURS, Image

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.patches import Patch

# White that stays around what is drawn, pixels.
_MARGIN = 12
# Names on an axis are cut to so many letters.
_LETTERS = 22
# Letters of a line of a small chart's legend.
_LINE = 62
# So many names fit below a small chart.
_NAMES = 24
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
    "hatch.linewidth": 0.9,
    "legend.fontsize": 10,
    "legend.frameon": False,
    "pdf.fonttype": 42,
}


def save(figure: Figure, target: Path) -> Path:
    """Write a figure as PNG, whole; returns `target`.

    Raises:
        MachineError: it cannot be written.
    """
    stream = BytesIO()
    figure.savefig(stream, format="png", dpi=150)
    return write_whole(target, stream.getvalue())


@contextmanager
def styled() -> Iterator[None]:
    """The style in which figures are drawn and saved."""
    import matplotlib as mpl

    with mpl.rc_context(_STYLE):
        yield


def chart(width: float = 4.6, height: float = 3.2) -> tuple[Figure, Axes]:
    """A small figure of one chart, inches: two stand side by side in a report, one fills a phone."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), facecolor="white", layout="constrained")
    axes = figure.add_subplot()
    open_frame(axes)
    return figure, axes


def legend_below(figure: Figure, axes: Axes, columns: int = 4) -> None:
    """Say below a small figure what its marks are, in as many columns as there is room for."""
    handles, labels = axes.get_legend_handles_labels()
    while columns > 1 and _broad(labels, columns) > _LINE:
        columns -= 1
    if handles:
        figure.legend(handles, labels, loc="outside lower center", ncols=columns, columnspacing=1.4, handlelength=1.8)


def _broad(labels: Sequence[str], columns: int) -> int:
    """Letters of a legend's line, its marks counted as some; entries go down the columns."""
    high = -(-len(labels) // columns)
    return sum(max(len(label) for label in labels[at : at + high]) + 7 for at in range(0, len(labels), high))


def short(name: object) -> str:
    """A name as it fits on an axis."""
    text = str(name)
    return text if len(text) <= _LETTERS else f"{text[: _LETTERS - 1]}…"


def name_ticks(axes: Axes, names: Sequence[object]) -> None:
    """Names below an axis: all of them, upright if they are crowded, or every so many."""
    step = max(1, -(-len(names) // _NAMES))
    shown = [short(name) for name in names[::step]]
    crowded = sum(len(name) + 1 for name in shown) > 44
    axes.set_xticks(range(0, len(names), step), shown, rotation=90 if crowded else 0)


def cropped(images: list[Image]) -> list[Image]:
    """Images (height, width, 3) of one size without the white border that all of them have."""
    ink = np.any([np.any(image < 250, axis=2) for image in images], axis=0)
    rows, columns = np.flatnonzero(ink.any(axis=1)), np.flatnonzero(ink.any(axis=0))
    if len(rows) == 0:
        return images
    top, left = max(rows[0] - _MARGIN, 0), max(columns[0] - _MARGIN, 0)
    return [image[top : rows[-1] + _MARGIN, left : columns[-1] + _MARGIN] for image in images]


def body_entries(grasp: str, kinds: Collection[str]) -> list[Patch]:
    """Legend entries of what a body has of patches and what is known to be held (`kinds`), and of the grasp if one is named."""
    from matplotlib.patches import Patch

    patches = [(COLOURS.anchored, "anchored patch"), (COLOURS.free, "free candidate patch")] if "patch" in kinds else []
    held = [(COLOURS.held, "known to be held")] if "held" in kinds else []
    held += [(COLOURS.driven, "driven by measured points")] if "driven" in kinds else []
    held += [(COLOURS.region, "region of the body")] if "region" in kinds else []
    gripped = [(COLOURS.grasp, f"grasp {grasp}")] if grasp else []
    return [Patch(color=colour, label=text) for colour, text in (*patches, *gripped, *held)]


def open_frame(axes: Axes) -> None:
    """Leave the axes' frame open at the top and on the right."""
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
