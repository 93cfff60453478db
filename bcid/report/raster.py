"""Figures as PNG inside a page."""

from __future__ import annotations

import base64
import io
from typing import TYPE_CHECKING

from bcid.report.markup import Markup, tag

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Pixels to an inch, and colours: enough for what VTK draws, a third of the bytes.
_FINE, _COLOURS = 120, 192


def embedded(figure: Figure, about: str) -> Markup:
    """A figure as an image element."""
    from PIL import Image

    drawn, packed = io.BytesIO(), io.BytesIO()
    figure.savefig(drawn, format="png", dpi=_FINE, metadata={"Software": None})
    with Image.open(drawn) as image:
        image.convert("RGB").quantize(_COLOURS, dither=Image.Dither.NONE).save(packed, "png", optimize=True)
    source = "data:image/png;base64," + base64.b64encode(packed.getvalue()).decode("ascii")
    width, height = figure.get_size_inches() * _FINE
    return tag("img", src=source, alt=about, width=int(width), height=int(height))
