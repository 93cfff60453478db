"""An effect as a user writes it: "gravity", "soft_anchor:3", "gravity: weight = 9.8 kN/m^3", "gravity: course = 8"."""

from __future__ import annotations

from bcid.base.errors import InputError, nearest
from bcid.base.units import quantity
from bcid.forms.course import COURSES, course_of, in_time
from bcid.forms.effects.effect import Effect
from bcid.forms.model import Term
from bcid.forms.written_effects import split
from bcid.search.answer.source import Source, find_effect
from bcid.search.fitting.courses import knots
from bcid.search.fitting.variants import neutral_values


def parsed_term(text: str, source: Source, where: str = "--add") -> Term:
    """The effect that a text names, with its place and the values to start from.

    Args:
        text: name of the effect; after a colon its place, and values as "parameter = number unit", separated by commas. A
            number without a unit is in SI units (degrees for angles). With "course = 8" the amounts follow a course in time
            with so many knots, see `bcid.search.fitting.courses.knots`, with "stepwise = 8" they are constant between them.
        source: whose scene, model and anchors it is for.
        where: where the text stands, for messages.

    Raises:
        InputError: effect, place, parameter, number or unit are not known.
    """
    name, place, written = split(text)
    effect = find_effect(name, source.own)
    effect = _in_time(effect, written, source, f"{where} {text}")
    values = neutral_values(source.model, effect)
    for key, value in written.items():
        names = _names(effect, key)
        values |= dict.fromkeys(names, _number(effect, key, names[0], value, f"{where} {text}"))
    _check_place(effect, place, source, f"{where} {text}", f"{where} {name}")
    return Term(effect, values, place=place)


def _in_time(effect: Effect, written: dict[str, str], source: Source, where: str) -> Effect:
    """The effect with a course of as many knots as are asked for; the word that asks is taken out."""
    asked = [word for word in COURSES if word in written]
    if len(asked) > 1:
        raise InputError(f"{where}: course and stepwise exclude each other; leave one of them out")
    for word in asked:
        number = written.pop(word)
        try:
            return in_time(effect, _knots(number, source, COURSES[word]), COURSES[word])
        except InputError as error:
            raise InputError(f"{where}: {word} = {number}: {error}") from None
    return effect


def _knots(number: str, source: Source, stepwise: bool) -> tuple[float, ...]:
    if not number.isascii() or not number.isdigit() or int(number) < 2:
        raise InputError("expected how many knots the course has, a whole number from 2 on, as in course = 8")
    found = knots(source.measurement, int(number), stepwise)
    if len(found) < int(number):
        raise InputError(f"the measurement has two frames, at different times, for at most {len(found)} knots")
    return found


def _names(effect: Effect, key: str) -> tuple[str, ...]:
    """The parameters that a written one stands for: an amount of a course for its values at all knots."""
    course = course_of(effect)
    constant = course is not None and key in {p.name for p in course.effect.amounts}
    return course.names(key) if course is not None and constant else (key,)


def _number(effect: Effect, key: str, name: str, value: str, where: str) -> float:
    """A value in the unit of a parameter, which may be left out; `key` is what the user calls it."""
    units = {parameter.name: parameter.unit for parameter in effect.parameters}
    if name not in units:
        course = course_of(effect)
        known = units if course is None else [p.name for p in course.effect.parameters if p.off is None]
        raise InputError(f"{where}: {effect.name} has no parameter '{key}'; {nearest(key, known)}")
    try:
        return float(value)
    except ValueError:
        pass
    try:
        return quantity(value, units[name])
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
