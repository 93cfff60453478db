"""Weighing the likely sets by the one likelihood, with what the scene may have wrong and with what may be missing."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product

import numpy as np
from numpy.typing import NDArray

from bcid.base.errors import SolveError, evaluating
from bcid.forms.force_bumps import BUMPS, bumps, force_unit, growth_bumps
from bcid.forms.forward import Forward, Prediction
from bcid.forms.gripper_force import ForceScale
from bcid.forms.model import Model
from bcid.forms.sensitivity import Sensitivity
from bcid.inference.data import Data
from bcid.inference.discrepancy import Evidence, SmoothDiscrepancy
from bcid.inference.error_covariance import ErrorCovariance, NuisanceEstimate
from bcid.inference.knots import knots_of, known_frames
from bcid.inference.mesh_error import ORDER, MeshError, gains
from bcid.inference.nuisances import NuisanceModes, Nuisances
from bcid.inference.outcome import Candidate
from bcid.inference.relative import relative
from bcid.inference.stiffness import Stiffness
from bcid.search.climb import ODDS
from bcid.search.evaluator import Evaluator
from bcid.search.set_evidence import SetEvidence

Array = NDArray[np.float64]
# So many sets are weighed at a time, and at most on the coarsest level and on the finest: where more are likely, little is decided.
_BATCH, _MOST, _FINELY = 4, 32, 8
# How often a fiducial goes astray.
_ASTRAY = 0.01
# Odds from which on two sets count as told apart.
_TELLING = 20.0


@dataclass(frozen=True)
class LinearisedPrediction:
    """What weighing a set on a level takes.

    Attributes:
        positions: predicted, shape (frames, fiducials, 3), m; NaN from where it could not be followed.
        modes: of the nuisances, in the frames that were followed.
        unknown: what something unknown and smooth does in these frames.
        failed: whether it could not be followed to the end.
    """

    positions: Array
    modes: NuisanceModes
    unknown: SmoothDiscrepancy
    failed: bool

    @property
    def frames(self) -> NDArray[np.bool_]:
        """The frames that were followed."""
        return np.asarray(np.isfinite(self.positions).all(axis=(1, 2)))


@dataclass(frozen=True)
class Weight:
    """What weighing says of a set.

    Attributes:
        evidence: in all frames that it was compared in.
        errors: of the residual, with an unknown force where that makes the measurement likelier.
        residual: measured minus predicted, shape (n,), m.
    """

    evidence: Evidence
    errors: ErrorCovariance
    residual: Array

    @property
    def told(self) -> list[NuisanceEstimate]:
        """What the data say of each thing that the scene may have slightly wrong."""
        return self.errors.told(self.residual)

    def stiffness(self, model: Model) -> Stiffness | None:
        """How stiff the body is, where forces are measured."""
        return Stiffness.of(self.errors, self.residual, model, self.errors.data.scene)


class EvidenceEvaluator:
    """Weighs sets on the levels that a search used. Methods are collective.

    Args:
        evaluator: which has evaluated the `best` set on all these levels.
        levels: that were used, coarsest first.
        best: that fits best.
        mesh: what is left of the error of the mesh, where a single level was used; without it nothing can be weighed there: sets
            that are held by more move less, and would be taken for the likelier ones on a mesh that is too stiff.
    """

    def __init__(
        self, evaluator: Evaluator, levels: Sequence[int], best: Candidate, mesh: MeshError | None = None
    ) -> None:
        self.evaluator, self.best, self.known = evaluator, best, mesh
        forces = ForceScale.of(evaluator.scene, evaluator.measurement)
        self.data = Data(evaluator.scene, evaluator.measurement, forces)
        self.solved = [level for level in levels if not evaluator.outcomes[level, best].failed]
        # Sensitivities are not made on a mesh that ranks share.
        self.levels = [level for level in self.solved if not evaluator.together(level)]
        if len(self.solved) == 1 and mesh is None:
            self.levels = []
        self._seen = np.asarray(self.data.mask.any(axis=(1, 2)))
        self._pans: dict[tuple[int, Candidate], LinearisedPrediction] = {}
        self._evidence: dict[tuple[int, Candidate, bytes], float] = {}
        self._sensitivities: dict[int, Sensitivity] = {}
        self._nuisances: dict[int, Nuisances] = {}
        self._meshes: dict[int, MeshError] = {}
        self._bumps: dict[int, tuple[Array, Array]] = {}

    def run(self, order: Sequence[Candidate], near: Callable[[Candidate], Iterable[Candidate]]) -> SetEvidence:
        """Logarithms of the evidence of the sets that were weighed.

        They are weighed on the coarsest level a few at a time, until the last few hold next to nothing; the likeliest of those that
        are not `ODDS` times less likely than the best, on the finest.

        Args:
            order: the sets, the likeliest first as far as it is known.
            near: the sets around one: they are weighed too when it is the likeliest.
        """
        if not self.levels:
            return SetEvidence()
        coarse, fine = self.levels[0], self.levels[-1]
        found: dict[Candidate, float] = {}
        waiting = list(order)
        while waiting and len(found) < _MOST:
            batch, waiting = waiting[:_BATCH], waiting[_BATCH:]
            found = self.relative(coarse, [*found, *batch])
            top = max(found, key=lambda c: found[c])
            around = [c for c in near(top) if c not in found]
            if max(found[c] for c in batch) < -math.log(ODDS) and (not around or self.alone(found)):
                break
            waiting = list(dict.fromkeys([*(around if top in batch else []), *waiting]))
            waiting = [c for c in waiting if c not in found]
        ordered = sorted(found, key=lambda c: (-found[c], len(c), sorted(c)))
        if fine == coarse:
            return SetEvidence(found)
        return SetEvidence(self.relative(fine, [c for c in ordered[:_FINELY] if found[c] > -math.log(ODDS)]), found)

    def alone(self, found: dict[Candidate, float]) -> bool:
        """Whether the likeliest set has no rival."""
        return sum(log > -math.log(ODDS) for log in found.values()) == 1

    def relative(self, level: int, candidates: Sequence[Candidate]) -> dict[Candidate, float]:
        """Logarithms of the evidence against the likeliest, each in the frames that both could be followed in."""
        self._fill(level, candidates)
        pans = {c: self._pans[level, c] for c in candidates}
        failed = {c for c, pan in pans.items() if pan.failed}
        return relative(
            {c: pan.frames for c, pan in pans.items()}, failed, lambda c, frames: self.evidence(level, c, frames)
        )

    def evidence(self, level: int, candidate: Candidate, frames: NDArray[np.bool_]) -> float:
        """Logarithm of the evidence of a set in some frames; a weight is too large to be kept."""
        key = level, candidate, frames.tobytes()
        if key not in self._evidence:
            self._evidence[key] = self.weight(level, candidate, frames).evidence.total
        return self._evidence[key]

    def weight(self, level: int, candidate: Candidate, frames: NDArray[np.bool_] | None = None) -> Weight:
        """Of a set that was weighed on a level, in all frames that it could be followed in or some of them."""
        self._fill(level, [candidate])
        pan = self._pans[level, candidate]
        followed = self.data.within(pan.frames)
        data = followed if frames is None else followed.within(frames)
        rows = np.ones(len(followed), bool) if frames is None else frames[followed.frame]
        mesh = self._mesh(level)
        residual = data.values - data.vector(pan.positions + mesh.correction)
        errors = ErrorCovariance(data, self._sigma[data.mask], mesh, pan.modes.at(rows))
        unknown = pan.unknown.at(rows)
        evidence = Evidence.of(errors, residual, unknown.forces(errors, force_unit(self.evaluator.forward(level))))
        if evidence.forced > evidence.plain:
            errors = ErrorCovariance(
                data, errors.sigma, mesh, errors.nuisances.beside(unknown.likeliest(data, evidence))
            )
        return Weight(evidence, errors, residual)

    def followed(self, candidate: Candidate) -> bool:
        """Whether a set was followed to any frame on the finest level: without one nothing is known of it; collective."""
        self._fill(self.levels[-1], [candidate])
        return bool(self._pans[self.levels[-1], candidate].frames.any())

    def astray(self, level: int, candidate: Candidate) -> tuple[str, ...]:
        """Fiducials that do not go with the body, whatever of the above acts: names that were swapped, marks that came off.

        One that is astray may be anywhere: its values have a density of one per size of the body. Of its share of chi-square r^T
        C^-1 r the others have taken what they explain. More than every fourth are no mistake of single ones.
        """
        weight = self.weight(level, candidate)
        data, errors = weight.errors.data, weight.errors
        shares = weight.residual * errors.rough(weight.residual) / errors.sigma**2
        size = float(np.linalg.norm(np.ptp(self.evaluator.forward(level).mesh.points, axis=0)))
        names = self.evaluator.scene.fiducial_names
        taken, lost = (
            np.bincount(data.fiducial[data.of_position], values[data.of_position], minlength=len(names))
            for values in (0.5 * shares, np.log(size / errors.sigma))
        )
        found = np.flatnonzero(taken > lost - math.log(_ASTRAY))
        seen = np.unique(data.fiducial[data.of_position])
        return tuple(names[i] for i in found) if 0 < len(found) <= len(seen) / 4 else ()

    def classes(self, level: int, logs: dict[Candidate, float]) -> list[list[Candidate]]:
        """Sets that the measured motions cannot tell apart, of those that are likely.

        Two belong together when, if one of them were the true set, the data would be expected to favour it by less than
        `_TELLING` to one: half the squared distance of their predictions, in units of their errors, is the expected logarithm of
        that ratio. Each class is built around its likeliest set, which comes first; so do the likelier classes.
        """
        known = [c for c in logs if (level, c) in self._pans and not self._pans[level, c].failed]
        known.sort(key=lambda c: (-logs[c], len(c), sorted(c)))
        errors = self.weight(level, known[0]).errors if known else None
        found: list[list[Candidate]] = []
        for candidate in known:
            here = self._pans[level, candidate].positions
            for others in found:
                assert errors is not None
                apart = errors.whiten(self.data.vector(here - self._pans[level, others[0]].positions))
                if 0.5 * float(apart @ apart) <= math.log(_TELLING):
                    others.append(candidate)
                    break
            else:
                found.append([candidate])
        return found

    def destroy(self) -> None:
        """Free the PETSc objects."""
        for sensitivity in self._sensitivities.values():
            sensitivity.destroy()

    # -- what it takes

    @cached_property
    def _sigma(self) -> Array:
        """Standard deviation of every value, (frames, fiducials, 3), m; as the best set's residual tells where none is stated."""
        level = self.levels[-1]
        positions = self.evaluator.positions(level, self.best) + self._mesh(level).correction
        return self.data.spread(self.data.noise(self.data.values - self.data.vector(positions)))

    def _mesh(self, level: int) -> MeshError:
        """Error of a level's mesh, as the best set's predictions on the levels tell."""

        def at(one: int) -> Array:
            return self.evaluator.positions(one, self.best)

        if level not in self._meshes:
            last = self.solved[-1]
            if len(self.solved) == 1:
                assert self.known is not None
                self._meshes[level] = self.known
            elif level == last:
                before = self.solved[-2]
                self._meshes[level] = MeshError.beyond(at(before), at(last), self._gains(before, last))
            else:
                self._meshes[level] = MeshError.between(at(level), at(last), self._gains(level, last))
            self._meshes[level] = replace(self._meshes[level], fiducials=len(self.evaluator.scene.fiducials))
        return self._meshes[level]

    def _gains(self, coarse: int, fine: int) -> Array:
        """By how much their distance exceeds the error of the finer of two levels, shape (rows, 1); collective."""
        return gains(self.evaluator.refinement(coarse, fine), ORDER, self.data.kinds)

    def _fill(self, level: int, candidates: Iterable[Candidate]) -> None:
        """Predict sets, with the sensitivities that weighing takes."""
        todo = [c for c in dict.fromkeys(candidates) if (level, c) not in self._pans]
        if todo:
            self._pans |= {(level, c): pan for c, pan in self.evaluator.each(level, todo, self._pan).items()}

    def _pan(self, forward: Forward, candidate: Candidate, prediction: Prediction) -> LinearisedPrediction:
        level = forward.level
        if level not in self._sensitivities:
            self._sensitivities[level] = Sensitivity(forward)
            self._nuisances[level] = Nuisances(forward.scene, forward.mesh, self.data.tells_stiffness)
            self._bumps[level] = bumps(forward, BUMPS)[1], growth_bumps(forward)
        nuisances, (forces, growths) = self._nuisances[level], self._bumps[level]
        wanted = replace(nuisances.wanted(forward.model, candidate), forces=forces, growths=growths)
        actions, failed = self.evaluator.actions, prediction.failure is not None
        followed = np.asarray(np.isfinite(prediction.positions).all(axis=(1, 2)))
        data = self.data.within(followed)
        known = knots_of(forward.model, actions, followed)
        seen = self._seen & followed if known is None else known_frames(known, len(followed))
        try:
            with evaluating("sensitivities"):
                found = self._sensitivities[level].of(candidate, actions, prediction, wanted, None, seen)
        except SolveError:
            # Where the tangent says nothing, neither nuisances nor an unknown force do.
            return LinearisedPrediction(
                prediction.positions, NuisanceModes.none(len(data)), SmoothDiscrepancy.nothing(len(data)), failed
            )
        for array, one in product(found.arrays, known or ()):
            one.fill(array)
        assert found.forces is not None
        unknown = SmoothDiscrepancy.of(data, found.forces, found.growths, force_unit(forward))
        modes = nuisances.modes(data, found, wanted, forward.model, prediction.positions)
        return LinearisedPrediction(prediction.positions, modes, unknown, failed)
