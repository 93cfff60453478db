"""Beads in one image, drawn where they are known to be."""

from __future__ import annotations

import numpy as np
import pytest
from drawn import draw

from bcid.vision.detect import Spots, detect


def grid(rng: np.random.Generator) -> np.ndarray:
    """Ninety centres anywhere within their pixels."""
    places = np.array([[x, y] for x in range(60, 600, 54) for y in range(50, 480, 52)], dtype=float)
    return np.asarray(places + rng.uniform(-0.5, 0.5, places.shape))


def matched(spots: Spots, centres: np.ndarray) -> np.ndarray:
    """Number of the centre of each spot; every spot must have one, and no two the same."""
    away = np.linalg.norm(spots.pixels[:, None] - centres[None], axis=2)
    assert away.min(axis=1).max() < 1
    return np.asarray(away.argmin(axis=1))


@pytest.mark.parametrize(("diameter", "noise"), [(4.0, 2.0), (7.5, 2.0), (7.5, 8.0), (12.0, 4.0)])
def test_centres_are_found_within_their_covariance(diameter: float, noise: float) -> None:
    rng = np.random.default_rng(0)
    centres = grid(rng)
    spots = detect(draw(centres, diameter, rng, (640, 512), noise), 1.1 * diameter)
    order = matched(spots, centres)
    assert sorted(order) == list(range(len(centres)))
    error = spots.pixels - centres[order]
    assert np.abs(error.mean(axis=0)).max() < 0.01
    chi2 = np.einsum("ni,nij,nj->n", error, np.linalg.inv(spots.covariance), error)
    assert 0.6 < chi2.mean() / 2 < 1.6
    assert spots.diameter.mean() == pytest.approx(diameter, rel=0.1)


def test_bright_beads_are_found_when_they_are_asked_for() -> None:
    rng = np.random.default_rng(1)
    centres = grid(rng)[:10]
    image = 255 - draw(centres, 7.5, rng, (640, 512))
    assert len(detect(image, 7.5)) == 0
    assert sorted(matched(detect(image, 7.5, dark=False), centres)) == list(range(10))


def test_edges_lines_and_blots_are_no_beads() -> None:
    rng = np.random.default_rng(2)
    centres = grid(rng)[::10]
    image = draw(centres, 7.5, rng, (640, 512)).astype(float)
    image[:, 330:] *= 0.5
    image[255:259, :] *= 0.4
    image[5:35, 250:280] = 30
    found = detect(np.clip(image, 0, 255).astype(np.uint8), 7.5)
    matched(found, centres)
    assert len(found) >= len(centres) - 2


@pytest.mark.parametrize("grey", [0, 128, 255])
def test_an_empty_image_holds_nothing(grey: int) -> None:
    assert len(detect(np.full((120, 160), grey, np.uint8), 7.5)) == 0
