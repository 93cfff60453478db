"""Plots of the benchmark. Without matplotlib there are none, and a note says so."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import wraps
from pathlib import Path
from typing import Any

import numpy as np

GREY, BLUE, ORANGE, GREEN, RED = "#9aa0a6", "#1f5fa8", "#d9822b", "#3b8a4b", "#b5403a"
Drawing = Callable[..., None]


def drawing(function: Drawing) -> Drawing:
    """Makes a drawing `function(axes, ...)` one that writes a PNG: called with the file first and the part last."""

    @wraps(function)
    def draw(file: Path, *content: Any, **more: Any) -> None:
        *content_, part = content
        try:
            import matplotlib

            matplotlib.use("Agg")
            import matplotlib.pyplot as plt
        except ImportError:
            part.notes.append(f"no {file.name}: matplotlib is not installed (the extra 'report')")
            return
        with plt.rc_context({"font.size": 9, "axes.spines.top": False, "axes.spines.right": False}):
            figure = plt.figure(figsize=more.pop("size", (7.0, 4.2)), dpi=150, layout="constrained")
            function(figure, *content_, **more)
            figure.savefig(file)
            plt.close(figure)
        part.plots.append(file.name)

    return draw


@drawing
def codes(figure: Any, meshes: Mapping[str, Mapping[str, Mapping[str, float]]]) -> None:
    """CPU seconds of every code on every mesh, as bars on a logarithmic axis; the fastest on the last mesh is on top."""
    last = list(meshes.values())[-1]
    names = sorted(last, key=lambda name: -last[name]["cpu_s"])
    axes = figure.subplots(1, len(meshes), squeeze=False, sharey=True)[0]
    for ax, (mesh, found) in zip(axes, meshes.items(), strict=True):
        limit = found["bcid"]["limit_s"]
        for i, name in enumerate(names):
            if name in found:
                seconds = found[name]["cpu_s"]
                ax.barh(i, seconds, color=BLUE if name == "bcid" else GREY, height=0.65)
                ax.text(seconds, i, f" {found[name]['times']:.2g} ×", va="center", fontsize=8)
        ax.axvline(limit, color=ORANGE, lw=1.2, ls="--", label="one residual and one triangular solve per iteration")
        ax.set_xscale("log")
        ax.set_xlim(limit / 2, max(r["cpu_s"] for r in found.values()) * 12)
        ax.set_yticks(range(len(names)), names)
        ax.set_xlabel("CPU seconds")
        ax.set_title(f"{mesh} (limit {limit:.2g} s)", fontsize=9)
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, frameon=False, fontsize=8, loc="outside lower center")


def slope(x: Sequence[float], y: Sequence[float]) -> tuple[float, float]:
    """Exponent and factor of y = factor * x ** exponent, by least squares of the logarithms."""
    exponent, offset = np.polyfit(np.log(np.asarray(x, dtype=float)), np.log(np.asarray(y, dtype=float)), 1)
    return float(exponent), float(np.exp(offset))


@drawing
def mesh_growth(figure: Any, found: Sequence[Mapping[str, Any]], fitted: Mapping[str, str]) -> None:
    """Seconds and memory over the unknowns, logarithmic, with fitted exponents; the multigrid point stands apart."""
    left, right = figure.subplots(1, 2, width_ratios=(1.6, 1))
    colours = dict(zip(fitted, (BLUE, GREEN, RED, GREY, ORANGE), strict=True))
    direct = [r for r in found if r["direct"]]
    other = [r for r in found if not r["direct"]]
    for key, words in fitted.items():
        x, y = [r["unknowns"] for r in direct], [r[key] for r in direct]
        exponent, factor = slope(x, y)
        limit = key.endswith("limit_s")
        left.plot(x, y, ls="none", marker=None if limit else "o", color=colours[key], ms=4)
        line = np.array([min(x), max(x)], dtype=float)
        style = "--" if limit else "-"
        left.plot(
            line, factor * line**exponent, style, color=colours[key], lw=1, label=f"{words}, n$^{{{exponent:.2f}}}$"
        )
        apart = [(r["unknowns"], r[key]) for r in other if key in r]
        if apart:
            left.plot(*zip(*apart, strict=True), "o", color=colours[key], ms=5, mfc="none")
    left.set_ylabel("CPU seconds")
    x, y = [r["unknowns"] for r in direct], [r["rss_mb"] for r in direct]
    right.plot([r["unknowns"] for r in found], [r["rss_mb"] for r in found], "-", color=GREY, lw=1)
    right.plot(x, y, "o", color=BLUE, ms=4, label="direct")
    if other:
        x, y = [r["unknowns"] for r in other], [r["rss_mb"] for r in other]
        right.plot(x, y, "o", color=BLUE, mfc="none", label="multigrid")
    right.set_ylabel("memory of the process, MB")
    handles, labels = left.get_legend_handles_labels()
    figure.legend(handles, labels, frameon=False, fontsize=8, ncols=3, loc="outside lower center")
    right.legend(frameon=False, fontsize=8)
    for ax in (left, right):
        ax.set_xscale("log")
        ax.set_yscale("log")
        ax.set_xlabel("unknowns n")
        ax.grid(alpha=0.25, lw=0.5)
    low, high = right.get_ylim()
    ticks = [value * decade for decade in (10, 100, 1000, 10_000) for value in (1, 2, 5)]
    right.set_yticks([tick for tick in ticks if low <= tick <= high], minor=False)
    right.yaxis.set_major_formatter("{x:.0f}")
    right.yaxis.set_minor_formatter("")


@drawing
def rank_growth(figure: Any, seconds: Mapping[int, float]) -> None:
    """CPU seconds of a rank over the number of ranks, with perfect scaling."""
    ax = figure.subplots()
    ranks = sorted(seconds)
    times = [seconds[n] for n in ranks]
    ax.plot(ranks, [times[0] * ranks[0] / n for n in ranks], "--", color=ORANGE, lw=1, label="perfect")
    ax.plot(ranks, times, "o-", color=BLUE, ms=5, label="measured")
    for n, value in zip(ranks, times, strict=True):
        ax.annotate(
            f"{100 * times[0] * ranks[0] / n / value:.0f} %", (n, value), (6, 6), textcoords="offset points", fontsize=8
        )
    ax.set_xticks(ranks, [str(n) for n in ranks])
    ax.set_ylim(0.0, 1.15 * max(times))
    ax.margins(x=0.2)
    ax.set_xlabel("ranks")
    ax.set_ylabel("CPU seconds of each rank")
    ax.legend(frameon=False, fontsize=8)


@drawing
def patch_growth(figure: Any, found: Sequence[Mapping[str, Any]]) -> None:
    """Sets looked at, trajectories and CPU seconds over the number of patches."""
    ax = figure.subplots()
    patches = [r["patches"] for r in found]
    shown = ("sets", "sets looked at", GREY), ("trajectories", "trajectories", BLUE), ("cpu_s", "CPU seconds", RED)
    for key, words, colour in shown:
        ax.plot(patches, [r[key] for r in found], "o-", color=colour, ms=5, lw=1, label=words)
    ax.set_xscale("log")
    ax.set_yscale("log")
    ax.set_xticks(patches, [str(n) for n in patches])
    ax.minorticks_off()
    ax.set_xlabel("patches")
    ax.set_ylabel("of one climb")
    ax.grid(alpha=0.25, lw=0.5)
    ax.legend(frameon=False, fontsize=8)


@drawing
def replay_growth(
    figure: Any,
    curves: Mapping[str, Mapping[int, float]],
    possible: Mapping[str, Mapping[int, float]],
    wanted: tuple[int, float],
) -> None:
    """Efficiency over the number of ranks, with what is possible, and what is wanted on how many ranks."""
    ax = figure.subplots()
    for (name, curve), colour in zip(curves.items(), (BLUE, GREEN), strict=False):
        ranks, most = list(curve), possible[name]
        ax.plot(ranks, list(curve.values()), "o-", color=colour, ms=4, lw=1, label=name)
        ax.plot(list(most), list(most.values()), ":", color=colour, lw=1, label="at most possible")
    ax.plot(*wanted, "D", color=ORANGE, ms=5, label=f"goal on {wanted[0]} ranks")
    ax.set_xscale("log", base=2)
    ax.set_xticks(ranks, [str(n) for n in ranks])
    ax.set_ylim(0.0, 1.05)
    ax.set_xlabel("ranks")
    ax.set_ylabel("efficiency")
    ax.grid(alpha=0.25, lw=0.5)
    ax.legend(frameon=False, fontsize=8, loc="lower left")
