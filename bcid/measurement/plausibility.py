"""Whether a measurement can be one of a scene: slips of writing and of frames, seen before anything is computed.

A slip is weighed against none by its posterior probability. At rest the body may have sagged: displacements are smooth
over the body, up to its size, with an error of markers on top (a Gaussian process; Rasmussen & Williams 2006, chapter 2). A slip
is believed when undoing it leaves displacements that are so much likelier that its small prior probability is outweighed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp, softmax

from bcid.base.errors import Problems
from bcid.base.units import show, unit_factor
from bcid.measurement.gripper_motion import GripperPoses
from bcid.measurement.slips import FAULT, Jump, Slip, jumps, slips, suspects

if TYPE_CHECKING:
    from bcid.measurement.contents import Contents
    from bcid.scene import Scene
    from bcid.scene.action import Action

Array = NDArray[np.float64]

# Prior probability that a measurement has a slip of the list: about one file in a hundred.
SLIP = 0.01
# A slip that is this probable is refused; one that is likelier than not is said first.
REFUSED, SAID = 0.99, 0.5
# Nothing of the body gets further from it than this many times its size; stretches of 3 and long strips stay far below.
REACH = 20.0
# How well people place markers, part of the body's size.
PLACED = 0.01
# Degrees of freedom of the t distribution that stands for the unknown scale of the error.
_TAIL = 4.0
# A body bends by as much as it moves as a whole, or by these parts of it.
_BENT = (1.0, 0.2, 0.04)
# With more fiducials every so many is looked at, and those unlike their neighbours, so that the check stays below two seconds.
_MOST = 150


class Sag:
    """What displacements a body may have at rest: of any amplitude up to its size, with an error of each marker.

    It may move, turn and stretch as a whole, and bend besides, by as much or by less: a body that hangs on an edge does the former.

    Args:
        points: rest positions, shape (n, 3).
        size: of the body; displacements by bending change over half of it.
        floor: error of a marker, all in one unit of length.
    """

    def __init__(self, points: Array, size: float, floor: float) -> None:
        away = np.linalg.norm(points[:, None] - points[None], axis=2) * math.sqrt(3.0) / (0.5 * size)
        arms = (points - points.mean(axis=0)) / (0.5 * size)
        # Linear in the place, and Matern's function of order 3/2.
        whole, bent = 1.0 + arms @ arms.T, (1.0 + away) * np.exp(-away)
        amplitudes = np.geomspace(floor, size, 9)
        self._parts = []
        for share in _BENT:
            sizes, modes = np.linalg.eigh(whole + share**2 * bent)
            self._parts.append((modes, np.maximum(sizes, 0.0) * amplitudes[:, None] ** 2 + floor**2))
        self._bound = 1e6 * size

    def log_evidence(self, moved: Array) -> Array:
        """Logarithm of the likelihood of displacement fields (h, n, 3), averaged over the amplitudes; shape (h,)."""
        moved = np.nan_to_num(np.clip(moved, -self._bound, self._bound))
        count = moved.shape[1] * 3
        likelihoods = []
        for modes, variances in self._parts:
            power = np.sum(np.einsum("nk,hna->hka", modes, moved, optimize=True) ** 2, axis=2)
            volume = 1.5 * np.log(variances).sum(axis=1)
            likelihoods.append(-volume - 0.5 * (count + _TAIL) * np.log1p(power @ (1.0 / variances.T) / _TAIL))
        each = np.concatenate(likelihoods, axis=1)
        return np.asarray(logsumexp(each, axis=1) - math.log(each.shape[1]))


@dataclass(frozen=True)
class Doubt:
    """What is wrong: with what probability, in words, and the slip that looks likeliest."""

    probability: float
    text: str
    slip: Slip | None = None


def examine(scene: Scene, measurement: Contents, problems: Problems) -> list[str]:
    """What is odd about a measurement of a scene; what is absurd is noted among the problems.

    The names of fiducials and grasps must be the scene's.
    """
    view = _View(scene, measurement)
    found = view.too_far()
    at_rest = _at_rest(view)
    found += at_rest or [*_gripper(view), *view.apart(), *view.jumping()]
    for one in found:
        if one.probability > REFUSED:
            problems.add(measurement.source, one.text)
    return [one.text for one in found if one.probability <= REFUSED]


class _View:
    """Positions of the measurement beside the scene, in m.

    Attributes:
        size: of the body, as far as fiducials and grasps tell it.
        floor: error of a position at rest.
        positions: shape (frames, fiducials, 3); NaN where a fiducial was not seen or cannot be.
    """

    def __init__(self, scene: Scene, measurement: Contents) -> None:
        self.actions, self.names = measurement.actions, measurement.fiducial_names
        self.rest = np.array([scene.fiducials[name] for name in self.names]).reshape(-1, 3)
        self.centres = {name: np.array(grasp.centre) for name, grasp in scene.grasps.items()}
        places = np.vstack([scene.rest, *(centre[None] for centre in self.centres.values())])
        self.size = float(np.linalg.norm(np.ptp(places, axis=0))) or float(np.abs(places).max()) or 1.0
        self.middle = places.mean(axis=0)
        sigma = measurement.noise_sigma or scene.noise_sigma or 0.0
        self.sigma, self.noise = sigma, min(sigma, 0.1 * self.size)
        self.floor = float(np.hypot(PLACED * self.size, self.noise))
        self.positions = _with_unmeasured(measurement.positions, self.rest)
        self.unit = measurement.units.length
        self.poses = GripperPoses(self.actions, self.rest, self.centres, self.size, self.noise)

    def written(self, value: float) -> str:
        """A length as the files have it."""
        return f"{value / unit_factor(self.unit, 'm'):.6g} {self.unit}"

    def too_far(self) -> list[Doubt]:
        """Single positions that nothing of the body can reach; they are left out of what follows.

        Where most are too far, the unit or the frame is wrong, which is looked at as a whole.
        """
        far = (np.abs(self.positions - self.middle) > REACH * self.size).any(axis=2)
        seen = np.isfinite(self.positions).all(axis=2)
        # More than this part of all positions is no matter of single ones.
        if not far.any() or far.sum() > 0.2 * seen.sum():
            return []
        found = []
        for action in self.actions:
            for k, i in zip(*np.nonzero(far[action.frames]), strict=True):
                place = self.positions[action.frames[k], i]
                axis = int(np.abs(place - self.middle).argmax())
                text = (
                    f"action {action.name}, step {action.steps[k]}, fiducial {self.names[i]}: "
                    f"{'xyz'[axis]} = {self.written(place[axis])} is further away than {REACH:g} times the size of the body "
                    f"({show(self.size, 'mm')}): check the number and its decimal point"
                )
                found.append(Doubt(1.0, text))
        self.positions[far] = np.nan
        return found

    def apart(self) -> list[Doubt]:
        """Fiducials that are on the whole further from their places than the body is large."""
        first = np.array([action.frames[0] for action in self.actions])
        away = np.linalg.norm(np.clip(self.positions[first] - self.rest, -1e9, 1e9), axis=-1)
        if not np.isfinite(away).any() or np.nanmedian(away) <= self.size + 3 * self.sigma:
            return []
        text = (
            f"at step 0 the fiducials are {show(float(np.nanmedian(away)), 'mm')} (median) from their rest positions in the scene, "
            f"which span {show(self.size, 'mm')}: check length_unit ('{self.unit}') and the frame of the positions"
        )
        return [Doubt(1.0, text)]

    def jumping(self) -> list[Doubt]:
        """Coordinates of fiducials and of the gripper that jump away, between steps."""
        found: list[Doubt] = []
        for action in self.actions:
            moved = np.abs(np.diff(action.translation, axis=0)).max(axis=1) if len(action) > 1 else np.zeros(0)
            for jump in jumps(self.positions[action.frames], moved, self.noise, self.size, SLIP):
                found.append(self._jump(action, jump, f"fiducial {self.names[jump.point]}"))
            if action.grasp:
                for jump in jumps(action.translation[:, None], np.zeros_like(moved), 0.0, self.size, SLIP):
                    found.append(self._jump(action, jump, f"gripper ({action.grasp})"))
        return found

    def _jump(self, action: Action, jump: Jump, what: str) -> Doubt:
        where = f"action {action.name}, step {action.steps[jump.step]}, {what}: {'xyz'[jump.axis]} = {self.written(jump.value)}"
        between = f"where the steps beside it let expect about {self.written(jump.expected)}"
        if jump.factor is None:
            return Doubt(min(jump.probability, REFUSED), f"{where} {between}: check that step, or leave it empty")
        mended = self.written(jump.value * jump.factor)
        return Doubt(jump.probability, f"{where} {between}: was {mended} meant? Check its decimal point")


def _with_unmeasured(positions: Array, rest: Array) -> Array:
    """Positions (frames, fiducials, 3); coordinates along an axis that was never measured as the scene has them."""
    whole, seen = positions.copy(), np.isfinite(positions)
    for axis in np.flatnonzero(~seen.any(axis=(0, 1))):
        whole[..., axis] = np.where(seen.any(axis=2), rest[:, axis], np.nan)
    return whole


def _at_rest(view: _View) -> list[Doubt]:
    """What the first steps of the actions say of slips, told once for all actions that agree."""
    found: dict[str, tuple[Doubt, list[str]]] = {}
    fields: dict[bytes, Sag] = {}
    for action in view.actions:
        one = _first_step(view, view.positions[action.frames[0]], fields)
        if one is not None:
            found.setdefault(one.text, (one, []))[1].append(action.name)
    told = []
    for one, names in found.values():
        shown = ", ".join(names[:6]) + (", ..." if names[6:] else "")
        which = "" if len(names) == len(view.actions) else f" of action{'s' if names[1:] else ''} {shown}"
        undo = None if one.slip is None else one.slip.undo
        poses = "" if undo is None else _concerned(view, undo)
        told.append(Doubt(one.probability, f"at step 0{which}, {one.text}{poses}"))
    return told


def _first_step(view: _View, seen: Array, fields: dict[bytes, Sag]) -> Doubt | None:
    """The slip that positions (n, 3) at rest look like, if that is likelier than none."""
    used = np.isfinite(seen).all(axis=1)
    if not used.any():
        used = np.isfinite(seen).any(axis=1)
    which = np.flatnonzero(used)
    if not len(which):
        return None
    if len(which) > _MOST:
        odd = which[suspects(seen[which] - view.rest[which], view.rest[which])]
        which = np.union1d(which[:: math.ceil(len(which) / _MOST)], odd)
    rest, names = view.rest[which], [view.names[i] for i in which]
    seen = np.clip(seen[which], -1e9, 1e9)
    sag = fields.setdefault(which.tobytes(), Sag(rest, view.size, view.floor))
    tried = slips(seen, rest, names, view.size, view.floor)
    evidence = sag.log_evidence(np.stack([seen - rest, *(slip.left for slip in tried)]))
    kinds = len({slip.kind for slip in tried}) or 1
    shares = softmax(evidence + np.array([math.log1p(-SLIP), *(math.log(SLIP / kinds) + slip.cost for slip in tried)]))
    if shares[0] >= 1 - SAID:
        return None
    likely = sorted(zip(shares[1:], tried, strict=True), key=lambda pair: -pair[0])
    if likely[0][1].kind == "units":
        # A body may stretch by another factor instead, which is as likely: that which leaves least is meant.
        likely.sort(key=lambda pair: math.inf if pair[1].kind != "units" else float(np.nanmean(pair[1].left ** 2)))
        likely = likely[:1]
    best = likely[0][1]
    remedy = f"{best.remedy} (it is '{view.unit}')" if best.kind == "units" else best.remedy
    sure = sum(share for share, slip in zip(shares[1:], tried, strict=True) if slip.kind != FAULT)
    return Doubt(float(sure), f"{_either(likely)}: {remedy}", best)


def _either(likely: Sequence[tuple[float, Slip]]) -> str:
    """The slips that together make up nearly all that speaks for one, at most three."""
    covered = np.cumsum([0.0, *(share for share, _ in likely)])
    texts = [slip.text for (_, slip), before in zip(likely, covered, strict=False) if before <= 0.8 * covered[-1]]
    return " or ".join(dict.fromkeys(texts[:3]))


def _concerned(view: _View, undo: Array) -> str:
    """Whether what mends the fiducials, `undo` (3, 3), mends the gripper's poses too."""
    whole = view.poses.mended_by(undo, np.clip(view.positions, -1e9, 1e9) @ undo.T, view.floor)
    if whole is None:
        return ""
    return " (the same holds for grasps.csv)" if whole else " (of fiducials.csv alone: grasps.csv looks right)"


def _gripper(view: _View) -> list[Doubt]:
    """Whether the fiducials near a grasp go where the gripper goes."""
    found = [_far_pose(view, a) for a in view.actions if (np.abs(a.translation) > REACH * view.size).any()]
    if found:
        return found
    probability, slip = view.poses.slip(view.positions, SLIP)
    text = (
        f"the fiducials near the grasp do not go where the gripper goes: in the gripper's poses {slip}; "
        f"write them in the frame and the length_unit ('{view.unit}') of the fiducials"
    )
    return [Doubt(probability, text)] if probability >= SAID else []


def _far_pose(view: _View, action: Action) -> Doubt:
    """The furthest pose of a gripper that goes where nothing can be."""
    step, axis = np.unravel_index(int(np.abs(action.translation).argmax()), action.translation.shape)
    text = (
        f"action {action.name}, step {action.steps[step]}: the gripper's {'xyz'[axis]} = "
        f"{view.written(float(action.translation[step, axis]))} is more than {REACH:g} times the size of the body "
        f"({show(view.size, 'mm')}): check the number, its decimal point and length_unit"
    )
    return Doubt(1.0, text)
