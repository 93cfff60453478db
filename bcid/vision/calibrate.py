"""Calibration of two cameras from the corners of a flat board, or the points of a solid object, that both saw."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from bcid.base.errors import Problems
from bcid.vision.adjustment import COEFFICIENTS, FEW, LENSES, MATRIX, Adjustment, CameraEstimate, Size, check_lens
from bcid.vision.calibration import GRID, Calibration
from bcid.vision.camera import SIDES, Cameras
from bcid.vision.corners import CORNERS, Corners, rms
from bcid.vision.first_guess import first_guess, is_mirrored, is_solid, relief

Array = NDArray[np.float64]

# Radial of fourth order and tangential. k3 matters for wide lenses only; where no corners lie near the edges of the image, it
# bends them at will.
DISTORTION = 4
# Pairs without which nothing is found.
FEWEST = 3
# A pair is left out when its error is so many times the median and not below so many px; at most this share of them.
_FAR, _NOTICEABLE, _SHARE = 3.0, 0.05, 4
# A board is flat up to this ratio of its relief to its size: then only tilts tell focal lengths.
_FLAT = 1e-3


def calibrate(
    corners: Sequence[Corners], size: Size, right_size: Size | None = None, distortion: int = DISTORTION
) -> Calibration:
    """Both cameras from corners of a board, or points of an object; of a solid one, one pair is enough.

    Pairs whose error is far above the others' are left out, one at a time and never more than a quarter.

    Args:
        size: width and height of the left images, px; of the right ones also if `right_size` is not given.
        distortion: coefficients of the lens: 0, 2 (k1, k2), 4 (k1, k2, p1, p2), 5 (and k3) or 8 (and k4, k5, k6). 4 is enough
            for all but wide lenses; k3 and what follows need corners up to the edges of the images.

    Raises:
        InputError: too few pairs, corners that cannot be used or are mirrored, a number of coefficients that does not exist.
    """
    sizes = (size, right_size or size)
    _check(corners, sizes, distortion)
    state, used, turned = first_guess(corners, sizes, distortion)
    may_go = len(used) // _SHARE
    left_out: list[tuple[Corners, CameraEstimate]] = []
    while True:
        adjustment = Adjustment(used, distortion)
        state = adjustment.solve(state)
        errors = adjustment.pair_errors(state)
        worst = int(errors.argmax())
        far = bool(errors[worst] > max(_FAR * float(np.median(errors)), _NOTICEABLE))
        if not far or len(left_out) >= may_go or len(used) <= FEWEST:
            break
        rest = np.arange(len(used)) != worst
        left_out.append((used.pop(worst), state.only(~rest)))
        state = state.only(rest)
    outside = {}
    for pair, then in left_out:
        # Its board is moved to where it fits best.
        alone = Adjustment([pair], distortion)
        moved = alone.solve(replace(state, turns=then.turns, places=then.places), shared=False)
        outside[pair.number] = float(alone.pair_errors(moved)[0])
    return _described(adjustment, state, sizes, turned, outside, far)


def _check(corners: Sequence[Corners], sizes: tuple[Size, Size], distortion: int) -> None:
    problems = Problems("calibration")
    check_lens(distortion, problems)
    if any(min(size) < 1 for size in sizes):
        problems.add("size", f"of the images: expected width and height in pixels, found {sizes[0]} and {sizes[1]}")
    if len(corners) < FEWEST and not any(is_solid(c.board) for c in corners):
        problems.add(
            "pairs",
            f"{len(corners)} pair(s) show the board, at least {FEWEST} are needed, {FEW} or more are good; take more pictures, "
            "the board tilted another way in each",
        )
    numbers = [c.number for c in corners]
    for number in sorted({n for n in numbers if numbers.count(n) > 1}):
        problems.add(f"pair {number}", "stands twice")
    for c in corners:
        flaw = _flaw(c, sizes)
        if flaw:
            problems.add(f"pair {c.number}", flaw)
    problems.raise_if_any()
    values, unknowns = 4 * sum(map(len, corners)), 2 * (4 + len(LENSES[distortion])) + 6 + 6 * len(corners)
    if values <= unknowns:
        problems.add(
            "points",
            f"their {values} pixel coordinates are not enough for {unknowns} unknowns; pick more points, or ask for fewer "
            "coefficients of the lens with --distortion 0",
        )
    if all(is_mirrored(c) for c in corners):
        problems.add(
            "points",
            "both cameras see the object as in a mirror; v must count down from the upper left of the image (v = height - 1 - v "
            "where it counts up), and the axes of the object must be right-handed (change the sign of one)",
        )
    problems.raise_if_any()


def _flaw(corners: Corners, sizes: tuple[Size, Size]) -> str:
    """Why a pair cannot be used; empty when it can."""
    shapes = corners.board.shape, corners.left.shape, corners.right.shape
    count = len(corners.board)
    if shapes != ((count, 3), (count, 2), (count, 2)):
        return f"expected arrays of shapes (n, 3), (n, 2), (n, 2), found {', '.join(map(str, shapes))}"
    if not all(np.isfinite(a).all() for a in (corners.board, corners.left, corners.right)):
        return "holds numbers that are not finite"
    extent = np.ptp(corners.board, axis=0).max() if count else 0.0
    if count < CORNERS or np.linalg.matrix_rank(corners.board - corners.board[0], tol=1e-3 * extent) < 2:
        return f"has {count} corners that both cameras see, or they lie on a line; at least {CORNERS} are needed"
    for side, pixels, size in zip(SIDES, (corners.left, corners.right), sizes, strict=True):
        # What is out by little may be noise.
        if (pixels < -0.02 * max(size)).any() or (pixels > 1.02 * np.array(size)).any():
            (u, v), (a, b) = pixels.min(axis=0), pixels.max(axis=0)
            return (
                f"its corners in the {side} image reach from ({u:.0f}, {v:.0f}) to ({a:.0f}, {b:.0f}), but the image has "
                f"{size[0]} x {size[1]} pixels; give the right size, width first"
            )
    return ""


def _described(
    adjustment: Adjustment,
    state: CameraEstimate,
    sizes: tuple[Size, Size],
    turned: list[int],
    outside: dict[int, float],
    many_far: bool,
) -> Calibration:
    used, residuals = adjustment.corners, adjustment.residuals(state)
    left, right = (state.camera(side, sizes[side]) for side in range(2))
    cameras = Cameras(left, right, state.rotation, state.translation, rms(residuals.reshape(-1, 2)))
    inside = {c.number: float(error) for c, error in zip(used, adjustment.pair_errors(state), strict=True)}
    normals = state.turns[:, :, 2] * np.where(state.turns[:, 2, 2] < 0, -1, 1)[:, None]
    tilts = np.degrees(np.arccos(np.clip(normals[:, 2], -1, 1)))
    return Calibration(
        cameras=cameras,
        used=used,
        residuals={
            c.number: (residuals[a:b, :2], residuals[a:b, 2:])
            for c, (a, b) in zip(used, itertools.pairwise(adjustment.ends), strict=True)
        },
        pair_errors=dict(sorted((inside | outside).items())),
        left_out=tuple(sorted(outside)),
        turned=tuple(turned),
        deviations=_deviations(adjustment, state, cameras),
        coverage=(coverage(adjustment.pixels[0], sizes[0]), coverage(adjustment.pixels[1], sizes[1])),
        tilts=(float(tilts.min()), float(tilts.max())),
        spread=math.degrees(math.acos(float(np.clip((normals @ normals.T).min(), -1, 1)))),
        sight=_sight(adjustment, state),
        distortion=adjustment.distortion,
        flat=relief(adjustment.board) < _FLAT,
        many_far=many_far,
    )


def _deviations(adjustment: Adjustment, state: CameraEstimate, cameras: Cameras) -> dict[str, float]:
    covariance = adjustment.covariance(state)
    names = [f"{side}.{(MATRIX + COEFFICIENTS)[k]}" for side in SIDES for k in adjustment.free]
    spread = np.sqrt(np.diag(covariance))
    found = dict(zip(names, spread[: len(names)].tolist(), strict=True))
    by_baseline = np.zeros(len(covariance))
    by_baseline[-3:] = cameras.translation / cameras.baseline
    by_angle = np.zeros(len(covariance))
    by_angle[-6:-3] = angle_by_turn(cameras.rotation)
    for name, direction, unit in (("baseline", by_baseline, 1.0), ("angle", by_angle, math.degrees(1.0))):
        known = np.isfinite(covariance).all()
        found[name] = unit * math.sqrt(max(0.0, float(direction @ covariance @ direction))) if known else math.inf
    return found


def angle_by_turn(rotation: Array) -> Array:
    """Derivatives (3) of the angle between the optical axes by small turns of the right camera, that is of `rotation` (3, 3).

    The cosine of the angle is the last element of the rotation; a turn w from the left changes the rotation by w x its columns.
    """
    x, y, _ = rotation[:, 2]
    return np.array([-y, x, 0.0]) / max(math.hypot(x, y), 1e-12)


def _sight(adjustment: Adjustment, state: CameraEstimate) -> float:
    """Mean angle between the lines from a board to the two cameras, deg."""
    points = adjustment.points(state)[0]
    centres = np.array([points[a:b].mean(axis=0) for a, b in itertools.pairwise(adjustment.ends)])
    other = centres + state.rotation.T @ state.translation
    cosines = np.sum(centres * other, axis=1) / np.linalg.norm(centres, axis=1) / np.linalg.norm(other, axis=1)
    return float(np.degrees(np.arccos(np.clip(cosines, -1, 1))).mean())


def coverage(pixels: Array, size: Size) -> float:
    """Share of the cells of `GRID` in which pixels (n, 2) of an image of a size lie."""
    inside = np.all((pixels > -0.5) & (pixels < np.array(size) - 0.5), axis=1)
    cells = ((pixels[inside] + 0.5) / size * GRID).astype(int)
    return len(np.unique(cells, axis=0)) / (GRID[0] * GRID[1])
