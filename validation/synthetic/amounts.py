"""Whether the numbers of an adopted effect are those of the hidden one, and whether their intervals hold the truth."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from bcid.base.units import UNTOLD
from bcid.forms import effects

Json = Mapping[str, Any]
NEAR, DEGREES = 0.2, 15.0
# Half a 95 % interval in standard errors.
HALF = 1.96


def parameters_right(truth: Json, diagnosis: Json) -> bool:
    """Whether the adopted effect has the amounts, direction and place of the hidden one.

    Amounts of which it is told that the data cannot tell them are not asked, as long as there are others.
    """
    effect = truth["effects"][0]
    entry = adopted(diagnosis, effect["effect"])
    if entry is None or entry.get("place", "") != effect["place"]:
        return False
    found = {name: _value(value) for name, value in entry["parameters"].items()}
    amounts = {name: p for name, p in _amounts(effect).items() if _is_told(entry, name)} or _amounts(effect)
    return set(effect["parameters"]) <= set(found) and _amounts_right(amounts, found) and _shapes_right(effect, found)


def _amounts(effect: Json) -> dict[str, Json]:
    return {name: p for name, p in effect["parameters"].items() if p["role"] == "amount"}


def _is_told(entry: Json, name: str) -> bool:
    """Whether the data tell an amount: not a translation of the grasp where the gripper never turns."""
    return float(entry["parameters"].get(name, {}).get("stderr") or 0.0) <= UNTOLD


def adopted(diagnosis: Json, effect: str) -> Json | None:
    """What the model of a diagnosis has of an effect."""
    entries = diagnosis.get("selected_effects", ())
    return next((entry for entry in entries if str(entry["effect"]).split("(")[0] == effect), None)


def intervals_hold(truth: Json, diagnosis: Json) -> tuple[bool, ...]:
    """For each amount of the hidden effects that were adopted at their places whether its 95 % interval holds the truth.

    What is only on or off has no interval, nor has what the data cannot tell.
    """
    held: list[bool] = []
    for effect in truth["effects"]:
        entry = adopted(diagnosis, effect["effect"])
        if entry is not None and entry.get("place", "") == effect["place"]:
            switches = {p.name for p in effects.effect(effect["effect"]).parameters if p.switch}
            told = {n: p for n, p in _amounts(effect).items() if n not in switches and _is_told(entry, n)}
            held += [_holds(entry["parameters"].get(name, {}), p) for name, p in told.items()]
    return tuple(held)


def _holds(found: Json, p: Json) -> bool:
    """Whether value and standard error, or the limit of what is at a bound, go with the truth.

    Of a reciprocal parameter its reciprocal is normal.
    """
    value, error, true = found.get("value"), found.get("stderr"), p["value"]
    limit = found.get("limit")
    if value is not None and limit is not None:
        return bool(min(value, limit) <= true <= max(value, limit))
    if value is None or error is None or (p["reciprocal"] and value == 0):
        return False
    if p["reciprocal"]:
        value, error, true = 1 / value, error / value**2, 1 / true
    return bool(abs(value - true) <= HALF * error)


def _value(written: Any) -> float:
    value = written["value"] if isinstance(written, Mapping) else written
    return math.nan if value is None else float(value)


def _amounts_right(amounts: Mapping[str, Json], found: Mapping[str, float]) -> bool:
    """Their vector, in units of their scales from the neutral values, is within 20 % in length and 15 degrees in direction."""
    if any(p["reciprocal"] for p in amounts.values()):
        return all(abs(found[n] / p["value"] - 1) <= NEAR for n, p in amounts.items())
    true, seen = (
        np.array([(values[n] - p["neutral"]) / p["scale"] for n, p in amounts.items()])
        for values in ({n: p["value"] for n, p in amounts.items()}, found)
    )
    length = float(np.linalg.norm(true))
    if not abs(np.linalg.norm(seen) - length) <= NEAR * length:
        return False
    cosine = float(true @ seen) / (length * float(np.linalg.norm(seen)))
    return cosine >= math.cos(math.radians(DEGREES))


def _shapes_right(effect: Json, found: Mapping[str, float]) -> bool:
    """Angles within 15 degrees; a centre no further off than the radius. Time constants and radii are not asked for."""
    parameters = effect["parameters"]
    for name, p in parameters.items():
        if p["role"] == "shape" and p["unit"] == "deg":
            period = p["period"] or 360.0
            off = abs((found[name] - p["value"] + period / 2) % period - period / 2)
            if not off <= DEGREES:
                return False
    # Through the thickness a centre cannot be seen.
    centre = [n for n in ("cx", "cz") if n in parameters]
    off = math.sqrt(sum((found[n] - parameters[n]["value"]) ** 2 for n in centre))
    return not centre or off <= parameters["radius"]["value"]
