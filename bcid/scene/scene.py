"""The scene: the body, how finely it is meshed, and the places on it that have a name. It holds SI numbers only."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bcid.base.errors import InputError
from bcid.base.fingerprint import file_fingerprint, fingerprint
from bcid.scene.parts import BodyRegion, Driven, Grasp, Level, Limits, Material, Region, Values, Vector, horizontal
from bcid.scene.reader import SceneFile
from bcid.scene.uncertainty import Uncertainty

PhysicsCheck = Callable[["Scene"], list[str]]


@dataclass(frozen=True)
class Scene:
    """What is known of the body before it is pulled; lengths in m.

    Attributes:
        geometry: the `.geo`, surface, label image or mesh file; `length_unit` is the unit (m) of its coordinates.
        parameters: numbers that a `.geo` asks for besides its element size, by name.
        thickness: of a sheet, whose geometry is a flat mesh of triangles, m; None for other bodies.
        thickness_known: whether the sheet has it, or is only computed with it.
        wrinkles: whether the sheet wrinkles where it would be pushed together in its plane.
        label: number of the body in a label image; None for other geometries.
        levels: the mesh ladder, coarsest first.
        patches: candidate anchors by name.
        patch_axes: of candidate patches that hold along some axes only, as a roller does, these (0, 1, 2).
        patch_directions: of candidate patches that hold along directions of their surface, "normal" or "tangent".
        divide: patches that stand for pieces of about this size (m); `bcid.forms.mesh.patches.divided` makes them.
        grasps: grasp areas by name.
        fiducials: stress-free positions by name.
        members: of fiducials that are the mean of points of a dense field, the stress-free positions of those.
        surface: names of the fiducials that are no markers but places on a surface that a depth camera sees.
        places: other named parts of the boundary, for known loads and supports.
        held: places that are known to be held, and the axes (0, 1, 2) along which they do not move; no axis: along their normals.
        driven: places, and grasps, that measured points drive.
        regions: parts of the volume with a stiffness or other constants of their own.
        down: unit vector of gravity.
        fibre_plane: the plane in which fibres and active stresses lie: unit vectors at 0 and at 90 degrees. None is the
            horizontal plane, from the x axis on.
        support: name of the place on which the body lies, "" if it lies on none.
        noise_sigma: per-axis standard deviation of a fiducial when the measurement does not state one.
        attach_within: a fiducial further from the body than this is refused; None means 5 % of the body's size.
        effects: effects that are already part of the model, with their parameters as written.
        limits: what exploring may do to the body; None where nothing is stated.
        uncertainty: how well all this is known.
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
    down: Vector = (0.0, -1.0, 0.0)
    fibre_plane: tuple[Vector, Vector] | None = None
    support: str = ""
    noise_sigma: float | None = None
    attach_within: float | None = None
    effects: dict[str, Values] = field(default_factory=dict)
    limits: Limits | None = None
    uncertainty: Uncertainty = field(default_factory=Uncertainty)
    parameters: dict[str, float] = field(default_factory=dict)
    label: int | None = None
    thickness: float | None = None
    thickness_known: bool = True
    wrinkles: bool = False
    members: dict[str, tuple[Vector, ...]] = field(default_factory=dict)
    surface: tuple[str, ...] = ()
    held: dict[str, tuple[int, ...]] = field(default_factory=dict)
    regions: dict[str, BodyRegion] = field(default_factory=dict)
    driven: dict[str, Driven] = field(default_factory=dict)
    patch_axes: dict[str, tuple[int, ...]] = field(default_factory=dict)
    patch_directions: dict[str, str] = field(default_factory=dict)
    description: str = ""
    source: str = "scene"

    def held_along(self, patch: str) -> tuple[int, ...]:
        """Axes (0, 1, 2) along which a candidate patch, or a piece of one, does not move where it is attached.

        There are none where it holds along a direction of its surface, see `held_direction`.
        """
        if self.held_direction(patch):
            return ()
        return self.patch_axes.get(self._stated(patch, self.patch_axes), (0, 1, 2))

    def held_direction(self, patch: str) -> str:
        """Along which direction of its surface a candidate patch, or a piece of one, does not move where it is attached.

        "normal", "tangent" (all directions within the surface), or "" where it holds along axes.
        """
        return self.patch_directions.get(self._stated(patch, self.patch_directions), "")

    def held_in_words(self, patch: str) -> str:
        """Along what a candidate patch holds: "x z", "its normal", "its surface"; "x y z" where along all."""
        words = {"normal": "its normal", "tangent": "its surface"}
        return words.get(self.held_direction(patch)) or " ".join("xyz"[axis] for axis in self.held_along(patch))

    def _stated(self, patch: str, stated: Mapping[str, Any]) -> str:
        """The patch, or the one that it is a piece of, as far as that is stated."""
        while patch not in stated and "." in patch and patch.rpartition(".")[0] not in self.patches:
            patch = patch.rpartition(".")[0]
        return patch

    def check_undriven(self, what: str) -> None:
        """Refuse a scene that measured points drive, for what is to be done without a measurement."""
        if self.driven:
            rule = "measure it, or describe the larger body and what holds it"
            raise InputError(
                f"scene {self.source}: driven.{next(iter(self.driven))} moves as measured points do, which cannot be {what}; {rule}"
            )

    @property
    def labels(self) -> tuple[int, ...]:
        """Of a label image that the body is made of: its own first, then those of its regions."""
        own = () if self.label is None else (self.label,)
        return tuple(dict.fromkeys([*own, *(r.label for r in self.regions.values() if r.label is not None)]))

    @property
    def fibre_axes(self) -> tuple[Vector, Vector]:
        """Unit vectors of the plane of fibres, at 0 and at 90 degrees."""
        return self.fibre_plane or horizontal(self.down)

    @property
    def fiducial_names(self) -> list[str]:
        """Names in the order of the file."""
        return list(self.fiducials)

    @property
    def rest(self) -> NDArray[np.float64]:
        """Stress-free fiducial positions, shape (fiducials, 3), m."""
        return np.array(list(self.fiducials.values()), dtype=float).reshape(-1, 3)

    def fingerprint(self) -> str:
        """Short hash of the scene and its geometry: not of where the files lie. `InputError` where the geometry cannot be read."""
        content = {
            key: value for key, value in asdict(self).items() if key not in ("geometry", "source", "description")
        }
        # What was added to the format changes no fingerprint where it is not used.
        for key in ("held", "regions", "driven", "patch_axes", "patch_directions"):
            if not content[key]:
                del content[key]
        for key in ("scale", "scale_of_gripper"):
            if content["uncertainty"][key] is None:
                del content["uncertainty"][key]
        if self.thickness is None:
            del content["thickness"], content["thickness_known"]
        if not self.wrinkles:
            del content["wrinkles"]
        for region in content.get("regions", {}).values():
            for key in ("label", "constants"):
                if region[key] in (None, {}):
                    del region[key]
        if not self.material.volumetric:
            del content["material"]["volumetric"]
        return fingerprint({"scene": content, "geometry": file_fingerprint(self.geometry)})

    @classmethod
    def read(cls, path: str | Path, physics: PhysicsCheck | None = None) -> Scene:
        """Read and validate a scene file.

        Args:
            path: the TOML file; paths inside it are relative to it.
            physics: a further check, as `bcid.forms.model.check_physics`, whose findings join the others.

        Raises:
            InputError: with every problem of the file.
        """
        file = SceneFile(Path(path))
        scene = cls(**file.fields())
        if physics is not None and not file.problems.found:
            for problem in physics(scene):
                file.problems.add(path, problem)
        file.problems.raise_if_any()
        return scene
