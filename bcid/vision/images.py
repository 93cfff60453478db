"""The images of one camera: a folder of image files, or a video; grey, 8 bit, and named by number."""

from __future__ import annotations

import os
import re
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from bcid.base.errors import InputError, Problems

Image = NDArray[np.uint8]

SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp")
VIDEOS = (".mp4", ".avi", ".mov", ".mkv", ".m4v")
# Bits that cameras put into 16; the images looked at to tell them apart.
_DEPTHS = (8, 10, 12, 14, 16)
_LOOKS = 9
# A gap of frames in a video that is read, not jumped over: jumps of a decoder are slow, and inexact in some formats.
_GAP = 100
# A file may carry zeros behind its end.
_PADDING = 64
_PNG = b"\x89PNG\r\n\x1a\n"
# How files of SUFFIXES begin. OpenCV goes by what a file holds, and knows formats that are seldom tried.
_IMAGES = (_PNG, b"\xff\xd8\xff", b"II*\0", b"MM\0*", b"II+\0", b"MM\0+", b"BM")
# How files of VIDEOS begin: AVI, Matroska, and the first box of MP4 and MOV. What begins otherwise may be a list of other files
# or addresses, which FFmpeg would open.
_VIDEO = re.compile(rb"RIFF....AVI |\x1aE\xdf\xa3|....(?:ftyp|moov|mdat|wide|free|skip|pnot)", re.DOTALL)


class _Source(Protocol):
    numbers: list[int]

    def grey(self, number: int) -> NDArray[Any]:
        """Grey image (height, width) as stored; `InputError` says why there is none."""

    def close(self) -> None:
        """Give back what is open."""


