"""The check film: the images of both cameras side by side, with what was found in them."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bcid.base.errors import MachineError
from bcid.base.run_folder import writing
from bcid.vision.camera import Cameras
from bcid.vision.detect import Image
from bcid.vision.track import StereoFrame

Array = NDArray[np.float64]
Colour = tuple[int, int, int]

# Blue, green, red (Okabe & Ito).
_SEEN: Colour = (178, 114, 0)
_EXPECTED: Colour = (0, 94, 213)
_WHITE: Colour = (255, 255, 255)
# Width of the film, px; height of the line of text; what residuals are magnified by.
_WIDTH, _LINE, _MAGNIFIED = 1920, 44, 200.0
_FONT = 0  # FONT_HERSHEY_SIMPLEX, in every version


class Film:
    """Writes frames as they come.

    Args:
        path: the .mp4 to write; it appears whole when the film is closed without an error.
        cameras: of the images.
        names: of the beads.
        rate: frames per second.
    """

    def __init__(self, path: Path, cameras: Cameras, names: list[str], rate: float = 8.0) -> None:
        self.path, self.cameras, self.names, self.rate = path, cameras, names, rate
        self._partial = path.with_name(f".{path.stem}.partial.mp4")
        self._writer: Any = None
        self._frames = 0

    def __enter__(self) -> Film:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._writer is not None:
            self._writer.release()
        try:
            if kind is None and self._writer is not None:
                self._finish()
        finally:
            # On a read-only file system there is none, and removing it fails as well.
            with suppress(OSError):
                self._partial.unlink(missing_ok=True)

    def _finish(self) -> None:
        """Give the film its name: OpenCV does not say when the disk is full, but then the film does not have its frames."""
        import cv2

        reader = cv2.VideoCapture(str(self._partial))
        written = int(reader.get(cv2.CAP_PROP_FRAME_COUNT)) if reader.isOpened() else 0
        reader.release()
        if written < self._frames:
            raise MachineError(
                f"{self.path}: cannot be written: it has {written} of {self._frames} frames; free some space or choose another "
                "folder, or make no film (--no-video)"
            )
        with writing(self.path):
            self._partial.replace(self.path)

    def add(self, left: Image | None, right: Image | None, frame: StereoFrame, text: str) -> NDArray[np.uint8]:
        """Draw a frame and append it; returns it (height, width, 3), in OpenCV's order of colours.

        Raises:
            MachineError: the film cannot be written.
        """
        import cv2

        drawn = self.drawn(left, right, frame, text)
        if self._writer is None:
            size = (drawn.shape[1], drawn.shape[0])
            self._writer = cv2.VideoWriter(str(self._partial), cv2.VideoWriter_fourcc(*"mp4v"), self.rate, size)
            if not self._writer.isOpened():
                raise MachineError(
                    f"{self.path}: cannot be written; is there space, may you write there, and can OpenCV write mp4?"
                )
        self._writer.write(drawn)
        self._frames += 1
        return drawn

    def drawn(self, left: Image | None, right: Image | None, frame: StereoFrame, text: str) -> NDArray[np.uint8]:
        """A frame of the film: circles around beads that were found, crosses where hidden ones are expected, residuals."""
        import cv2

        expected = self.cameras.project(frame.expected)
        shown = self.cameras.project(frame.points.positions)
        sides = []
        size = next((image.shape for image in (left, right) if image is not None), self._size())
        scale = (_WIDTH / 2) / size[1]
        for side, image in enumerate((left, right)):
            grey = np.zeros(size, np.uint8) if image is None else image
            small = cv2.resize(grey, (_WIDTH // 2, int(size[0] * scale) // 2 * 2), interpolation=cv2.INTER_AREA)
            picture = cv2.cvtColor(small, cv2.COLOR_GRAY2BGR)
            if image is None:
                _write(picture, "no image", (20, 40), _WHITE)
            self._beads(
                picture, frame.pixels[side] * scale, expected[side] * scale, (frame.pixels - shown)[side] * scale
            )
            sides.append(picture)
        body = np.hstack(sides)
        line = np.full((_LINE, body.shape[1], 3), 30, np.uint8)
        _write(line, text, (14, 29), _WHITE)
        return np.vstack([line, body])

    def _size(self) -> tuple[int, int]:
        width, height = self.cameras.left.size
        return (height, width) if height else (1024, 1280)

    def _beads(self, picture: NDArray[np.uint8], found: Array, expected: Array, residual: Array) -> None:
        import cv2

        for name, place, guess, off in zip(self.names, found, expected, residual, strict=True):
            seen = np.isfinite(place).all()
            at = place if seen else guess
            if not np.isfinite(at).all() or np.abs(at).max() > 1e5:
                continue
            u, v = (round(float(x)) for x in at)
            if seen:
                cv2.circle(picture, (u, v), 9, _SEEN, 2, cv2.LINE_AA)
                end = at + _MAGNIFIED * np.nan_to_num(off)
                cv2.line(picture, (u, v), (round(float(end[0])), round(float(end[1]))), _EXPECTED, 2, cv2.LINE_AA)
            else:
                cv2.drawMarker(picture, (u, v), _EXPECTED, cv2.MARKER_TILTED_CROSS, 14, 2, cv2.LINE_AA)
            _write(picture, name, (u + 10, v - 8), _SEEN if seen else _EXPECTED)


def _write(picture: NDArray[np.uint8], text: str, at: tuple[int, int], colour: Colour) -> None:
    """Text with a pale rim, so that it can be read on any ground."""
    import cv2

    rim = (255, 255, 255) if colour != _WHITE else (30, 30, 30)
    cv2.putText(picture, text, at, _FONT, 0.6, rim, 3, cv2.LINE_AA)
    cv2.putText(picture, text, at, _FONT, 0.6, colour, 1, cv2.LINE_AA)


def legend() -> str:
    """What the film shows, in a sentence."""
    return f"circles: beads; lines: residuals times {_MAGNIFIED:.0f}; crosses: where hidden beads are expected"
