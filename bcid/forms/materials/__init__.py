"""Material laws, one file each; a law is found by the name of its file.

>>> from bcid.forms import materials
>>> "neo_hooke" in materials.names()
True
>>> materials.law("yeoh").title
'Yeoh'

A new law is a new file in this folder that defines `law`, a `Law`. Names with a leading underscore are helpers.
"""

from __future__ import annotations

from importlib import import_module
from pkgutil import iter_modules

from bcid.base.errors import InputError, nearest

# imported here, before `law` is defined, so that the function and not the module is `materials.law`
from bcid.forms.materials.law import Law

__all__ = ["Law", "law", "names"]


def names() -> list[str]:
    """Names of all material laws, sorted; nothing is loaded."""
    return sorted(m.name for m in iter_modules(__path__) if m.name != "law" and not m.name.startswith("_"))


def law(name: str) -> Law:
    """The material law of that name.

    Raises:
        InputError: there is no such law, or its file does not define `law` under its own name.
    """
    known = names()
    if name not in known:
        raise InputError(f"unknown material law '{name}'; {nearest(name, known)}")
    found = getattr(import_module(f"{__name__}.{name}"), "law", None)
    if not isinstance(found, Law) or found.name != name:
        raise InputError(f"the file of material law '{name}' must define law = Law(name='{name}', ...)")
    return found
