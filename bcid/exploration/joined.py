"""Pulls as one measurement: what is common to all of them, as where the markers sit, is then common in their errors too."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import xarray as xr

from bcid.measurement import Measurement
from bcid.scene import Scene


def joined(pulls: Sequence[Measurement], scene: Scene) -> Measurement:
    """Measurements of one action each as one measurement, its actions numbered from 1."""
    parts = []
    for number, pull in enumerate(pulls, start=1):
        sigma = pull.sigma(scene.noise_sigma)
        data = pull.data.assign_coords(action=("frame", [str(number)] * pull.data.sizes["frame"]))
        if sigma is not None:
            data["sigma"] = (data["position"].dims, np.broadcast_to(sigma, data["position"].shape))
        parts.append(data)
    whole = xr.concat(parts, dim="frame", join="outer")
    return replace(pulls[0], data=whole)
