"""Nuisances in words and numbers, as summaries and results tell them."""

from __future__ import annotations

from collections.abc import Sequence

from bcid.base.units import for_people
from bcid.inference.driven_errors import DRIVEN
from bcid.inference.error_covariance import NuisanceEstimate
from bcid.results.common_rows import InputUncertaintyRow
from bcid.scene.uncertainty import ANGLES, FORCES, LENGTHS

# What is off.
_OFF = {
    "markers": "markers would have to sit {} from where the scene has them",
    "dimensions": "the body would have to be larger or smaller than the scene has it by {}",
    "borders": "patches or regions would have to end {} from where the scene has them end",
    "grip": "the gripper would have to be {} from where it is reported",
    "grip_turn": "the gripper would have to be turned by {} against what is reported",
    "camera": "the measured frame would have to be turned by {}",
    "scale": "a pixel would have to be longer or shorter by {}",
    "poisson": "Poisson's ratio would have to be off by {}",
    "law": "the law would have to stiffen or soften with strain by {} shear moduli, as the coefficient of (I1bar - 3)^2",
    "stiffness": "the body would have to be stiffer or softer than the scene has it by {}",
    "force_gain": "the gain of the force sensor would have to be off by {}",
    "force_bias": "the force sensor would have to show {} without a force",
    "force_drift": "what the force sensor shows without a force would have to change over an action by {}",
    "gripper_weight": "the gripper would have to weigh {}",
    DRIVEN: "what measured points drive would have to be {} from where these have it",
}
_RELATIVE = ("dimensions", "scale", "stiffness", "force_gain", "noise")
_UNITS = dict.fromkeys(LENGTHS, "m") | dict.fromkeys(ANGLES, "deg") | dict.fromkeys(FORCES, "N") | {DRIVEN: "m"}


def _at_length(one: NuisanceEstimate) -> str:
    """That a nuisance is larger than the scene says."""
    off = _OFF[one.name].format(f"up to {_amount(one, one.most * one.size)}")
    return f"{off}, where {_amount(one, one.size)} is allowed for (a standard deviation)"


def _briefly(one: NuisanceEstimate) -> str:
    """How large a nuisance would have to be, and what is allowed for."""
    return f"{one.name.replace('_', ' ')} {_amount(one, one.most * one.size)} ({_amount(one, one.size)})"


def rows(estimates: Sequence[NuisanceEstimate]) -> tuple[InputUncertaintyRow, ...]:
    """As results hold them."""
    return tuple(
        InputUncertaintyRow(
            name=one.name,
            stddev=one.size,
            estimate=one.found,
            largest_sigmas=one.most,
            text=f"{one.name} {_amount(one, one.size)} ({_amount(one, one.found)})",
            exceeds_prior=_at_length(one) if one.used_up else "",
            exceeds_prior_short=_briefly(one) if one.used_up else "",
        )
        for one in estimates
    )


def _amount(one: NuisanceEstimate, value: float) -> str:
    return amount(one.name, value)


def amount(name: str, value: float) -> str:
    """A value of a nuisance with its unit: "0.41 mm", "2 %"."""
    if name in _RELATIVE:
        return f"{100 * value:.2g} %"
    shown, _, unit = for_people(value, None, _UNITS.get(name, "1"))
    return f"{shown:.2g}" if unit == "1" else f"{shown:.2g} {unit}"
