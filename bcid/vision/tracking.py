"""From a recording to a measurement: the beads of all frames, in the body's frame, with what is known of their errors."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bcid.base.errors import InputError
from bcid.measurement import Action, Measurement
from bcid.measurement.contents import motions_dataset
from bcid.vision.camera import SIDES
from bcid.vision.images import Image, Images
from bcid.vision.layout import spans
from bcid.vision.recording import Recording
from bcid.vision.register import Registration, register
from bcid.vision.track import StereoFrame, Tracker
from bcid.vision.triangulate import Points

Array = NDArray[np.float64]
Pair = tuple[Image | None, Image | None]
# What looks at every frame: its place in the sequence, the images, and what was found.
Watch = Callable[[int, Pair, StereoFrame], None]

# The scale that the layout asks for is wrong beyond so many standard deviations and this part.
_SIGMAS, _SCALE = 3.0, 0.003
# The two cameras do not agree when the median of chi-square (0.45 for one degree of freedom) is larger.
_DISAGREE = 4.0


@dataclass(frozen=True)
class Tracking:
    """Where the beads were.

    Attributes:
        names: of the beads.
        actions: motions, numbered along the frames.
        numbers: of the images, shape (frames,).
        frames: what each pair of images showed.
        registration: from the left camera's frame to the body's.
        troubles: what was wrong with images, in words.
    """

    names: list[str]
    actions: list[Action]
    numbers: list[int]
    frames: list[StereoFrame]
    registration: Registration
    troubles: list[str]

    @property
    def seen(self) -> NDArray[np.bool_]:
        """Which beads have a place, shape (frames, beads)."""
        return np.array([frame.seen for frame in self.frames])

    @property
    def positions(self) -> Array:
        """In the body's frame, shape (frames, beads, 3), m; NaN in gaps."""
        return self.registration.to_body(np.array([frame.points.positions for frame in self.frames]))

    @property
    def covariance(self) -> Array:
        """Of the positions, shape (frames, beads, 3, 3), m^2: of this frame and bead alone."""
        return self.registration.turned(np.array([frame.points.covariance for frame in self.frames]))

    @property
    def misfit(self) -> Array:
        """Chi-square of each bead from its four pixel coordinates, shape (frames, beads)."""
        return np.array([frame.points.misfit for frame in self.frames])

    def measurement(self, recording: Recording) -> Measurement:
        """The measurement, with standard deviations of every position and the error of its frame."""
        sigma = np.sqrt(np.einsum("fnii->fni", self.covariance))
        times = [float(time) for action in self.actions for time in action.clock]
        data = motions_dataset(self.actions, times, self.names, self.positions)
        data["sigma"] = (("frame", "fiducial", "axis"), sigma)
        return Measurement(
            data,
            float(np.sqrt(np.nanmean(sigma**2))),
            units=recording.units,
            description=f"tracked in images: {len(self.frames)} pairs",
            source="tracking",
            frame_error=self.registration.error,
        ).validated()

    @property
    def warnings(self) -> list[str]:
        """What a user should look at before trusting the measurement, in sentences."""
        found = []
        scale, error = self.registration.free_scale
        if abs(scale - 1) > max(_SIGMAS * error, _SCALE):
            found.append(
                f"Lengths in the images are {abs(1 / scale - 1) * 100:.2g} % {'smaller' if scale > 1 else 'larger'} than in the "
                f"layout (scale {scale:.5f} ± {error:.1g}): is the size of the board's squares right, or has a camera been moved?"
            )
        middle = float(np.nanmedian(self.misfit))
        if middle > _DISAGREE:
            found.append(
                f"The two cameras do not agree: the median of chi-square is {middle:.2g} where 0.45 is expected. Was a camera "
                "moved after the calibration? Depths may be wrong by more than is stated."
            )
        share = self.seen.mean(axis=0)
        rare = [f"{name} ({part:.0%})" for name, part in zip(self.names, share, strict=True) if part < 0.5]
        if rare:
            found.append(f"Seen in less than half of the frames: {', '.join(rare)}.")
        empty = [number for number, frame in zip(self.numbers, self.frames, strict=True) if not frame.seen.any()]
        if empty:
            found.append(f"No bead was found in {len(empty)} of {len(self.frames)} pairs of images: {_listed(empty)}.")
        return found


