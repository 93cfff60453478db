"""What rendered pictures look like: beads, tissue, light, blur and noise."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bcid.base.errors import Problems
from validation.rendering.vectors import unit

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Appearance:
    """What the pictures look like. Greys are reflectances from 0 (black) to 1; a white surface in full light is at 255.

    Attributes:
        diameter: of the beads, m.
        bead, body, background: greys.
        lamp: its position in the left camera's frame, m.
        strength: of the lamp, at the middle of the body.
        ambient: light from everywhere.
        specular: gloss of the beads.
        blur: standard deviation of the Gaussian blur, px.
        noise: standard deviation of the noise, grey levels.
        supersampling: rays across a pixel of a bead.
        texture: standard deviation of the tissue's mottling, relative; 0 is plain tissue.
        decoys: number of dots like beads that do not move with the body: a third on the gripper, if the first frame has
            one, the others on the background. Those that would be seen nowhere are left out.
    """

    diameter: float = 1e-3
    bead: float = 0.06
    body: float = 0.8
    background: float = 0.3
    lamp: tuple[float, float, float] = (-0.12, -0.16, 0.02)
    strength: float = 0.65
    ambient: float = 0.3
    specular: float = 0.15
    blur: float = 0.7
    noise: float = 2.0
    supersampling: int = 3
    texture: float = 0.03
    decoys: int = 0

    def __post_init__(self) -> None:
        problems = Problems("look of the pictures")
        for name in ("diameter", "supersampling"):
            if not 0 < getattr(self, name) < math.inf:
                problems.add(name, f"must be positive, is {getattr(self, name)}")
        for name in ("strength", "ambient", "specular", "blur", "noise", "texture", "decoys"):
            if not 0 <= getattr(self, name) < math.inf:
                problems.add(name, f"must not be negative, is {getattr(self, name)}")
        for name in ("bead", "body", "background"):
            if not 0 <= getattr(self, name) <= 1:
                problems.add(name, f"a grey is from 0 to 1, not {getattr(self, name)}")
        for name in ("supersampling", "decoys"):
            if getattr(self, name) != int(getattr(self, name)):
                problems.add(name, f"must be a whole number, is {getattr(self, name)}")
        if len(self.lamp) != 3 or not np.isfinite(self.lamp).all():
            problems.add("lamp", f"must be three finite coordinates, is {self.lamp}")
        problems.raise_if_any()

    @property
    def radius(self) -> float:
        """Of the beads, m."""
        return self.diameter / 2

    def centres(self, surface: Array, normals: Array) -> Array:
        """Centres (k, 3) of beads that touch `surface` (k, 3), m, where its outward normals are `normals` (k, 3)."""
        return np.asarray(surface + self.radius * unit(np.asarray(normals, dtype=float)))
