"""Directions in the plane of fibres: the angle that several effects have."""

from __future__ import annotations

from bcid.forms.parameter import Shape


def angle(harmonics: int) -> Shape:
    """An angle in degrees that means the same after half a turn.

    What the effect does is a polynomial in cos 2a of degree `harmonics`, which twice as many values and one more determine.
    """
    count = 2 * harmonics + 1
    return Shape(
        "angle",
        "deg",
        "direction in the plane of fibres",
        default=0.0,
        lower=-180.0,
        upper=360.0,
        scale=20.0,
        scan=tuple(180.0 * k / count for k in range(count)),
        period=180.0,
        harmonics=harmonics,
    )
