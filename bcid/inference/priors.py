"""The numbers of the prior: what is believed of a hypothesis and of its sizes before the data are seen.

None of them is fitted to the cases that score an answer. A parameter of an effect has its prior in the file of that effect.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Priors:
    """Probabilities, and ranges over which sizes are uniform in their logarithm.

    Attributes:
        effects: known effects that are expected to act, each as likely as the others; shared by all effects of the catalogue.
        force, change_point, response: probability of each kind of discrepancy: a smooth force or growth, a force at one place
            from one frame on, and a misfit in observation space. They also stand for effects that no search came upon.
        missing: probability of a discrepancy of a model whose anchors alone are asked for: as likely as not.
        fidelity_error: scale of the error of a difference of log evidences, as a logarithm of a factor, before a run has any pair
            of fidelities: of a toggled patch by a tangent, of an effect by a tangent, of either in a few steps, and of a patch with
            the errors of another set.
        error_nats: the difference below which that error is one of so many nats, no factor.
        error_freedom: degrees of freedom of the Student distribution of these errors, before any pair.
        failed_fit: a fit that loses more log evidence by an added effect has failed: no prior of an effect is so wide.
        draws: of them.
        tangent_error: standard deviation of the error of a movement that the tangent of another set predicts, as a part of it: of a
            small one, and what it has more where it is as large as that of the pull.
        amounts: standard deviations of the amount of an effect, in notable changes: smallest, largest and how many. A mixture of
            normal distributions has the heavy tails of a half-Cauchy distribution (Gelman, Bayesian Anal. 1, 2006, 515).
        scanned: a time constant or radius lies within so many times the values that are tried, in either direction.
        cycles: a period is one of so many cycles per measurement, from and to.
        other: any other number lies within so many notable changes of where it was found.
        sudden_sizes: standard deviations of a force that begins in a frame, in those that the data leave of it: from what is just
            seen on (`Thresholds.detection`); smallest, largest and how many.
        force_sizes: standard deviations of the density of an unknown force, in units of shear modulus per size of the body: from a
            strain that nobody sees to one that tears.
        noise: factors of all errors where no noise is stated.
        misfit_lengths: correlation lengths of a misfit over the markers, in their largest distance.
        misfit_sizes: how many of its standard deviations are tried, from the noise to the motion.
        misfit_smooth: variance and correlation length of its part that is smooth in the pose, where the furthest pose is 1.
        mesh_error: how far the error of the mesh may be from what the ladder says, as a part of that: of each action, of a single
            trajectory, of a marker at rest, and of all forces together, for a mesh is too stiff everywhere.
        mesh_gain: by how much the difference of two meshes exceeds the error of the finer one, at most: where patches end,
            convergence is of little more than first order, which makes it 3 for meshes with a ratio of three.
        first_mesh_error: the error of the mesh before anything was seen, as a part of the motion.
        failures: how often the forward model cannot follow the true set to the end: what a set that fails has for it beforehand.
        noise_error: relative standard deviation of a noise that is stated, where an answer is given for another one: a convention,
            with which two standard deviations are 20 %.
        force_sensor: noise of a force sensor, in the largest force that it shows: of one that is not there yet, and at least of one
            that is, for its linearity; as of six-axis sensors of a laboratory.
        misfit_columns: in which it is kept at most (Kennedy & O'Hagan, J. R. Stat. Soc. B 63, 2001, 425). What these leave out is
            white: of markers that move as those of another body a set has 98 % with 60 columns, 41 % with 180 and 49 % with 480.
    """

    effects: float = 0.7
    force: float = 0.1
    change_point: float = 0.05
    response: float = 0.05
    missing: float = 0.5
    fidelity_error: tuple[float, float, float, float] = (0.5, 0.2, 0.3, 0.1)
    error_nats: float = 3.0
    error_freedom: float = 4.0
    failed_fit: float = 12.0
    draws: int = 4096
    tangent_error: tuple[float, float] = (0.1, 0.5)
    amounts: tuple[float, float, int] = (0.1, 10.0, 7)
    scanned: float = 2.0
    cycles: tuple[float, float] = (1.0, 8.0)
    other: float = 3.0
    sudden_sizes: tuple[float, float, int] = (3.0, 3000.0, 7)
    force_sizes: tuple[float, float, int] = (1e-4, 10.0, 21)
    noise: tuple[float, float, int] = (1.0, 20.0, 30)
    misfit_lengths: tuple[float, ...] = (0.1, 0.25, 0.6, 1.5)
    misfit_sizes: int = 8
    misfit_smooth: tuple[float, float] = (0.1, 0.3)
    misfit_columns: int = 180
    mesh_error: tuple[float, float, float, float] = (0.5, 0.5, 1.5, 0.5)
    mesh_gain: float = 3.0
    first_mesh_error: float = 0.03
    failures: float = 0.01
    noise_error: float = 0.1
    force_sensor: float = 0.005

    @property
    def discrepancy(self) -> float:
        """Probability that something unknown acts besides what a hypothesis names."""
        return self.force + self.change_point + self.response

    @property
    def widest(self) -> float:
        """Standard deviation of the widest prior of an amount, in notable changes."""
        return self.amounts[1]


def spaced(span: tuple[float, float, int]) -> Array:
    """So many values from a first to a last, evenly in their logarithm, shape (count,)."""
    return np.geomspace(span[0], span[1], span[2], dtype=float)


PRIORS = Priors()
