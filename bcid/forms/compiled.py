"""Forms and expressions, compiled into folders that stay small.

DOLFINx keeps all that it ever compiled in one folder, and FFCx lists that folder whenever it loads from it: 10 ms for each form
where it has gathered 16,000 files. In one of 256 folders below it, by the form's signature, the list is short.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from dolfinx import fem, jit
from numpy.typing import NDArray


def form(integrals: Any) -> Any:
    """The compiled form of integrals in UFL; collective on its mesh."""
    return fem.form(integrals, jit_options=_kept_in(integrals.signature()[:2]))


def expression(value: Any, points: NDArray[Any]) -> Any:
    """A value in UFL that can be evaluated at points of the reference cell, shape (n, 3); collective on its mesh."""
    return fem.Expression(value, points, jit_options=_kept_in("expressions"))


def _kept_in(folder: str) -> dict[str, str]:
    return {"cache_dir": str(Path(jit.get_options()["cache_dir"]) / folder)}
