"""An effect as a user writes it: "gravity", "soft_anchor:3", "gravity: weight = 9.8 kN/m^3"."""

from __future__ import annotations

from bcid.base.errors import InputError, nearest
from bcid.base.units import quantity
from bcid.comparison.source import Source, find_effect
from bcid.comparison.variants import neutral_values
from bcid.forms.effects.effect import Effect
from bcid.forms.model import Term
from bcid.forms.written_effects import split


def parsed_term(text: str, source: Source, where: str = "--add") -> Term:
    """The effect that a text names, with its place and the values to start from.

    Args:
        text: name of the effect; after a colon its place, and values as "parameter = number unit", separated by commas. A
            number without a unit is in SI units (degrees for angles).
        source: whose scene, model and anchors it is for.
        where: where the text stands, for messages.

    Raises:
        InputError: effect, place, parameter, number or unit are not known.
    """
    name, place, written = split(text)
    effect = find_effect(name, source.own)
    values = neutral_values(source.model, effect)
    values |= {key: _number(effect, key, value, f"{where} {text}") for key, value in written.items()}
    _check_place(effect, place, source, f"{where} {text}", f"{where} {name}")
    return Term(effect, values, place=place)


def _number(effect: Effect, key: str, value: str, where: str) -> float:
    """A value in the unit of its parameter, which may be left out."""
    units = {parameter.name: parameter.unit for parameter in effect.parameters}
    if key not in units:
        raise InputError(f"{where}: {effect.name} has no parameter '{key}'; {nearest(key, units)}")
    try:
        return float(value)
    except ValueError:
        pass
    try:
        return quantity(value, units[key])
    except InputError as error:
        raise InputError(f"{where}: {key}: {error}") from None


def _check_place(effect: Effect, place: str, source: Source, where: str, example: str) -> None:
    known = effect.places(source.scene, source.anchors or frozenset()) if effect.places else [""]
    if place in known:
        return
    there = [name for name in known if name]
    if not place and there:
        raise InputError(f"{where}: say where, as {example}:{there[0]}; known: {', '.join(there)}")
    reason = f"place '{place}': {nearest(place, there)}" if there else "it has no places"
    raise InputError(f"{where}: {reason}")
