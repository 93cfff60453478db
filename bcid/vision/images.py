"""The images of one camera: a folder of image files, or a video; grey, 8 bit, and named by number."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from bcid.base.answering import Answering
from bcid.base.errors import InputError, Problems

Image = NDArray[np.uint8]

SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp")
VIDEOS = (".mp4", ".avi", ".mov", ".mkv", ".m4v")
# Bits that cameras put into 16; the images looked at to tell them apart.
_DEPTHS = (8, 10, 12, 14, 16)
_LOOKS = 9
# Images that are tried until one can be read.
_TRIES = 1000
# What decodes them, in a process of its own.
_DECODER = "bcid.vision.decoder"
# Longest file of an image, bytes, and most frames of a film: a day at 100 frames per second.
_LONGEST, _MOST_FRAMES = 1_000_000_000, 10_000_000
# Time for an image, s, and how much more a byte of its file may take; for a frame of a film, which may be counted from the first.
_SECONDS, _SECONDS_PER_BYTE = 30.0, 1e-6
_FILM_SECONDS, _FILM_SECONDS_PER_BYTE = 120.0, 1e-5


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
        """End the process that decodes."""
        self._stored.close()

    def _read(self, number: int) -> Image:
        if number not in self._known:
            raise InputError(f"there is no image with the number {number}")
        grey = self._stored.grey(number)
        if (found := (grey.shape[1], grey.shape[0])) != self.size:
            raise InputError(f"is {found[0]} x {found[1]} pixels, the others are {self.size[0]} x {self.size[1]}")
        return self._eight_bit(grey)

    def _first_size(self) -> tuple[int, int]:
        tried = self.numbers[:_TRIES]
        for number in tried:
            try:
                grey = self._stored.grey(number)
            except InputError as error:
                self.troubles[number] = str(error)
                continue
            return grey.shape[1], grey.shape[0]
        reasons = "".join(f"\n  {number}: {reason}" for number, reason in list(self.troubles.items())[:5])
        self.close()
        which = f"first {_TRIES}" if len(tried) < len(self.numbers) else str(len(tried))
        raise InputError(f"{self.source}: none of its {which} images can be read:{reasons}")

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
        self._decoder = Answering(_DECODER)
        self.numbers = list(self._files)

    def grey(self, number: int) -> NDArray[Any]:
        file = self._files[number]
        try:
            if not file.is_file() or file.stat().st_size > _LONGEST:
                raise InputError(f"{file.name} is no file of at most {_LONGEST / 1e9:g} GB")
            content = file.read_bytes()
        except OSError as error:
            raise InputError(f"{file.name} cannot be read: {error.strerror}") from None
        try:
            return self._decoder.ask(content, _SECONDS + _SECONDS_PER_BYTE * len(content))
        except InputError as error:
            raise InputError(f"{file.name} {error}") from None

    def close(self) -> None:
        self._decoder.close()


class _Video:
    """Frames of a video."""

    def __init__(self, file: Path) -> None:
        self._decoder = Answering(_DECODER, [str(file.absolute())])
        size = file.stat().st_size
        self._seconds = _FILM_SECONDS + _FILM_SECONDS_PER_BYTE * size
        try:
            count = int(self._decoder.ask(b"", self._seconds).flat[0])
        except InputError as error:
            raise InputError(f"{file}: {error}") from None
        # A frame takes at least a byte.
        most = min(_MOST_FRAMES, size)
        if not 0 < count <= most:
            self.close()
            raise InputError(f"{file}: states {count} frames, expected 1 to {most}; save it as AVI or MP4 again")
        self.numbers = list(range(count))

    def grey(self, number: int) -> NDArray[Any]:
        try:
            return self._decoder.ask(number.to_bytes(8, "little"), self._seconds)
        except InputError as error:
            raise InputError(f"frame {number} {error}") from None

    def close(self) -> None:
        self._decoder.close()


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


def _listed(suffixes: tuple[str, ...]) -> str:
    return ", ".join(suffix[1:] for suffix in suffixes)
