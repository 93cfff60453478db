"""Beads in an image: candidates where a difference of Gaussians peaks, then a fit of a blurred ellipse to the pixels around.

The grey value around a bead is modelled as a plane plus contrast / (1 + exp(k (|A (p - c)| - 1))): an ellipse with centre c and
soft rim. The centre's covariance is that of the least squares fit, with the noise taken from its residual.
"""

from __future__ import annotations

from dataclasses import astuple, dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

# The window of a fit reaches so many diameters from the middle.
_REACH = 1.15
# Candidates: peaks above so many times the noise of the response and this part of the strongest, and at most so many.
_NOISES, _PART, _MOST = 6.0, 0.3, 150
# The fit: iterations, and the smallest step (px) that goes on.
_ITERATIONS, _SETTLED = 30, 1e-3
# Steepness of the rim to begin with, for a bead of one pixel.
_RIM = 1.0
# A bead's diameter may differ from what is expected by this factor; one axis may be this part of the other.
_SIZE, _ROUND = 1.8, 0.4
# What the fit leaves is at most this part of the contrast.
_LEFT = 0.2
# Error of a centre that the fit does not know of (pixels are not points, shade is not a plane), px.
_FLOOR = 0.007
_PARAMETERS = 10


@dataclass(frozen=True)
class Spots:
    """What may be beads in an image.

    Attributes:
        pixels: centres, shape (n, 2), px.
        covariance: of the centres, shape (n, 2, 2), px^2.
        diameter: geometric mean of the axes, shape (n,), px.
        contrast: grey levels between bead and surroundings, shape (n,), positive.
        residual: RMS of what the fit leaves, grey levels, shape (n,).
    """

    pixels: Array
    covariance: Array
    diameter: Array
    contrast: Array
    residual: Array

    def __len__(self) -> int:
        return len(self.pixels)


def detect(image: Image, diameter: float, dark: bool = True) -> Spots:
    """Find what may be beads.

    Args:
        image: grey, shape (height, width).
        diameter: that a bead is expected to have, px.
        dark: whether beads are darker than what surrounds them, or brighter.
    """
    grey = image.astype(np.float32)
    if dark:
        grey = 255.0 - grey
    return _fitted(grey, _candidates(grey, diameter), diameter)


def _candidates(grey: NDArray[np.float32], diameter: float) -> Array:
    """Peaks (n, 2), px, of the difference of two Gaussians that answers most to discs of this diameter."""
    import cv2

    narrow = diameter / 3.6
    response = cv2.GaussianBlur(grey, (0, 0), narrow) - cv2.GaussianBlur(grey, (0, 0), 1.6 * narrow)
    reach = max(round(diameter / 2), 1)
    highest = cv2.dilate(response, np.ones((2 * reach + 1, 2 * reach + 1), np.uint8))
    # Median of absolute deviations of a part of the pixels: edges and beads are few.
    few = response[::7, ::7]
    noise = 1.4826 * float(np.median(np.abs(few - np.median(few))))
    least = max(_NOISES * noise, _PART * float(response.max()), 1e-3)
    rows, columns = np.nonzero((response >= highest) & (response > least))
    order = np.argsort(response[rows, columns])[::-1][:_MOST]
    return np.column_stack([columns[order], rows[order]]).astype(float)


def _fitted(grey: NDArray[np.float32], peaks: Array, diameter: float) -> Spots:
    """Fit all windows at once (Levenberg and Marquardt), and keep what looks like a bead."""
    reach = int(np.ceil(_REACH * diameter)) + 1
    height, width = grey.shape
    inside = (peaks >= reach).all(axis=1) & (peaks[:, 0] < width - reach) & (peaks[:, 1] < height - reach)
    peaks = peaks[inside]
    if len(peaks) == 0:
        return _none()
    offsets = np.arange(-reach, reach + 1)
    rows, columns = peaks[:, 1].astype(int), peaks[:, 0].astype(int)
    windows = grey[rows[:, None, None] + offsets[None, :, None], columns[:, None, None] + offsets[None, None, :]]
    values: Array = windows.reshape(len(peaks), -1).astype(float)
    grid: Array = np.stack(np.meshgrid(offsets, offsets), axis=-1).reshape(-1, 2).astype(float)
    inside = np.linalg.norm(grid, axis=1) <= reach
    values, grid = values[:, inside], grid[inside]
    parameters, hessian, noise = _least_squares(grid, values, _start(values, grid, diameter))
    covariance = np.linalg.pinv(hessian)[:, :2, :2] * (noise**2)[:, None, None] + _FLOOR**2 * np.eye(2)
    axes = np.linalg.svd(_shape(parameters), compute_uv=False)
    sizes, contrast = 2 / np.sqrt(axes[:, 0] * axes[:, 1]), parameters[:, 5]
    good = (
        (np.abs(parameters[:, :2]).max(axis=1) < diameter / 2)
        & (sizes < _SIZE * diameter)
        & (sizes > diameter / _SIZE)
        & (axes[:, 1] > _ROUND * axes[:, 0])
        & (contrast > 0)
        & (noise < _LEFT * contrast)
        & np.isfinite(covariance).all(axis=(1, 2))
    )
    return _distinct(
        Spots((peaks + parameters[:, :2])[good], covariance[good], sizes[good], contrast[good], noise[good])
    )


