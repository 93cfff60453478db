"""The turnable view of a body as elements: stage, controls, readings, key; `web/viewer.js` makes them live."""

from __future__ import annotations

from typing import Any

from bcid.report.markup import Markup, tag
from bcid.report.scene3d import COLOURS

_CAPTION = (
    "The body as the last model has it. Drag it to turn it; move the slider through actions and steps. Arrows lead from where the "
    "model has a fiducial towards where it was seen. Anchored patches are striped and their names bold."
)


def view(data: dict[str, Any], still: Markup | None, name: str) -> Markup:
    """The view whose data the page holds in the element `name`; `still` is shown in print and where it cannot be drawn."""
    stage = tag(
        "div",
        still,
        tag(
            "canvas",
            class_="canvas",
            tabindex="0",
            role="img",
            aria_label="The body; arrow keys turn it, plus and minus zoom",
        ),
        tag("div", class_="labels", aria_hidden="true"),
        _axes(),
        tag("p", tag("span", class_="bar"), tag("span", class_="bar-text"), class_="bar-key"),
        class_="stage",
    )
    caption = tag("figcaption", _CAPTION)
    return tag("figure", stage, _controls(data), _readings(), _keys(data), caption, class_="view", data_view=name)


def _controls(data: dict[str, Any]) -> Markup:
    last = len(data["actions"]) - 1
    slider = tag(
        "input", type="range", class_="frame", min="0", max=str(last), value=str(data["start"]), aria_label="frame"
    )
    time = tag(
        "div", tag("button", "Play", type="button", class_="play"), slider, tag("output", class_="where"), class_="time"
    )
    scales = [
        tag("option", f"{scale:g} ×", value=f"{scale:g}", selected=scale == data["scale"]) for scale in data["scales"]
    ]
    controls = [time, tag("label", "arrows ", tag("select", scales, class_="scale"))]
    last_model = len(data["models"]) - 1
    if last_model > 0:
        options = [
            tag("option", model["name"], value=str(i), selected=i == last_model)
            for i, model in enumerate(data["models"])
        ]
        controls.append(tag("label", "residual of ", tag("select", options, class_="model")))
    shown = {"anchors": "anchors"}
    if any("chance" in place for place in data["places"]):
        shown["chance"] = "probability"
    shown |= {"displacement": "displacement"} | ({"energy": "strain energy"} if data["energy"] else {})
    shown["residual"] = "residual (interpolated)"
    options = [tag("option", text, value=value) for value, text in shown.items()]
    controls.append(tag("label", "colours: ", tag("select", options, class_="shown")))
    for text, name, about in (
        ("−", "farther", "farther"),
        ("+", "nearer", "nearer"),
        ("Reset", "reset", "reset the view"),
    ):
        controls.append(tag("button", text, type="button", class_=name, aria_label=about))
    return tag("div", controls, class_="controls")


def _axes() -> Markup:
    """The axes and the direction of gravity, which the script turns with the body."""
    arrows = [tag("g", tag("path"), tag("text", name), class_=f"axis-{name}") for name in "xyzg"]
    return tag("svg", arrows, width="150", height="104", class_="axes", aria_hidden="true")


def _readings() -> Markup:
    readings = [("residual per coordinate (RMS) ", "rms"), ("largest ", "worst"), ("fiducials seen ", "count")]
    return tag("p", [tag("span", text, tag("b", class_=name)) for text, name in readings], class_="readout")


def _keys(data: dict[str, Any]) -> Markup:
    entries = [
        _key("anchored patch", _swatch(COLOURS.anchored, striped=True), "held-key"),
        _key("free candidate patch", _swatch(COLOURS.free), "held-key"),
        _key("measured", tag("circle", cx="9", cy="7", r="4", fill=COLOURS.measured)),
        _key("predicted", tag("path", d="M9 2 14 7 9 12 4 7Z", fill=COLOURS.predicted)),
        _key("residual", tag("path", d="M1 8.2V5.8H10V2.5L17 7 10 11.5V8.2Z", fill=COLOURS.predicted)),
    ]
    if any(data["grasps"]):
        entries.insert(2, _key("grasp that moves", _swatch(COLOURS.grasp)))
    bar = [tag("rect", x=str(6 * i), y="1", width="6.5", height="12", fill=c) for i, c in enumerate(data["shades"])]
    svg = tag("svg", bar, width="96", height="14", aria_hidden="true")
    ends = tag("span", class_="shade-name"), tag("span", class_="shade-most")
    entries.insert(0, tag("li", ends[0], svg, ends[1], class_="shades"))
    return tag("ul", entries, class_="body-keys")


def _swatch(colour: str, striped: bool = False) -> list[Markup]:
    made = [tag("rect", x="1", y="1", width="16", height="12", fill=colour)]
    if striped:
        made.append(tag("path", d="M1 7 7 1M4 13 16 1M11 13 17 7", stroke="#ffffff", stroke_width="1.6", fill="none"))
    return made


def _key(text: str, drawn: Markup | list[Markup], class_: str | None = None) -> Markup:
    return tag("li", tag("svg", drawn, width="18", height="14", aria_hidden="true"), text, class_=class_)
