"""The scene: the body, how finely it is meshed, and the places on it that have a name. It holds SI numbers only."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Values = dict[str, Any]
PhysicsCheck = Callable[["Scene"], list[str]]


@dataclass(frozen=True)
class Level:
    """One rung of the mesh ladder.

    `element_size` (m) drives a `.geo` file; for a mesh file `refinements` counts uniform refinements of it.
    `degree` is the polynomial degree of the displacement, 1 or 2 (3 only in code: for reference solutions).
    """

    degree: int = 1
    element_size: float | None = None
    refinements: int = 0


@dataclass(frozen=True)
class Box:
    """Boundary facets whose corners all lie in a box (m), and on a plane if one is given."""

    lower: tuple[float, float, float]
    upper: tuple[float, float, float]


@dataclass(frozen=True)
class Plane:
    """Boundary facets whose corners all lie on a plane through `point` (m) with `normal`."""

    point: tuple[float, float, float]
    normal: tuple[float, float, float]


@dataclass(frozen=True)
class Region:
    """Part of the boundary: physical groups of the mesh, or the facets inside a box and/or on a plane.

    Of these, `within` takes the facets whose middle m has lower <= m < upper on every axis (m; infinite where nothing is
    cut off). Boxes that tile the space so take every facet of every mesh exactly once.
    """

    groups: tuple[str, ...] = ()
    box: Box | None = None
    plane: Plane | None = None
    within: Box | None = None


@dataclass(frozen=True)
class Grasp:
    """Where the gripper holds the body, and the centre (m) about which it turns."""

    region: Region
    centre: tuple[float, float, float]


@dataclass(frozen=True)
class Material:
    """Name of a law, its constants as written (units are the law's business), and the formulation."""

    law: str
    values: Values
    formulation: str = "displacement"


@dataclass(frozen=True)
class Limits:
    """What a robot may do to the body, and what it costs.

    Attributes:
        displacement: the gripper's distance from rest is never larger, m.
        force: of the gripper, N; None for no limit.
        strain: largest principal strain (stretch - 1, either sign) that 99 % of the volume may reach; None for no limit.
        amplitudes: how far a pull may go, m, the largest first.
        directions: unit vectors by name.
        steps: of a pull, to its end; as many lead back to rest.
        cost: of one pull.
        regrasp: what changing the grasp costs besides.
    """

    displacement: float
    force: float | None = None
    strain: float | None = None
    amplitudes: tuple[float, ...] = ()
    directions: dict[str, tuple[float, float, float]] = field(default_factory=dict)
    steps: int = 4
    cost: float = 1.0
    regrasp: float = 0.0


@dataclass(frozen=True)
class Scene:
    """What is known of the body before it is pulled; lengths in m.

    Attributes:
        geometry: the `.geo` or mesh file; `length_unit` is the unit (m) of its coordinates.
        parameters: numbers that a `.geo` asks for besides its element size, by name.
        levels: the mesh ladder, coarsest first.
        patches: candidate anchors by name.
        divide: patches that stand for pieces of about this size (m); `bcid.forms.patches.divided` makes them.
        grasps: grasp areas by name.
        fiducials: stress-free positions by name.
        places: other named parts of the boundary, for known loads and supports.
        down: unit vector of gravity.
        support: name of the place on which the body lies, "" if it lies on none.
        noise_sigma: per-axis standard deviation of a fiducial when the measurement does not state one.
        attach_within: a fiducial further from the body than this is refused; None means 5 % of the body's size.
        effects: effects that are already part of the model, with their parameters as written.
        limits: what exploring may do to the body; None where nothing is stated.
    """

    name: str
    geometry: Path
    length_unit: float
    levels: tuple[Level, ...]
    material: Material
    patches: dict[str, Region]
    grasps: dict[str, Grasp]
    fiducials: dict[str, tuple[float, float, float]]
    places: dict[str, Region] = field(default_factory=dict)
    divide: dict[str, float] = field(default_factory=dict)
    down: tuple[float, float, float] = (0.0, -1.0, 0.0)
    support: str = ""
    noise_sigma: float | None = None
    attach_within: float | None = None
    effects: dict[str, Values] = field(default_factory=dict)
    limits: Limits | None = None
    parameters: dict[str, float] = field(default_factory=dict)
    description: str = ""
    source: str = "scene"

    @property
    def fiducial_names(self) -> list[str]:
        """Names in the order of the file."""
        return list(self.fiducials)

    @property
    def rest(self) -> NDArray[np.float64]:
        """Stress-free fiducial positions, shape (fiducials, 3), m."""
        return np.array(list(self.fiducials.values()), dtype=float).reshape(-1, 3)

    @classmethod
    def read(cls, path: str | Path, physics: PhysicsCheck | None = None) -> Scene:
        """Read and validate a scene file.

        Args:
            path: the TOML file; paths inside it are relative to it.
            physics: a further check, as `bcid.forms.model.check_physics`, whose findings join the others.

        Raises:
            InputError: with every problem of the file.
        """
        from bcid.scene.reader import read_scene

        return read_scene(Path(path), physics)
