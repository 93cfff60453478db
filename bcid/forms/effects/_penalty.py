"""The penalty of contact: what penetration stores, per area and stiffness."""

from __future__ import annotations

from typing import Any

import ufl

_EDGE = 1e-3


def stored(gap: Any, size: float) -> Any:
    """Integral of the positive part of a penetration (m), in a body of a size (m); m^2.

    It is smoothed over e = size/1000: 0 up to none, then g^3/(6 e), and (g - e/2)^2/2 + e^2/24 from e on.
    """
    edge = _EDGE * size
    deep = (gap - edge / 2) ** 2 / 2 + edge**2 / 24
    return ufl.conditional(ufl.gt(gap, edge), deep, ufl.conditional(ufl.gt(gap, 0), gap**3 / (6 * edge), 0))
