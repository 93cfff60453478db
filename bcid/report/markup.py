"""HTML that is put together from elements: whatever is not an element already is text, and is escaped."""

from __future__ import annotations

import json
import re
from typing import Any

from markupsafe import Markup, escape

# Characters that HTML does not allow, or that turn the text after them around.
_UNWANTED = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u200e\u200f\u202a-\u202e\u2066-\u2069\ud800-\udfff\ufffe\uffff]")
# What ends a script element or a line of JavaScript inside a string.
_IN_SCRIPT = {ord(c): f"\\u{ord(c):04x}" for c in "<>&\u2028\u2029"}
_EMPTY = frozenset({"meta", "img", "input", "br", "col"})
_NAME = re.compile(r"[a-z][a-z0-9-]*$")


def clean(text: str) -> str:
    """Text without characters that cannot be in a page."""
    return _UNWANTED.sub("\ufffd", text)


def text(content: object) -> Markup:
    """Anything as HTML: an element as it is, a list one after the other, all else as escaped text."""
    if isinstance(content, Markup):
        return content
    if content is None:
        return Markup("")
    if isinstance(content, list | tuple):
        return Markup("".join(text(part) for part in content))
    return escape(clean(str(content)))


def tag(name: str, /, *children: object, **attributes: object) -> Markup:
    """An element. An attribute that is None or False is left out; `class_` is class, and `data_x` is data-x.

    Event handlers, styles and addresses other than fragments and images in the page are refused: a page needs none.
    """
    written = "".join(
        _attribute(key, value) for key, value in attributes.items() if value is not None and value is not False
    )
    if name in _EMPTY:
        return Markup(f"<{name}{written}>")
    return Markup(f"<{name}{written}>{text(children)}</{name}>")


def _attribute(key: str, value: object) -> str:
    name = key.rstrip("_").replace("_", "-").lower()
    if not _NAME.match(name) or name.startswith("on") or name == "style":
        raise ValueError(f"attribute '{name}' does not belong into a report")
    if name == "href" and not str(value).startswith("#"):
        raise ValueError(f"address '{value}': a report links only to its own parts")
    if name == "src" and not str(value).startswith("data:image/png;base64,"):
        raise ValueError("an image of a report is part of it")
    return f" {name}" if value is True else f' {name}="{text(value)}"'


def verbatim(name: str, content: str, /, **attributes: object) -> Markup:
    """A script or style element; its content is bcid's own, or comes from `json_text`."""
    if re.search(rf"</{name}|<!--", content, re.IGNORECASE):
        raise ValueError(f"the content of <{name}> would end it early")
    written = "".join(_attribute(key, value) for key, value in attributes.items())
    return Markup(f"<{name}{written}>{content}</{name}>")


def json_text(content: Any) -> str:
    """JSON that may stand in a script element."""
    return json.dumps(content, allow_nan=False, separators=(",", ":")).translate(_IN_SCRIPT)