def _none() -> Spots:
    return Spots(np.zeros((0, 2)), np.zeros((0, 2, 2)), np.zeros(0), np.zeros(0), np.zeros(0))


def _start(values: Array, grid: Array, diameter: float) -> Array:
    """First values (n, 10): centre, A as (a, b, c) of [[a, b], [b, c]], contrast, background, its slopes, steepness."""
    start = np.zeros((len(values), _PARAMETERS))
    far = np.linalg.norm(grid, axis=1) > 0.75 * diameter
    near = np.linalg.norm(grid, axis=1) < 0.25 * diameter
    start[:, 2] = start[:, 4] = 2 / diameter
    start[:, 6] = np.median(values[:, far], axis=1)
    start[:, 5] = np.median(values[:, near], axis=1) - start[:, 6]
    start[:, 9] = _RIM * diameter
    return start


def _shape(parameters: Array) -> Array:
    a, b, c = parameters[:, 2], parameters[:, 3], parameters[:, 4]
    return np.stack([np.stack([a, b], axis=-1), np.stack([b, c], axis=-1)], axis=-2)


def _profile(parameters: Array, grid: Array) -> tuple[Array, Array, Array, Array]:
    """Of every window and pixel: offset (n, p, 2) from the centre, A times it, its length rho, and the share (n, p) of the bead."""
    away = grid[None] - parameters[:, None, :2]
    # The shape is symmetric: no transpose is needed.
    mapped = away @ _shape(parameters)
    radius = np.sqrt(mapped[:, :, 0] ** 2 + mapped[:, :, 1] ** 2) + 1e-12
    edge = np.clip(parameters[:, 9:10] * (radius - 1), -40, 40)
    return away, mapped, radius, 1 / (1 + np.exp(edge))


def _plane(parameters: Array, grid: Array) -> Array:
    return np.asarray(parameters[:, 6:7] + parameters[:, 7:9] @ grid.T)


def _model(parameters: Array, grid: Array) -> Array:
    """Grey values (n, pixels)."""
    return np.asarray(_plane(parameters, grid) + parameters[:, 5:6] * _profile(parameters, grid)[3])


def _slopes(parameters: Array, grid: Array) -> Array:
    """Derivatives (n, pixels, 10) of the model."""
    away, mapped, radius, share = _profile(parameters, grid)
    by_edge = -parameters[:, 5:6] * share * (1 - share)
    by_mapped = (by_edge * parameters[:, 9:10] / radius)[:, :, None] * mapped
    slopes = np.empty((*share.shape, _PARAMETERS))
    slopes[:, :, :2] = -by_mapped @ _shape(parameters)
    slopes[:, :, 2] = by_mapped[:, :, 0] * away[:, :, 0]
    slopes[:, :, 3] = by_mapped[:, :, 0] * away[:, :, 1] + by_mapped[:, :, 1] * away[:, :, 0]
    slopes[:, :, 4] = by_mapped[:, :, 1] * away[:, :, 1]
    slopes[:, :, 5] = share
    slopes[:, :, 6] = 1.0
    slopes[:, :, 7:9] = grid
    slopes[:, :, 9] = by_edge * (radius - 1)
    return slopes


def _least_squares(grid: Array, values: Array, start: Array) -> tuple[Array, Array, Array]:
    """Parameters (n, 10), their J^T J (n, 10, 10), and the RMS of what is left with the degrees of freedom (n,)."""
    parameters = start.copy()
    left = values - _model(parameters, grid)
    cost = np.sum(left**2, axis=1)
    damping = np.full(len(start), 1e-2)
    hessian = np.zeros((len(start), _PARAMETERS, _PARAMETERS))
    active = np.arange(len(start))
    for _ in range(_ITERATIONS):
        slope = _slopes(parameters[active], grid)
        normal = np.swapaxes(slope, 1, 2) @ slope
        hessian[active] = normal
        gradient = (left[active, None] @ slope)[:, 0]
        diagonal = np.einsum("nii->ni", normal)
        damped = normal + (damping[active, None] * diagonal + 1e-12)[:, :, None] * np.eye(_PARAMETERS)
        step = np.linalg.solve(damped, gradient[:, :, None])[:, :, 0]
        tried = parameters[active] + step
        remains = values[active] - _model(tried, grid)
        smaller = np.sum(remains**2, axis=1) < cost[active]
        taken = active[smaller]
        parameters[taken], left[taken] = tried[smaller], remains[smaller]
        cost[taken] = np.sum(remains[smaller] ** 2, axis=1)
        damping[active] *= np.where(smaller, 0.2, 10.0)
        moving = np.abs(step[:, :2]).max(axis=1) > _SETTLED
        active = active[(moving | ~smaller) & (damping[active] < 1e6)]
        if len(active) == 0:
            break
    return parameters, hessian, np.sqrt(cost / (len(grid) - _PARAMETERS))


def _distinct(spots: Spots) -> Spots:
    """Without spots whose centres fall together: the one with more contrast stays."""
    order = np.argsort(-spots.contrast)
    kept: list[int] = []
    for i in order:
        apart = np.linalg.norm(spots.pixels[kept] - spots.pixels[i], axis=1) if kept else np.ones(1) * np.inf
        if (apart > spots.diameter[i] / 2).all():
            kept.append(int(i))
    return Spots(*(values[kept] for values in astuple(spots)))
