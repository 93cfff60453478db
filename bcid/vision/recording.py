"""A recording: which images show which step of which motion, and what the beads look like.

Its TOML file is described in docs/vision.md.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from bcid.base.errors import InputError, Problems
from bcid.base.text_file import read_toml
from bcid.base.units import quantity, unit_factor, usable
from bcid.measurement import Action, Units
from bcid.measurement.folder import read_grasps
from bcid.vision.camera import SIDES, Cameras

FORMAT = "bcid-recording/1"
# What is said of the file of the cameras, where it does not say so itself.
_OF_CAMERAS = ("length_unit", "image_size", "first_pixel", "origin")
_KEYS = ("format", "cameras", *(f"camera_{key}" for key in _OF_CAMERAS), *SIDES)
_KEYS += ("grasps", "rate", "length_unit", "time_unit", "distance")
_TABLES = {
    "beads": ("diameter", "colour"),
    "images": ("first", "every", "last"),
    "layout": ("sigma", "tolerance", "scale"),
    "seen": None,
}
_COLOURS = ("dark", "bright")
# No image is wider.
_PIXELS = 1e6


@dataclass(frozen=True)
class Recording:
    """What was recorded, and where it is; lengths in m.

    Attributes:
        cameras: the calibration.
        left, right: folders of images, or videos.
        actions: motions of the gripper; None where nothing holds the body: all images are one action then.
        rate: images per second, used without motions.
        diameter: of a bead.
        dark: whether beads are darker than the body.
        distance: of the body from the cameras; None where their axes tell.
        first, every, last: numbers of the images that are used; the first and last that exist where None.
        layout_sigma: standard deviation of a coordinate of the layout.
        tolerance: how far a bead at rest may be from the layout; None for a part of its size.
        scale: whether a scale is fitted.
        seen: pixels (u, v) of beads in the left of the first images, by name.
        units: of the files, and of the measurement to be written.
    """

    cameras: Cameras
    left: Path
    right: Path
    actions: list[Action] | None
    rate: float
    diameter: float
    dark: bool = True
    distance: float | None = None
    first: int | None = None
    every: int = 1
    last: int | None = None
    layout_sigma: float = 0.0
    tolerance: float | None = None
    scale: bool = False
    seen: dict[str, tuple[float, float]] = field(default_factory=dict)
    units: Units = field(default_factory=Units)
    source: str = "recording"

    @classmethod
    def read(cls, path: str | Path) -> Recording:
        """Read and validate a recording file; paths inside are relative to it.

        Raises:
            InputError: with every problem of the file.
        """
        path = Path(path)
        return _Reader(path, read_toml(path, "no such recording file")).recording()

    def numbers(self, present: Iterable[int]) -> list[int]:
        """Numbers of the images that are used, one for each step.

        Args:
            present: numbers of the images that one of the cameras has.

        Raises:
            InputError: there are not as many as the motions have steps.
        """
        present = sorted(present)
        first = present[0] if self.first is None else self.first
        last = present[-1] if self.last is None else self.last
        if self.actions is None:
            return list(range(first, last + 1, self.every))
        steps = sum(map(len, self.actions))
        end = first + self.every * (steps - 1)
        if end > last or (self.last is not None and end != last):
            raise InputError(
                f"{self.source}: the motions have {steps} steps, which are images {first} to {end} (every {self.every}); "
                f"the images end at {last}. Set first, every and last in [images]"
            )
        return list(range(first, end + 1, self.every))


class _Reader:
    """Reads the table of a recording file, noting every problem."""

    def __init__(self, path: Path, table: dict[str, Any]) -> None:
        self.path, self.table = path, table
        self.problems = Problems(f"recording {path}")

    def bad(self, text: str) -> None:
        self.problems.add(self.path, text)

    def recording(self) -> Recording:
        self.keys()
        units = Units(self.unit("length_unit", "mm", "m"), self.unit("time_unit", "s", "s"))
        images = [self.path.parent / self.text(side) for side in SIDES]
        found: dict[str, Any] = {
            "diameter": self.length("beads", "diameter"),
            "dark": self.colour(),
            "distance": self.length(None, "distance", None),
            "first": self.whole("first", None, 0),
            "every": self.whole("every", 1, 1),
            "last": self.whole("last", None, 0),
            "layout_sigma": self.length("layout", "sigma", 0.0),
            "tolerance": self.length("layout", "tolerance", None),
            "scale": self.flag("layout", "scale"),
            "seen": self.seen(),
        }
        rate = self.table.get("rate", 1.0)
        if isinstance(rate, bool) or not isinstance(rate, int | float) or not usable(rate) or rate <= 0:
            self.bad(f"rate: expected a positive number (up to 1e30) of images per second, found {rate!r}")
        cameras = self.attempt(
            "cameras",
            lambda: Cameras.read(
                self.path.parent / self.text("cameras"), **{key: self.table.get(f"camera_{key}") for key in _OF_CAMERAS}
            ),
        )
        actions = None
        if "grasps" in self.table:
            actions = self.attempt("grasps", lambda: read_grasps(self.path.parent / self.text("grasps"), units))
        self.problems.raise_if_any()
        left, right = images
        return Recording(cameras, left, right, actions, float(rate), **found, units=units, source=str(self.path))

    def keys(self) -> None:
        if self.table.get("format") != FORMAT:
            self.bad(f'format: expected "{FORMAT}", found {self.table.get("format")!r}')
        for key, value in self.table.items():
            if key in _TABLES:
                allowed = _TABLES[key]
                if not isinstance(value, dict):
                    self.bad(f"{key}: expected a table [{key}], found {value!r}")
                    self.table[key] = {}
                elif allowed is not None:
                    self.problems.add_unknown(self.path, value, allowed, f"{key}.{{}}: unknown key; {{}}".format)
        self.problems.add_unknown(self.path, self.table, [*_KEYS, *_TABLES])

    def attempt(self, key: str, read: Any) -> Any:
        """What another file, named by `key`, holds; its problems join those of this one."""
        try:
            return read()
        except InputError as error:
            self.bad(f"{key}: {error}")
            return None

    def text(self, key: str, default: str | None = None) -> str:
        value = self.table.get(key, default)
        if not isinstance(value, str):
            self.bad(f"{key}: {'is missing' if value is None else f'expected text, found {value!r}'}")
            return ""
        return value

    def unit(self, key: str, default: str, like: str) -> str:
        unit = self.text(key, default)
        try:
            unit_factor(unit, like)
        except InputError as error:
            self.bad(f"{key}: {error}")
            return default
        return unit

    def value(self, table: str | None, key: str, default: Any = None) -> Any:
        return (self.table if table is None else self.table.get(table, {})).get(key, default)

    def length(self, table: str | None, key: str, *default: Any) -> Any:
        """A length, m; it must be there unless a default is given."""
        value = self.value(table, key)
        name = key if table is None else f"{table}.{key}"
        if value is None:
            if not default:
                self.bad(f'{name}: is missing; give it, as {key} = "1 mm"')
                return 0.0
            return default[0]
        try:
            number = quantity(value, "m")
        except InputError as error:
            self.bad(f"{name}: {error}")
            return 0.0
        if not number > 0:
            self.bad(f"{name}: must be positive, found {value!r}")
        return number

    def whole(self, key: str, default: int | None, least: int) -> int | None:
        value = self.value("images", key, default)
        if value is None:
            return None
        if isinstance(value, bool) or not isinstance(value, int) or value < least:
            self.bad(f"images.{key}: expected a whole number from {least}, found {value!r}")
            return default
        return value

    def flag(self, table: str, key: str) -> bool:
        value = self.value(table, key, False)
        if not isinstance(value, bool):
            self.bad(f"{table}.{key}: expected true or false, found {value!r}")
        return bool(value)

    def colour(self) -> bool:
        value = self.value("beads", "colour", "dark")
        if value not in _COLOURS:
            self.bad(f"beads.colour: expected {' or '.join(_COLOURS)}, found {value!r}")
        return bool(value == "dark")

    def seen(self) -> dict[str, tuple[float, float]]:
        found = {}
        for name, value in self.table.get("seen", {}).items():
            numbers = isinstance(value, list) and all(type(v) in (int, float) and abs(v) <= _PIXELS for v in value)
            if not numbers or len(value) != 2:
                self.bad(f"seen.{name}: expected a pixel [u, v] of an image, found {value!r}")
            else:
                found[name] = (float(value[0]), float(value[1]))
        return found
