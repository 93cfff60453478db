"""The cases of the hidden study: which patches hold the body, how it is pulled, how noisy it is seen, what is hidden.

Drawing needs numpy only. Case i depends on the seed and i alone, so that cases can be made in any order and on any number
of processes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, replace
from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from bcid.measurement import Action
from bcid.scene.motions import about_x, actions

if TYPE_CHECKING:
    from bcid.studies.hidden.inexact import Inexact

Array = NDArray[np.float64]
Rng = np.random.Generator

KINDS = ("none", "one", "two", "outside")
# What a block of twenty cases holds.
BLOCK = ("none",) * 4 + ("one",) * 10 + ("two",) * 2 + ("outside",) * 4
CATALOGUE = (
    "gravity", "strain_stiffening", "compressibility", "fibres", "stiffness_gradient", "inclusion", "prestrain",
    "active_stress", "viscosity", "soft_anchor", "foundation", "support_contact", "support_friction", "grasp_slip",
    "grasp_offset", "camera_offset", "time_lag", "marker_fault",
)  # fmt: skip
OUTSIDE = ("permanent_set", "obstacle", "peeling")

# Size of a hidden effect in units of noise, and noise in m.
SIZES = (0.5, 10.0)
NOISE = (1e-4, 5e-4)
AMPLITUDE = (6e-3, 16e-3)
# Across, where an anchored edge lies beside the grasps: the tissue between them must not be crushed.
CROWDED = (6e-3, 9e-3)
SECONDS_PER_STEP = (0.25, 4.0)
# Between two actions the body rests so long, s: the clock runs on.
PAUSE = 5.0

PATCHES = tuple("12345678")
FIDUCIALS = tuple(str(i) for i in range(1, 17))
# Grasps and the z of their middles, m.
GRASPS = {"I": 0.020, "II": 0.050, "III": 0.080}
# The edge patch 10 mm beside a grasp: where it is anchored, the grasp is not used.
_BESIDE = {"I": "6", "III": "1"}
DIRECTIONS = {
    "x": (1.0, 0.0, 0.0),
    "z": (0.0, 0.0, 1.0),
    "-z": (0.0, 0.0, -1.0),
    "up": (0.0, 1.0, 0.0),
    "x and up": (0.8, 0.6, 0.0),
    "x and z": (0.8, 0.0, 0.6),
    "x and -z": (0.8, 0.0, -0.6),
}
# On the anchored bottom quarters 7 and 8 the edges beside them do not move: nothing could tell whether they are held.
_SHIELDED = ({"7", "2"}, {"7", "3"}, {"8", "4"}, {"8", "5"})


@dataclass(frozen=True)
class Motion:
    """One action: a pull along a direction, perhaps back again, perhaps with a twist about x.

    Attributes:
        grasp: what is held.
        direction: one of `DIRECTIONS`.
        amplitude: how far, m.
        steps: number of steps.
        back: whether the second half of the steps leads back to rest.
        twist: final turn about x, degrees.
        seconds: per step.
    """

    grasp: str
    direction: str
    amplitude: float
    steps: int
    back: bool = False
    twist: float = 0.0
    seconds: float = 1.0

    @property
    def path(self) -> tuple[Array, Array]:
        """Translations (steps, 3), m, and unit quaternions (steps, 4), the rest pose included."""
        count = self.steps // 2 if self.back else self.steps
        part = np.arange(count + 1) / count
        if self.back:
            part = np.concatenate([part, part[-2::-1]])
        return part[:, None] * self.amplitude * np.array(DIRECTIONS[self.direction]), about_x(part * self.twist)


@dataclass(frozen=True)
class Hidden:
    """A hidden effect before its term is known.

    Attributes:
        effect: its name.
        target: size it shall have: RMS of the fiducials' shift, in units of noise.
        weights: what a term of one is made of, in units of each parameter's scale, by amount.
        shapes: parameters that say where, in which direction and how fast, SI.
        place: where it acts.
    """

    effect: str
    target: float
    weights: Mapping[str, float] = field(default_factory=dict)
    shapes: Mapping[str, float] = field(default_factory=dict)
    place: str = ""

    @property
    def outside(self) -> bool:
        """Whether it is outside the catalogue."""
        return self.effect in OUTSIDE


@dataclass(frozen=True)
class Case:
    """One case of the study; `noise` in m. `attempt` counts how often it was drawn anew because it could not be solved.

    `inexact` is what its scene states wrongly, if anything.
    """

    seed: int
    index: int
    attempt: int
    kind: str
    anchors: tuple[str, ...]
    motions: tuple[Motion, ...]
    noise: float
    hidden: tuple[Hidden, ...]
    inexact: Inexact | None = None

    @property
    def made(self) -> list[Action]:
        """The motions as the gripper really makes them."""
        return self.inexact.actions(self.actions) if self.inexact else self.actions

    @property
    def actions(self) -> list[Action]:
        """The commanded motions, on a clock that runs on from action to action."""
        result, start = [], 0.0
        for action, motion in zip(actions([m.path for m in self.motions], ""), self.motions, strict=True):
            times = start + motion.seconds * np.arange(len(action))
            result.append(replace(action, grasp=motion.grasp, times=times))
            start = float(times[-1]) + PAUSE
        return result

    def to_json(self) -> dict[str, Any]:
        """As plain numbers and words."""
        return asdict(self)


def generator(*key: int) -> Rng:
    """Random numbers that depend on the key alone."""
    return np.random.default_rng(np.random.SeedSequence(list(key)))


def draw(seed: int, index: int, attempt: int = 0, least: float = SIZES[0]) -> Case:
    """Case `index` of a seed, with effects of at least a size. Kind and effects do not depend on attempt and size."""
    kind, names = plan(seed, index)
    rng = generator(seed, 1, index, attempt)
    anchors = _anchors(rng, peeled="peeling" in names)
    motions = _motions(rng, anchors)
    noise = _log_uniform(rng, *NOISE)
    case = Case(seed, index, attempt, kind, anchors, motions, noise, ())
    hidden = tuple(_hidden(rng, name, case, least) for name in names)
    return replace(case, hidden=hidden)


def plan(seed: int, index: int) -> tuple[str, tuple[str, ...]]:
    """Kind of a case and the names of what it hides; every twenty cases hold the same kinds, and all effects take turns."""
    block, place = divmod(index, len(BLOCK))
    order = generator(seed, 2, block).permutation(len(BLOCK))
    kind = BLOCK[order[place]]
    before = sum(BLOCK[k] == kind for k in order[:place]) + block * BLOCK.count(kind)
    if kind == "one":
        return kind, (_turn(CATALOGUE, before, seed, 3),)
    if kind == "two":
        return kind, _pair(before, seed)
    return kind, (_turn(OUTSIDE, before, seed, 5),) if kind == "outside" else ()


def _turn(names: tuple[str, ...], turn: int, *key: int) -> str:
    """The names in a new order each round."""
    cycle, place = divmod(turn, len(names))
    return names[generator(*key, cycle).permutation(len(names))[place]]


def _pair(turn: int, seed: int) -> tuple[str, str]:
    first, second = (_turn(CATALOGUE, 2 * turn + k, seed, 4) for k in range(2))
    return first, second


def sound_sets(peeled: bool = False) -> list[tuple[str, ...]]:
    """Sets of one to four patches that hold the body soundly and of which every patch matters.

    One edge alone does not hold soundly, a bottom quarter does. A patch is only left to peel where the others hold.
    """
    every = [s for count in range(1, 5) for s in combinations(PATCHES, count)]
    sets = [s for s in every if (len(s) > 1 or s[0] in "78") and not any(pair <= set(s) for pair in _SHIELDED)]
    return [s for s in sets if len(s) > 2] if peeled else sets


def _anchors(rng: Rng, peeled: bool) -> tuple[str, ...]:
    sets = sound_sets(peeled)
    counts = sorted({len(s) for s in sets})
    share = np.array([{1: 0.15, 2: 0.4, 3: 0.3, 4: 0.15}[count] for count in counts])
    count = int(rng.choice(counts, p=share / share.sum()))
    of_count = [s for s in sets if len(s) == count]
    return of_count[rng.integers(len(of_count))]


def _motions(rng: Rng, anchors: tuple[str, ...]) -> tuple[Motion, ...]:
    """Four or five actions, among them a pull along x, one across and a lift; one or more lead back, one has a twist."""
    count = int(rng.integers(4, 6))
    directions = [
        "x",
        str(rng.choice(["z", "-z", "x and z", "x and -z"])),
        "up",
        *rng.choice(list(DIRECTIONS), count - 3),
    ]
    order = rng.permutation(count)
    back = rng.random(count) < 0.25
    back[rng.integers(count)] = True
    twisted = int(rng.integers(count)) if rng.random() < 0.5 else -1
    common = _log_uniform(rng, *SECONDS_PER_STEP)
    grasps = [grasp for grasp in GRASPS if _BESIDE.get(grasp) not in anchors]
    crowded = len(grasps) < len(GRASPS)
    result = []
    for k, i in enumerate(order):
        steps = int(rng.integers(6, 11))
        direction = str(directions[i])
        # Sheared far in its plane the slab buckles.
        sheared = direction in ("z", "-z") or (crowded and "z" in direction)
        amplitude = float(rng.uniform(*(CROWDED if sheared else AMPLITUDE)))
        seconds = common if rng.random() < 0.5 else _log_uniform(rng, *SECONDS_PER_STEP)
        twist = float(rng.uniform(10, 30) * rng.choice([-1, 1])) if k == twisted else 0.0
        steps += steps % 2 if back[k] else 0
        grasp = str(rng.choice(grasps))
        result.append(Motion(grasp, direction, amplitude, steps, bool(back[k]), twist, seconds))
    return tuple(result)


# -- what is hidden: weights of the amounts, shapes and place of each effect
# ------------------------------------------------------------------------------------------------------------------

Recipe = tuple[dict[str, float], dict[str, float], str]


def _hidden(rng: Rng, name: str, case: Case, least: float) -> Hidden:
    target = _log_uniform(rng, least, SIZES[1])
    weights, shapes, place = _RECIPES.get(name, _plain)(rng, case)
    return Hidden(name, target, weights, shapes, place)


def _plain(rng: Rng, case: Case) -> Recipe:
    """A term of the only amount."""
    return {}, {}, ""


def _either_sign(amount: str) -> Callable[[Rng, Case], Recipe]:
    return lambda rng, case: ({amount: float(rng.choice([-1, 1]))}, {}, "")


def _in_plane(first: str, second: str) -> Callable[[Rng, Case], Recipe]:
    """A direction in the plane of the slab: across its 10 mm little can be seen."""

    def recipe(rng: Rng, case: Case) -> Recipe:
        angle = rng.uniform(0, 2 * np.pi)
        return {first: float(np.cos(angle)), second: float(np.sin(angle))}, {}, ""

    return recipe


def _spatial(*names: str) -> Callable[[Rng, Case], Recipe]:
    """A direction in the space of several amounts."""

    def recipe(rng: Rng, case: Case) -> Recipe:
        vector = rng.normal(size=len(names))
        return dict(zip(names, map(float, vector / np.linalg.norm(vector)), strict=True)), {}, ""

    return recipe


def _angled(rng: Rng, case: Case) -> Recipe:
    return {}, {"angle": float(rng.uniform(0, 180))}, ""


def _inclusion(rng: Rng, case: Case) -> Recipe:
    """A harder or softer ball in the part that the fiducials see."""
    x, z = (float(v) for v in rng.uniform(0.025, 0.075, 2))
    ball = {"cx": x, "cy": 0.005, "cz": z, "radius": float(rng.uniform(0.008, 0.020))}
    return {"ratio": float(rng.choice([-1, 1], p=[0.3, 0.7]))}, ball, ""


def _active_stress(rng: Rng, case: Case) -> Recipe:
    """Steady, or beating."""
    duration = case.actions[-1].clock[-1]
    period = float(rng.choice([0.0, duration * rng.uniform(0.15, 0.5)]))
    return {}, {"angle": float(rng.uniform(0, 180)), "period": period}, ""


def _viscosity(rng: Rng, case: Case) -> Recipe:
    longest = max(float(np.ptp(action.clock)) for action in case.actions)
    return {}, {"relaxation_time": longest * _log_uniform(rng, 0.1, 1.0)}, ""


def _soft_anchor(rng: Rng, case: Case) -> Recipe:
    """One of the anchors, or all."""
    return {}, {}, str(rng.choice([*case.anchors, ""]))


def _marker_fault(rng: Rng, case: Case) -> Recipe:
    weights, _, _ = _spatial("x", "y", "z")(rng, case)
    frames = sum(len(action) for action in case.actions)
    onset = float(rng.choice([0, rng.integers(1, int(0.7 * frames))]))
    return weights, {"onset": onset}, str(rng.choice(FIDUCIALS))


def _permanent_set(rng: Rng, case: Case) -> Recipe:
    return {}, {"yield_strain": float(rng.uniform(0.005, 0.03))}, ""


def _obstacle(rng: Rng, case: Case) -> Recipe:
    """A ball above the part that rises in a lift; a large one is nearly a plane."""
    lift = next(motion for motion in case.motions if motion.direction == "up")
    x, z = float(rng.uniform(0.055, 0.075)), float(GRASPS[lift.grasp] + rng.uniform(-0.015, 0.015))
    return {}, {"cx": x, "cz": z, "radius": _log_uniform(rng, 0.015, 0.100)}, ""


def _peeling(rng: Rng, case: Case) -> Recipe:
    """One of the anchors, half-way through one of the first actions."""
    action = case.actions[int(rng.integers(1, len(case.actions) - 1))]
    step = len(action) // 2
    ramp = float(action.clock[step + 1] - action.clock[step])
    return {}, {"onset": float(action.clock[step]), "ramp": ramp}, str(rng.choice(case.anchors))


_RECIPES: dict[str, Callable[[Rng, Case], Recipe]] = {
    "compressibility": _either_sign("poisson"),
    "fibres": _angled,
    "stiffness_gradient": _in_plane("gx", "gz"),
    "inclusion": _inclusion,
    "prestrain": _in_plane("sx", "sz"),
    "active_stress": _active_stress,
    "viscosity": _viscosity,
    "soft_anchor": _soft_anchor,
    "grasp_offset": _spatial("x", "y", "z", "rx", "ry", "rz"),
    "camera_offset": _spatial("rx", "ry", "rz", "tx", "ty", "tz", "scale"),
    "time_lag": _either_sign("seconds"),
    "marker_fault": _marker_fault,
    "permanent_set": _permanent_set,
    "obstacle": _obstacle,
    "peeling": _peeling,
}


def _log_uniform(rng: Rng, lower: float, upper: float) -> float:
    return float(np.exp(rng.uniform(np.log(lower), np.log(upper))))
