"""Rows that several files hold: numbers, patches' stiffnesses, input uncertainties."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from bcid.results.record import Record, length


def set_label(anchored: Iterable[str]) -> str:
    """An anchor set: "{1 2}"."""
    return "{" + " ".join(anchored) + "}"


@dataclass(frozen=True, kw_only=True)
class ParameterRow(Record):
    """A number of an effect, in its unit.

    Attributes:
        value: None where these data do not determine it.
        stderr: standard error, or None.
        limit: where the number ended at a bound, the end of its one-sided 95 % interval, else None.
        unit: as "Pa"; "1" for none.
    """

    value: float | None
    stderr: float | None
    limit: float | None = None
    unit: str


@dataclass(frozen=True, kw_only=True)
class ConstantRow(Record):
    """A fitted constant of a constitutive model.

    Attributes:
        value, stderr: the estimate and its standard error (None: not identifiable).
        interval: 95 % interval; None where it is not identifiable.
        unit: as "Pa", or "N/mm" for a stiffness times an unknown thickness.
        per_thickness: whether it is times the unknown thickness of a sheet.
    """

    value: float
    stderr: float | None
    interval: tuple[float, ...] | None
    unit: str
    per_thickness: bool

    @property
    def times(self) -> str:
        """What the constant is multiplied by, in words after its name."""
        return " x thickness" if self.per_thickness else ""


@dataclass(frozen=True, kw_only=True)
class StiffnessRow(ConstantRow):
    """A stiffness that measured forces determine.

    Attributes:
        scene: its value in the scene.
    """

    scene: float


@dataclass(frozen=True, kw_only=True)
class StiffnessRecord(Record):
    """How stiff the body is by known forces.

    Attributes:
        constants: stiffnesses of the constitutive model.
    """

    constants: dict[str, StiffnessRow]

    @property
    def text(self) -> str:
        """As in summaries: "young = 15210 Pa (95 %: 14600 to 15900; the scene has 15000)"."""
        parts = [
            f"{name}{one.times} = {one.value:.4g} {one.unit} (95 %: {one.interval[0]:.3g} to {one.interval[1]:.3g}; "
            f"the scene has {one.scene:.6g})"
            for name, one in self.constants.items()
            if one.interval
        ]
        return ", ".join(parts) + unknown_thickness(self.constants.values())


def unknown_thickness(constants: Iterable[ConstantRow]) -> str:
    """Why constants times a thickness stand in a list, as a sentence for its end; "" where none does."""
    if not any(one.per_thickness for one in constants):
        return ""
    return "; the thickness is unknown, so that the constants themselves are not known"


@dataclass(frozen=True, kw_only=True)
class InputUncertaintyRow(Record):
    """An input of the scene that may be slightly wrong, SI.

    Attributes:
        name: as "markers".
        stddev: its prior standard deviation.
        estimate: RMS of its posterior mean.
        largest_sigmas: its largest posterior mean, in prior standard deviations.
        text: name, prior standard deviation and estimate, in words; "" in files of format/1.
        exceeds_prior: what it would have to be, where the prior does not hold it; "" where it does.
        exceeds_prior_short: the same in a few words.
    """

    name: str
    stddev: float
    estimate: float
    largest_sigmas: float
    text: str = ""
    exceeds_prior: str
    exceeds_prior_short: str


@dataclass(frozen=True, kw_only=True)
class LeftOutRow(Record):
    """Frames that were not compared, and test the model.

    Attributes:
        frames: how many.
        rms: RMS residual per coordinate in them.
        compared_rms: in those that were compared.
    """

    frames: int
    rms: float = length()
    compared_rms: float = length()

    @property
    def text(self) -> str:
        """As in summaries; the row is in mm."""
        return (
            f"{self.frames} more frames were not compared, and are a test: the model misses them by {self.rms:.3g} mm, "
            f"those that were compared by {self.compared_rms:.3g} mm."
        )


@dataclass(frozen=True, kw_only=True)
class ComparedRow(Record):
    """What was compared.

    Attributes:
        actions, frames, markers: how many.
        points: of a dense field, of which the markers are means; 0 for none.
        surface: points of the surface that were seen, in words; "" for none.
    """

    actions: int
    frames: int
    markers: int
    points: int
    surface: str
