"""A term as the file of an effect: text that a user can read, change and run, and that the search itself runs."""

from __future__ import annotations

import keyword
import math
import textwrap
from collections.abc import Mapping, Sequence
from typing import Any

from bcid.base.errors import InputError
from bcid.forms.effects.effect import Effect
from bcid.forms.parameter import Amount, Parameter
from bcid.grammar.family import FINE, OBSERVATION, SPOT, SURFACE, Family

# Digits of numbers that are written: enough for any that a measurement tells.
_DIGITS = 6
_SPOT = (
    'away = point.X - ufl.as_vector([c["cx"], c["cy"], c["cz"]])',
    'weight = ufl.exp(-ufl.inner(away, away) / (2 * c["radius"] ** 2))',
)
_PICTURE = (
    ("away = positions - frame.rest.mean(axis=0)", "away"),
    ("size = np.linalg.norm(np.ptp(frame.rest, axis=0))", "size"),
)
_LIBRARIES = ("import math", "import numpy as np", "import ufl")
_WIDTH = 120


def check_name(name: str) -> None:
    """Refuse what cannot be the name of an effect.

    Raises:
        InputError: it is no identifier, or a word of Python.
    """
    if not name.isidentifier() or keyword.iskeyword(name):
        raise InputError(f"'{name}' cannot be the name of an effect: use letters, digits and _, as in soft_spot.py")


def source(
    family: Family, name: str, values: Mapping[str, float], place: str, about: Sequence[str], places: Sequence[str] = ()
) -> str:
    """The file of one term.

    Args:
        family: of the term.
        name: of the effect, and of its file.
        values: found for its numbers; those of its shapes become defaults.
        place: the surface on which it was found; "" where it has none.
        about: lines of the docstring after the first, wrapped already.
        places: the surfaces on which it may act; only that on which it was found by default.
    """
    docstring = "\n".join([f"{family.about[0].upper()}{family.about[1:]}: {family.formula}.", "", *about]).rstrip()
    imports, code = _imports(family), []
    effect = f'effects.effect("{family.catalogue}")'
    if not family.catalogue:
        kind = _kind(family)
        function = _observe(family) if kind == "observe" else _function(kind, family)
        needed = [line for line in _LIBRARIES if f"{line.split()[-1]}." in function]
        imports[1:1] = ["\n".join(needed)]
        code = [function, _effect(kind, family, name, values, list(places) or [place])]
        effect = "effect"
    if family.times:
        times = ", ".join(_number(t) for t in family.times)
        code.append(
            f"# Knots of the course, s: amounts go straight from one to the next.\nTIMES = ({times})\n"
            f'effect = replace(in_time({effect}, TIMES), name="{name}")'
        )
    head = "\n\n".join(
        part for part in (f'"""{docstring}\n"""', "from __future__ import annotations", *imports) if part
    )
    return "\n\n\n".join([head, *code]) + "\n"


def _imports(family: Family) -> list[str]:
    """Blocks of imports: of Python's library, and of bcid."""
    own = [] if family.catalogue else [f"from bcid.forms.effects.effect import {_class(family)}"]
    own += [] if family.catalogue else [f"from bcid.forms.parameter import {_kinds(family)}"]
    own += ["from bcid.forms import effects"] if family.catalogue else []
    own += ["from bcid.forms.course import in_time"] if family.times else []
    own += ["from bcid.forms.spectrum import Spectrum"] if "Spectrum." in family.code else []
    return ["from dataclasses import replace" if family.times else "", "\n".join(sorted(own))]


def made(text: str) -> Effect:
    """The effect that a text defines, which is run for it."""
    names: dict[str, Any] = {"__name__": "bcid_proposed"}
    exec(compile(text, "<proposed effect>", "exec"), names)
    found = names["effect"]
    assert isinstance(found, Effect)
    return found


def _kinds(family: Family) -> str:
    return "Amount, Shape" if family.shapes else "Amount"


def _class(family: Family) -> str:
    return "ObservationEffect" if family.kind == OBSERVATION else "BodyEffect"


def _kind(family: Family) -> str:
    """Which function of the effect a family's code is."""
    if family.kind == OBSERVATION:
        return "observe"
    return "work" if family.works else "potential" if family.kind == "boundary" else "energy"


def _observe(family: Family) -> str:
    """The function that says where fiducials appear."""
    *lines, last = family.code.replace("'", '"').splitlines()
    value = last.removeprefix("return ")
    lines = [line for line, needed in _PICTURE if needed in family.code] + lines
    return "\n".join(
        [
            "def observe(positions, c, frame, place):",
            *(f"    {line}" for line in lines),
            f"    return positions + {value}",
        ]
    )


def _function(kind: str, family: Family) -> str:
    """The function that says what the effect does."""
    *lines, last = family.code.replace("'", '"').splitlines()
    value = last.removeprefix("return ")
    if family.local:
        lines = [*lines, *_SPOT]
        value = f"weight * {_grouped(value)}"
    if family.where == SURFACE:
        value = f"{_grouped(value)} * point.surface(point.place)"
    elif family.where == SPOT:
        value = f'{value} * point.boundary(metadata={{"quadrature_degree": {FINE}}})'
    elif family.works:
        value = f"{_grouped(value)} * ufl.dx"
    return "\n".join([f"def {kind}(point, c):", *(f"    {line}" for line in (*lines, f"return {value}"))])


def _grouped(value: str) -> str:
    """A sum in brackets."""
    return f"({value})" if value.startswith("-") or " + " in value or " - " in value else value


def _effect(kind: str, family: Family, name: str, values: Mapping[str, float], places: Sequence[str]) -> str:
    lines = [f"effect = {_class(family)}(", f'    name="{name}",', "    parameters=("]
    lines += [f"        {_parameter(p, values)}," for p in family.parameters]
    acts = {"energy": "material"}.get(family.kind, family.kind)
    lines += ["    ),", f'    about="{family.about}",', f'    acts_on="{acts}",', f"    {kind}={kind},"]
    lines += ["    symmetric=False,"] if family.works else []
    lines += ["    uses_past=True,"] if family.remembers else []
    lines += [f'    instead_of="{family.instead_of}",'] if family.instead_of else []
    lines += [f"    places=lambda scene, anchors: {_listed(places)},"] if family.where == SURFACE else []
    return "\n".join([*lines, ")"])


def _listed(places: Sequence[str]) -> str:
    return "[" + ", ".join(f'"{place}"' for place in places) + "]"


def _parameter(p: Parameter, values: Mapping[str, float]) -> str:
    """As it is declared; a value that was found for a shape is its default."""
    amount = isinstance(p, Amount)
    words = [f'"{p.name}"', f'"{p.unit}"', f'"{p.about}"']
    if amount:
        words.append("neutral=0.0")
    elif p.default is not None:
        words.append(f"default={_number(values.get(p.name, p.default))}")
    words += [f"{side}={_number(getattr(p, side))}" for side in ("lower", "upper") if math.isfinite(getattr(p, side))]
    words += ["open_lower=True"] if p.open_lower else []
    words += [f"scale={_number(p.scale)}"]
    words += [f"period={_number(p.period)}"] if p.period else []
    words += [f"prior=({_number(p.prior[0])}, {_number(p.prior[1])})"] if p.prior else []
    return f"{'Amount' if amount else 'Shape'}({', '.join(words)})"


def _number(value: float) -> str:
    return repr(float(f"{value:.{_DIGITS}g}"))


def wrapped(text: str) -> list[str]:
    """A paragraph of a docstring."""
    return textwrap.wrap(text, _WIDTH)
