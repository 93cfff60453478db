"""What a scene has slightly wrong, and what that does to the measured positions: it is integrated over, not fitted.

Each nuisance has a standard deviation (`bcid.scene.uncertainty`) and a sensitivity from the tangent; their products are columns
of low rank in the covariance of the residual (Kennedy & O'Hagan 2001 for the idea; Rasmussen & Williams 2006, section 2.7,
for the algebra).
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bcid.forms.gripper_force import torque_per_force
from bcid.forms.mesh import BodyMesh
from bcid.forms.mesh.shares import share
from bcid.forms.model import Model, Term
from bcid.forms.probes import Probe, Sensitivities, SensitivityRequest
from bcid.forms.scene_errors import Outline, dimensions, grip_term, law_form_term, moved_with
from bcid.inference.data import Data
from bcid.inference.driven_errors import DRIVEN, DrivenErrors
from bcid.inference.pixel_scale import pixel_column, pixel_probes
from bcid.measurement.frame_error import FrameError
from bcid.scene import Scene
from bcid.scene.rotation import as_rotation
from bcid.scene.uncertainty import Uncertainty

Array = NDArray[np.float64]
MARKERS, STIFFNESS = "markers", "stiffness"
# The effects of `bcid.forms.scene_errors` whose every number is an error by itself.
_OWN = ("dimension", "border", "law_form", "grip")


@dataclass(frozen=True)
class NuisanceModes:
    """What nuisances of one standard deviation do to the measured values, m.

    Attributes:
        markers: of the fiducial that a value belongs to, along each axis on the body, shape (n, 3).
        common: of all others, shape (n, k).
        names: of the nuisances that the columns of `common` belong to.
        sizes: standard deviation of every nuisance in its own unit (m, deg or 1), those of markers included.
        numbers: of which effect (`bcid.forms.scene_errors`) they are which number; None where of none, and none by default.
    """

    markers: Array
    common: Array
    names: tuple[str, ...]
    sizes: dict[str, float]
    numbers: tuple[tuple[Term, str] | None, ...] = ()

    @classmethod
    def none(cls, count: int) -> NuisanceModes:
        """Nothing is wrong."""
        return cls(np.zeros((count, 3)), np.zeros((count, 0)), (), {})

    def at(self, rows: NDArray[np.bool_]) -> NuisanceModes:
        """Of some of the values."""
        return replace(self, markers=self.markers[rows], common=self.common[rows])

    def beside(self, columns: Array) -> NuisanceModes:
        """With something that is not told of besides, of one standard deviation, (n, m), m."""
        count = columns.shape[1]
        numbers = (*self.numbers, *(None,) * count) if self.numbers else ()
        names = (*self.names, *("",) * count)
        return replace(self, common=np.hstack([self.common, columns]), names=names, numbers=numbers)

    def of(self, names: Collection[str]) -> NDArray[np.bool_]:
        """Which columns belong to some names, of nuisances or of a part of one ("law.part")."""
        numbers = self.numbers or (None,) * len(self.names)
        own = zip(self.names, numbers, strict=True)
        return np.array([n in names or (of is not None and f"{n}.{of[1]}" in names) for n, of in own], dtype=bool)

    def without(self, names: Collection[str]) -> NuisanceModes:
        """Without those of some names, see `of`, of which that of the markers is none."""
        gone = self.of(names)
        if not gone.any():
            return self
        kept = np.flatnonzero(~gone)
        left = tuple(self.names[n] for n in kept)
        sizes = {name: size for name, size in self.sizes.items() if name in left or name not in self.names}
        return NuisanceModes(
            self.markers, self.common[:, kept], left, sizes, tuple(self.numbers[n] for n in kept if self.numbers)
        )


def stood_for(model: Model) -> frozenset[str]:
    """The nuisances that effects of a model take the place of; of fiducials `placed` says which."""
    return frozenset(term.effect.instead_of for term in model.terms) - {"", MARKERS}


def fitted_instead(model: Model, free: Collection[str]) -> frozenset[str]:
    """The nuisances that are no longer, where numbers of a model are fitted: these, or any stiffness of the law."""
    return frozenset(free) | ({STIFFNESS} if set(free) & set(model.stiffnesses) else frozenset())


def placed(model: Model) -> frozenset[str]:
    """The fiducials of which an effect says from the first frame on where they are.

    Were it unknown besides where they sit on the body, both could cancel at rest, and what is left would pass for strain.
    """
    here = (term for term in model.terms if term.effect.instead_of == MARKERS)
    return frozenset(t.place for t in here if not any(t.values[p.name] > 0 for p in t.effect.parameters if p.onset))


def replaced(modes: NuisanceModes, data: Data, model: Model) -> Array:
    """What nuisances of one standard deviation do in whose place effects of a model act, (n, k), m.

    The numbers of these effects hold them besides: of a marker's fault where it sits on the body too. An amount that is a
    constant of the law is all that there is of it.
    """
    names = {t.effect.instead_of for t in model.terms if not any(p.law for p in t.effect.amounts)} - {"", MARKERS}
    columns = [modes.common[:, modes.of(names)]]
    for fiducial in sorted(placed(model)):
        own = data.fiducial == data.names.index(fiducial)
        columns.append(np.where(own[:, None], modes.markers, 0.0))
    return np.hstack(columns)


def _together(data: Data, term: Term) -> Array:
    """In which values a nuisance has one size, shape (parts, n): what has to do with a grip is another in each action."""
    if not (term.effect.drive or term.place):
        return np.ones((1, len(data)))
    gripped = data.grasp == term.place if term.place else np.ones(len(data), dtype=bool)
    return gripped & (data.action == np.unique(data.action[gripped])[:, None])


def _on_the_spot(data: Data, border: Term, places: Array | None) -> Array:
    """What a fiducial would show more if it moved with a border: it stays where the scene says, (frames, rows, 3)."""
    count = len(data.scene.fiducials)
    moved = np.zeros((len(data.names), 3))
    moved[:count] = moved_with(border, data.scene.rest)
    assert places is not None
    return np.asarray(np.einsum("frca,ra->frc", places - np.eye(3), moved))


class Nuisances:
    """The nuisances of a scene with a mesh of its body.

    Args:
        scene: with its `uncertainty`.
        mesh: of the body.
        forces: whether forces are known: measured, or those of loads.
    """

    def __init__(self, scene: Scene, mesh: BodyMesh, forces: bool = False) -> None:
        self.scene, self._forces = scene, forces
        poisson = scene.material.values.get("poisson")
        self._poisson = float(poisson) if poisson is not None else None
        self._size = float(np.linalg.norm(np.ptp(mesh.points, axis=0)))
        self._middle = (mesh.points.min(axis=0) + mesh.points.max(axis=0)) / 2
        self.sizes = self._sizes(0.0)
        self._patches = {name: Outline.of(mesh, region, f"patch {name}") for name, region in scene.patches.items()}
        self._regions = {
            name: Outline.of_volume(mesh, share(mesh, region, f"regions.{name}"))
            for name, region in scene.regions.items()
        }
        self._driven = DrivenErrors.of(scene, mesh)
        self._grasps = {name: Outline.of(mesh, grasp.region, f"grasp {name}") for name, grasp in scene.grasps.items()}

    def _sizes(self, force: float) -> Uncertainty:
        """Standard deviations where the largest force that was measured is `force`, N."""
        return self.scene.uncertainty.of(self._size, self._poisson, force)

    def wanted(self, model: Model, anchors: Iterable[str]) -> SensitivityRequest:
        """The sensitivities that are needed with a set of anchors."""
        probes = [Probe(term, ("part",)) for term in dimensions()] if self.sizes.dimensions else []
        if self.sizes.borders:
            held = [("", self._patches[patch]) for patch in sorted(anchors)] + sorted(self._grasps.items())
            changing = {term.place for term in model.terms if term.effect.stiffness or term.effect.constants}
            acting = changing | model.region_constants.keys()
            held += [("", outline) for region, outline in self._regions.items() if region in acting]
            probes += [
                Probe(term, ("distance",)) for grasp, outline in held if outline for term in outline.terms(grasp)
            ]
        probes += [Probe(law_form_term(), ("part", "second"))] if self.sizes.law else []
        grip = grip_term()
        wanted = (("grip", "xyz"), ("grip_turn", ("rx", "ry", "rz")))
        probes += [Probe(grip, tuple(names)) for name, names in wanted if getattr(self.sizes, name)]
        law = ["poisson"] if self.sizes.poisson and "poisson" in model.law.complete(model.values) else []
        law += model.stiffnesses if self._forces and self.sizes.stiffness else []
        probes += pixel_probes(model, not self.sizes.scale_of_gripper) if self.sizes.scale else []
        places = bool(self.sizes.markers or self.sizes.borders)
        return SensitivityRequest(tuple(probes), tuple(law), places=places, boundary=bool(self.scene.driven))

    def modes(
        self,
        data: Data,
        found: Sensitivities,
        wanted: SensitivityRequest,
        model: Model | None = None,
        predicted: Array | None = None,
    ) -> NuisanceModes:
        """Their columns, from the sensitivities that were wanted.

        Where forces are measured also from the model and what it predicts, (frames, rows, 3), m.
        """
        columns: list[Array] = []
        names: list[str] = []
        numbers: list[tuple[Term, str] | None] = []
        sizes = self._sizes(largest_force(data))
        of_effect = {
            "dimension": ("dimensions", sizes.dimensions),
            "border": ("borders", sizes.borders),
            "law_form": ("law", sizes.law),
        }
        turns = ("grip_turn", sizes.grip_turn), ("grip", sizes.grip)
        for probe, arrays in zip(wanted.probes, found.probes, strict=True):
            # What is no error by itself is part of that of the length of a pixel.
            for parameter, array in arrays.items() if probe.effect.name in _OWN else ():
                name, size = of_effect.get(probe.effect.name) or turns[not parameter.startswith("r")]
                seen = array - _on_the_spot(data, probe.term, found.places) if name == "borders" else array
                parts = _together(data, probe.term) * np.nan_to_num(data.vector(seen))
                columns += [part * float(size or 0.0) for part in parts]
                names += [name] * len(parts)
                numbers += [(probe.term, parameter)] * len(parts)
        if sizes.scale:
            columns.append(pixel_column(data, found, wanted, model, predicted) * sizes.scale)
            names.append("scale")
        for name, column in self._of_law(data, found, model):
            columns.append(column)
            names.append(name)
        for name, column in force_modes(data, sizes, predicted) if predicted is not None else ():
            columns.append(column)
            names.append(name)
        # Where it is known for sure where they sit, whatever the body's size, it takes none along.
        for column in self._taken_along(data) if sizes.markers else ():
            columns.append(column * float(sizes.dimensions or 0.0))
            names.append("dimensions")
        if found.boundary is not None:
            driven = self._driven.columns(data, found.boundary)
            columns += list(driven.T)
            names += [DRIVEN] * driven.shape[1]
        if sizes.camera and data.measurement.frame_error is None:
            turned = self._camera(data)
            columns += list(turned.T)
            names += ["camera"] * turned.shape[1]
        markers: Array = np.zeros((len(data), 3))
        if found.places is not None:
            markers = np.nan_to_num(data.vector(found.places)) * float(sizes.markers or 0.0)
        # What does not matter here, as the grip where no gripper moves, is not told of.
        felt = [number for number, column in enumerate(columns) if column.any()]
        matrix = np.column_stack([columns[number] for number in felt] or [np.zeros((len(data), 0))])
        names = [names[number] for number in felt]
        stated = {
            name: float(getattr(sizes, name)) for name in (MARKERS, *dict.fromkeys(names)) if getattr(sizes, name, None)
        }
        if DRIVEN in names:
            stated[DRIVEN] = self._driven.size
        numbers += [None] * (len(columns) - len(numbers))
        return NuisanceModes(markers, matrix, tuple(names), stated, tuple(numbers[number] for number in felt))

    def _of_law(self, data: Data, found: Sensitivities, model: Model | None) -> list[tuple[str, Array]]:
        """Of Poisson's ratio, and of all stiffnesses of the law together, which only forces and loads tell."""
        moved = {name: np.nan_to_num(data.vector(array)) for name, array in found.law.items()}
        columns = [("poisson", moved.pop("poisson") * float(self.sizes.poisson or 0.0))] if "poisson" in moved else []
        if moved and model is not None:
            constants = model.stiffnesses
            together = sum(constants[name] * column for name, column in moved.items())
            columns.append((STIFFNESS, np.asarray(together) * float(self.sizes.stiffness or 0.0)))
        return columns

    def _taken_along(self, data: Data) -> list[Array]:
        """Where a body that is larger by its own size along an axis has its fiducials, of each axis, (n,), m."""
        away = self.scene.rest - self._middle
        found = []
        for axis in range(3):
            moved = np.zeros((*data.mask.shape[:2], 3))
            moved[:, : len(away), axis] = away[:, axis]
            found.append(data.vector(moved))
        return found

    def _camera(self, data: Data) -> Array:
        variance = np.radians(float(self.sizes.camera or 0.0)) ** 2
        centre = data.points.reshape(-1, 3).mean(axis=0)
        error = FrameError(centre, np.diag([variance] * 3 + [0.0] * 4))
        return data.moved(error.modes(data.points))


