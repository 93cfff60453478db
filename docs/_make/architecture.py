"""The figures of docs/architecture.md, from the imports: the rooms of the product, and the path of a measurement."""

import ast
from collections import Counter
from pathlib import Path

import matplotlib

matplotlib.use("svg")
import matplotlib.pyplot as plt
from matplotlib.patches import FancyArrowPatch, FancyBboxPatch

PRODUCT = Path(__file__).resolve().parents[2] / "bcid"
# Rooms from the bottom to the top: a room imports what stands in rows below it.
ROWS = (
    ("base",),
    ("results", "scene"),
    ("measurement",),
    ("forms", "vision"),
    ("inference",),
    ("predict",),
    ("search", "report"),
    ("grammar", "exploration"),
    ("api", "app"),
)
# What a measurement passes, one after the other: module, what is called there, and what it hands on.
PATH = (
    ("bcid.measurement.measurement", "Measurement", "markers, poses and forces by frame"),
    ("bcid.search.answer.source", "Source", "with its scene and a model"),
    ("bcid.inference.data", "Data", "what is compared, with its noise"),
    ("bcid.predict.predictor", "Predictor", "predictions and sensitivities"),
    ("bcid.search.hypothesis_table", "HypothesisTable", "evidence of every hypothesis"),
    ("bcid.search.explain", "explain", "posterior, fitted models"),
    ("bcid.search.answer.output", "documents", "records and arrays"),
    ("bcid.results.run_documents", "write_documents", "the run folder"),
    ("bcid.report.found", "Found", "records, read back"),
    ("bcid.report.page", "write_report", "the page"),
)
STYLE = {"font.size": 9.5, "svg.fonttype": "none", "svg.hashsalt": "bcid"}


def draw_architecture(folder: Path) -> None:
    """Write both figures as SVG."""
    with plt.rc_context(STYLE):
        for name, draw in (("rooms", rooms), ("path", path)):
            figure = draw()
            figure.savefig(folder / f"{name}.svg", metadata={"Date": None})
            plt.close(figure)


def lines(room: str) -> int:
    """Lines of code of a room."""
    return sum(file.read_text(encoding="utf-8").count("\n") for file in (PRODUCT / room).rglob("*.py"))


def imports(room: str) -> Counter:
    """How many import statements of a room name each other room."""
    found = Counter()
    for file in (PRODUCT / room).rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            words = (node.module or "").split(".") if isinstance(node, ast.ImportFrom) else []
            if words[:1] == ["bcid"] and len(words) > 1 and words[1] != room:
                found[words[1]] += 1
    return found


def rooms():
    """Boxes of rooms with their lines, and arrows to the rooms that they import, but for those that these import as well."""
    figure, axis = plt.subplots(figsize=(7.2, 6.4), layout="constrained")
    places = {}
    for height, row in enumerate(ROWS):
        for k, room in enumerate(row):
            places[room] = (3.2 * (k - (len(row) - 1) / 2), height)
    known = {room: imports(room) for room in places}
    for room, (x, y) in places.items():
        for other, count in known[room].items():
            if other not in places or any(other in known[between] for between in known[room]):
                continue
            a, b = (x, y - 0.26), (places[other][0], places[other][1] + 0.26)
            bend = 0.0 if y - places[other][1] == 1 else 0.12 * (1 if places[other][0] >= x else -1)
            style = {"arrowstyle": "-|>", "mutation_scale": 8, "color": "#0072B2", "alpha": 0.55}
            width = 0.8 + min(count, 60) / 20
            axis.add_patch(FancyArrowPatch(a, b, connectionstyle=f"arc3,rad={bend}", lw=width, zorder=1, **style))
    for room, (x, y) in places.items():
        box = FancyBboxPatch((x - 1.05, y - 0.24), 2.1, 0.48, boxstyle="round,pad=0.02", zorder=2)
        box.set(facecolor="white", edgecolor="#444444", lw=1)
        axis.add_patch(box)
        axis.text(x, y, f"{room}  {lines(room):,}", ha="center", va="center", zorder=3)
    axis.set_xlim(-3.2, 3.2)
    axis.set_ylim(-0.5, len(ROWS) - 0.5)
    axis.axis("off")
    return figure


def path():
    """What a measurement passes, from the reader to the page."""
    figure, axis = plt.subplots(figsize=(7.2, 4.8), layout="constrained")
    for k, (module, name, handed) in enumerate(PATH):
        y = -k
        axis.text(0, y, name, ha="right", va="center", weight="bold")
        axis.text(0.12, y, module.removeprefix("bcid."), ha="left", va="center", color="#444444")
        axis.text(1.9, y, handed, ha="left", va="center")
        if k + 1 < len(PATH):
            arrow = FancyArrowPatch((-0.14, y - 0.25), (-0.14, y - 0.75), arrowstyle="-|>", mutation_scale=9)
            arrow.set(color="#0072B2", lw=1.4)
            axis.add_patch(arrow)
    axis.set_xlim(-0.9, 3.6)
    axis.set_ylim(-len(PATH) + 0.5, 0.5)
    axis.axis("off")
    return figure
