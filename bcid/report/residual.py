"""What the models miss, by action, step and fiducial, and fiducial by frame."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from bcid.base.units import unit_factor
from bcid.report.figure import DARK, GREY, LIGHT, chart, legend_below, name_ticks, short
from bcid.report.text import model_name

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]
# More fiducials than these have every so many named.
_NAMES = 24


@dataclass(frozen=True)
class Residual:
    """Measured minus predicted positions of one or two models.

    Attributes:
        models: by name (the first model before the last), shape (frames, fiducials, 3), in `unit`; NaN where not seen.
        actions, steps: of each frame.
        fiducials: their names.
        noise: standard deviation of a coordinate in `unit`, or None.
        unit: of length.
    """

    models: dict[str, Array]
    actions: NDArray[np.str_]
    steps: NDArray[np.int64]
    fiducials: list[str]
    noise: float | None
    unit: str

    @classmethod
    def of(cls, positions: xr.Dataset, noise: float | None, unit: str) -> Residual:
        """The residuals of a run's `residuals.nc` or `prediction.nc`; `noise` in `unit`."""
        length = unit_factor(unit, "m")
        measured = positions["measured"].values / length
        models = {
            model_name(str(positions.attrs.get("model", "model"))): measured - positions["predicted"].values / length
        }
        first = model_name(str(positions.attrs.get("model_first", "")))
        if "predicted_first" in positions and first not in models:
            models = {first: measured - positions["predicted_first"].values / length} | models
        fiducials = [str(name) for name in positions["fiducial"].values] if "fiducial" in positions.coords else []
        return cls(
            models,
            positions["action"].values.astype(str),
            positions["step"].values.astype(int),
            fiducials or [str(i + 1) for i in range(measured.shape[1])],
            noise,
            unit,
        )

    @property
    def action_names(self) -> list[str]:
        """In the order of the frames."""
        return list(dict.fromkeys(str(name) for name in self.actions))

    def by_action(self, model: str) -> list[float]:
        """RMS per coordinate of each action."""
        return [rms(self.models[model][self.actions == name]) for name in self.action_names]

    def by_step(self, model: str) -> tuple[list[int], list[float]]:
        """Steps, and RMS per coordinate of each, over all actions."""
        steps = sorted({int(step) for step in self.steps})
        return steps, [rms(self.models[model][self.steps == step]) for step in steps]

    def by_fiducial(self, model: str) -> list[float]:
        """RMS per coordinate of each fiducial."""
        return [rms(self.models[model][:, i]) for i in range(len(self.fiducials))]

    @property
    def last(self) -> str:
        """The last model's name."""
        return list(self.models)[-1]


def rms(values: Array) -> float:
    """Root mean square of what is there; NaN where nothing is."""
    seen = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(seen**2))) if len(seen) else float("nan")


def action_chart(residual: Residual) -> Figure:
    """Bars for each action."""
    figure, axes = chart()
    names = residual.action_names
    width = 0.76 / len(residual.models)
    for k, model in enumerate(residual.models):
        places = np.arange(len(names)) + (k - (len(residual.models) - 1) / 2) * width
        axes.bar(
            places, residual.by_action(model), width, edgecolor="white", label=short(model), **_fill(residual, model)
        )
    name_ticks(axes, names)
    axes.set_xlim(-0.6, max(len(names), 3) - 0.4)
    axes.set_xlabel("action")
    return _finished(figure, axes, residual)


def step_chart(residual: Residual) -> Figure:
    """Lines over the steps: all actions together, and thin ones of each for the last model."""
    from matplotlib.ticker import MaxNLocator

    figure, axes = chart()
    for name in residual.action_names:
        own = residual.actions == name
        values = [rms(frame) for frame in residual.models[residual.last][own]]
        axes.plot(residual.steps[own], values, color="#c3c9d1", linewidth=0.9, zorder=1)
    for model in residual.models:
        axes.plot(*residual.by_step(model), label=short(model), **_line(residual, model))
    axes.set_xlabel("step (thin lines: each action)")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    return _finished(figure, axes, residual)


def fiducial_chart(residual: Residual) -> Figure:
    """A mark for each fiducial and model."""
    figure, axes = chart()
    for model in residual.models:
        style = _line(residual, model) | {"linestyle": ""}
        axes.plot(range(len(residual.fiducials)), residual.by_fiducial(model), label=short(model), **style)
    name_ticks(axes, residual.fiducials)
    axes.grid(axis="x", color="#eeeeee", linewidth=1)
    axes.set_axisbelow(True)
    axes.set_xlabel("fiducial")
    return _finished(figure, axes, residual)


def map_chart(residual: Residual) -> Figure:
    """Length of the last model's residual for each fiducial and frame, actions apart."""
    figure, axes = chart()
    length = np.linalg.norm(residual.models[residual.last], axis=2).T
    axes.set_facecolor("#e3e6ea")
    image = axes.imshow(length, aspect="auto", cmap="cividis", vmin=0, interpolation="nearest", origin="upper")
    bar = figure.colorbar(image, ax=axes, pad=0.02)
    bar.outline.set_visible(False)
    bar.set_label(f"residual ({residual.unit})")
    begins = [int(np.flatnonzero(residual.actions == name)[0]) for name in residual.action_names]
    for begin in begins[1:]:
        axes.axvline(begin - 0.5, color="white", linewidth=1.6)
    few = max(1, -(-len(begins) // 10))
    axes.set_xticks(begins[::few], [short(name) for name in residual.action_names[::few]], ha="left")
    axes.tick_params(axis="x", length=0)
    every = max(1, -(-len(residual.fiducials) // _NAMES))
    axes.set_yticks(
        range(0, len(residual.fiducials), every), [short(n) for n in residual.fiducials[::every]], fontsize=8
    )
    axes.set_xlabel("frames of action")
    axes.set_ylabel("fiducial")
    return figure


def _fill(residual: Residual, model: str) -> dict[str, Any]:
    return {"color": DARK} if model == residual.last else {"color": LIGHT, "hatch": "///"}


def _line(residual: Residual, model: str) -> dict[str, Any]:
    if model == residual.last:
        return {"color": DARK, "linewidth": 2, "marker": "o", "markersize": 4.5}
    return {
        "color": GREY,
        "linewidth": 1.4,
        "linestyle": ":",
        "marker": "s",
        "markersize": 4.5,
        "markerfacecolor": "white",
    }


def _finished(figure: Figure, axes: Axes, residual: Residual) -> Figure:
    if residual.noise is not None:
        axes.axhline(residual.noise, color="black", linewidth=1.2, linestyle="--", label="noise")
    axes.set_ylim(bottom=0)
    axes.set_ylabel(f"RMS residual ({residual.unit})")
    legend_below(figure, axes)
    return figure
