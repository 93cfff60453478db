"""Sensitivities to effects that act by the clock, from those to the same amounts if they were steady.

What a steady amount does changes as smoothly as the motion; what acts of it in a frame need not.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from bcid.forms.model import Model
from bcid.forms.probes import Probe

Array = NDArray[np.float64]
Slopes = Sequence[Mapping[str, float]]


def steady(probe: Probe, model: Model, times: Array) -> Probe | None:
    """The same effect with all that acts of it at any of some times (s) acting always.

    None where that is not all there is to it: it is no effect in the body, or acts already, so that what more of it does depends on
    how much acts.
    """
    effect, values = probe.effect, probe.term.values
    inside = effect.acting and effect.mechanical and not (effect.drive or effect.observe or effect.memory)
    if not inside or effect.uses_past or any(values[p.name] != model.neutral(p) for p in effect.amounts):
        return None
    names = {key for name in probe.wanted for found in _slopes(probe, name, times) for key in found}
    if not names or not names <= set(values):
        return None
    return Probe(replace(probe.term, effect=replace(effect, acting=None)), tuple(sorted(names)))


def by_the_clock(probe: Probe, always: Mapping[str, Array], times: Array) -> dict[str, Array]:
    """Sensitivities to a probe, each (frames, ...), from those to its `steady` one and the times of the frames, s."""
    found = {}
    for name in probe.wanted:
        here = _slopes(probe, name, times)
        found[name] = sum(
            (np.array([one.get(key, 0.0) for one in here])[:, None, None] * array for key, array in always.items()),
            start=np.zeros_like(next(iter(always.values()))),
        )
    return found


def _slopes(probe: Probe, name: str, times: Array) -> Slopes:
    """How the values that act at each time (s) change with a parameter, see `Effect.slopes`."""
    return [probe.effect.slopes(name, float(time), probe.term.values) for time in times]
