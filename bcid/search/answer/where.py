"""Where? The smooth force that would have to act on the body, and where, to explain what a model leaves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bcid.forms.force_bumps import SPOTS, bumps, farthest_point_sample
from bcid.forms.probes import SensitivityRequest
from bcid.search.fitting.state import State

Array = NDArray[np.float64]
# The force is told by so many regions: neighbouring bumps stand in for each other, and only their sums are known well.
_REGIONS = 9
# Sizes of the force that are tried, relative to the one that would explain everything.
_SIZES = np.logspace(-4, 4, 33)


@dataclass(frozen=True)
class Place:
    """The missing force on a region of the body.

    Attributes:
        position: middle of the region, rest state, shape (3,), m.
        force: N, shape (3,).
        stderr: of a component of it (RMS), N.
    """

    position: Array
    force: Array
    stderr: float


@dataclass(frozen=True)
class SpreadForce:
    """A force that is spread over the body.

    Attributes:
        regions: its parts.
        together: their sum, which may be told where no part is, at the middle of the body.
    """

    regions: tuple[Place, ...]
    together: Place


@dataclass(frozen=True)
class MissingForce:
    """A force field that would explain the residual. Its size is right if the stiffness is.

    Attributes:
        steady: the part that acts in all frames.
        growing: by action, the part that grows from nothing to its value at the last step.
        explained: share of the residual's excess over the noise that it explains, 0 to 1.
        rms: RMS residual that it leaves, m.
    """

    steady: SpreadForce
    growing: dict[str, SpreadForce]
    explained: float
    rms: float


def missing_force(state: State) -> MissingForce:
    """The force field of least size that explains the residual as far as noise asks for it; collective.

    Gaussian bumps spread over the body; their sizes have a common prior whose width is chosen by the evidence of the data
    (MacKay, Neural Computation 4, 1992).
    """
    predictor, data = state.predictor, state.predictor.data
    forward = predictor.forward(state.model)
    centres, weights = bumps(forward, SPOTS)
    shown = predictor.sensitivities(state.model, state.anchors, state.prediction, SensitivityRequest(forces=weights))
    assert shown.forces is not None
    raw = data.vector(shown.forces).astype(float).reshape(len(data), -1)
    names = [name for a, name in enumerate(data.actions) if data.progress[data.action == a].any()]
    growing = [np.where(data.action == data.actions.index(name), data.progress, 0.0) for name in names]
    blocks = [raw] + [raw * part[:, None] for part in growing]
    middles, volumes = _regions(centres, weights.sum(axis=0))
    sums = np.kron(np.eye(len(blocks)), np.kron(volumes, np.eye(3)))
    columns = np.hstack([state.errors.whiten(b) for b in blocks])
    amounts, deviation, explained = _evidence(columns, state.scaled, sums)
    parts = (sums @ amounts).reshape(len(blocks), len(middles), 3)
    spread = deviation.reshape(len(blocks), len(middles), 3)

    def force(number: int) -> SpreadForce:
        *regions, together = (
            Place(c, f, float(np.linalg.norm(s) / np.sqrt(3)))
            for c, f, s in zip(middles, parts[number], spread[number], strict=True)
        )
        return SpreadForce(tuple(regions), together)

    left = state.residual - np.hstack(blocks) @ amounts
    return MissingForce(
        force(0), {name: force(number) for number, name in enumerate(names, 1)}, explained, data.rms(left)
    )


def _regions(centres: Array, volumes: Array) -> tuple[Array, Array]:
    """Middles of the regions and of the body, shape (regions + 1, 3), and the volume of each bump in them, (regions + 1, bumps)."""
    seeds = farthest_point_sample(centres, _REGIONS)
    nearest = np.linalg.norm(centres[:, None] - seeds[None], axis=2).argmin(axis=1)
    held = np.vstack([np.where(np.arange(len(seeds))[:, None] == nearest, volumes, 0.0), volumes])
    return held @ centres / held.sum(axis=1)[:, None], held


def _evidence(columns: Array, residual: Array, sums: Array) -> tuple[Array, Array, float]:
    """Ridge regression with the width of the prior that makes the data most likely.

    Returns:
        The amounts, the standard errors of sums of them (sums @ amounts), and the share of the residual explained.
    """
    basis, sizes, rows = np.linalg.svd(columns, full_matrices=False)
    along = basis.T @ residual
    scale = np.sqrt(np.mean(sizes**2)) or 1.0
    best, chosen = -np.inf, 0.0
    for size in _SIZES:
        variance = 1 + (size * sizes / scale) ** 2
        evidence = -0.5 * float(np.sum(along**2 / variance) + np.sum(np.log(variance)))
        if evidence > best:
            best, chosen = evidence, size
    prior = (chosen / scale) ** 2
    gain = sizes * prior / (1 + prior * sizes**2)
    amounts = rows.T @ (gain * along)
    variance = prior * (np.sum(sums**2, axis=1) - (sums @ rows.T) ** 2 @ (gain * sizes))
    deviation = np.sqrt(np.maximum(variance, 0.0))
    after = residual - columns @ amounts
    # Noise alone leaves its number of values, give or take as many as chance does: a share of less means nothing.
    beyond = max(float(residual @ residual) - len(residual), float(np.sqrt(2 * len(residual))))
    explained = float(np.clip((residual @ residual - after @ after) / beyond, 0.0, 1.0))
    return amounts, deviation, explained
