"""What the models miss, by action, step and fiducial, and fiducial by frame."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from bcid.report.figure import DARK, GREY, LIGHT, MAP, name_frames, name_ticks, short
from bcid.report.found import Found
from bcid.results.words import model_name

Array = NDArray[np.float64]
# More fiducials than these have every so many named.
_NAMES = 24


@dataclass(frozen=True)
class Residual:
    """Measured minus predicted positions of one or two models.

    Attributes:
        models: by name (the first model before the last), shape (frames, fiducials, 3), in mm; NaN where not seen.
        actions, steps: of each frame.
        fiducials: their names.
        noise: standard deviation of a coordinate in mm, or None.
    """

    models: dict[str, Array]
    actions: NDArray[np.str_]
    steps: NDArray[np.int64]
    fiducials: list[str]
    noise: float | None

    def by(self, what: str, model: str) -> dict[str, float]:
        """RMS per coordinate of each "action" in turn, "step" over all actions, or "fiducial"."""
        values = self.models[model]
        if what == "fiducial":
            return {name: rms(values[:, i]) for i, name in enumerate(self.fiducials)}
        if what == "step":
            return {str(step): rms(values[self.steps == step]) for step in np.unique(self.steps)}
        return {name: rms(values[self.actions == name]) for name in self.action_names}

    @property
    def action_names(self) -> list[str]:
        """In the order of the frames."""
        return list(dict.fromkeys(map(str, self.actions)))

    @property
    def last(self) -> str:
        """The last model's name."""
        return list(self.models)[-1]


def residuals_of(found: Found) -> Residual:
    """Of the positions of a run.

    Raises:
        ValueError: it has none, or neither a diagnosis nor an identification.
    """
    result, positions = found.diagnosis or found.identification, found.positions
    if positions is None or result is None:
        raise ValueError("no residuals")
    measured = positions["measured"].values / 1e-3
    models = {}
    for suffix in ("_first", ""):
        if f"predicted{suffix}" in positions:
            name = model_name(str(positions.attrs.get(f"model{suffix}", "model")))
            models[name] = measured - positions[f"predicted{suffix}"].values / 1e-3
    names = positions["fiducial"].values if "fiducial" in positions.coords else range(1, measured.shape[1] + 1)
    actions, steps = positions["action"].values.astype(str), positions["step"].values.astype(int)
    return Residual(models, actions, steps, [str(name) for name in names], result.noise_rms)


def rms(values: Array) -> float:
    """Root mean square of what is there; NaN where nothing is."""
    seen = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(seen**2))) if len(seen) else float("nan")


def draw_actions(axes: Axes, residual: Residual) -> None:
    """Bars for each action."""
    names = residual.action_names
    width = 0.76 / len(residual.models)
    for k, model in enumerate(residual.models):
        places = np.arange(len(names)) + (k - (len(residual.models) - 1) / 2) * width
        fill: dict[str, Any] = {"color": DARK} if model == residual.last else {"color": LIGHT, "hatch": "///"}
        axes.bar(
            places, list(residual.by("action", model).values()), width, edgecolor="white", label=short(model), **fill
        )
    name_ticks(axes, names)
    axes.set_xlim(-0.6, max(len(names), 3) - 0.4)
    _finish(axes, residual, "action")


def draw_steps(axes: Axes, residual: Residual) -> None:
    """Lines over the steps: all actions together, and thin ones of each for the last model."""
    for name in residual.action_names:
        own = residual.actions == name
        values = [rms(frame) for frame in residual.models[residual.last][own]]
        axes.plot(residual.steps[own], values, color="#c3c9d1", linewidth=0.9, zorder=1)
    for model in residual.models:
        found = residual.by("step", model)
        axes.plot([int(step) for step in found], list(found.values()), label=short(model), **_line(residual, model))
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    _finish(axes, residual, "step (thin lines: each action)")


def draw_fiducials(axes: Axes, residual: Residual) -> None:
    """A mark for each fiducial and model."""
    for model in residual.models:
        style = _line(residual, model) | {"linestyle": ""}
        values = list(residual.by("fiducial", model).values())
        axes.plot(range(len(values)), values, label=short(model), **style)
    name_ticks(axes, residual.fiducials)
    axes.grid(axis="x", color="#eeeeee", linewidth=1)
    axes.set_axisbelow(True)
    _finish(axes, residual, "fiducial")


def draw_map(axes: Axes, residual: Residual) -> None:
    """Length of the last model's residual for each fiducial and frame, actions apart."""
    length = np.linalg.norm(residual.models[residual.last], axis=2).T
    axes.set_facecolor("#e3e6ea")
    image = axes.imshow(length, aspect="auto", cmap=MAP, vmin=0, interpolation="nearest", origin="upper")
    bar = axes.get_figure().colorbar(image, ax=axes, pad=0.02)  # type: ignore[union-attr]
    bar.outline.set_visible(False)
    bar.set_label("residual (mm)")
    name_frames(axes, residual.actions, color="white", linewidth=1.6)
    axes.tick_params(axis="x", length=0)
    every = max(1, -(-len(residual.fiducials) // _NAMES))
    named = [short(name) for name in residual.fiducials[::every]]
    axes.set_yticks(range(0, len(residual.fiducials), every), named, fontsize=8)
    axes.set_ylabel("fiducial")


def _line(residual: Residual, model: str) -> dict[str, Any]:
    if model == residual.last:
        return {"color": DARK, "linewidth": 2, "marker": "o", "markersize": 4.5}
    hollow = {"marker": "s", "markersize": 4.5, "markerfacecolor": "white"}
    return {"color": GREY, "linewidth": 1.4, "linestyle": ":", **hollow}


def _finish(axes: Axes, residual: Residual, label: str) -> None:
    if residual.noise is not None:
        axes.axhline(residual.noise, color="black", linewidth=1.2, linestyle="--", label="noise")
    axes.set_ylim(bottom=0)
    axes.set_xlabel(label)
    axes.set_ylabel("RMS residual (mm)")
