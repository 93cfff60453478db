"""Two calibrated cameras, and what their calibration is worth: errors, standard deviations, and a verdict in words."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from bcid.vision.adjustment import FEW
from bcid.vision.camera import SIDES, Cameras
from bcid.vision.corners import Corners, rms

Array = NDArray[np.float64]

# Cells of an image, columns and rows, that corners should fill.
GRID = (8, 6)
# Limits of the verdict: error, px; share of cells; angles, deg; standard deviation of a focal length as a share of it.
_ERROR, _BAD_ERROR = 1.0, 5.0
_COVERAGE = 0.4
_SIGHT, _BAD_SIGHT, _SPREAD, _FLAT = 3.0, 0.3, 20.0, 8.0
_FOCAL, _BAD_FOCAL = 0.005, 0.03
# What to do about a large error, and about too little knowledge.
_FLAT_ADVICE = (
    "Check that board and cameras stand still in each picture, that the pictures of a pair were taken at the same time, that the "
    "board is flat, and its numbers of columns and rows."
)
_POINTS_ADVICE = (
    "Check the points that fit worst (the largest residual is {}), their names and places, whether pixels count from 0 or 1, and "
    "that the object stood still."
)
_MORE_POINTS = "Pick more points, at more depths and nearer to the edges of the images, or the object in more poses."


@dataclass(frozen=True)
class CalibrationFault:
    """What is wrong with a calibration, what to do about it, and whether it forbids its use."""

    text: str
    advice: str
    fatal: bool = False


@dataclass(frozen=True)
class Calibration:
    """Two calibrated cameras, and how good they are.

    Attributes:
        cameras: lengths in m.
        used: corners of the pairs that were used.
        residuals: found minus projected, left and right, by pair, each of shape (n, 2), px.
        pair_errors: RMS distance between corners found and projected in both images, by pair, px; also of pairs left out.
        left_out: pairs whose error is far above the others'.
        turned: pairs whose corners were counted from the other end of the board in the right image.
        deviations: standard deviations: fx, fy, cx, cy (px) and coefficients by camera, as "left.fx", "baseline" (m), "angle"
            (deg); infinite where the boards do not determine the number. See `deviations_from`.
        coverage: share of the cells of `GRID` in which corners lie, left and right.
        tilts: smallest and largest angle between a board and the left image, deg.
        spread: largest angle between two boards, deg.
        sight: mean angle between the lines from a board to the two cameras, deg.
        distortion: how many coefficients of the lens were found.
        flat: whether the board is: a solid object tells all from one pose, a board must be tilted.
        many_far: whether more pairs than may be left out have errors far above the others'.
    """

    cameras: Cameras
    used: tuple[Corners, ...]
    residuals: dict[int, tuple[Array, Array]]
    pair_errors: dict[int, float]
    left_out: tuple[int, ...]
    turned: tuple[int, ...]
    deviations: dict[str, float]
    coverage: tuple[float, float]
    tilts: tuple[float, float]
    spread: float
    sight: float
    distortion: int
    flat: bool
    many_far: bool

    @cached_property
    def errors(self) -> tuple[float, float]:
        """RMS distance between corners found and projected in the left and in the right images, px."""
        left, right = (np.vstack([two[side] for two in self.residuals.values()]) for side in range(2))
        return rms(left), rms(right)

    @property
    def error(self) -> float:
        """RMS distance in all images, px: what OpenCV calls the reprojection error."""
        return math.sqrt((self.errors[0] ** 2 + self.errors[1] ** 2) / 2)

    @cached_property
    def findings(self) -> tuple[CalibrationFault, ...]:
        """What is wrong."""
        return (*_about_error(self), *_about_boards(self))

    @cached_property
    def worst_point(self) -> str | None:
        """Where the largest residual of points with names is, in words; None of corners."""
        far = [
            (float(distance), f"{distance:.2f} px, of point {name} in the {side} image of pair {c.number}")
            for c in self.used
            for side, residuals in zip(SIDES, self.residuals[c.number], strict=True)
            for name, distance in zip(c.names, np.linalg.norm(residuals, axis=1), strict=bool(c.names))
        ]
        return max(far)[1] if far else None

    @property
    def usable(self) -> bool:
        """Whether positions can be measured with it."""
        return not any(finding.fatal for finding in self.findings)

    @property
    def verdict(self) -> str:
        """One sentence."""
        texts = "; ".join(f.text for f in sorted(self.findings, key=lambda f: not f.fatal))
        if not texts:
            return "good"
        return f"{'usable with care' if self.usable else 'not usable'}: {texts}"

    @property
    def deviations_from(self) -> str:
        """How the standard deviations were found."""
        return "jackknife over pairs" if len(self.used) >= FEW else "Jacobian"


def _about_error(found: Calibration) -> list[CalibrationFault]:
    findings = []
    if found.error > _ERROR:
        findings.append(
            CalibrationFault(
                f"the error is {found.error:.2f} px (good: below {_ERROR:g} px)",
                _FLAT_ADVICE if found.worst_point is None else _POINTS_ADVICE.format(found.worst_point),
                found.error > _BAD_ERROR,
            )
        )
    if found.many_far:
        findings.append(
            CalibrationFault(
                "more pairs than a quarter have errors far above the others'",
                "Look at the pairs with the largest errors, and remove those that are blurred or do not belong together.",
            )
        )
    if len(found.used) < FEW and found.flat:
        findings.append(
            CalibrationFault(
                f"{len(found.used)} pairs are few (good: {FEW} or more)",
                f"Take at least {FEW - len(found.used)} more pairs, the board tilted another way in each.",
            )
        )
    return findings


def _about_boards(found: Calibration) -> list[CalibrationFault]:
    findings = []
    doubt = max(
        found.deviations[f"{side}.{f}"] / float(camera.matrix[k, k])
        for side, camera in zip(SIDES, (found.cameras.left, found.cameras.right), strict=True)
        for k, f in enumerate(("fx", "fy"))
    )
    tilt = "Tilt the board by 20 to 45 degrees, to the left, right, top and bottom."
    if found.flat and found.spread < _FLAT:
        findings.append(
            CalibrationFault(
                f"the boards are not tilted against each other (by {found.spread:.1f} degrees at most): focal length and "
                "distance cannot be told apart",
                tilt,
                True,
            )
        )
    else:
        if found.flat and found.spread < _SPREAD:
            findings.append(
                CalibrationFault(
                    f"the boards are hardly tilted against each other (by {found.spread:.0f} degrees at most)", tilt
                )
            )
        if doubt > _FOCAL:
            text = f"focal lengths are known to {doubt:.1%} only" if doubt < 1 else "focal lengths are not determined"
            advice = tilt + " Take more pairs." if found.flat else _MORE_POINTS
            findings.append(CalibrationFault(text, advice, doubt > _BAD_FOCAL))
    for side, share in zip(SIDES, found.coverage, strict=True):
        if share < _COVERAGE:
            findings.append(
                CalibrationFault(
                    f"corners cover {share:.0%} of the {side} images (good: above {_COVERAGE:.0%})",
                    f"Show the board also near the edges and corners of the {side} images.",
                )
            )
    if found.sight < _SIGHT:
        findings.append(
            CalibrationFault(
                f"the cameras see the board from nearly the same side (angle {found.sight:.1f} degrees, good: above {_SIGHT:g})",
                "Move the cameras apart: depth is measured the better the larger the angle, best at 20 to 60 degrees.",
                found.sight < _BAD_SIGHT,
            )
        )
    return findings
