"""Effects as a user writes them in a line: "gravity", "soft_anchor: 3", "fibres: k1 = 5 kPa, angle = 30 deg"."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from bcid.base.errors import InputError
from bcid.forms import effects
from bcid.forms.model import check_physics
from bcid.scene import Scene


def split(text: str) -> tuple[str, str, dict[str, str]]:
    """Name, place ("" where none is given) and values, as they are written, of an effect in a line."""
    name, _, rest = (part.strip() for part in text.partition(":"))
    place, values = "", {}
    for part in (piece.strip() for piece in rest.split(",") if piece.strip()):
        key, equals, value = (piece.strip() for piece in part.partition("="))
        if equals:
            values[key] = value
        else:
            place = key
    return name, values.pop("place", place), values


def with_effects(scene: Scene, hidden: Sequence[str], where: str = "--true-effect") -> Scene:
    """The scene with more effects, each with values; `where` they stand is told in errors.

    Raises:
        InputError: an effect, its place or its numbers cannot be used.
    """
    for text in hidden:
        name, place, written = split(text)
        somewhere = name not in effects.names() or effects.effect(name).places
        if not name or not written or not all(written.values()) or (place and not somewhere):
            raise InputError(f"{where} '{text}': expected as in \"fibres: k1 = 5 kPa, angle = 30 deg\"")
        if name in scene.effects:
            raise InputError(f"{where} '{text}': the scene's model has {name} already")
        values = {key: _number(value) for key, value in written.items()} | ({"place": place} if place else {})
        scene = replace(scene, effects={**scene.effects, name: values})
        problems = check_physics(scene)
        if problems:
            raise InputError("\n".join([f"{where} '{text}':", *(f"  {problem}" for problem in problems)]))
    return scene


def _number(text: str) -> float | str:
    """A pure number, or a quantity with its unit."""
    try:
        return float(text)
    except ValueError:
        return text
