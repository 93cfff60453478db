"""The drawings of docs/concepts.md, made from the slab's scene file and from Bayes' rule."""

from pathlib import Path

import matplotlib

matplotlib.use("svg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.patches import FancyArrowPatch, Rectangle

from bcid.scene import Scene

SCENE = Path(__file__).resolve().parents[2] / "examples/scenes/slab.toml"
# Okabe & Ito's colours.
ANCHORED, FREE, GRASP, MARKER = "#0072B2", "#BBBBBB", "#E69F00", "#000000"
# Where the patches of the benchmark are, seen from above: from (x, z) to (x, z), mm.
EDGES = {
    "1": ((50, 100), (100, 100)),
    "2": ((0, 100), (50, 100)),
    "3": ((0, 50), (0, 100)),
    "4": ((0, 0), (0, 50)),
    "5": ((0, 0), (50, 0)),
    "6": ((50, 0), (100, 0)),
}
STYLE = {
    "font.size": 10,
    "svg.fonttype": "none",
    "svg.hashsalt": "bcid",
    "axes.spines.top": False,
    "axes.spines.right": False,
}


def draw_concepts(folder: Path) -> None:
    """Write the drawings as SVG."""
    with plt.rc_context(STYLE):
        for name, draw in (
            ("question", question),
            ("candidates", candidates),
            ("belief", belief),
            ("missing", missing),
        ):
            figure = draw()
            figure.savefig(folder / f"{name}.svg", metadata={"Date": None})
            plt.close(figure)


def slab(axis, anchored=(), labels=True):
    """The slab from above."""
    axis.add_patch(Rectangle((0, 0), 100, 100, facecolor="#F4EFE8", edgecolor="#555555", lw=0.8))
    for name, (a, b) in EDGES.items():
        held = name in anchored
        axis.plot(*zip(a, b, strict=True), color=ANCHORED if held else FREE, lw=6 if held else 4, solid_capstyle="butt")
        if labels:
            middle = np.mean([a, b], axis=0)
            x, z = middle + 9 * np.sign(np.round((middle - 50) / 50 * 0.6))
            axis.text(x, z, name, ha="center", va="center", color=ANCHORED if held else "#555555")
    axis.add_patch(Rectangle((80, 40), 20, 20, facecolor=GRASP, edgecolor="none", alpha=0.6))
    axis.set_aspect("equal")
    axis.axis("off")


def question():
    """What is known and what is asked."""
    figure, axis = plt.subplots(figsize=(6.4, 4.4), layout="constrained")
    slab(axis)
    scene = Scene.read(SCENE)
    rest = scene.rest * 1e3
    axis.plot(rest[:, 0], rest[:, 2], "o", color=MARKER, ms=4)
    axis.add_patch(FancyArrowPatch((92, 50), (128, 50), arrowstyle="-|>", mutation_scale=16, color=GRASP, lw=2))
    notes = {
        "markers, seen by cameras": ((35, 87.5), (20, 119)),
        "grasp: how it\nmoves is known": ((97, 57), (122, 78)),
        "candidate patches:\nwhich of them are anchored?": ((50, -1), (50, -22)),
    }
    for text, (tip, place) in notes.items():
        axis.annotate(text, tip, place, ha="center", va="center", arrowprops={"arrowstyle": "-", "color": "#888888"})
    axis.set_xlim(-20, 150)
    axis.set_ylim(-30, 125)
    return figure


def candidates():
    """The search: from set to set, one patch at a time."""
    figure, axes = plt.subplots(1, 4, figsize=(8.0, 2.5), layout="constrained")
    path = [(("1", "5"), "2.9 mm"), (("5",), "2.1 mm"), (("3", "5"), "0.9 mm"), (("3", "4"), "0.3 mm: the noise")]
    for axis, (anchored, residual) in zip(axes, path, strict=True):
        slab(axis, anchored, labels=False)
        axis.set_title("{" + " ".join(anchored) + "}", fontsize=10)
        axis.text(50, -14, residual, ha="center", va="top", fontsize=9)
        axis.set_ylim(-30, 108)
    return figure


def belief():
    """Residuals become probabilities."""
    figure, axis = plt.subplots(figsize=(6.0, 2.6), layout="constrained")
    names = ["{3 4}", "{3 4 7}", "{4 7}", "{3}", "{1 3 4}"]
    values = [0.97, 0.02, 0.007, 0.002, 0.001]
    axis.barh(names[::-1], values[::-1], color=[*["#999999"] * 4, ANCHORED])
    for k, value in enumerate(values[::-1]):
        axis.text(value + 0.01, k, f"{value:.1%}", va="center")
    axis.set_xlim(0, 1.15)
    axis.set_xlabel("probability of the set")
    return figure


def missing():
    """How the error falls with what the model has."""
    figure, axis = plt.subplots(figsize=(6.0, 2.6), layout="constrained")
    names, errors = ["neo-Hookean", "+ gravity"], [1.42, 0.207]
    axis.barh(names[::-1], errors[::-1], color=[ANCHORED, "#999999"], height=0.5)
    axis.axvline(0.2, color=MARKER, ls="--", lw=1)
    axis.text(0.22, 1.42, "noise", va="bottom")
    for k, value in enumerate(errors[::-1]):
        axis.text(value + 0.02, k, f"{value:g} mm", va="center")
    axis.set_xlim(0, 1.7)
    axis.set_ylim(-0.5, 1.7)
    axis.set_xlabel("RMS error at the markers, mm")
    return figure