class Images:
    """The images of one camera; make it with `Images.open`.

    Attributes:
        source: the folder or the video.
        numbers: of the images, in order.
        size: width and height of the first image that can be read, px; others must have the same.
        troubles: why an image could not be read, by number; filled while reading.
    """

    def __init__(self, source: Path, stored: _Source) -> None:
        self.source = source
        self.numbers = sorted(stored.numbers)
        self.troubles: dict[int, str] = {}
        self._known = frozenset(self.numbers)
        self._stored = stored
        self._bits = 0
        self.size = self._first_size()

    @classmethod
    def open(cls, path: str | Path) -> Images:
        """Find the images in a folder or in a video.

        The number of a file is the last run of digits in its name (12 of left_0012.png). Files of which none has a number are
        counted from 0 in the order of their names, frames of a video from 0.

        Raises:
            InputError: there is nothing to read, or the numbers of the files are not clear.
        """
        path = Path(path)
        if path.is_dir():
            return cls(path, _Folder(path))
        if not path.is_file():
            raise InputError(f"{path}: no such folder of images or video")
        if path.suffix.lower() not in VIDEOS:
            raise InputError(
                f"{path}: expected a folder of images ({_listed(SUFFIXES)}) or a video ({_listed(VIDEOS)}); "
                f"give the folder that holds the images"
            )
        return cls(path, _Video(path))

    def read(self, number: int) -> Image | None:
        """Grey image (height, width) of a number; None where there is none, and `troubles` says why.

        Colour is turned into grey. Of 16 bit, 8 are kept: cameras store 10, 12 or 14 bit in 16, so the range is the smallest of
        these that holds the brightest pixel of a few images spread over all; what is brighter still becomes white.
        """
        try:
            return self._read(number)
        except InputError as error:
            self.troubles[number] = str(error)
            return None

    def close(self) -> None:
        """Close the video."""
        self._stored.close()

    def _read(self, number: int) -> Image:
        if number not in self._known:
            raise InputError(f"there is no image with the number {number}")
        grey = self._stored.grey(number)
        if (found := (grey.shape[1], grey.shape[0])) != self.size:
            raise InputError(f"is {found[0]} x {found[1]} pixels, the others are {self.size[0]} x {self.size[1]}")
        return self._eight_bit(grey)

    def _first_size(self) -> tuple[int, int]:
        for number in self.numbers:
            try:
                grey = self._stored.grey(number)
            except InputError as error:
                self.troubles[number] = str(error)
                continue
            return grey.shape[1], grey.shape[0]
        reasons = "".join(f"\n  {number}: {reason}" for number, reason in list(self.troubles.items())[:5])
        raise InputError(f"{self.source}: none of its {len(self.numbers)} images can be read:{reasons}")

    def _eight_bit(self, grey: NDArray[Any]) -> Image:
        if grey.dtype == np.uint8:
            return np.ascontiguousarray(grey)
        if not self._bits:
            self._bits = self._depth(int(grey.max()))
        return np.minimum(grey >> (self._bits - 8), 255).astype(np.uint8)

    def _depth(self, brightest: int) -> int:
        """Bits that the camera used, from a few images spread over all."""
        for number in self.numbers[:: max(1, len(self.numbers) // _LOOKS)]:
            try:
                grey = self._stored.grey(number)
            except InputError:
                continue
            if grey.dtype == np.uint16:
                brightest = max(brightest, int(grey.max()))
        return next(bits for bits in _DEPTHS if brightest < 2**bits)


class _Folder:
    """Image files."""

    def __init__(self, folder: Path) -> None:
        try:
            entries = sorted(folder.iterdir())
        except OSError as error:
            raise InputError(f"{folder}: cannot be read: {error.strerror}") from None
        files = [f for f in entries if f.suffix.lower() in SUFFIXES and f.is_file() and not f.name.startswith(".")]
        if not files:
            raise InputError(f"{folder}: holds no image; expected files that end in {_listed(SUFFIXES)}")
        self._files = _numbered(files, folder)
        self.numbers = list(self._files)

    def grey(self, number: int) -> NDArray[Any]:
        import cv2

        file = self._files[number]
        try:
            content = file.read_bytes()
        except OSError as error:
            raise InputError(f"{file.name} cannot be read: {error.strerror}") from None
        if not content:
            raise InputError(f"{file.name} is empty")
        if not content.startswith(_IMAGES):
            raise InputError(f"{file.name} is no image of a format that is read ({_listed(SUFFIXES)}), or is damaged")
        if not _whole(content):
            raise InputError(f"{file.name} is cut short or damaged; copy it again")
        flags = cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION
        try:
            with _silent():
                image = cv2.imdecode(np.frombuffer(content, np.uint8), flags)
        except cv2.error:
            image = None
        if image is None or image.size == 0:
            raise InputError(f"{file.name} is not an image that OpenCV can read, or is damaged")
        if image.dtype not in (np.uint8, np.uint16):
            raise InputError(f"{file.name} holds {image.dtype} values; save it with 8 or 16 bit")
        return np.asarray(image)

    def close(self) -> None:
        """Nothing stays open."""


class _Video:
    """Frames of a video, read one after the other; it jumps only where it must."""

    def __init__(self, file: Path) -> None:
        self._file = file
        self._capture = self._opened()
        self._next = 0
        self.numbers = list(range(self._count()))
        if not self.numbers:
            raise InputError(f"{file}: holds no frame that OpenCV can read; save it as AVI or MP4 again")

    def grey(self, number: int) -> NDArray[Any]:
        import cv2

        with _silent():
            self._go(number)
            good, frame = self._capture.read()
        if not good or frame is None:
            # Where a decoder stands after an error is not known.
            self._next = -1
            raise InputError(f"frame {number} cannot be read: the video is damaged, or shorter than it says")
        self._next = number + 1
        if frame.ndim == 3:
            frame = cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY) if frame.shape[2] == 3 else frame[:, :, 0]
        return np.asarray(frame)

    def close(self) -> None:
        self._capture.release()

    def _opened(self) -> Any:
        import cv2

        try:
            with self._file.open("rb") as stream:
                head = stream.read(12)
        except OSError as error:
            raise InputError(f"{self._file}: cannot be read: {error.strerror}") from None
        os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
        os.environ.setdefault("OPENCV_FFMPEG_CAPTURE_OPTIONS", "protocol_whitelist;file")
        # The other ways in which OpenCV opens a name take it for a pattern of images, an address or a pipeline.
        for backend in (cv2.CAP_FFMPEG, cv2.CAP_OPENCV_MJPEG) if _VIDEO.match(head) else ():
            with _silent():
                capture = cv2.VideoCapture(str(self._file.absolute()), backend)
            if capture.isOpened():
                break
        else:
            raise InputError(f"{self._file}: is not a video that OpenCV can read, or is damaged")
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
            self._capture.grab()
        self._next = number

    def _count(self) -> int:
        import cv2

        stated = round(self._capture.get(cv2.CAP_PROP_FRAME_COUNT))
        if stated > 0:
            return stated
        # The file does not say.
        count = 0
        while self._capture.grab():
            count += 1
        self._capture.release()
        self._capture = self._opened()
        return count


def _numbered(files: list[Path], folder: Path) -> dict[int, Path]:
    """Files by number."""
    found: dict[Path, int] = {}
    for file in files:
        digits = re.findall(r"[0-9]+", file.stem)
        if digits:
            found[file] = int(digits[-1])
    if not found:
        return dict(enumerate(sorted(files, key=lambda file: file.name.lower())))
    problems = Problems(f"images in {folder}")
    for file in files:
        if file not in found:
            problems.add(file.name, "has no number, but others have; give it one, or move it elsewhere")
    result: dict[int, Path] = {}
    for file, number in found.items():
        if number in result:
            problems.add(file.name, f"has the number {number}, as has {result[number].name}; give every image its own")
        result.setdefault(number, file)
    problems.raise_if_any()
    return result


def _whole(content: bytes) -> bool:
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


@contextmanager
def _silent() -> Iterator[None]:
    """Keep OpenCV from writing to standard error about files that are damaged; they are reported by number."""
    import cv2

    logging = getattr(getattr(cv2, "utils", None), "logging", None)
    if logging is None:
        yield
        return
    before = logging.getLogLevel()
    logging.setLogLevel(logging.LOG_LEVEL_SILENT)
    try:
        yield
    finally:
        logging.setLogLevel(before)


def _listed(suffixes: tuple[str, ...]) -> str:
    return ", ".join(suffix[1:] for suffix in suffixes)
