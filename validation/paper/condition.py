"""A condition: what holds the body, how it is pulled and seen, what is wrong with what is known of it, and how it is searched."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from typing import Any

from bcid.base.errors import InputError
from bcid.base.options import STOPS as RULES
from bcid.base.units import quantity
from bcid.measurement import Action
from bcid.scene import Level, Scene
from bcid.scene.motions import MOTIONS, motion

SEARCHES = ("stages", "single", "identify")
SEEN = ("positions", "images")


@dataclass(frozen=True)
class Condition:
    """Under what a trial is made; lengths in m, angles in degrees. What is random is drawn anew for each trial.

    Attributes:
        anchors: sets that are anchored, taken in turns: trial i has the i-th.
        motion, grasp: how the body is pulled.
        steps: of the motion, besides rest; 0 for as many as it has.
        search: "stages" and "single" are Algorithm 1 of the paper over the levels and on the last alone (see
            `bcid.search.hill_climbing`); "identify" is what `bcid identify` does.
        seeds: random sets that Algorithm 1 starts from.
        finest: last level of the scene that the search may use.
        stop, tolerance: when the stages end, see `bcid.base.options.Stop`.
        compared: level on which all sets are compared, to tell what the data say.
        true_degree, true_size: elements in which the truth is computed; 0 for those of the scene's last level.
        noise: standard deviation of the noise on each coordinate.
        registration: standard deviation, along each axis, of a shift of all positions of a trial.
        camera_turn, camera_scale: standard deviations of the angle by which positions are turned, about a random axis
            through their middle, and of their scale.
        robot_turn: standard deviation of the angle by which the gripper's motion is turned.
        robot_noise: standard deviation, along each axis and in each step, by which the gripper is elsewhere than commanded.
        grasp_error: standard deviation, along x and along z, by which the gripper holds the body elsewhere than the search
            assumes; 15 mm at most. The `.geo` must have the parameters `shift_x` and `shift_z`.
        placement: standard deviation, along x and along z, by which a marker is elsewhere than the scene says.
        young, poisson: true constants of the material; the search assumes the scene's. None for the scene's.
        seen: "positions", or "images": the body is filmed by two cameras, these are calibrated, and the markers tracked.
        effects: what acts besides, as "gravity: weight = 500 N/m^3", and is not in the model that is searched with.
    """

    anchors: tuple[tuple[str, ...], ...] = (("1", "2"), ("3", "4"), ("1", "2", "3", "4"))
    motion: str = "semicircle"
    grasp: str = "II"
    steps: int = 0
    search: str = "stages"
    seeds: int = 24
    finest: int = 3
    stop: str = "refinement"
    tolerance: float = 0.5e-3
    compared: int = 2
    true_degree: int = 0
    true_size: float = 0.0
    noise: float = 0.0
    registration: float = 0.0
    camera_turn: float = 0.0
    camera_scale: float = 0.0
    robot_turn: float = 0.0
    robot_noise: float = 0.0
    grasp_error: float = 0.0
    placement: float = 0.0
    young: float | None = None
    poisson: float | None = None
    seen: str = "positions"
    effects: tuple[str, ...] = field(default=())

    @classmethod
    def from_json(cls, content: Mapping[str, Any]) -> Condition:
        """What `to_json` gave."""
        tuples = {"anchors": tuple(tuple(a) for a in content["anchors"]), "effects": tuple(content["effects"])}
        return cls(**{**content, **tuples})

    def to_json(self) -> dict[str, Any]:
        """As JSON."""
        return asdict(self)

    def held(self, number: int) -> frozenset[str]:
        """The set that is anchored in a trial."""
        return frozenset(self.anchors[number % len(self.anchors)])

    def actions(self) -> list[Action]:
        """How the body is pulled, as the search assumes it."""
        return motion(self.motion, self.grasp, steps=self.steps or None)

    def truth(self, scene: Scene) -> Scene:
        """The scene as it really is, with the truth's elements as its only level."""
        from bcid.forms.written_effects import with_effects

        level = scene.levels[-1] if not self.true_degree else Level(self.true_degree, self.true_size)
        values = dict(scene.material.values)
        values |= {} if self.young is None else {"young": f"{self.young!r} Pa"}
        values |= {} if self.poisson is None else {"poisson": self.poisson}
        true = replace(scene, levels=(level,), material=replace(scene.material, values=values))
        return with_effects(true, self.effects, "effects")


# How each is written in a study file: a unit, or the kind of a plain value.
_WRITTEN: dict[str, str | type] = {
    "motion": str,
    "grasp": str,
    "steps": int,
    "search": str,
    "seeds": int,
    "finest": int,
    "stop": str,
    "tolerance": "m",
    "compared": int,
    "true_degree": int,
    "true_size": "m",
    "noise": "m",
    "registration": "m",
    "camera_turn": "deg",
    "camera_scale": "1",
    "robot_turn": "deg",
    "robot_noise": "m",
    "grasp_error": "m",
    "placement": "m",
    "young": "Pa",
    "poisson": float,
    "seen": str,
}
_CHOICES: dict[str, tuple[Any, ...]] = {
    "motion": tuple(MOTIONS),
    "search": SEARCHES,
    "stop": RULES,
    "seen": SEEN,
    "true_degree": (0, 1, 2, 3),
}
NAMES = tuple(f.name for f in fields(Condition))


def parsed(name: str, value: object) -> Any:
    """The value of an attribute of `Condition` as a study file writes it.

    Raises:
        InputError: it is something else; the text says what is expected.
    """
    if name in ("anchors", "effects"):
        return _texts(value, name)
    kind = _WRITTEN[name]
    if isinstance(kind, str):
        return quantity(value, kind)
    right = type(value) in (int, float) if kind is float else type(value) is kind
    if not right:
        expected = {str: "a text", int: "a whole number", float: "a number"}[kind]
        raise InputError(f"expected {expected}, found {value!r}")
    choices = _CHOICES.get(name)
    if choices and value not in choices:
        raise InputError(f"{value!r}: allowed are {', '.join(map(str, choices))}")
    if kind is int and isinstance(value, int) and value < (1 if name == "seeds" else 0):
        raise InputError(f"{value}: must be at least {1 if name == 'seeds' else 0}")
    return value


def _texts(value: object, name: str) -> tuple[Any, ...]:
    if name == "effects" and isinstance(value, list) and all(isinstance(item, str) for item in value):
        return tuple(value)
    sets = isinstance(value, list) and value and all(isinstance(item, list) for item in value)
    if name == "anchors" and sets and all(isinstance(patch, str) for item in value for patch in item):  # type: ignore[attr-defined]
        return tuple(tuple(item) for item in value)  # type: ignore[attr-defined]
    example = '[["1", "2"], ["3", "4"]]' if name == "anchors" else '["gravity: weight = 500 N/m^3"]'
    raise InputError(f"expected a list as {example}, found {value!r}")


def named(name: str) -> str:
    """The name of an attribute in a table."""
    return name.replace("_", " ")


def written(name: str, value: Any) -> str:
    """The value of an attribute for a table: in the units of a laboratory."""
    units = {"m": (1e3, " mm"), "Pa": (1e-3, " kPa"), "deg": (1.0, " deg"), "1": (1e2, " %")}
    kind = _WRITTEN.get(name)
    if value is None:
        return "the scene's"
    if isinstance(kind, str):
        factor, unit = units[kind]
        return f"{value * factor:.4g}{unit}"
    if name == "anchors":
        return " ".join("{" + " ".join(item) + "}" for item in value)
    if name == "effects":
        return "; ".join(value) or "none"
    return f"{value:g}" if isinstance(value, float) else str(value)
