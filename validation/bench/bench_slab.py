"""The scene and the measurements of the searches, and how they stand on a command line."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable

from bcid import Measurement, Scene
from bcid.base.shipped import shipped
from bcid.scene import Level

FOLDER, EXPLAINED, DEMO = "examples/measurements", "examples/scenes/slab_explain.toml", "slab-34-heavy"
MEASUREMENTS = ("slab-12-semicircle", "slab-34-complex", "slab-1234-semicircle", "slab-27-five")
EMPTY = "none"


def scene() -> Scene:
    """The benchmark slab with its ladder."""
    return Scene.read(shipped("examples/scenes/slab.toml"))


def with_level(size_mm: float, degree: int) -> Scene:
    """The slab with one level only."""
    return dataclasses.replace(scene(), levels=(Level(degree, size_mm * 1e-3),))


def measurement(name: str) -> Measurement:
    """One of the shipped measurements."""
    return Measurement.read(shipped(FOLDER) / name)


def encoded(candidate: Iterable[str]) -> str:
    """A set of patches as one word."""
    return ",".join(sorted(candidate)) or EMPTY


def decoded(word: str) -> frozenset[str]:
    """The set that `encoded` made a word of."""
    return frozenset() if word == EMPTY else frozenset(word.split(","))
