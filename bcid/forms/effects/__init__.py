"""The catalogue of physical effects: one file each, found by the name of its file.

An effect is a `bcid.forms.effects.effect.Effect`; a file that defines ``effect = Effect(...)`` in this folder is part
of the catalogue, and nothing else names it.
"""

from __future__ import annotations

from importlib import import_module
from pkgutil import iter_modules

from bcid.errors import InputError, nearest
from bcid.forms.effects.effect import Effect

__all__ = ["Effect", "effect", "names"]


def names() -> list[str]:
    """Names of all effects, sorted; nothing is loaded."""
    return sorted(m.name for m in iter_modules(__path__) if m.name != "effect" and not m.name.startswith("_"))


def effect(name: str) -> Effect:
    """The effect of that name; `InputError` when there is none."""
    if name not in names():
        raise InputError(f"unknown effect '{name}'; {nearest(name, names())}")
    found: Effect = import_module(f"{__name__}.{name}").effect
    return found
