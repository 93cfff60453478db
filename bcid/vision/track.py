"""Following beads through two image sequences.

In every pair of images, spots of the two that fit the epipolar geometry are triangulated. A bead takes the nearest of these to
where it is expected: where its motion, or that of a model, leads it. Then each bead is held against its neighbours: a body deforms
smoothly, so a spot whose displacement is not what the others' suggests is another bead, a false one or a reflection, and is given
up. A bead that is hidden is expected where its neighbours have it, so that it is found again. What is not seen by both cameras is a
gap.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bcid.base.errors import InputError
from bcid.vision.camera import SIDES, Cameras
from bcid.vision.detect import Image, Spots, detect
from bcid.vision.layout import LEAST, Assignment, Indices, axes, find, neighbours, spans
from bcid.vision.register import rigid
from bcid.vision.triangulate import Points, epipolar_distance, triangulate

Array = NDArray[np.float64]

# A pair of spots may be so far from the epipolar line, px, and so many errors of the calibration.
_EPIPOLAR, _ERRORS = 1.0, 3.0
# Where nothing fits, so much is tried in order to say what is wrong, px.
_BADLY = 40.0
# A bead's next place may be so far from where it is expected, in parts of the spacing of the beads.
_STEP = 0.45
# What neighbours say may be off by this part of the spacing, by so many times what it usually is in this frame, and by this part
# of the way since the bead was last seen.
_NEIGHBOURS, _USUAL, _OF_MOTION = 0.02, 6.0, 0.06
# A bead's place at rest may be so far from the layout, in parts of the layout's size.
_LAYOUT = 0.02
# A bead that is partly hidden looks smaller, and what hides it disturbs the ground: allowed change of the diameter in one camera,
# and of what the fit leaves against that of the other beads.
_PARTLY, _DISTURBED = 1.06, 2.5
# This part of the beads must be found at rest.
_FOUND = 0.34
# A depth may be this factor from the working distance.
_DEPTH = 3.0
# A pair of spots whose chi-square is more than so many times the usual one is not one bead.
_MISFIT = 25.0
# How fast a bead's usual diameter follows what is seen of it.
_LEARN = 0.3
# A hint names a spot within so many pixels.
_HINT = 25.0


@dataclass(frozen=True)
class StereoFrame:
    """Where the beads are in a pair of images.

    Attributes:
        points: in the left camera's frame, in the order of the layout; NaN where a bead is not seen by both cameras.
        pixels: in the left and the right image, shape (2, beads, 2), px; NaN likewise.
        diameters: in the left and the right image, shape (2, beads), px; NaN likewise.
        expected: where they were expected, shape (beads, 3), m.
    """

    points: Points
    pixels: Array
    diameters: Array
    expected: Array

    @property
    def seen(self) -> NDArray[np.bool_]:
        """Which beads have a place, shape (beads,)."""
        return _finite(self.points.positions)


@dataclass(frozen=True)
class _Pairs:
    """Pairs of spots that fit the epipolar geometry: numbers of the spots, and where their rays meet."""

    left: Indices
    right: Indices
    points: Points
    spots: tuple[Spots, Spots]

    def __len__(self) -> int:
        return len(self.left)


class Tracker:
    """Follows the beads of a layout.

    Args:
        cameras: the calibration.
        layout: rest positions by name, m, in the body's frame.
        diameter: of a bead, m.
        dark: whether beads are darker than the body.
        tolerance: how far a bead at rest may be from the layout, m; by default a part of the layout's size.
        distance: of the body from the cameras, m; by default where the two optical axes are nearest to each other.

    Raises:
        InputError: fewer than four beads, all of them in a row, or no working distance follows from the cameras.
    """

    def __init__(
        self,
        cameras: Cameras,
        layout: Mapping[str, tuple[float, float, float]],
        diameter: float,
        dark: bool = True,
        tolerance: float | None = None,
        distance: float | None = None,
    ) -> None:
        self.cameras, self.names, self.diameter, self.dark = cameras, list(layout), diameter, dark
        self.rest = np.array(list(layout.values()), dtype=float).reshape(-1, 3)
        if len(self.names) < LEAST:
            raise InputError(f"{len(self.names)} beads: at least {LEAST} are needed to find a layout in images")
        if len(axes(self.rest)) < 2:
            raise InputError(
                "the beads stand in a row: how the body is turned about it cannot be seen; add one beside it"
            )
        apart = np.linalg.norm(self.rest[:, None] - self.rest[None], axis=2)
        np.fill_diagonal(apart, np.inf)
        self.spacing = apart.min(axis=1)
        size = float(np.linalg.norm(np.ptp(self.rest, axis=0)))
        self.tolerance = _LAYOUT * size if tolerance is None else tolerance
        self.distance = working_distance(cameras) if distance is None else distance
        self._epipolar = max(_EPIPOLAR, _ERRORS * (cameras.error or 0.0))
        # Diameters that the beads usually have in the two cameras, px.
        self._usual: Array = np.full((2, len(self.names)), np.nan)
        # What the epipolar misfit of a bead usually is, at least one; nothing is refused for it before the first pair.
        self._misfit = np.inf
        # Of each bead: its last place, the motion that led there, how it differed from what the neighbours said, and where it was
        # last seen.
        self._start: Array | None = None
        self._last: Array = np.full(self.rest.shape, np.nan)
        self._motion: Array = np.zeros(self.rest.shape)
        self._own: Array = np.zeros(self.rest.shape)
        self._sighted: Array = self._last

    # -- the first pair

    def begin(self, left: Image, right: Image, hints: Mapping[str, tuple[float, float]] | None = None) -> StereoFrame:
        """Find the layout in a pair of images of the body at rest.

        Args:
            hints: pixels (u, v) in the left image where beads are, by name: needed where a layout is symmetric.

        Raises:
            InputError: less than a third of the beads is found, they fit no motion of the layout, more than one, or the two cameras
                do not agree.
        """
        spots = self._spots(left, right, None)
        pairs = self._pairs(spots, self._epipolar)
        best = self._laid(pairs, hints or {})
        if best is None or best.count < self._least():
            self._explain(spots, best)
        assert best is not None
        frame = self._frame(pairs, best.points, self.rest)
        if not spans(self.rest[frame.seen]):
            self._explain(spots, replace(best, points=np.where(frame.seen, best.points, -1)))
        self._keep(frame)
        assert self._start is not None
        return replace(frame, expected=self._start)

    def _least(self) -> int:
        return max(LEAST + 1, int(np.ceil(_FOUND * len(self.names))))

    def _laid(self, pairs: _Pairs, hints: Mapping[str, tuple[float, float]]) -> Assignment | None:
        if len(pairs) < LEAST:
            return None
        ways = find(pairs.points.positions, self.rest, self.tolerance, self._hinted(pairs, hints))
        if len(ways) > 1:
            raise InputError(self._ambiguous(pairs, ways))
        return ways[0] if ways else None

    def _hinted(self, pairs: _Pairs, hints: Mapping[str, tuple[float, float]]) -> dict[int, Indices]:
        """Pairs that named beads may be. Of several names, some may belong to beads that cannot be seen."""
        found, missing = {}, []
        pixels = pairs.spots[0].pixels
        for name, place in hints.items():
            away = np.linalg.norm(pixels - np.asarray(place), axis=1)
            if len(away) and away.min() <= _HINT:
                found[self.names.index(name)] = np.flatnonzero(pairs.left == np.argmin(away))
            else:
                near = f"the nearest is {away.min():.0f} px away" if len(away) else "there is none"
                missing.append(f"at {place[0]:g}, {place[1]:g} (bead {name}; {near})")
        if missing and not found:
            raise InputError(f"seen: no spot of the left image is {', '.join(missing[:3])}")
        return found

    def _ambiguous(self, pairs: _Pairs, ways: list[Assignment]) -> str:
        """Which bead, told apart how, would decide between the ways."""
        pixels = pairs.spots[0].pixels[pairs.left]
        numbers = np.array([way.points for way in ways])
        everywhere = np.flatnonzero((numbers >= 0).all(axis=0))
        differ = [len(set(numbers[:, bead])) for bead in everywhere]
        bead = int(everywhere[int(np.argmax(differ))]) if len(everywhere) else 0
        places = [pixels[way.points[bead]] for way in ways if way.points[bead] >= 0]
        told = " or ".join(f"{u:.0f}, {v:.0f}" for u, v in dict.fromkeys((round(p[0]), round(p[1])) for p in places))
        return (
            f"the layout of the beads lies on the spots in {len(ways)} ways: bead {self.names[bead]} is at {told} in the left "
            f'image; say which with [seen] "{self.names[bead]}" = [u, v]'
        )

    def _explain(self, spots: tuple[Spots, Spots], best: Assignment | None) -> None:
        """Say why the layout was not found; raises."""
        counts = " and ".join(f"{len(s)} in the {side} image" for s, side in zip(spots, SIDES, strict=True))
        head = f"{best.count if best else 0} of {len(self.names)} beads were found at rest (spots: {counts})"
        if min(len(s) for s in spots) < LEAST:
            raise InputError(f"{head}: are their diameter ({self.diameter * 1e3:.3g} mm) and colour right?")
        badly = self._pairs(spots, _BADLY)
        ways = find(badly.points.positions, self.rest, 2 * self.tolerance) if len(badly) >= LEAST else []
        if ways and ways[0].count >= self._least() and (best is None or ways[0].count > best.count):
            chosen = ways[0].points[ways[0].points >= 0]
            pixels = [s.pixels[i[chosen]] for s, i in zip(spots, (badly.left, badly.right), strict=True)]
            away = float(np.median(np.diag(epipolar_distance(self.cameras, *pixels))))
            if away < self._epipolar:
                raise InputError(
                    f"{head}: the layout lies on them, but both cameras see no bead that is named in [seen]; name others"
                )
            raise InputError(
                f"{head}: the calibration does not fit the images. Spots are {away:.1f} px (median) from the epipolar lines, "
                f"{self._epipolar:.2g} are allowed: was a camera moved or refocused? Calibrate again"
            )
        if best is not None:
            raise InputError(
                f"{head}, {self._least()} are needed: begin with images in which more of them are seen by both cameras"
            )
        raise InputError(
            f"{head}: no rigid motion takes the layout to them within {self.tolerance * 1e3:.3g} mm. "
            "Is the scene's layout that of the body, and its unit and that of the calibration right?"
        )

    # -- the pairs after it

    def rest_again(self) -> None:
        """The body is back at rest: beads are expected where they were in the first pair."""
        if self._start is not None:
            self._last = self._sighted = self._start
            self._motion = self._own = np.zeros(self.rest.shape)

    def follow(self, left: Image | None, right: Image | None, moved: Array | None = None) -> StereoFrame:
        """Find the beads in the next pair of images.

        Args:
            left, right: images; None for one that is missing, which makes the whole frame a gap.
            moved: how far each bead moves from the frame before as a model has it, shape (beads, 3), m, in the camera's frame;
                by default they go on as before.
        """
        assert self._start is not None, "begin first"
        expected = self._last + (self._motion if moved is None else moved)
        if left is None or right is None:
            self._last = expected if moved is not None else self._last
            return _nothing(expected)
        spots = self._spots(left, right, expected)
        pairs = self._pairs(spots, self._epipolar)
        chosen = self._nearest(pairs, expected, _STEP * self.spacing)
        chosen, expected = self._agreed(pairs, chosen, expected)
        frame = self._frame(pairs, chosen, expected)
        self._keep(frame)
        return frame

    def _nearest(self, pairs: _Pairs, expected: Array, reach: Array, chosen: Indices | None = None) -> Indices:
        """Number of the pair of each bead, -1 for none: the nearest first, every spot for one bead; those chosen already stay."""
        chosen = np.full(len(self.names), -1, dtype=np.int64) if chosen is None else chosen.copy()
        if len(pairs) == 0:
            return chosen
        away = np.linalg.norm(expected[:, None] - pairs.points.positions[None], axis=2) / reach[:, None]
        cost = np.where(away < 1, away**2 + pairs.points.misfit / 100, np.inf)
        left, right = (set(map(int, ends[chosen[chosen >= 0]])) for ends in (pairs.left, pairs.right))
        for flat in np.argsort(cost, axis=None):
            bead, pair = np.unravel_index(flat, cost.shape)
            if not np.isfinite(cost[bead, pair]):
                break
            if chosen[bead] < 0 and pairs.left[pair] not in left and pairs.right[pair] not in right:
                chosen[bead] = pair
                left.add(int(pairs.left[pair]))
                right.add(int(pairs.right[pair]))
        return chosen

    def _agreed(self, pairs: _Pairs, chosen: Indices, expected: Array) -> tuple[Indices, Array]:
        """Without the beads whose neighbours contradict, and with those that are found where the neighbours have them."""
        assert self._start is not None
        chosen = chosen.copy()
        while True:
            places = self._places(pairs, chosen)
            said = self._start + neighbours(self.rest, places - self._start) + self._own
            off = np.linalg.norm(places - said, axis=1)
            known = off[np.isfinite(off)]
            usual = float(np.median(known)) if len(known) else 0.0
            allowed = (
                _NEIGHBOURS * self.spacing + _USUAL * usual + _OF_MOTION * np.linalg.norm(said - self._sighted, axis=1)
            )
            allowed = np.minimum(np.nan_to_num(allowed, nan=np.inf), _STEP * self.spacing)
            if not np.nanmax(off / allowed, initial=0.0) > 1:
                break
            chosen[int(np.nanargmax(off / allowed))] = -1
        expected = np.where((chosen < 0)[:, None] & np.isfinite(said), said, expected)
        return self._nearest(pairs, expected, allowed, chosen), expected

    def _places(self, pairs: _Pairs, chosen: Indices) -> Array:
        places = np.full(self.rest.shape, np.nan)
        places[chosen >= 0] = pairs.points.positions[chosen[chosen >= 0]]
        return places

    # -- both

    def _spots(self, left: Image, right: Image, expected: Array | None) -> tuple[Spots, Spots]:
        """Spots of both images; only around where beads are expected, if that is known."""
        cameras = (self.cameras.left, self.cameras.right)
        places: tuple[Array | None, ...] = (None, None) if expected is None else self.cameras.project(expected)
        depth = self.distance if expected is None else float(np.nanmedian(expected[:, 2]))
        found = []
        for image, camera, place in zip((left, right), cameras, places, strict=True):
            size = self.diameter * camera.focal / depth
            margin = 4 * size + _STEP * float(self.spacing.max()) * camera.focal / depth
            found.append(_detected(image, size, self.dark, place, margin))
        return found[0], found[1]

    def _pairs(self, spots: tuple[Spots, Spots], reach: float) -> _Pairs:
        """Pairs of spots within `reach` px of the epipolar line, at a plausible depth."""
        left, right = spots
        if len(left) == 0 or len(right) == 0:
            none = np.zeros(0, dtype=np.int64)
            return _Pairs(none, none, triangulate(self.cameras, np.zeros((0, 2)), np.zeros((0, 2))), spots)
        i, j = np.nonzero(epipolar_distance(self.cameras, left.pixels, right.pixels) < reach)
        # What the calibration does not know counts with the errors of the spots.
        extra = (self.cameras.error or 0.0) ** 2 / 2 * np.eye(2)
        points = triangulate(
            self.cameras, left.pixels[i], right.pixels[j], left.covariance[i] + extra, right.covariance[j] + extra
        )
        depth = points.positions[:, 2]
        good = (depth > self.distance / _DEPTH) & (depth < self.distance * _DEPTH)
        good &= points.misfit < _MISFIT * self._misfit
        points = Points(points.positions[good], points.covariance[good], points.misfit[good])
        return _Pairs(i[good], j[good], points, spots)

    def _frame(self, pairs: _Pairs, chosen: Indices, expected: Array) -> StereoFrame:
        """What is known of the beads whose pairs were chosen, without those that something hides in part or disturbs."""
        frame = _nothing(expected)
        beads = np.flatnonzero(chosen >= 0)
        for side, (spots, numbers) in enumerate(zip(pairs.spots, (pairs.left, pairs.right), strict=True)):
            at = numbers[chosen[beads]]
            frame.pixels[side, beads], frame.diameters[side, beads] = spots.pixels[at], spots.diameter[at]
        clear = ~self._partly(frame.diameters)[beads] & ~_disturbed(pairs, chosen[beads])
        frame.pixels[:, beads[~clear]], frame.diameters[:, beads[~clear]] = np.nan, np.nan
        beads = beads[clear]
        for name in ("positions", "covariance", "misfit"):
            getattr(frame.points, name)[beads] = getattr(pairs.points, name)[chosen[beads]]
        return frame

    def _partly(self, diameters: Array) -> NDArray[np.bool_]:
        """Which beads look smaller or larger in a camera than they use to: something hides a part of them."""
        ratio = diameters / self._usual
        return np.asarray(((ratio > _PARTLY) | (ratio < 1 / _PARTLY)).any(axis=0))

    def _keep(self, frame: StereoFrame) -> None:
        """Remember a frame for the next one."""
        places, seen = frame.points.positions, frame.seen[:, None]
        learned = self._usual + _LEARN * (frame.diameters - self._usual)
        first = np.where(np.isnan(self._usual), frame.diameters, learned)
        self._usual = np.where(np.isnan(frame.diameters), self._usual, first)
        if self._start is None:
            self._start = self._last = self._sighted = _whole(self.rest, places)
            self._misfit = max(1.0, float(np.nanmedian(frame.points.misfit)))
            return
        said = self._start + neighbours(self.rest, places - self._start)
        here = np.where(seen, places, frame.expected)
        self._motion, self._last = here - self._last, here
        self._own = np.where(seen & np.isfinite(said), places - said, self._own)
        self._sighted = np.where(seen, places, self._sighted)


def working_distance(cameras: Cameras) -> float:
    """Depth, m, in the left camera at which the two optical axes are nearest to each other.

    Raises:
        InputError: they are parallel, or nearest behind the cameras.
    """
    # The right camera's axis and place in the frame of the left one.
    axis, place = cameras.rotation.T[:, 2], -cameras.rotation.T @ cameras.translation
    across = 1 - axis[2] ** 2
    depth = (place[2] - axis[2] * (axis @ place)) / across if across > 1e-4 else -1.0
    if depth <= 0:
        raise InputError(
            'the optical axes of the cameras do not meet in front of them: state how far the body is, as distance = "300 mm"'
        )
    return float(depth)


def _whole(rest: Array, places: Array) -> Array:
    """Places at rest, shape (beads, 3), m, with those that were not seen where the layout has them."""
    seen = _finite(places)
    rotation, translation, _ = rigid(rest[seen], places[seen])
    return np.where(seen[:, None], places, rest @ rotation.T + translation)


def _disturbed(pairs: _Pairs, chosen: Indices) -> NDArray[np.bool_]:
    """Which of some pairs (n,) are fitted much worse than the others in a camera: something else is in the window."""
    worse = np.zeros(len(chosen), dtype=bool)
    for spots, numbers in zip(pairs.spots, (pairs.left, pairs.right), strict=True):
        left = spots.residual[numbers[chosen]]
        worse |= left > _DISTURBED * np.median(left) if len(left) else False
    return worse


def _nothing(expected: Array) -> StereoFrame:
    count = len(expected)
    points = Points(np.full((count, 3), np.nan), np.full((count, 3, 3), np.nan), np.full(count, np.nan))
    return StereoFrame(points, np.full((2, count, 2), np.nan), np.full((2, count), np.nan), expected)


def _detected(image: Image, size: float, dark: bool, places: Array | None, margin: float) -> Spots:
    """Spots of an image, or of its part around some pixels."""
    if places is None or not np.isfinite(places).any():
        return detect(image, size, dark)
    height, width = image.shape
    lower = np.floor(np.clip(np.nanmin(places, axis=0) - margin, 0, None)).astype(int)
    upper = np.ceil(np.clip(np.nanmax(places, axis=0) + margin, 0, [width, height])).astype(int)
    if (upper - lower).min() < 4 * size:
        return detect(image, size, dark)
    spots = detect(image[lower[1] : upper[1], lower[0] : upper[0]], size, dark)
    return replace(spots, pixels=spots.pixels + lower)


def _finite(places: Array) -> NDArray[np.bool_]:
    """Which of some places (n, 3) are known, shape (n,)."""
    return np.asarray(np.isfinite(places).all(axis=1), dtype=bool)
