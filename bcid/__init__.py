"""bcid: how a soft body is held, and what its model lacks, from watching it being pulled.

Importing the package is light: no DOLFINx, VTK or OpenCV is loaded before something needs it.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

__version__ = "0.1.0"

_PUBLIC = {
    "Scene": "bcid.scene",
    "Measurement": "bcid.measurement",
    "Run": "bcid.base.run",
    "Forward": "bcid.forms.forward",
    "Model": "bcid.forms.model",
    "identify": "bcid.search.identify",
    "Identification": "bcid.search.identify",
    "Twin": "bcid.compare.twin",
    "explain": "bcid.compare.explain",
    "Explanation": "bcid.compare.explain",
    "Plan": "bcid.compare.explain",
    "simulate": "bcid.forms.simulate",
}
__all__ = [*_PUBLIC, "__version__"]


def __getattr__(name: str) -> Any:
    if name not in _PUBLIC:
        raise AttributeError(f"module 'bcid' has no attribute '{name}'")
    return getattr(import_module(_PUBLIC[name]), name)


def __dir__() -> list[str]:
    return sorted(__all__)
