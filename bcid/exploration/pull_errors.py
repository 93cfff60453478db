"""How likely pulls are with an anchor set: the one likelihood, over all pulls as one measurement."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from bcid.exploration.joined import joined
from bcid.forms.gripper_force import ForceScale
from bcid.forms.model import Model
from bcid.inference.criteria import MAX_NORMALISED_RMS
from bcid.inference.data import Data
from bcid.inference.discrepancy import Evidence, SmoothDiscrepancy
from bcid.inference.error_covariance import ErrorCovariance
from bcid.inference.mesh_error import MeshError
from bcid.inference.nuisances import NuisanceModes
from bcid.inference.relative import relative
from bcid.inference.stiffness import Stiffness
from bcid.measurement import Measurement
from bcid.scene import Scene

Array = NDArray[np.float64]
Anchored = frozenset[str]
Frames = NDArray[np.bool_]
# A body that may buckle in a pull is taken to go anywhere within this part of its motion; half as much differs from frame to frame.
_ANYWHERE, _ROUGH = 0.5, 0.5


@dataclass(frozen=True)
class ErrorModel:
    """What is known of the errors about a set's prediction, in all frames of all pulls; it serves for sets like it too.

    Attributes:
        mesh: error of the mesh.
        modes: of the nuisances.
        unknown: what something unknown and smooth does.
        adrift: numbers of the pulls in which the mesh tells nothing: the fine level cannot be followed.
    """

    mesh: MeshError
    modes: NuisanceModes
    unknown: SmoothDiscrepancy
    adrift: frozenset[int] = frozenset()

    @classmethod
    def nothing(cls, data: Data) -> ErrorModel:
        """Before anything is known."""
        count = len(data)
        return cls(MeshError.unknown(data.mask.shape), NuisanceModes.none(count), SmoothDiscrepancy.nothing(count))


@dataclass(frozen=True)
class Weighed:
    """What the pulls say of a set with its own allowance.

    Attributes:
        evidence: without and with an unknown force.
        more: by how much the evidence exceeds the likelihood with the likeliest force.
    """

    evidence: Evidence
    more: float

    @property
    def missing(self) -> Evidence | None:
        """What is likeliest of something unknown, where that is likelier than nothing."""
        return self.evidence if self.evidence.forced > self.evidence.plain else None


class PullErrors:
    """Compares sets with pulls.

    Args:
        scene: the scene.
        seen: the pulls, one measurement each.
        unit: of the density of an unknown force, N/m^3.
        gripper: what force and torque of the gripper are divided by; None where they do not count.

    Attributes:
        data: the values of all pulls.
        places: frames of each pull.
        motions: RMS motion of the fiducials in each pull, m.
    """

    def __init__(
        self, scene: Scene, seen: Sequence[Measurement], unit: float, gripper: ForceScale | None = None
    ) -> None:
        whole = joined(seen, scene)
        self.unit = unit
        self.data = Data(scene, whole, gripper)
        self.places = [slice(int(a.frames[0]), int(a.frames[-1]) + 1) for a in whole.actions]
        moved = (self.data.measured - self.data.rest)[:, : len(scene.rest)]
        self.motions = [float(np.sqrt(np.nanmean(moved[place] ** 2))) for place in self.places]
        self._positions: dict[Anchored, Array] = {}
        self._failed: set[Anchored] = set()
        self._adrift: dict[Anchored, frozenset[int]] = {}
        self._allowed: dict[Anchored, ErrorModel] = {}
        self._weighed: dict[Anchored, Weighed] = {}
        self._errors: dict[tuple[object, ...], ErrorCovariance] = {}
        self._likelihoods: dict[tuple[object, ...], float] = {}

    # -- what is known

    def predicted(self, anchors: Anchored, pull: int, positions: Array, adrift: bool) -> None:
        """Take a prediction of a pull; `adrift` where the body may buckle in it."""
        whole = self._positions.setdefault(anchors, np.full(self.data.measured.shape, np.nan))
        whole[self.places[pull]] = positions
        if not np.isfinite(positions).all():
            self._failed.add(anchors)
        if adrift:
            self._adrift[anchors] = self._adrift.get(anchors, frozenset()) | {pull}
        self._forget(anchors)

    def allow(self, anchors: Anchored, allowed: ErrorModel) -> None:
        """Take what is known of the errors about a set, whose predictions of all pulls are known."""
        self._allowed[anchors] = allowed
        # Other sets may have had its errors, or have them from now on.
        self._weighed.pop(anchors, None)
        self._errors = {key: errors for key, errors in self._errors.items() if key[0] != anchors}
        self._likelihoods = {key: value for key, value in self._likelihoods.items() if key[1] != anchors}

    def _forget(self, anchors: Anchored) -> None:
        """What was compared with a set."""
        self._weighed.pop(anchors, None)
        self._likelihoods = {key: value for key, value in self._likelihoods.items() if key[0] != anchors}

    @property
    def allowed(self) -> tuple[Anchored, ...]:
        """The sets about which errors are known."""
        return tuple(self._allowed)

    def allowance(self, anchors: Anchored) -> ErrorModel:
        """What is known of the errors about one of these."""
        return self._allowed[anchors]

    def followed(self, anchors: Anchored) -> bool:
        """Whether a set's prediction of every pull is known, to the end."""
        return anchors in self._positions and bool(self._frames(anchors).all())

    def _frames(self, anchors: Anchored) -> Frames:
        if anchors not in self._positions:
            return np.zeros(len(self.data.mask), bool)
        return np.asarray(np.isfinite(self._positions[anchors]).all(axis=(1, 2)))

    # -- what it says

    def relative(self, sets: Sequence[Anchored]) -> dict[Anchored, float]:
        """Logarithms of the evidence of sets, against the likeliest, each in the frames that are known of it."""
        known = {a: self._frames(a) for a in sets}
        return relative(known, self._failed, self._evidence)

    def missing(self, anchors: Anchored) -> float:
        """Probability that something is missing besides a set, or the one like it whose errors are known.

        Where no force can be asked for, 1 for a residual far beyond its errors, and else 0.
        """
        like = self.like(anchors)
        if like is None or not self._allowed[like].unknown.known:
            return float(self.missed(anchors) > MAX_NORMALISED_RMS)
        return self._weigh(like).evidence.missing

    def missed(self, anchors: Anchored) -> float:
        """RMS residual of a set in units of its errors, where no force acts; NaN where it cannot be followed."""
        frames = self._frames(anchors)
        if not frames.any():
            return math.nan
        like = self.like(anchors)
        errors = self._errors_of(like, self._drifting(anchors, like), frames, None)
        return float(np.sqrt(np.mean(errors.whiten(self._residual(anchors, errors.data, like)) ** 2)))

    def rms(self, anchors: Anchored) -> float:
        """RMS residual of a set, m; NaN where it cannot be followed."""
        if not self._frames(anchors).any():
            return math.nan
        data = self.data.within(self._frames(anchors))
        return data.rms(self._residual(anchors, data, self.like(anchors)))

    def stiffness(self, anchors: Anchored, model: Model) -> Stiffness | None:
        """How stiff the body is with a set, where forces are measured; None also where its errors are not known."""
        if anchors not in self._allowed:
            return None
        frames = np.ones(len(self.data.mask), bool)
        errors = self._errors_of(anchors, self._drifting(anchors, anchors), frames, self._weigh(anchors).missing)
        return Stiffness.of(errors, self._residual(anchors, errors.data, anchors), model, self.data.scene)

    def predictions(self, anchors: Anchored) -> Array:
        """What a set predicts for all pulls, shape (frames, rows, 3), m; NaN where that is not known."""
        return self._positions[anchors]

    def left(self, anchors: Anchored) -> float | None:
        """RMS error that the mesh leaves, as part of the motion, over all pulls; None where it is not known."""
        like = self.like(anchors)
        if like is None or not self._allowed[like].mesh.known:
            return None
        allowed, parts = self._allowed[like], []
        for pull, (place, motion) in enumerate(zip(self.places, self.motions, strict=True)):
            size = allowed.mesh.at(np.arange(place.start, place.stop)).rms / max(motion, 1e-12)
            parts.append(_ANYWHERE if pull in allowed.adrift else size)
        return float(np.mean(parts))

    def like(self, anchors: Anchored) -> Anchored | None:
        """The set most like one, of those whose errors are known."""
        return min(self._allowed, key=lambda a: (len(a ^ anchors), sorted(a)), default=None)

    # -- the likelihood

    def _evidence(self, anchors: Anchored, frames: Frames) -> float:
        """Logarithm of the evidence of a set in some frames.

        In all of them it has the errors of the set most like it, and by as much more evidence as that one by an unknown force;
        in fewer, which only sets that are not likely have in common, the errors of the likeliest.
        """
        if not frames.all():
            return self._likelihood(anchors, self._likeliest, frames)
        like = self.like(anchors)
        value = self._likelihood(anchors, like, frames)
        return value if like is None else value + self._weigh(like).more

    @property
    def _likeliest(self) -> Anchored | None:
        return max(self._allowed, key=lambda a: (self._weigh(a).evidence.total, -len(a), sorted(a)), default=None)

    def _likelihood(self, anchors: Anchored, like: Anchored | None, frames: Frames) -> float:
        """With the errors of another set, and with the force that is likeliest with that one."""
        missing = None if like is None else self._weigh(like).missing
        drifting = self._drifting(anchors, like)
        key = anchors, like, drifting, frames.tobytes(), missing
        if key not in self._likelihoods:
            errors = self._errors_of(like, drifting, frames, missing)
            self._likelihoods[key] = errors.log_likelihood(self._residual(anchors, errors.data, like))
        return self._likelihoods[key]

    def _weigh(self, anchors: Anchored) -> Weighed:
        """What the pulls say of a set whose errors are known."""
        if anchors not in self._weighed:
            frames = np.ones(len(self.data.mask), bool)
            errors = self._errors_of(anchors, self._drifting(anchors, anchors), frames, None)
            residual = self._residual(anchors, errors.data, anchors)
            evidence = Evidence.of(errors, residual, self._allowed[anchors].unknown.forces(errors, self.unit))
            self._weighed[anchors] = found = Weighed(evidence, 0.0)
            likeliest = self._likelihood(anchors, anchors, frames)
            self._weighed[anchors] = Weighed(found.evidence, evidence.total - likeliest)
        return self._weighed[anchors]

    def _residual(self, anchors: Anchored, data: Data, like: Anchored | None) -> Array:
        """Seen minus predicted, with the error of the mesh of another set taken out, shape (n,), m."""
        predicted = self._positions[anchors]
        if like is not None:
            predicted = predicted + self._allowed[like].mesh.correction
        return data.values - data.vector(predicted)

    def _drifting(self, anchors: Anchored, like: Anchored | None) -> frozenset[int]:
        """The pulls in which a set's prediction is worth little."""
        of_mesh = frozenset[int]() if like is None else self._allowed[like].adrift
        return self._adrift.get(anchors, frozenset()) | of_mesh

    def _errors_of(
        self, like: Anchored | None, drifting: frozenset[int], frames: Frames, missing: Evidence | None
    ) -> ErrorCovariance:
        key = like, drifting, frames.tobytes(), missing
        if key not in self._errors:
            allowed = self._nothing if like is None else self._allowed[like]
            data, rows = self.data.within(frames), frames[self.data.frame]
            modes, sigma = allowed.modes.at(rows), self._sigma[rows]
            if missing is not None:
                modes = modes.beside(allowed.unknown.at(rows).likeliest(data, missing))
            for pull in sorted(drifting):
                modes = modes.beside(_anywhere(data, pull, _ANYWHERE * self.motions[pull]))
                rough = np.where(data.action == pull, _ROUGH * _ANYWHERE * self.motions[pull] * data.way, 0.0)
                sigma = np.hypot(sigma, rough)
            self._errors[key] = ErrorCovariance(data, sigma, allowed.mesh, modes)
        return self._errors[key]

    @cached_property
    def _nothing(self) -> ErrorModel:
        return ErrorModel.nothing(self.data)

    @cached_property
    def _sigma(self) -> Array:
        """Standard deviation of the noise, shape (n,), m; where none is stated, as the residual of the closest set tells."""
        if self.data.stated:
            return self.data.sigma
        residuals = [
            self.data.values - self.data.vector(self._positions[a]) for a in self._positions if self._frames(a).any()
        ]
        known = [np.isfinite(r) for r in residuals]
        most = max((int(k.sum()) for k in known), default=0)
        whole = [(r, k) for r, k in zip(residuals, known, strict=True) if int(k.sum()) == most]
        if not whole:
            return self.data.noise(np.zeros(len(self.data)))
        residual, seen = min(whole, key=lambda item: float(np.sum(item[0][item[1]] ** 2)))
        noise = self.data.within(self._within(seen)).noise(residual[seen])
        return np.where(self.data.of_position, noise[0], self.data.sigma)

    def _within(self, rows: NDArray[np.bool_]) -> Frames:
        """The frames that some values belong to."""
        frames = np.zeros(len(self.data.mask), bool)
        frames[self.data.frame[rows]] = True
        return frames


def _anywhere(data: Data, pull: int, size: float) -> Array:
    """Every trajectory of a pull may be off by itself, in proportion to the motion, shape (n, trajectories), m."""
    rows = data.action == pull
    along = data.trajectory[:, None] == np.unique(data.trajectory[rows])
    return np.where(along, size * data.way[:, None], 0.0)


def allowance(
    data: Data,
    meshes: Mapping[int, MeshError | None],
    places: Sequence[slice],
    modes: NuisanceModes,
    unknown: SmoothDiscrepancy,
) -> ErrorModel:
    """From the error of the mesh in each pull; None where the fine level cannot be followed, none where there is no such level."""
    shape, count = data.mask.shape, len(data.scene.fiducials)
    whole = MeshError(np.zeros(shape), np.zeros(shape), bool(meshes), fiducials=count)
    for pull, mesh in meshes.items():
        if mesh is not None:
            whole.correction[places[pull]], whole.left[places[pull]] = mesh.correction, mesh.left
    return ErrorModel(whole, modes, unknown, frozenset(pull for pull, mesh in meshes.items() if mesh is None))
