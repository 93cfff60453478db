"""A spring in series with a slider (Prandtl's element): it stores up to a limit, and follows beyond.

With linear kinematic hardening beside it, it is plasticity without (Simo & Hughes, Computational Inelasticity, 1998, section 1.4).
`strain` is what the spring would be strained by if the slider stood still, `limit` the strain from which the slider moves, and the
size of a strain its norm in units of the limit. Between sizes of 0.95 and 1.05 the stress bends smoothly from rising to constant.
"""

from __future__ import annotations

from typing import Any

import ufl

_EDGE = 0.05
_LOW, _HIGH = 1 - _EDGE, 1 + _EDGE
# Keeps the derivative of a norm finite where there is nothing.
_TINY = 1e-24


def size(strain: Any, limit: Any) -> Any:
    """Of a strain."""
    return ufl.sqrt(ufl.inner(strain, strain) / limit**2 + _TINY)


def _by_size(at: Any, below: Any, bend: Any, beyond: Any) -> Any:
    return ufl.conditional(ufl.lt(at, _LOW), below, ufl.conditional(ufl.lt(at, _HIGH), bend, beyond))


def work(strain: Any, limit: Any) -> Any:
    """What a step stores in the spring and takes to move the slider: size^2 below the limit, 2 size - 1 beyond."""
    at = size(strain, limit)
    below = ufl.inner(strain, strain) / limit**2
    bend = _LOW**2 + 2 * (at - _LOW) + ((_HIGH - at) ** 3 - (2 * _EDGE) ** 3) / (6 * _EDGE)
    beyond = _LOW**2 + 4 * _EDGE - 4 * _EDGE**2 / 3 + 2 * (at - _HIGH)
    return _by_size(at, below, bend, beyond)


def slid(strain: Any, limit: Any) -> Any:
    """By how much the slider has moved after a step: by what the strain is more than the spring holds."""
    at = size(strain, limit)
    held = _by_size(at, 1.0, (1 - (_HIGH - at) ** 2 / (4 * _EDGE)) / at, 1 / at)
    return (1 - held) * strain