def track(
    recording: Recording,
    layout: Mapping[str, tuple[float, float, float]],
    watch: Watch | None = None,
    started: Callable[[], None] | None = None,
    expected: Measurement | None = None,
) -> Tracking:
    """Follow the beads of a layout through a recording.

    Args:
        layout: rest positions by name in the body's frame, m.
        watch: is told of every frame, in order.
        started: is called once the layout has been found in the first images.
        expected: what a model has the beads do, frame by frame: they are looked for there.

    Raises:
        InputError: images are missing altogether or do not fit the cameras, or the layout is not found (see `Tracker.begin`).
    """
    images = [Images.open(path) for path in (recording.left, recording.right)]
    try:
        _check(recording, images, layout)
        numbers = recording.numbers(set(images[0].numbers) | set(images[1].numbers))
        actions = _actions(recording, len(numbers))
        moved = _moved(expected, list(layout), len(numbers))
        tracker = Tracker(
            recording.cameras, layout, recording.diameter, recording.dark, recording.tolerance, recording.distance
        )
        registration = _begun(tracker, recording, images, numbers, actions)
        if started:
            started()
        frames: list[StereoFrame] = []
        for action in actions:
            tracker.rest_again()
            for place in action.frames:
                pair = images[0].read(numbers[place]), images[1].read(numbers[place])
                step = (
                    None if moved is None or place == action.frames[0] else registration.vectors_to_camera(moved[place])
                )
                frames.append(tracker.follow(*pair, moved=step))
                if watch:
                    watch(int(place), pair, frames[-1])
        rest = _mean([frames[action.frames[0]].points for action in actions])
        if spans(tracker.rest[np.isfinite(rest.positions).all(axis=1)]):
            registration = register(rest, tracker.rest, recording.layout_sigma, recording.scale)
        return Tracking(list(layout), actions, numbers, frames, registration, _troubles(images, numbers))
    finally:
        for one in images:
            one.close()


def _check(recording: Recording, images: Sequence[Images], layout: Mapping[str, object]) -> None:
    for side, one, camera in zip(SIDES, images, (recording.cameras.left, recording.cameras.right), strict=True):
        if any(camera.size) and camera.size != one.size:
            raise InputError(
                f"{one.source}: the {side} images have {one.size[0]} x {one.size[1]} pixels, the camera was calibrated with "
                f"{camera.size[0]} x {camera.size[1]}: use images of the same size for both"
            )
    for name in recording.seen:
        if name not in layout:
            raise InputError(f"{recording.source}: seen: bead '{name}' is not one of the layout: {', '.join(layout)}")


def _actions(recording: Recording, count: int) -> list[Action]:
    if recording.actions is not None:
        return recording.actions
    steps = np.arange(count)
    still, upright = np.zeros((count, 3)), np.tile([1.0, 0.0, 0.0, 0.0], (count, 1))
    return [Action("1", steps, steps, "", still, upright, times=steps * recording.every / recording.rate)]


def _moved(expected: Measurement | None, names: list[str], frames: int) -> Array | None:
    """How far each bead moves to each frame as a model has it, shape (frames, beads, 3), m."""
    if expected is None:
        return None
    known = expected.fiducial_names
    if len(expected.positions) != frames or any(name not in known for name in names):
        raise InputError(
            f"{expected.source}: what is expected must have the recording's {frames} frames and beads, "
            f"it has {len(expected.positions)} frames of {', '.join(known)}"
        )
    positions = expected.positions[:, [known.index(name) for name in names]]
    return np.asarray(np.diff(positions, axis=0, prepend=positions[:1]))


def _begun(
    tracker: Tracker,
    recording: Recording,
    images: Sequence[Images],
    numbers: Sequence[int],
    actions: Sequence[Action],
) -> Registration:
    """Find the layout in the first images of the body at rest in which it can be found."""
    reason: InputError | None = None
    for place in [int(action.frames[0]) for action in actions]:
        left, right = images[0].read(numbers[place]), images[1].read(numbers[place])
        if left is None or right is None:
            side, one = (SIDES[0], images[0]) if left is None else (SIDES[1], images[1])
            why = one.troubles.get(numbers[place], "cannot be read")
            reason = reason or InputError(f"{one.source}: {side} image {numbers[place]}, of the body at rest: {why}")
            continue
        try:
            # Hints are pixels of the first images; the camera stands still and the body comes back to rest.
            frame = tracker.begin(left, right, recording.seen)
        except InputError as error:
            reason = reason or InputError(f"images {numbers[place]}: {error}")
            continue
        return register(frame.points, tracker.rest, recording.layout_sigma, recording.scale)
    assert reason is not None
    raise reason


def _mean(points: Sequence[Points]) -> Points:
    """Mean of the same points seen several times; the errors of pixels differ from frame to frame."""
    positions = np.array([one.positions for one in points])
    covariance = np.array([one.covariance for one in points])
    seen = np.isfinite(positions).all(axis=2)
    count = np.maximum(seen.sum(axis=0), 1)
    none = ~seen.any(axis=0)
    mean = np.nansum(positions, axis=0) / count[:, None]
    spread = np.nansum(covariance, axis=0) / (count**2)[:, None, None]
    mean[none], spread[none] = np.nan, np.nan
    return Points(mean, spread, np.where(none, np.nan, 0.0))


def _troubles(images: Sequence[Images], numbers: Sequence[int]) -> list[str]:
    """What was wrong with images that were wanted, in words."""
    found = []
    for side, one in zip(SIDES, images, strict=True):
        by_reason: dict[str, list[int]] = {}
        for number in numbers:
            if number in one.troubles:
                reason = one.troubles[number].replace(str(number), "N")
                by_reason.setdefault(reason, []).append(number)
        found += [f"{side} image {_listed(which)}: {reason}" for reason, which in by_reason.items()]
    return found


def _listed(numbers: Sequence[int]) -> str:
    shown = ", ".join(map(str, numbers[:12]))
    return shown + (f", ... ({len(numbers)} in all)" if len(numbers) > 12 else "")
