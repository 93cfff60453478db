"""Worlds outside the family of models: what is drawn for a measurement of each kind, and which answers are right.

An ideal observer can decide every patch that moves some marker by more than the noise when its attachment is toggled, unless
the kind hides it: that patch is open. Of the verdicts, "unknown" is right in every kind but the control, and so are the
effects of the catalogue that are the same thing by another name (`accepted`). "none" is right where what is wrong moves the
markers by less than three noises. Of markers of another body no anchor is right: there only doubt is.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

# Fixed before the first run.
SEED = 60_2026
CASES = 20
STEPS = 4
# RMS change of a coordinate by what is wrong, in noises, and the noises that there are, mm. The coarsest grid errs by 0.02 mm.
SIZES = (3.0, 20.0)
NOISES = (0.1, 0.3)

# Corners in shares of the body's size; all borders are lines of the grid of `felupe_world`.
Box = list[list[float]]
Spec = dict[str, Any]
PATCHES: Mapping[str, Box] = {
    "1": [[0, 0, 0], [0, 1, 1 / 2]],
    "2": [[0, 0, 1 / 2], [0, 1, 1]],
    "3": [[0, 0, 0], [1 / 2, 1, 0]],
    "4": [[1 / 2, 0, 0], [1, 1, 0]],
    "5": [[0, 0, 0], [1 / 2, 0, 1 / 2]],
    "6": [[0, 0, 1 / 2], [1 / 2, 0, 1]],
}
GRASPS: Mapping[str, Box] = {"G1": [[1, 0, 1 / 4], [1, 1, 3 / 4]], "G2": [[1 / 2, 0, 1], [7 / 8, 1, 1]]}
# Nodes of the coarsest grid, on the top.
MARKERS = [[x / 16, 1.0, z / 8] for z in (1, 3, 5, 7) for x in (2, 5, 9, 12)]


@dataclass(frozen=True)
class Kind:
    """One way of being outside the family.

    Attributes:
        summary: for the table.
        change: draws what is wrong; changes the specification in place.
        accepted: effects of the catalogue that an ideal observer cannot separate from it.
        open_patches: whose attachment it hides, from the specification.
        patches: that may be anchored.
        most: patches that are anchored, and at least one less.
        anchors_right: False where no set of anchors is right.
    """

    summary: str
    change: Callable[[np.random.Generator, Spec], None]
    accepted: tuple[str, ...] = ()
    open_patches: Callable[[Spec], list[str]] = field(default=lambda _spec: [])
    patches: tuple[str, ...] = tuple(PATCHES)
    most: int = 3
    anchors_right: bool = True


def draw(kind: str, index: int) -> Spec:
    """The specification of a measurement: the body, its anchors and pulls (mm, kPa), and what is wrong (`world`)."""
    rng = np.random.default_rng([SEED, list(KINDS).index(kind), index])
    count = rng.integers(KINDS[kind].most - 1, KINDS[kind].most + 1)
    anchored = sorted(rng.choice(KINDS[kind].patches, count, replace=False).tolist())
    spec: Spec = {
        "kind": kind,
        "index": index,
        "size": [round(float(rng.uniform(*ends)), 1) for ends in ((52, 68), (11, 17), (36, 46))],
        "young": round(float(rng.uniform(8, 20)), 1),
        "poisson": round(float(rng.uniform(0.33, 0.42)), 2),
        "patches": PATCHES,
        "grasps": GRASPS,
        "markers": MARKERS,
        "anchored": anchored,
        "pulls": [_pull(rng, grasp) for grasp in ("G1", "G1", "G2")],
        "steps": STEPS,
        "refine": 1,
        "toggle": True,
        "world": {},
        "wanted": round(float(np.exp(rng.uniform(*np.log(SIZES)))), 2),
    }
    KINDS[kind].change(rng, spec)
    return spec


def _pull(rng: np.random.Generator, grasp: str) -> dict[str, Any]:
    """Outward, and aside: translations of 8 to 12 mm."""
    outward, aside = {"G1": (0, 2), "G2": (2, 0)}[grasp]
    to = np.zeros(3)
    to[outward], to[1], to[aside] = rng.uniform(0.3, 1), rng.uniform(0, 1), rng.uniform(-1, 1)
    return {"grasp": grasp, "to": [round(float(x), 3) for x in to / np.linalg.norm(to) * rng.uniform(8, 12)]}


def _pad(rng: np.random.Generator, spec: Spec) -> None:
    # In units of the stiffness of the body along its length.
    stiffness = spec["young"] / spec["size"][0] * np.exp(rng.uniform(np.log(2), np.log(10)))
    spec["world"] = {"pad": {"stiffness": float(stiffness)}}


def _far_field(rng: np.random.Generator, spec: Spec) -> None:
    spec["world"] = {"beyond": int(rng.integers(2, 5))}


def _thickness(rng: np.random.Generator, spec: Spec) -> None:
    along = rng.uniform(0.6, 1.4, 2) * rng.choice([-1, 1], 2)
    spec["world"] = {"thickness": {"along": along.tolist(), "phase": float(rng.uniform(0, 2 * np.pi)), "share": 0.2}}


def _partly(rng: np.random.Generator, spec: Spec) -> None:
    patch = str(rng.choice(spec["anchored"]))
    low, high = np.array(PATCHES[patch], dtype=float)
    axis = 0 if high[0] > low[0] else 2
    (high if rng.random() < 1 / 2 else low)[axis] = (low[axis] + high[axis]) / 2
    spec["world"] = {"partly": {"patch": patch, "box": [low.tolist(), high.tolist()]}}


def _other_body(rng: np.random.Generator, spec: Spec) -> None:
    spec["other"] = {
        "size": [round(float(s * rng.uniform(0.6, 1.5)), 1) for s in spec["size"]],
        "anchored": sorted(rng.choice(list(PATCHES), rng.integers(1, 4), replace=False).tolist()),
    }


def _energy(rng: np.random.Generator, spec: Spec) -> None:
    spec["world"] = {"second_invariant": {"scale": float(np.exp(rng.uniform(np.log(0.003), np.log(0.03))))}}


def _pressure(rng: np.random.Generator, spec: Spec) -> None:
    x, z = int(rng.integers(0, 6)), int(rng.integers(0, 3))
    box = [[x / 8, 1.0, z / 4], [(x + 3) / 8, 1.0, (z + 2) / 4]]
    kPa = spec["young"] * rng.uniform(0.05, 0.15) * rng.choice([-1, 1])
    spec["world"] = {"pressure": {"box": box, "kPa": float(kPa)}}


def _adhesion(rng: np.random.Generator, spec: Spec) -> None:
    stiffness = spec["young"] / spec["size"][1] * rng.uniform(0.3, 1.5)
    patch = str(rng.choice(spec["anchored"]))
    spec["world"] = {
        "adhesion": {"patch": patch, "stiffness": float(stiffness), "length": float(rng.uniform(0.5, 1.5))}
    }


KINDS: Mapping[str, Kind] = {
    "control": Kind("nothing is wrong", lambda _rng, _spec: None),
    "gripper": Kind("the gripper holds by an elastic pad", _pad, ("grasp_compliance",)),
    "far-field": Kind(
        "the body goes on beyond the face of patches 1 and 2",
        _far_field,
        ("soft_anchor", "foundation", "tether"),
        lambda _spec: ["1", "2"],
        ("3", "4", "5", "6"),
        # More would hide what is wrong.
        most=2,
    ),
    "thickness": Kind("the thickness varies by 20 %", _thickness, ("stiffness_gradient", "inclusion")),
    "partly": Kind(
        "a patch is attached on half of its area",
        _partly,
        ("partial_anchor", "soft_anchor", "release"),
        lambda spec: [spec["world"]["partly"]["patch"]],
        most=2,
    ),
    "other-body": Kind("markers of another body", _other_body, anchors_right=False),
    "energy": Kind("a strain energy of the second invariant", _energy),
    "pressure": Kind("a pressure on a part of the surface", _pressure),
    "adhesion": Kind(
        "a patch adheres and gives off",
        _adhesion,
        ("soft_anchor", "release"),
        lambda spec: [spec["world"]["adhesion"]["patch"]],
    ),
}
