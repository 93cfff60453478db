"""bcid: how a soft body is held, and what its model lacks, from watching it being pulled.

    Scene, Measurement      the body and what was seen of it; both have `read`
    identify                anchored patches, with probabilities
    compare                 is a model adequate, and where does it fail?
    diagnose                which effect does it lack?
    fit                     add effects, fit numbers
    explain                 anchors and missing effects, unattended
    explore                 choose the next pull, and learn
    simulate                a measurement of a body whose anchors are known
    load                    the result that a finished run folder holds
    motions                 motions of the gripper
    IdentifyOptions, StageOptions, ExplainOptions, ExploreOptions, Model, Term    what the functions can be told

Importing the package is light: no DOLFINx, VTK or OpenCV is loaded before something needs it.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from bcid.base.version import VERSION as __version__

if TYPE_CHECKING:
    from bcid.api.functions import compare, diagnose, explain, explore, fit, identify, propose
    from bcid.api.results import load
    from bcid.base.options import ExplainOptions, ExploreOptions, IdentifyOptions, ProposeOptions, StageOptions
    from bcid.forms.model import Model, Term
    from bcid.forms.simulate import simulate
    from bcid.measurement import Measurement
    from bcid.scene import Scene, motions

_MODULES = {
    "bcid.scene": ("Scene",),
    "bcid.measurement": ("Measurement",),
    "bcid.api.functions": ("identify", "compare", "diagnose", "fit", "explain", "propose", "explore"),
    "bcid.forms.simulate": ("simulate",),
    "bcid.api.results": ("load",),
    "bcid.base.options": ("IdentifyOptions", "StageOptions", "ExplainOptions", "ProposeOptions", "ExploreOptions"),
    "bcid.forms.model": ("Model", "Term"),
}
_HOME = {name: module for module, names in _MODULES.items() for name in names} | {"motions": "bcid.scene.motions"}

__all__ = [
    "ExplainOptions",
    "ExploreOptions",
    "IdentifyOptions",
    "Measurement",
    "Model",
    "ProposeOptions",
    "Scene",
    "StageOptions",
    "Term",
    "__version__",
    "compare",
    "diagnose",
    "explain",
    "explore",
    "fit",
    "identify",
    "load",
    "motions",
    "propose",
    "simulate",
]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'bcid' has no attribute '{name}'")
    if name == "motions":
        return import_module(_HOME[name])
    return getattr(import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    return sorted(__all__)
