"""What the result of an expensive step depends on, as text: equal texts, equal results.

Numbers are told with so many digits that rounding does not tell them apart, and what the solver leaves open does not either.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import fields
from typing import Any

import numpy as np

from bcid.base.fingerprint import fingerprint
from bcid.forms.course import course_of
from bcid.forms.effects.effect import Effect
from bcid.forms.model import Model, Term
from bcid.forms.probes import SensitivityRequest
from bcid.measurement import Action, Measurement


def of_measurement(measurement: Measurement) -> str:
    """Of the motions, and of which markers are seen when."""
    data = measurement.data
    return fingerprint({str(name): data[name].values for name in data.variables})


def of_action(action: Action) -> str:
    """Of the motion of one action, and which frames of the measurement it has."""
    loads = {place: np.asarray(load) for place, load in (action.loads | action.boundary).items()}
    motion = {"frames": action.frames, "translation": action.translation, "rotation": action.rotation}
    return fingerprint({"grasp": action.grasp, "clock": action.clock, "loads": loads} | motion)


def of_pull(action: Action, timed: bool = False) -> str:
    """Of a motion to be predicted: grasp, poses to the nanometre, loads, and if it is `timed` its clock; not its name."""
    loads = {place: np.round(load, 9) for place, load in (action.loads | action.boundary).items()}
    # Adding zero makes one of the two zeros of the other.
    content = {"translation": np.round(action.translation, 9) + 0.0, "rotation": np.round(action.rotation, 9) + 0.0}
    clock = np.round(action.clock, 9) if timed else None
    return fingerprint(content | {"grasp": action.grasp, "loads": loads, "clock": clock})


def of_all(parts: Iterable[object]) -> str:
    """Of models, requests, sets and plain values, one after the other."""
    found = []
    for part in parts:
        if isinstance(part, Model):
            found.append(of_model(part))
        elif isinstance(part, SensitivityRequest):
            found.append(of_wanted(part))
        else:
            found.append(str(sorted(part)) if isinstance(part, frozenset) else str(part))
    return " ".join(found)


def of_model(model: Model) -> str:
    """Of its parts and values."""
    told = ("law", "values", "terms", "anchors")
    plain = [(f.name, getattr(model, f.name)) for f in fields(model) if f.name not in told]
    terms = [of_term(term) for term in model.terms]
    return f"{model.law.name} {_numbers(model.values)} {sorted(model.anchors)} {plain} {terms}"


def of_term(term: Term) -> str:
    """Of an effect, where it acts, and its values. A file's effect is known by the file, which the inputs name."""
    return f"{term.label} {term.place} {_effect(term.effect)} {_numbers(term.values)}"


def _effect(effect: Effect) -> str:
    course = course_of(effect)
    timed = "" if course is None else f"{_effect(course.effect)} {course.times} {course.stepwise}"
    return f"{effect.name} {[(p.name, p.scale) for p in effect.parameters]} {bool(effect.acting)} {timed}"


def of_wanted(wanted: SensitivityRequest) -> str:
    """Of what a sensitivity is asked for."""
    probes = [(of_term(probe.term), probe.wanted) for probe in wanted.probes]
    many = {name: value for name in ("forces", "growths") if (value := getattr(wanted, name)) is not None}
    terms = None if wanted.terms is None else (type(wanted.terms).__name__, wanted.terms.count, wanted.terms.holds)
    driven = " driven" if wanted.boundary else ""
    return f"{probes} {wanted.law} {wanted.stiffness} {fingerprint(many) if many else None} {wanted.places} {terms}{driven}"


def _numbers(values: Mapping[str, Any]) -> str:
    return " ".join(f"{name}={value:.10g}" for name, value in sorted(values.items()))
