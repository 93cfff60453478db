"""The catalogue of physical effects: one file each, found by the name of its file.

An effect is a `bcid.forms.effects.effect.Effect`; a file that defines one as ``effect`` in this folder is part
of the catalogue, and nothing else names it. A file elsewhere is read by `load`.
"""

from __future__ import annotations

import traceback
from collections.abc import Iterable, Sequence
from importlib import import_module
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from pkgutil import iter_modules

from bcid.base.errors import InputError, nearest
from bcid.forms.effects.effect import Effect

__all__ = ["Effect", "catalogue", "effect", "load", "names"]


def names() -> list[str]:
    """Names of all effects, sorted; nothing is loaded."""
    return sorted(m.name for m in iter_modules(__path__) if m.name != "effect" and not m.name.startswith("_"))


def effect(name: str) -> Effect:
    """The effect of that name; `InputError` when there is none."""
    if name not in names():
        raise InputError(f"unknown effect '{name}'; {nearest(name, names())}")
    found: Effect = import_module(f"{__name__}.{name}").effect
    return found


def catalogue(only: Sequence[str] | None = None, own: Iterable[Effect] = ()) -> list[Effect]:
    """The effects of the catalogue that are looked for unasked, and others beside them; or those of the given names."""
    every, own = list(map(effect, names())), list(own)
    if only is None:
        return [*(one for one in every if not one.only_named), *own]
    return [one for one in [*every, *own] if one.name in only]


def load(path: str | Path) -> Effect:
    """The effect of a Python file outside the catalogue, which is run for it.

    Raises:
        InputError: with file and line, when the file cannot be run, defines no effect, or takes a name of the catalogue.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path}: no such file; expected a Python file that defines effect = BodyEffect(...)")
    spec = spec_from_file_location(f"bcid_effect_{path.stem}", path)
    if spec is None or spec.loader is None:
        raise InputError(f"{path}: is not a Python file; its name must end in .py")
    module = module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except SyntaxError as error:
        raise InputError(f"{path}:{error.lineno}: {error.msg}") from None
    except (Exception, SystemExit) as error:
        lines = [f.lineno for f in traceback.extract_tb(error.__traceback__) if f.filename == str(path)]
        where = f"{path}:{lines[-1]}" if lines else str(path)
        raise InputError(f"{where}: {type(error).__name__}: {error}") from None
    found = getattr(module, "effect", None)
    if not isinstance(found, Effect):
        raise InputError(
            f"{path}: defines no effect; write effect = BodyEffect(name=..., parameters=..., about=..., ...)"
        )
    if found.name in names():
        raise InputError(f"{path}: the catalogue has an effect '{found.name}' already; give yours another name")
    return found
