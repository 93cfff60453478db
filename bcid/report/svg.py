"""Figures as SVG inside a page: no ids in common, no style attributes, nothing but shapes and text."""

from __future__ import annotations

import io
import re
import xml.etree.ElementTree as ET
from typing import TYPE_CHECKING

from bcid.report.markup import Markup, text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_SVG, _XLINK = "{http://www.w3.org/2000/svg}", "{http://www.w3.org/1999/xlink}"
_ELEMENTS = frozenset(
    {"svg", "g", "path", "text", "tspan", "rect", "circle", "defs", "clipPath", "use", "image", "pattern"}
)
_ATTRIBUTES = frozenset(
    [
        "id",
        "d",
        "x",
        "y",
        "x1",
        "x2",
        "y1",
        "y2",
        "cx",
        "cy",
        "r",
        "width",
        "height",
        "viewBox",
        "transform",
        "clip-path",
        "clip-rule",
        "points",
        "href",
        "patternUnits",
        "preserveAspectRatio",
    ]
)
# Properties that matplotlib writes into style attributes, which a page with a strict policy must not have.
_PROPERTIES = frozenset(
    [
        "fill",
        "fill-opacity",
        "fill-rule",
        "stroke",
        "stroke-width",
        "stroke-opacity",
        "stroke-linecap",
        "stroke-linejoin",
        "stroke-dasharray",
        "stroke-dashoffset",
        "stroke-miterlimit",
        "opacity",
        "font-size",
        "font-weight",
        "font-style",
        "text-anchor",
        "image-rendering",
    ]
)
_FONT = re.compile(r"^(?P<rest>.*?)(?P<size>[\d.]+)px")
_POINT = 4 / 3  # CSS pixels


def inline(figure: Figure, prefix: str, about: str) -> Markup:
    """A figure as an SVG element whose ids begin with `prefix`; `about` says to those who cannot see it what it shows."""
    root = ET.fromstring(svg_bytes(figure, "none"))
    written = _element(root, prefix)
    width, height = (float(str(root.get(side)).removesuffix("pt")) * _POINT for side in ("width", "height"))
    head = f'<svg role="img" aria-label="{text(about)}" width="{width:.0f}" height="{height:.0f}" '
    return Markup(written.replace("<svg ", f'{head}stroke-linejoin="round" stroke-linecap="butt" ', 1))


def svg_bytes(figure: Figure, fonts: str) -> bytes:
    """A figure as an SVG file, the same bytes for the same figure; `fonts` is "none" (text) or "path" (outlines)."""
    import matplotlib as mpl

    stream = io.BytesIO()
    with mpl.rc_context({"svg.fonttype": fonts, "svg.hashsalt": "bcid"}):
        figure.savefig(stream, format="svg", metadata={"Date": None, "Creator": None})
    return stream.getvalue()


def _element(node: ET.Element, prefix: str) -> str:
    name = node.tag.removeprefix(_SVG) if isinstance(node.tag, str) else ""
    if name not in _ELEMENTS:
        return ""
    attributes: dict[str, str] = {}
    for key, value in node.attrib.items():
        own = key.removeprefix(_XLINK)
        if own == "style":
            attributes |= _properties(value)
        elif own in _ATTRIBUTES | _PROPERTIES and not (name == "svg" and own in ("width", "height")):
            attributes[own] = value
    written = "".join(f' {key}="{text(_own(key, value, prefix))}"' for key, value in attributes.items() if value)
    inside = text((node.text or "").strip()) if name in ("text", "tspan") else ""
    return f"<{name}{written}>{inside}{''.join(_element(child, prefix) for child in node)}</{name}>"


def _properties(style: str) -> dict[str, str]:
    """The declarations of a style attribute as attributes."""
    found = {}
    for declaration in style.split(";"):
        key, _, value = (part.strip() for part in declaration.partition(":"))
        if key == "font" and (match := _FONT.match(value)):
            found["font-size"] = match["size"]
            found |= {"font-weight": "bold"} if re.search(r"bold|[6-9]00", match["rest"]) else {}
        elif key in _PROPERTIES:
            found[key] = value.removesuffix("px") if key == "font-size" else value
    return found


def _own(key: str, value: str, prefix: str) -> str:
    """A value with the ids that it has or points to made the page's only ones."""
    if key == "id":
        return f"{prefix}{value}"
    if key == "href":
        if value.startswith("#"):
            return f"#{prefix}{value[1:]}"
        return value if value.startswith("data:image/png;base64,") else ""
    return re.sub(r"url\(#", f"url(#{prefix}", value)
