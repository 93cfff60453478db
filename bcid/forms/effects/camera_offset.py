"""Camera offset: the frame of the measured positions is turned, shifted or scaled.

A fiducial at x appears at m + scale R (x - m) + t, with the middle m of the stress-free fiducials, the rotation vector
(rx, ry, rz) of R (deg) and the shift t (m).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from bcid.forms.effects.effect import Array, Frame, ObservationEffect
from bcid.forms.parameter import Amount
from bcid.scene.rotation import from_vector, rotate


def observe(positions: Array, values: Mapping[str, float], frame: Frame, _place: str) -> Array:
    """Where the fiducials appear."""
    turned = from_vector([values[name] for name in ("rx", "ry", "rz")])
    shift = np.array([values[name] for name in ("tx", "ty", "tz")])
    middle = frame.rest.mean(axis=0)
    return middle + values["scale"] * rotate(turned, positions - middle) + shift


effect = ObservationEffect(
    name="camera_offset",
    parameters=(
        *(
            Amount(f"r{axis}", "deg", f"rotation about {axis}", lower=-90.0, upper=90.0, neutral=0.0, scale=2.0)
            for axis in "xyz"
        ),
        *(
            Amount(f"t{axis}", "m", f"shift along {axis}", lower=-1.0, upper=1.0, neutral=0.0, scale=1e-3)
            for axis in "xyz"
        ),
        Amount("scale", "1", "scale", lower=0.5, upper=2.0, neutral=1.0, scale=0.02),
    ),
    about="the measured frame is turned, shifted or scaled",
    acts_on="observation",
    observe=observe,
    instead_of="camera",
)