def force_modes(data: Data, sizes: Uncertainty, predicted: Array) -> list[tuple[str, Array]]:
    """Columns (n,), m, of one standard deviation each, with the name of the nuisance they belong to.

    The sensor turns with the gripper. What it shows without a force is the same in all actions, and drifts in each by itself.
    `predicted` are the values, (frames, rows, 3), m.
    """
    forces = data.forces
    if forces is None or not (data.kind > 0).any():
        return []
    found = [("force_gain", np.where(data.kind > 0, data.vector(predicted), 0.0) * float(sizes.force_gain or 0.0))]
    for axes in _axes(data):
        found.append(("force_bias", axes * float(sizes.force_bias or 0.0)))
        drift = axes * data.progress * float(sizes.force_drift or 0.0)
        found += [("force_drift", np.where(data.action == a, drift, 0.0)) for a in range(len(data.actions))]
    found += [("gripper_weight", column * float(sizes.gripper_weight or 0.0)) for column in _weights(data)]
    return found


def largest_force(data: Data) -> float:
    """N; 0 where none is measured."""
    return float(np.nanmax(np.abs(data.measurement.wrenches[:, :3]), initial=0.0)) if data.forces else 0.0


def _axes(data: Data) -> list[Array]:
    """A force of 1 N along each axis of the gripper in turn, and a torque that goes with it about each, (n,), m."""
    assert data.forces is not None
    turned = np.stack([_turned(data, unit) for unit in np.eye(3)])
    of_force, of_torque = 1 / data.forces.units.ravel()
    along = turned[:, data.frame, data.axis]
    found = [np.where(data.kind == 1, row * of_force, 0.0) for row in along]
    return found + [
        np.where(data.kind == 2, row * of_torque * torque_per_force(data.measurement.wrenches), 0.0) for row in along
    ]


def _weights(data: Data) -> list[Array]:
    """A weight of 1 N: its force, and torques about the grasp of arms along each axis of the gripper, (n,), m."""
    assert data.forces is not None
    down = np.array(data.scene.down, dtype=float)
    of_force, of_torque = 1 / data.forces.units.ravel()
    found = [np.where(data.kind == 1, down[data.axis] * of_force, 0.0)]
    for unit in np.eye(3):
        torque = np.cross(_turned(data, unit), down) * torque_per_force(data.measurement.wrenches)
        found.append(np.where(data.kind == 2, torque[data.frame, data.axis] * of_torque, 0.0))
    return found


def _turned(data: Data, direction: Array) -> Array:
    """A direction of the gripper in each frame, shape (frames, 3)."""
    return np.asarray(as_rotation(data.measurement.data["rotation"].values).apply(direction))
