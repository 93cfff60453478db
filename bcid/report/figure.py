"""What the figures share: how they are saved, cropped and framed, and what their legends say of the body."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from bcid.report.scene3d import COLOURS, Image

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.patches import Patch

# White that stays around what is drawn, pixels.
_MARGIN = 12


def save(figure: Figure, target: Path) -> Path:
    """Write a figure whole under another name and rename it: a reader never sees half of one. Returns `target`."""
    partial = target.with_name(f".{target.stem}.partial.png")
    figure.savefig(partial, dpi=150)
    return partial.replace(target)


def cropped(images: list[Image]) -> list[Image]:
    """Images (height, width, 3) of one size without the white border that all of them have."""
    ink = np.any([np.any(image < 250, axis=2) for image in images], axis=0)
    rows, columns = np.flatnonzero(ink.any(axis=1)), np.flatnonzero(ink.any(axis=0))
    if len(rows) == 0:
        return images
    top, left = max(rows[0] - _MARGIN, 0), max(columns[0] - _MARGIN, 0)
    return [image[top : rows[-1] + _MARGIN, left : columns[-1] + _MARGIN] for image in images]


def body_entries(grasp: str) -> list[Patch]:
    """Legend entries of the patches, and of the grasp if one is named."""
    from matplotlib.patches import Patch

    return [
        Patch(color=COLOURS.anchored, label="anchored patch"),
        Patch(color=COLOURS.free, label="free candidate patch"),
        *([Patch(color=COLOURS.grasp, label=f"grasp {grasp}")] if grasp else []),
    ]


def open_frame(axes: Axes) -> None:
    """Leave the axes' frame open at the top and on the right."""
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
