"""Something is missing: a smooth force of unknown size acts on the body besides what a model knows, or parts of it grow.

It stands for whatever the model lacks (a latent force; Kennedy & O'Hagan, J. R. Stat. Soc. B 63 (2001) 425). To first order
it moves the markers by the sensitivities of the model, so that the likelihood integrated over all such forces has a closed
form: it is a further part of the covariance.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import logsumexp, softmax

from bcid.inference import response
from bcid.inference.change_point import ChangePoint, ChangePointForce
from bcid.inference.data import Data
from bcid.inference.error_covariance import ErrorCovariance
from bcid.inference.evidence import LARGER, KnownNuisance, LinearParameters, LowRankDiscrepancy, MarginalLikelihood
from bcid.inference.priors import PRIORS, spaced
from bcid.inference.thresholds import THRESHOLDS

Array = NDArray[np.float64]
# Where the way back does not mirror the way there, what grows with time differs from what grows with the way by this part.
_APART = 0.2


@dataclass(frozen=True)
class SmoothDiscrepancy:
    """What something unknown and smooth does to the values in each frame: a force, or a growth.

    Either is the whole of it: both at once explain more than any of what they stand for.

    Attributes:
        kinds: of each that it may be, movements per unit of a force's density, shape (n, bumps), m.
    """

    kinds: tuple[Array, ...]

    @classmethod
    def of(
        cls, data: Data, forces: NDArray[np.float32], growths: NDArray[np.float32] | None, unit: float
    ) -> SmoothDiscrepancy:
        """Of what forces and growths do.

        Args:
            data: the values.
            forces: movements (frames, rows, 3, bumps, 3), m per N/m^3 along each axis.
            growths: movements (frames, rows, 3, bumps), m per growth of one; None where nothing grows.
            unit: density that counts like a growth of one, N/m^3.
        """
        pushed = np.nan_to_num(data.vector(forces).astype(float)).reshape(len(data), math.prod(forces.shape[3:]))
        if growths is None:
            return cls((pushed,))
        return cls((pushed, np.nan_to_num(data.vector(growths).astype(float)) / unit))

    @classmethod
    def nothing(cls, count: int) -> SmoothDiscrepancy:
        """Nothing is known of what it does to so many values."""
        return cls((np.zeros((count, 0)),))

    @property
    def known(self) -> bool:
        """Whether it moves anything."""
        return any(kind.any() for kind in self.kinds)

    def at(self, rows: NDArray[np.bool_]) -> SmoothDiscrepancy:
        """In some of the rows, shape (n,)."""
        return SmoothDiscrepancy(tuple(kind[rows] for kind in self.kinds))

    def forces(self, errors: ErrorCovariance, unit: float) -> list[LowRankDiscrepancy]:
        """Of each kind, see `low_rank_discrepancy`."""
        return [low_rank_discrepancy(errors, courses(errors.data, kind), unit) for kind in self.kinds]

    def likeliest(self, data: Data, evidence: Evidence) -> Array:
        """What one of the likeliest kind and size does, a standard deviation of each of its courses, shape (n, m), m."""
        if evidence.length is not None:
            return evidence.size * response.columns(data)[evidence.length]
        return evidence.size * courses(data, self.kinds[evidence.kind])


def courses(data: Data, slopes: Array) -> Array:
    """Movements (n, m), m per unit of each force, from the `slopes` (n, forces) of forces that act in a frame.

    Each may act in all frames alike, grow from the first frame of the measurement to the last, and along an action with the
    gripper's way, and where that leads back also with time; along an action it is the same in those that are the same.
    """
    parts: list[Array] = [np.ones(len(data)), *([data.late] if data.late.any() else [])]
    for number in np.unique(data.motion):
        inside = data.motion == number
        parts.append(np.where(inside, data.way, 0.0))
        if np.abs(data.way - data.progress)[inside].max() > _APART:
            parts.append(np.where(inside, data.progress, 0.0))
    return np.hstack([slopes * part[:, None] for part in parts])


def low_rank_discrepancy(errors: ErrorCovariance, moved: Array, unit: float) -> LowRankDiscrepancy:
    """A force of any size that moves the markers by a notable part of the noise: of a smaller one nothing is said.

    Args:
        errors: of all else.
        moved: movements (n, m), m per unit of force, see `courses`.
        unit: of the force's density: shear modulus per size of the body.
    """
    most = math.sqrt(float(np.mean(np.sum(moved**2, axis=1) / errors.sigma**2)))
    sizes = spaced(PRIORS.force_sizes) * unit
    return LowRankDiscrepancy.of(
        errors.whiten(moved), sizes[sizes * most >= min(THRESHOLDS.effect, float(sizes[-1]) * most)]
    )


@dataclass(frozen=True)
class Evidence:
    """How likely a residual is, without and with an unknown force; logarithms of densities.

    Attributes:
        plain: nothing is missing.
        forced: an unknown force acts, integrated over its size.
        size: the likeliest standard deviation of its density, or of a misfit in observation space, m.
        kind: the likeliest of those that it may be.
        length: the likeliest of the lengths of a misfit in observation space, where that is likelier than a force.
        begins: something that begins at a place, see `bcid.inference.change_point`, where that was asked.
        sudden: probability that it begins somewhere, if something is missing.
    """

    plain: float
    forced: float
    size: float
    kind: int = 0
    length: int | None = None
    begins: ChangePoint | None = None
    sudden: float = 0.0

    @classmethod
    def of(
        cls,
        errors: ErrorCovariance,
        residual: Array,
        forces: Sequence[LowRankDiscrepancy],
        numbers: LinearParameters | None = None,
        sudden: ChangePointForce | None = None,
    ) -> Evidence:
        """Of a residual (n,), m.

        What is missing is a smooth force or growth, something that begins somewhere, or a smooth misfit in observation space
        (`bcid.inference.response`), with the prior probabilities of `PRIORS`. Errors that are not stated may be larger by any of
        the factors `LARGER`.

        Args:
            errors: of all else.
            residual: measured minus predicted.
            forces: of each kind that it may be, all equally likely, in units of these errors.
            numbers: what is unknown of the hypothesis; nothing by default.
            sudden: what may begin; nothing by default.
        """
        scaled, known = errors.whiten(residual), numbers or LinearParameters.none(len(residual))
        factors, volume = None if errors.data.stated else LARGER, errors.log_volume
        plain = MarginalLikelihood.of(scaled, known).log(factors)
        pushed = [MarginalLikelihood.of(scaled, known, force) for force in forces]
        misfits = [MarginalLikelihood.of(scaled, known, process) for process in errors.misfits]
        begins = sudden.beginning(residual, known) if sudden else None
        kinds = [[found.log(factors) for found in some] for some in (pushed, misfits)]
        ways = _ways(plain, kinds[0], kinds[1], begins)
        shares = softmax(ways)
        kind, size = _likeliest(pushed, forces)
        length = None
        if int(np.argmax(ways)) == 1:
            length, size = _likeliest(misfits, errors.misfits)
        forced = float(logsumexp(ways))
        return cls(plain - volume, forced - volume, size, kind, length, begins, float(shares[2]))

    @property
    def total(self) -> float:
        """Whether or not something is missing."""
        return float(np.logaddexp(self.plain + math.log(1 - PRIORS.missing), self.forced + math.log(PRIORS.missing)))

    @property
    def missing(self) -> float:
        """Probability that something is."""
        return math.exp(self.forced + math.log(PRIORS.missing) - self.total)


@dataclass(frozen=True)
class EvidenceCells:
    """Logarithms of the evidence for each size of a discrepancy, each width of unknown numbers and each factor of the noise.

    They are of the residual in units of its errors: the volume of these is left out.

    Attributes:
        plain: nothing is missing, shape (cells,).
        pushed, misfits: of each unknown force, and of each length of a misfit in observation space; likewise.
    """

    plain: Array
    pushed: tuple[Array, ...]
    misfits: tuple[Array, ...]

    @classmethod
    def of(
        cls,
        errors: ErrorCovariance,
        residual: Array,
        forces: Sequence[LowRankDiscrepancy],
        misfits: Sequence[LowRankDiscrepancy],
        numbers: LinearParameters,
    ) -> EvidenceCells:
        """Of a residual (n,), m; the other arguments are as of `Evidence.of`, `misfits` are in units of the errors as well."""
        scaled, factors = errors.whiten(residual), None if errors.data.stated else LARGER
        plain = MarginalLikelihood.of(scaled, numbers).cells(factors)
        pushed, observed = (
            tuple(MarginalLikelihood.of(scaled, numbers, one).cells(factors) for one in some)
            for some in (forces, misfits)
        )
        return cls(plain, pushed, observed)

    def beside(self, here: EvidenceCells, there: EvidenceCells) -> EvidenceCells:
        """These cells with each changed as from `there` to `here`, of what tells of some of the values alone."""
        plain = self.plain + here.plain - there.plain
        pushed, misfits = (
            tuple(own + a - b for own, a, b in zip(*some, strict=True))
            for some in ((self.pushed, here.pushed, there.pushed), (self.misfits, here.misfits, there.misfits))
        )
        return EvidenceCells(plain, pushed, misfits)

    def evidence(self, volume: float) -> Evidence:
        """Integrated over the cells; `volume` is that of the errors."""
        plain = float(logsumexp(self.plain))
        pushed, misfits = ([float(logsumexp(one)) for one in some] for some in (self.pushed, self.misfits))
        return Evidence(plain - volume, float(logsumexp(_ways(plain, pushed, misfits, None))) - volume, 0.0)


def conditional(
    errors: ErrorCovariance,
    residual: Array,
    forces: Sequence[LowRankDiscrepancy],
    numbers: LinearParameters,
    begins: ChangePoint | None,
    known: KnownNuisance | None = None,
    larger: float = 1.0,
) -> tuple[Array, Array]:
    """Logarithms of the evidence without and with a discrepancy where a nuisance is known, each of shape (values,).

    What begins keeps the gain that it has where the nuisance is not known.

    Args:
        errors, residual, forces, numbers: as of `Evidence.of`.
        begins: of the evidence without that knowledge.
        known: the nuisance; none by default, which has one value.
        larger: factor of all errors.
    """
    scaled, volume = errors.whiten(residual), errors.log_volume
    factors = np.array([larger]) if errors.data.stated else larger * LARGER

    def logs(force: LowRankDiscrepancy | None = None) -> Array:
        return MarginalLikelihood.of(scaled, numbers, force, known).logs(factors) - volume

    plain = logs()
    pushed, misfits = ([logs(one) for one in some] for some in (forces, errors.misfits))
    return plain, np.asarray(logsumexp(_ways(plain, pushed, misfits, begins), axis=0))


def _ways(
    plain: ArrayLike, pushed: Sequence[ArrayLike], misfits: Sequence[ArrayLike], begins: ChangePoint | None
) -> Array:
    """Logarithms of the density with each kind of discrepancy and its prior, given that there is one: shape (3, ...)."""
    asked = math.log(PRIORS.force + PRIORS.response + (PRIORS.change_point if begins else 0.0))
    nothing = np.full_like(np.asarray(plain), -math.inf)
    found = [
        math.log(PRIORS.force) + _mean(pushed),
        math.log(PRIORS.response) + _mean(misfits),
        math.log(PRIORS.change_point) + np.asarray(plain) + begins.log if begins else nothing,
    ]
    return np.array(found) - asked


def _likeliest(found: Sequence[MarginalLikelihood], forces: Sequence[LowRankDiscrepancy]) -> tuple[int, float]:
    """Which of some forces is the likeliest, and with which standard deviation."""
    kind = int(np.argmax([one.forced.max() for one in found]))
    return kind, float(forces[kind].sizes[int(np.argmax(found[kind].forced))])


def _mean(logs: Sequence[ArrayLike]) -> Array:
    """Logarithm of the mean of what has these logarithms, over the first axis."""
    return np.asarray(logsumexp(logs, axis=0)) - math.log(len(logs))
