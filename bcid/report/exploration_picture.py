"""What `bcid explore` shows: the belief after each pull, and what each pull was expected to tell and told."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from bcid.base.units import percent
from bcid.report.figure import open_frame, short

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Okabe & Ito; hatches tell them apart in black and white.
_COLOURS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00")
_HATCHES = ("", "///", "...", "xx", "\\\\\\", "++")
_OTHERS = "#BBBBBB"


def belief_figure(found: dict[str, Any]) -> Figure:
    """Bars of probability by pull (as Figures 13 and 14 of the paper), patches below, bits on the right."""
    from matplotlib.figure import Figure

    steps = found["steps"]
    figure = Figure(figsize=(12, 6.4), facecolor="white")
    grid = figure.add_gridspec(2, 2, width_ratios=[2.1, 1], height_ratios=[1.25, 1], hspace=0.5, wspace=0.2)
    # Names of effects need room.
    rivals = bool(steps) and len(steps[0]["effects"]) > 1
    grid.update(left=0.11 if rivals else 0.065, right=0.98, top=0.86, bottom=0.1)
    figure.suptitle(title(found), x=0.02, ha="left", fontsize=14, fontweight="bold")
    draw_patches(figure.add_subplot(grid[1, 0]), steps)
    for axes, draw in ((figure.add_subplot(grid[0, 0]), draw_sets), (figure.add_subplot(grid[:, 1]), draw_bits)):
        draw(axes, steps)
        if steps:
            axes.legend(
                loc="lower left",
                bbox_to_anchor=(0, 1.0),
                ncols=4 if draw is draw_sets else 1,
                frameon=False,
                fontsize=9,
            )
    return figure


def title(found: dict[str, Any]) -> str:
    """How the exploration ended."""
    count = len(found["steps"])
    pulls = f"{count} pull{'s' if count != 1 else ''}"
    if found["reason"] == "decided":
        return f"anchored: {_name(found)}, probability {percent(found['probability'])}, after {pulls}"
    if found["reason"] == "inseparable":
        return "no allowed pull separates " + ", ".join(map(_name, found["not_separated"][:4]))
    if found["reason"] == "unexplained":
        return f"nothing explains what was seen after {pulls}; likeliest {_name(found)}"
    return f"not decided after {pulls}; likeliest {_name(found)}, probability {percent(found['probability'])}"


def _name(hypothesis: dict[str, Any]) -> str:
    return "{" + " ".join(hypothesis["anchored"]) + "}" + (f" + {hypothesis['effect']}" if hypothesis["effect"] else "")


def draw_sets(axes: Axes, steps: list[dict[str, Any]]) -> None:
    """One stacked bar per pull: the likeliest sets, the rest in grey."""
    weight: dict[str, float] = {}
    for step in steps:
        for entry in step["belief"]:
            name = _name(entry)
            weight[name] = weight.get(name, 0.0) + entry["probability"]
    shown = sorted(weight, key=lambda name: -weight[name])[: len(_COLOURS)]
    for k, name in enumerate(shown):
        heights, bottoms = [], []
        for step in steps:
            known = {_name(entry): entry["probability"] for entry in step["belief"]}
            bottoms.append(sum(known.get(other, 0.0) for other in shown[:k]))
            heights.append(known.get(name, 0.0))
        axes.bar(
            range(1, len(steps) + 1),
            heights,
            _width(steps),
            bottoms,
            color=_COLOURS[k],
            hatch=_HATCHES[k],
            edgecolor="white",
            label=short(name),
        )
    rest = []
    for step in steps:
        known = {_name(entry): entry["probability"] for entry in step["belief"]}
        rest.append(max(0.0, 1 - sum(known.get(name, 0.0) for name in shown)))
    if max(rest, default=0.0) > 1e-3:
        axes.bar(range(1, len(steps) + 1), rest, _width(steps), [1 - r for r in rest], color=_OTHERS, label="others")
    axes.set_ylim(0, 1)
    axes.set_ylabel("probability")
    axes.set_xlim(0.4, len(steps) + 0.6)
    axes.set_xticks(range(1, len(steps) + 1), [_pull(step) for step in steps])
    open_frame(axes)


def _width(steps: list[dict[str, Any]]) -> float:
    """Of a bar: few are not broad."""
    return min(0.6, 0.15 * len(steps))


def _pull(step: dict[str, Any]) -> str:
    return f"{short(step['grasp'])} {short(step['direction'])}\n{step['amplitude']:.3g} mm"


def draw_patches(axes: Axes, steps: list[dict[str, Any]]) -> None:
    """Probability of each patch, and of each effect where there are rivals, by pull, as numbers on shades of grey."""
    if not steps:
        axes.set_axis_off()
        return
    rows = [_probabilities(step) for step in steps]
    names = list(rows[0])
    table = [[row[name] for row in rows] for name in names]
    axes.imshow(
        table, cmap="Greys", vmin=0, vmax=1.25, aspect="auto", extent=(0.5, len(steps) + 0.5, len(names) - 0.5, -0.5)
    )
    for i, row in enumerate(table):
        for j, p in enumerate(row):
            axes.text(j + 1, i, f"{p:.2f}", ha="center", va="center", fontsize=8, color="white" if p > 0.6 else "black")
    patches = len(steps[0]["patches"])
    if len(names) > patches:
        axes.axhline(patches - 0.5, color="#0072B2", lw=1.5)
    axes.set_xlim(0.4, len(steps) + 0.6)
    axes.set_yticks(range(len(names)), [short(name) for name in names])
    axes.set_xticks(range(1, len(steps) + 1))
    axes.set_xlabel("pull")
    axes.set_ylabel("patch anchored" if len(names) == patches else "patch anchored,\neffect acting")
    open_frame(axes)


def _probabilities(step: dict[str, Any]) -> dict[str, float]:
    """Of patches, and of effects where there are rivals."""
    rivals = step["effects"] if len(step["effects"]) > 1 else {}
    return step["patches"] | {name or "no effect": p for name, p in rivals.items()}


def draw_bits(axes: Axes, steps: list[dict[str, Any]]) -> None:
    """Expected against gained information, by pull."""
    numbers = [step["number"] for step in steps]
    known = [step for step in steps if step["expected_bits"] is not None]
    axes.bar([n + 0.18 for n in numbers], [s["gained_bits"] for s in steps], 0.34, color="#0072B2", label="gained")
    axes.bar(
        [s["number"] - 0.18 for s in known],
        [s["expected_bits"] for s in known],
        0.34,
        yerr=[2 * (s["expected_error"] or 0.0) for s in known],
        color="white",
        edgecolor="black",
        hatch="///",
        label="expected (2 standard errors)",
    )
    axes.axhline(0, color="black", lw=0.8)
    axes.set_xticks(numbers)
    axes.set_xlabel("pull")
    axes.set_ylabel("information (bits)")
    open_frame(axes)
