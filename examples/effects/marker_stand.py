"""Marker stand: a marker stands above the body, and tilts with it.

What is seen of the marker that is its place moves by (R - I) h z, with its height h (m) above the point of the body that it
is fixed to, along z at rest. R is the rotation that best takes the markers' places on the body from rest to where they
are, so that all of them should sit on a part that hardly deforms.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from bcid.forms.effects.effect import Array, Frame, ObservationEffect
from bcid.forms.parameter import Amount


def observe(positions: Array, values: Mapping[str, float], frame: Frame, place: str) -> Array:
    """Where the markers appear."""
    stand = np.zeros_like(positions)
    stand[frame.names.index(place), 2] = values["height"]
    # What turns is the body, where the marker stands on it.
    return np.asarray(positions - stand + stand @ rotation(frame.rest - stand, positions - stand).T)


def rotation(before: Array, after: Array) -> Array:
    """The rotation that takes points (n, 3) closest to others (Kabsch, Acta Cryst. A 32, 1976)."""
    u, _, v = np.linalg.svd((before - before.mean(axis=0)).T @ (after - after.mean(axis=0)))
    turn = np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ v))])
    return np.asarray((u @ turn @ v).T)


effect = ObservationEffect(
    name="marker_stand",
    parameters=(Amount("height", "m", "height above the body", lower=-0.05, upper=0.05, neutral=0.0, scale=5e-3),),
    about="a marker stands above the body, and tilts with it",
    acts_on="observation",
    observe=observe,
    places=lambda scene, _anchors: list(scene.fiducials),
)
