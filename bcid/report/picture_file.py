"""Pictures that runs keep, decoded by Pillow in a process of its own: ``python -m bcid.report.picture_file FILE OUT.npz``."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bcid.base.confined import read_in_child, serve
from bcid.base.errors import InputError
from bcid.base.scratch import temporary_folder

Pixels = NDArray[np.uint8]
_SECONDS = 30.0


def decoded(content: bytes, path: Path) -> Pixels:
    """Red, green and blue of a PNG file, shape (height, width, 3).

    Args:
        content: of the file.
        path: for messages.

    Raises:
        InputError: it is no picture, or ends its decoder.
    """
    with temporary_folder("bcid-picture-") as folder:
        file = folder / "picture.png"
        file.write_bytes(content)
        try:
            pixels = read_in_child("bcid.report.picture_file", file, seconds=_SECONDS).get("pixels", np.array(0))
            if pixels.dtype != np.uint8 or pixels.ndim != 3 or pixels.shape[2] != 3:
                raise InputError("the reader gave back no picture")
        except (InputError, TimeoutError) as error:
            raise InputError(f"{path}: is damaged and cannot be read: {error}; repeat the run") from None
    return np.asarray(pixels)


def _pixels(source: Path, _arguments: Sequence[str]) -> dict[str, Pixels]:
    from PIL import Image

    with Image.open(source, formats=["PNG"]) as image:
        return {"pixels": np.asarray(image.convert("RGB"))}


if __name__ == "__main__":
    sys.exit(serve(_pixels, ["PIL.PngImagePlugin"]))
