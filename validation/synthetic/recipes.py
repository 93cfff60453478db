"""Where, in which direction and how fast a hidden effect of a case acts: weights of its amounts, shapes, and place."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from validation.synthetic.cases import Case
from validation.synthetic.chance import Rng, log_uniform

Recipe = tuple[dict[str, float], dict[str, float], str]


def recipe(name: str, rng: Rng, case: Case) -> Recipe:
    """Of an effect of a case, before its amount is known."""
    return _RECIPES.get(name, _plain)(rng, case)


def _plain(rng: Rng, case: Case) -> Recipe:
    """A term of the only amount."""
    return {}, {}, ""


def _either_sign(amount: str) -> Callable[[Rng, Case], Recipe]:
    return lambda rng, case: ({amount: float(rng.choice([-1, 1]))}, {}, "")


def _in_plane(prefix: str) -> Callable[[Rng, Case], Recipe]:
    """A direction in the plane in which the body shows it."""

    def recipe(rng: Rng, case: Case) -> Recipe:
        vector = rng.normal(size=len(case.body.plane))
        vector /= np.linalg.norm(vector)
        return {prefix + axis: float(v) for axis, v in zip(case.body.plane, vector, strict=True)}, {}, ""

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
    ball = case.body.ball
    ranges = {"cx": ball.x, "cy": ball.y, "cz": ball.z, "radius": ball.radius}
    values = {name: float(rng.uniform(*ends)) for name, ends in ranges.items()}
    return {"ratio": float(rng.choice([-1, 1], p=[0.3, 0.7]))}, values, ""


def _active_stress(rng: Rng, case: Case) -> Recipe:
    """Steady, or beating."""
    duration = case.actions[-1].clock[-1]
    period = float(rng.choice([0.0, duration * rng.uniform(0.15, 0.5)]))
    return {}, {"angle": float(rng.uniform(0, 180)), "period": period}, ""


def _viscosity(rng: Rng, case: Case) -> Recipe:
    longest = max(float(np.ptp(action.clock)) for action in case.actions)
    return {}, {"relaxation_time": longest * log_uniform(rng, 0.1, 1.0)}, ""


def _soft_anchor(rng: Rng, case: Case) -> Recipe:
    """One of the anchors, or all."""
    return {}, {}, str(rng.choice([*case.anchors, ""]))


def _marker_fault(rng: Rng, case: Case) -> Recipe:
    weights, _, _ = _spatial("x", "y", "z")(rng, case)
    frames = sum(len(action) for action in case.actions)
    onset = float(rng.choice([0, rng.integers(1, int(0.7 * frames))]))
    return weights, {"onset": onset}, str(rng.integers(1, case.body.fiducials + 1))


def _permanent_set(rng: Rng, case: Case) -> Recipe:
    return {}, {"yield_strain": log_uniform(rng, 0.01, 0.1)}, ""


def _obstacle(rng: Rng, case: Case) -> Recipe:
    """A ball above the part that rises in a lift, near enough to be met."""
    body = case.body
    lift = next(motion for motion in case.motions if motion.direction == body.lift)
    radius, clear = log_uniform(rng, *body.obstacle.radius), float(rng.uniform(0.05, 0.3)) * lift.amplitude
    x = float(rng.uniform(*body.obstacle.x))
    z = body.grasps[lift.grasp][2] + float(rng.uniform(-1, 1)) * body.obstacle.beside
    return {}, {"cx": x, "cy": body.obstacle.top + clear + radius, "cz": z, "radius": radius}, ""


def _release(rng: Rng, case: Case) -> Recipe:
    """One of the anchors, half-way through one of the first actions but the first."""
    action = case.actions[int(rng.integers(1, len(case.actions) - 1))]
    return {}, {"onset": float(action.frames[len(action) // 2])}, str(rng.choice(case.anchors))


def _tether(rng: Rng, case: Case) -> Recipe:
    """One of the patches that are not anchored."""
    patches = sorted({patch for anchors in case.body.sound for patch in anchors} - set(case.anchors))
    return {}, {"angle": float(rng.uniform(0, 180))}, str(rng.choice(patches))


# -- outside the catalogue
# ------------------------------------------------------------------------------------------------------------------


def _in_the_ball(rng: Rng, case: Case) -> dict[str, float]:
    ball = case.body.ball
    return {name: float(rng.uniform(*ends)) for name, ends in (("cx", ball.x), ("cy", ball.y), ("cz", ball.z))}


def _direction(rng: Rng) -> dict[str, float]:
    vector = rng.normal(size=3)
    return dict(zip(("dx", "dy", "dz"), map(float, vector / np.linalg.norm(vector)), strict=True))


def _half_way(rng: Rng, case: Case) -> dict[str, float]:
    """In one of the first actions but the first, over one step."""
    action = case.actions[int(rng.integers(1, len(case.actions) - 1))]
    step = len(action) // 2
    return {"onset": float(action.clock[step]), "ramp": float(action.clock[step + 1] - action.clock[step])}


def _second_grasp(rng: Rng, case: Case) -> Recipe:
    """During one of the actions."""
    clock = case.actions[int(rng.integers(len(case.actions)))].clock
    when = {"start": float(clock[0]), "seconds": float(np.ptp(clock))}
    return {}, _in_the_ball(rng, case) | _direction(rng) | {"radius": case.body.ball.radius[0]} | when, ""


def _warming(rng: Rng, case: Case) -> Recipe:
    return {}, _direction(rng), ""


def _tear(rng: Rng, case: Case) -> Recipe:
    low, high = case.body.ball.radius
    band = {"width": low / 2, "length": high, "angle": float(rng.uniform(0, 180))}
    return {}, _in_the_ball(rng, case) | band | _half_way(rng, case), ""


_RECIPES: dict[str, Callable[[Rng, Case], Recipe]] = {
    "compressibility": _either_sign("poisson"),
    "fibres": _angled,
    "stiffness_gradient": _in_plane("g"),
    "inclusion": _inclusion,
    "prestrain": _in_plane("s"),
    "active_stress": _active_stress,
    "viscosity": _viscosity,
    "soft_anchor": _soft_anchor,
    "grasp_offset": _spatial("x", "y", "z", "rx", "ry", "rz"),
    "camera_offset": _spatial("rx", "ry", "rz", "tx", "ty", "tz", "scale"),
    "time_lag": _either_sign("seconds"),
    "marker_fault": _marker_fault,
    "permanent_set": _permanent_set,
    "swelling": _either_sign("rate"),
    "obstacle": _obstacle,
    "release": _release,
    "tether": _tether,
    "second_grasp": _second_grasp,
    "warming": _warming,
    "tear": _tear,
}
