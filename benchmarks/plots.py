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
