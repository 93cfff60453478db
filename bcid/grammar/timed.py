"""Families whose amounts follow a course in time: of the catalogue and of the grammar, straight from beginning to end or free."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

from bcid.forms import effects
from bcid.forms.effects.effect import Effect
from bcid.forms.parameter import Amount, Shape
from bcid.grammar.family import Family
from bcid.search.fitting.courses import knots, variant_in_time
from bcid.search.fitting.state import State
from bcid.search.fitting.variants import Variant, all_variants

# What may change with time: effects of the catalogue with the kind of term that each is, and families of the grammar.
_CATALOGUE = {
    "active_stress": "energy",
    "gravity": "body force",
    "grasp_slip": "grip",
    "grasp_offset": "grip",
    "camera_offset": "observation",
    "time_lag": "observation",
}
_FAMILIES = ("pressure", "traction", "body_force", "pressure_at_a_spot")
# By how many knots, and how a family of that kind is called.
_COURSES = {2: "drifting", 8: "in_time"}


def timed_families(state: State, grammar: Iterable[Family], kinds: Sequence[str]) -> list[Family]:
    """All of them that can act in the scene and measurement of a state; none where it was seen at too few times."""
    scene, measurement = state.predictor.scene, state.predictor.measurement
    steady = [family for family in grammar if family.name in _FAMILIES]
    for name, kind in _CATALOGUE.items():
        effect = effects.effect(name)
        family = _of_catalogue(effect, kind)
        if family.group in kinds and not effect.not_applicable(scene, measurement):
            steady.append(family)
    found = []
    for most, word in _COURSES.items():
        times = _knots(state, most)
        found += [_in_time(family, word, times) for family in steady if times]
    return found


def steady_variants(state: State, families: Iterable[Family]) -> dict[str, list[Variant]]:
    """Of the effects of the catalogue that families are made of, by its name; collective."""
    names = {family.catalogue for family in families if family.catalogue}
    taken = {term.effect.name for term in state.model.terms}
    wanted = [(effects.effect(name), "") for name in sorted(names - taken)]
    return all_variants(state, wanted) if wanted else {}


def variants_in_time(state: State, family: Family, steady: Sequence[Variant]) -> list[Variant]:
    """Each steady variant with a course, but for those that come and go by themselves."""
    return [variant_in_time(state, v, family.times) for v in steady if _is_steady(v)]


def _is_steady(variant: Variant) -> bool:
    term = variant.term
    return all(p.off is None or term.values[p.name] == p.off for p in term.effect.shapes)


def _knots(state: State, most: int) -> tuple[float, ...]:
    """Times of knots; none where the measurement has too few."""
    measurement = state.predictor.measurement
    clocks = {float(t) for action in measurement.actions for t in action.clock}
    return knots(measurement, most) if len(clocks) > 2 * most else ()


def _of_catalogue(effect: Effect, kind: str) -> Family:
    """An effect of the catalogue as a family."""
    shapes = tuple(p for p in effect.shapes if isinstance(p, Shape) and p.off is None)
    given = tuple(p for p in effect.amounts if isinstance(p, Amount))
    return Family(
        effect.name, kind, effect.about, f"{effect.name} of the catalogue", "", given, shapes, catalogue=effect.name
    )


def _in_time(family: Family, word: str, times: tuple[float, ...]) -> Family:
    how = "amounts that change evenly" if len(times) == 2 else "amounts that follow a free course in time"
    return replace(
        family,
        name=f"{family.name}_{word}",
        about=f"{family.about}, with {how}",
        formula=f"{family.formula}, amounts straight between {len(times)} knots",
        steady=family.name,
        times=times,
    )
