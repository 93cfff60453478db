"""Marker fault: one fiducial is not where the scene says, or has come loose.

Its offset (m) is added to what is seen of the fiducial that is its place, from the frame with the number `onset` on
(counted over the whole measurement from 0).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from bcid.forms.effects import _needs
from bcid.forms.effects.effect import Array, Frame, ObservationEffect
from bcid.forms.parameter import Amount, Shape


def observe(positions: Array, values: Mapping[str, float], frame: Frame, place: str) -> Array:
    """Where the fiducials appear."""
    if frame.index < values["onset"] or place not in frame.names:
        return positions
    moved = positions.copy()
    moved[frame.names.index(place)] += np.array([values[name] for name in ("x", "y", "z")])
    return moved


effect = ObservationEffect(
    name="marker_fault",
    parameters=(
        *(Amount(axis, "m", f"offset along {axis}", lower=-0.1, upper=0.1, neutral=0.0, scale=2e-3) for axis in "xyz"),
        Shape("onset", "1", "first frame that is wrong", default=0.0, lower=0.0, scan=(0.0,), onset=True),
    ),
    about="one fiducial is not where the scene says",
    acts_on="observation",
    observe=observe,
    places=lambda scene, _anchors: [name for name in scene.fiducials if name not in scene.surface],
    needs=_needs.single_markers,
    instead_of="markers",
)
