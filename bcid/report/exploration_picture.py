"""What `bcid explore` shows: the belief after each pull, and what each pull was expected to tell and told."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bcid.base.units import percent
from bcid.report.figure import DARK, short
from bcid.results.exploration_record import ExplorationRecord, ExplorationStep

# Okabe & Ito; hatches tell them apart in black and white.
_COLOURS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00")
_HATCHES = ("", "///", "...", "xx", "\\\\\\", "++")
_OTHERS = "#BBBBBB"


def posterior_figure(found: ExplorationRecord) -> Figure:
    """Bars of probability by pull (as Figures 13 and 14 of the paper), patches below, bits on the right."""
    steps = found.steps
    figure = Figure(figsize=(12, 6.4), facecolor="white")
    grid = figure.add_gridspec(2, 2, width_ratios=[2.1, 1], height_ratios=[1.25, 1], hspace=0.5, wspace=0.2)
    # Names of effects need room.
    rivals = bool(steps) and len(steps[0].effects) > 1
    grid.update(left=0.11 if rivals else 0.065, right=0.98, top=0.86, bottom=0.1)
    figure.suptitle(title(found), x=0.02, ha="left", fontsize=14, fontweight="bold")
    draw_patches(figure.add_subplot(grid[1, 0]), steps)
    for place, draw, columns in ((grid[0, 0], draw_sets, 4), (grid[:, 1], draw_bits, 1)):
        axes = figure.add_subplot(place)
        draw(axes, steps)
        if steps:
            axes.legend(loc="lower left", bbox_to_anchor=(0, 1.0), ncols=columns, fontsize=9)
    return figure


def title(found: ExplorationRecord) -> str:
    """How the exploration ended."""
    count = len(found.steps)
    pulls = f"{count} pull{'s' if count != 1 else ''}"
    if found.reason == "decided":
        return f"anchored: {found.hypothesis.label}, probability {percent(found.probability)}, after {pulls}"
    if found.reason == "inseparable":
        return "no allowed pull separates " + ", ".join(one.label for one in found.not_separated[:4])
    if found.reason == "unexplained":
        return f"nothing explains what was seen after {pulls}; likeliest {found.hypothesis.label}"
    return f"not decided after {pulls}; likeliest {found.hypothesis.label}, probability {percent(found.probability)}"


def draw_sets(axes: Axes, steps: Sequence[ExplorationStep]) -> None:
    """One stacked bar per pull: the likeliest sets, the rest in grey."""
    beliefs = [{entry.label: entry.probability for entry in step.posterior} for step in steps]
    weight = {name: sum(belief.get(name, 0.0) for belief in beliefs) for belief in beliefs for name in belief}
    shown = sorted(weight, key=lambda name: -weight[name])[: len(_COLOURS)]
    # Few bars are not broad.
    places, width, below = range(1, len(steps) + 1), min(0.6, 0.15 * len(steps)), np.zeros(len(steps))
    for name, colour, hatch in zip(shown, _COLOURS, _HATCHES, strict=False):
        heights = np.array([belief.get(name, 0.0) for belief in beliefs])
        axes.bar(places, heights, width, below, color=colour, hatch=hatch, edgecolor="white", label=short(name))
        below = below + heights
    if max(1 - below, default=0.0) > 1e-3:
        axes.bar(places, np.maximum(1 - below, 0), width, below, color=_OTHERS, label="others")
    axes.set_ylim(0, 1)
    axes.set_ylabel("probability")
    axes.set_xlim(0.4, len(steps) + 0.6)
    names = [f"{short(step.grasp)} {short(step.direction)}\n{step.amplitude:.3g} mm" for step in steps]
    axes.set_xticks(places, names)


def draw_patches(axes: Axes, steps: Sequence[ExplorationStep]) -> None:
    """Probability of each patch, and of each effect where there are rivals, by pull, as numbers on shades of grey."""
    if not steps:
        axes.set_axis_off()
        return
    patches, count = len(steps[0].patches), len(steps)
    rivals = len(steps[0].effects) > 1
    rows = [[*step.patches.values(), *(step.effects.values() if rivals else ())] for step in steps]
    names = [*steps[0].patches, *(name or "no effect" for name in steps[0].effects if rivals)]
    table = np.array(rows).T
    extent = (0.5, count + 0.5, len(names) - 0.5, -0.5)
    axes.imshow(table, cmap="Greys", vmin=0, vmax=1.25, aspect="auto", extent=extent)
    for (i, j), p in np.ndenumerate(table):
        axes.text(j + 1, i, f"{p:.2f}", ha="center", va="center", fontsize=8, color="white" if p > 0.6 else "black")
    if rivals:
        axes.axhline(patches - 0.5, color=DARK, lw=1.5)
    axes.set_xlim(0.4, count + 0.6)
    axes.set_yticks(range(len(names)), [short(name) for name in names])
    axes.set_xticks(range(1, count + 1))
    axes.set_xlabel("pull")
    axes.set_ylabel("patch anchored,\neffect acting" if rivals else "patch anchored")


def draw_bits(axes: Axes, steps: Sequence[ExplorationStep]) -> None:
    """Expected against gained information, by pull."""
    numbers = [step.number for step in steps]
    known = [step for step in steps if step.expected_bits is not None]
    places, expected = [step.number - 0.18 for step in known], [step.expected_bits or 0.0 for step in known]
    errors = [2 * (step.expected_stderr or 0.0) for step in known]
    axes.bar([n + 0.18 for n in numbers], [step.gained_bits for step in steps], 0.34, color=DARK, label="gained")
    style: dict[str, Any] = {"color": "white", "edgecolor": "black", "hatch": "///"}
    axes.bar(places, expected, 0.34, yerr=errors, label="expected (2 standard errors)", **style)
    axes.axhline(0, color="black", lw=0.8)
    axes.set_xticks(numbers)
    axes.set_xlabel("pull")
    axes.set_ylabel("information (bits)")
