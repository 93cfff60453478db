"""Decodes images and films of cameras, in a process of its own: ``python -m bcid.vision.decoder [FILM]``.

Without FILM it is asked with the content of image files, with it for frames by number, or with nothing for how many there are.
"""

from __future__ import annotations

import os
import re
import sys
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bcid.base.answering import answer
from bcid.base.errors import InputError

# A gap of frames in a film that is read, not jumped over: jumps of a decoder are slow, and inexact in some formats.
_GAP = 100
# A file may carry zeros behind its end.
_PADDING = 64
_PNG = b"\x89PNG\r\n\x1a\n"
# How files of images begin. OpenCV goes by what a file holds, and knows formats that are seldom tried.
_IMAGES = (_PNG, b"\xff\xd8\xff", b"II*\0", b"MM\0*", b"II+\0", b"MM\0+", b"BM")
# How films begin: AVI, Matroska, and the first box of MP4 and MOV. What begins otherwise may be a list of other files or addresses,
# which FFmpeg would open.
_FILM = re.compile(rb"RIFF....AVI |\x1aE\xdf\xa3|....(?:ftyp|moov|mdat|wide|free|skip|pnot)", re.DOTALL)


def grey_image(content: bytes) -> NDArray[Any]:
    """The grey image (height, width) that a file holds, of 8 or 16 bits as stored.

    Raises:
        InputError: there is none; the text goes on behind the name of the file.
    """
    import cv2

    if not content:
        raise InputError("is empty")
    if not content.startswith(_IMAGES):
        raise InputError("is no image of a format that is read (png, jpg, jpeg, tif, tiff, bmp), or is damaged")
    if not whole(content):
        raise InputError("is cut short or damaged; copy it again")
    flags = cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION
    try:
        image = cv2.imdecode(np.frombuffer(content, np.uint8), flags)
    except cv2.error:
        image = None
    if image is None or image.size == 0:
        raise InputError("is not an image that OpenCV can read, or is damaged")
    if image.dtype not in (np.uint8, np.uint16):
        raise InputError(f"holds {image.dtype} values; save it with 8 or 16 bit")
    return np.asarray(image)


class StoredFilm:
    """Frames of a film, read one after the other; it jumps only where it must.

    Args:
        file: absolute.
    """

    def __init__(self, file: Path) -> None:
        self._file = file
        self._capture: Any = None
        self._next = 0

    def reply(self, request: bytes) -> NDArray[Any]:
        """A frame by number (8 bytes), or, asked with nothing, the count of frames."""
        if self._capture is None:
            self._capture = self._opened()
        return self.grey(int.from_bytes(request, "little")) if request else np.array([[self.count()]], np.uint64)

    def grey(self, number: int) -> NDArray[Any]:
        """Grey image (height, width) of a frame; `InputError` where it cannot be read."""
        import cv2

        self._go(number)
        good, frame = self._capture.read()
        if not good or frame is None:
            # Where a decoder stands after an error is not known.
            self._next = -1
            raise InputError("cannot be read: the video is damaged, or shorter than it says")
        self._next = number + 1
        if frame.ndim == 3:
            frame = cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY) if frame.shape[2] == 3 else frame[:, :, 0]
        return np.asarray(frame)

    def count(self) -> int:
        """Frames, as the file says, or counted where it does not."""
        import cv2

        stated = round(self._capture.get(cv2.CAP_PROP_FRAME_COUNT))
        if stated > 0:
            return stated
        count = 0
        while self._capture.grab():
            count += 1
        self._capture.release()
        self._capture = self._opened()
        return count

    def _opened(self) -> Any:
        import cv2

        try:
            with self._file.open("rb") as stream:
                head = stream.read(12)
        except OSError as error:
            raise InputError(f"cannot be read: {error.strerror}") from None
        os.environ["OPENCV_FFMPEG_CAPTURE_OPTIONS"] = "protocol_whitelist;file"
        # The other ways in which OpenCV opens a name take it for a pattern of images, an address or a pipeline.
        for backend in (cv2.CAP_FFMPEG, cv2.CAP_OPENCV_MJPEG) if _FILM.match(head) else ():
            capture = cv2.VideoCapture(str(self._file), backend)
            if capture.isOpened():
                break
        else:
            raise InputError("is not a video that OpenCV can read, or is damaged")
        capture.set(cv2.CAP_PROP_ORIENTATION_AUTO, 0)
        return capture

    def _go(self, number: int) -> None:
        """Stand before a frame."""
        import cv2

        if not 0 <= number - self._next <= _GAP or self._next < 0:
            self._capture.set(cv2.CAP_PROP_POS_FRAMES, number)
            self._next = number
            if round(self._capture.get(cv2.CAP_PROP_POS_FRAMES)) != number:
                # The jump went elsewhere: count from the start.
                self._capture.release()
                self._capture = self._opened()
                self._next = 0
        for _ in range(number - self._next):
            if not self._capture.grab():
                break
        self._next = number


def whole(content: bytes) -> bool:
    """Whether a PNG, JPEG or BMP is complete: decoders fill up what is missing with grey. Of other formats always true."""
    if content.startswith(_PNG):
        return _whole_png(content)
    if content.startswith(b"\xff\xd8"):
        return b"\xff\xd9" in content[-_PADDING:]
    if content.startswith(b"BM") and len(content) >= 6:
        return len(content) >= int.from_bytes(content[2:6], "little")
    return True


def _whole_png(content: bytes) -> bool:
    """Whether all chunks are there, up to the last one, with the right checksums (PNG specification, section 5)."""
    at = len(_PNG)
    while at + 12 <= len(content):
        end = at + 8 + int.from_bytes(content[at : at + 4], "big")
        kind = content[at + 4 : at + 8]
        if zlib.crc32(content[at + 4 : end]) != int.from_bytes(content[end : end + 4], "big"):
            return False
        if kind == b"IEND":
            return True
        at = end + 4
    return False


if __name__ == "__main__":
    film = [Path(name) for name in sys.argv[1:2]]
    sys.exit(answer(StoredFilm(film[0]).reply if film else grey_image, ["cv2"], film))
