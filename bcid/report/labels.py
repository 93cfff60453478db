"""Texts in pictures of the body, and the view that they stand in."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
# Height of the letters of a name, pixels of a picture of usual size.
LETTER = 36


@dataclass(frozen=True)
class Viewpoint:
    """From where the body is seen, all unit vectors: to the right, upwards and towards the eye; and its size, mm."""

    right: Array
    high: Array
    away: Array
    size: float


@dataclass(frozen=True)
class Label:
    """A text at a place (mm), in a colour; the height of its letters is in pixels.

    It stands to the left (-1) or right (1) of its place, or in its middle (0), and below or above it.
    """

    place: Array
    text: str
    colour: str
    height: int = LETTER
    beside: int = 0
    above: int = 0


def beside_arrows(
    starts: Array, arrows: Array, texts: Sequence[str], colour: str, others: Sequence[Label], view: Viewpoint
) -> list[Label]:
    """A text at the tip of each arrow, so that it hides none of it; behind the arrow where another label is in the way.

    Args:
        starts, arrows: where arrows begin and what is drawn, shape (arrows, 3), mm.
        texts: one for each arrow, none where it is empty; or none at all.
        colour: of the texts.
        others: labels that the picture has already.
        view: from where it is seen.
    """
    labels: list[Label] = []
    for start, arrow, text in zip(starts, arrows, texts, strict=False):
        if not text:
            continue
        places = [_beyond(start + arrow, arrow, text, colour, view), _beyond(start, -arrow, text, colour, view)]
        taken = [_box(label, view) for label in (*others, *labels)]
        free = [label for label in places if not any(_overlap(_box(label, view), box) for box in taken)]
        labels += (free or places)[:1]
    return labels


def _beyond(end: Array, way: Array, text: str, colour: str, view: Viewpoint) -> Label:
    """A text at the end of an arrow, on the side that is further on in the picture."""
    along, high = float(way @ view.right), float(way @ view.high)
    length = float(np.hypot(along, high)) or 1.0
    gap = 0.012 * view.size * (along * view.right + high * view.high) / length
    beside = int(np.sign(along)) if abs(along) > 0.35 * length else 0
    above = int(np.sign(high)) if abs(high) > abs(along) else 0
    return Label(end + gap, text, colour, round(0.75 * LETTER), beside, above)


def _box(label: Label, view: Viewpoint) -> Array:
    """About where a label is in the picture: least and most to the right and upwards, mm, shape (2, 2)."""
    high = 0.025 * view.size * label.height / LETTER
    half = np.array([0.3 * len(label.text), 0.5]) * high
    middle = np.array([label.place @ view.right, label.place @ view.high]) + half * (label.beside, label.above)
    return np.array([middle - half, middle + half])


def _overlap(one: Array, other: Array) -> bool:
    return bool(np.all(one[0] < other[1]) and np.all(other[0] < one[1]))


def drawn(label: Label) -> Any:
    """A label as VTK draws it: over everything, beside its place, on a little white."""
    import pyvista as pv
    from vtkmodules.vtkRenderingCore import vtkTextActor

    actor = vtkTextActor()
    actor.SetInput(label.text)
    actor.GetPositionCoordinate().SetCoordinateSystemToWorld()
    actor.GetPositionCoordinate().SetValue(*map(float, label.place))
    style = actor.GetTextProperty()
    style.SetFontFamilyToArial()
    style.SetFontSize(label.height)
    style.SetBold(True)
    # VTK's left-justified text begins at its place, and its bottom-justified text stands on it.
    [style.SetJustificationToRight, style.SetJustificationToCentered, style.SetJustificationToLeft][label.beside + 1]()
    vertical = [style.SetVerticalJustificationToTop, style.SetVerticalJustificationToCentered]
    [*vertical, style.SetVerticalJustificationToBottom][label.above + 1]()
    style.SetColor(*pv.Color(label.colour).float_rgb)
    style.SetBackgroundColor(1.0, 1.0, 1.0)
    style.SetBackgroundOpacity(0.6)
    return actor
