"""Evidence of anchor sets against each other, each in the frames that both could be followed in."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping

import numpy as np
from numpy.typing import NDArray

from bcid.inference.criteria import CONTINUATION_FAILURE_RATE

Anchored = frozenset[str]
Frames = NDArray[np.bool_]


def relative(
    known: Mapping[Anchored, Frames], failed: Collection[Anchored], evidence: Callable[[Anchored, Frames], float]
) -> dict[Anchored, float]:
    """Logarithms of the evidence of sets, against the likeliest of them.

    Each is compared with the best of those that are known furthest. That a set cannot be followed speaks against it by how
    seldom that happens with the true one, however many frames are missing.

    Args:
        known: the frames that are known of each set, shape (frames,).
        failed: sets that could not be followed further; others were not asked.
        evidence: its logarithm of a set in some frames, at least one.
    """
    if not known:
        return {}
    furthest = known[max(known, key=lambda c: int(known[c].sum()))]
    if not furthest.any():
        return dict.fromkeys(known, 0.0)
    found = {c: evidence(c, furthest) for c, frames in known.items() if np.array_equal(frames, furthest)}
    best = max(found, key=lambda c: (found[c], -len(c), sorted(c)))
    found = {c: value - found[best] for c, value in found.items()}
    for c, frames in known.items():
        if c not in found:
            both = frames & furthest
            apart = evidence(c, both) - evidence(best, both) if both.any() else 0.0
            found[c] = apart + (math.log(CONTINUATION_FAILURE_RATE) if c in failed else 0.0)
    most = max(found.values())
    return {c: found[c] - most for c in known}
