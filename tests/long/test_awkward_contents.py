"""Measurements that contradict themselves, of a slab with eight patches: the anchors are right or open; see verify/test_awkward."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from verify.test_awkward import (
    ANCHORED,
    MARKER,
    STEPS,
    Array,
    changed,
    eight,  # noqa: F401
    found,
    seen,
)

from bcid import Scene
from bcid.inference.thresholds import THRESHOLDS

OTHER = 10


@pytest.fixture(scope="module")
def slab(eight: Scene) -> Scene:
    return eight


def swapped(positions: Array) -> None:
    # In the middle of each action: at rest the two would be known by their places.
    later = np.arange(len(positions)) % STEPS > STEPS // 2
    positions[np.ix_(later, [MARKER, OTHER])] = positions[np.ix_(later, [OTHER, MARKER])]


def of_another_body(positions: Array) -> None:
    """The markers move as those of a body that is turned by a right angle about the vertical axis."""
    moved = (positions - positions[:1])[:, _TURNED]
    positions[:] = positions[:1] + moved @ np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])


def relabelled(positions: Array) -> None:
    """What was seen in the first action stands under the name of the last, and the other way round."""
    first, last = positions[:STEPS].copy(), positions[-STEPS:].copy()
    positions[:STEPS], positions[-STEPS:] = last, first


# The 16 markers stand in a square of 4 by 4.
_TURNED = np.rot90(np.arange(16).reshape(4, 4)).ravel()
INCONSISTENT: dict[str, Callable[[Array], None]] = {
    "the field of another body": of_another_body,
    "two actions have each other's names": relabelled,
}


@pytest.mark.parametrize("case", INCONSISTENT)
def test_identify_inconsistent_data_no_set_is_certain(slab: Scene, case: str) -> None:
    identified = found(slab, changed(seen(slab), INCONSISTENT[case]))

    assert identified.probability < THRESHOLDS.credible
    assert identified.discrepancy_probability is not None
    assert identified.discrepancy_probability > THRESHOLDS.credible


def test_two_markers_swapped_half_way_it_is_right_or_open(slab: Scene) -> None:
    identified = found(slab, changed(seen(slab), swapped))

    assert identified.anchored == ANCHORED or identified.probability < THRESHOLDS.credible
