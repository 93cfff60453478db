"""Folders of images and videos: numbers, grey values, and what is said of files that cannot be read."""

import re
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from bcid.base.errors import InputError
from bcid.vision.decoder import StoredFilm, whole
from bcid.vision.images import Image, Images


def smooth(seed: int = 0, size: tuple[int, int] = (60, 40)) -> Image:
    """A grey image (height, width) that has something in it."""
    noise = np.random.default_rng(seed).integers(0, 256, size[::-1]).astype(np.uint8)
    return np.asarray(cv2.GaussianBlur(noise, (0, 0), 3))


def write(file: Path, image: Any) -> Path:
    file.parent.mkdir(exist_ok=True)
    assert cv2.imwrite(str(file), image)
    return file


def same(found: Image | None, wanted: Image) -> None:
    assert found is not None
    np.testing.assert_array_equal(found, wanted)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for number in (2, 10, 12):
        write(tmp_path / "cam1" / f"cam1_{number:04d}.png", smooth(number))
    return tmp_path / "cam1"


def test_numbers_are_the_last_digits_of_a_name(folder: Path) -> None:
    write(folder / "left2_7.JPG", smooth(7))
    (folder / "notes.txt").write_text("1")
    (folder / ".hidden_3.png").write_bytes(b"")
    images = Images.open(folder)
    assert images.numbers == [2, 7, 10, 12]
    assert images.size == (60, 40)
    assert images.source == folder
    same(images.read(10), smooth(10))
    assert images.troubles == {}


def test_names_without_numbers_are_counted_in_their_order(tmp_path: Path) -> None:
    for name in ("b", "a", "C"):
        write(tmp_path / "x" / f"{name}.png", smooth(ord(name)))
    images = Images.open(tmp_path / "x")
    assert images.numbers == [0, 1, 2]
    for number, name in enumerate("abC"):
        same(images.read(number), smooth(ord(name)))


def test_numbers_that_are_not_clear_are_all_told(folder: Path) -> None:
    write(folder / "cam1_2.bmp", smooth())
    write(folder / "cam_a.png", smooth())
    write(folder / "only.png", smooth())
    with pytest.raises(InputError) as raised:
        Images.open(folder)
    text = str(raised.value)
    for part in ("cam1_2.bmp", "cam1_0002.png", "only.png: has no number", "cam_a.png: has no number"):
        assert part in text


@pytest.mark.parametrize("suffix", ["png", "jpg", "tif", "bmp"])
@pytest.mark.parametrize("share", [0.0, 0.05, 0.6, 0.97])
def test_a_file_that_is_cut_short_is_no_image(folder: Path, suffix: str, share: float) -> None:
    """Decoders would fill up what is missing with grey."""
    file = write(folder / f"cut_5.{suffix}", smooth(5))
    content = file.read_bytes()
    images = Images.open(folder)
    assert images.read(5) is not None
    file.write_bytes(cut := content[: int(len(content) * share)])
    # Some versions of OpenCV refuse these files by themselves, others do not.
    assert whole(content)
    assert not share or suffix == "tif" or not whole(cut)
    images = Images.open(folder)
    assert images.read(5) is None
    assert f"cut_5.{suffix}" in images.troubles[5]
    assert images.read(10) is not None
    assert list(images.troubles) == [5]


def test_a_damaged_png_is_no_image(folder: Path) -> None:
    file = folder / "cam1_0010.png"
    content = bytearray(file.read_bytes())
    content[len(content) // 2] ^= 0xFF
    assert not whole(bytes(content))
    file.write_bytes(content)
    images = Images.open(folder)
    assert images.read(10) is None
    assert "damaged" in images.troubles[10]


def test_what_one_image_has_wrong_is_kept_by_number(folder: Path) -> None:
    write(folder / "big_11.png", smooth(0, (61, 40)))
    (folder / "text_13.png").write_text("not an image")
    (folder / "cam1_0002.png").write_bytes(b"")
    images = Images.open(folder)
    # The first that can be read decides on the size.
    assert images.size == (60, 40)
    assert [images.read(n) is None for n in (2, 3, 10, 11, 13)] == [True, True, False, True, True]
    assert "empty" in images.troubles[2]
    assert images.troubles[3] == "there is no image with the number 3"
    assert "61 x 40" in images.troubles[11]
    assert "60 x 40" in images.troubles[11]
    assert "text_13.png" in images.troubles[13]


def test_colour_becomes_grey_and_sixteen_bits_eight(tmp_path: Path) -> None:
    colour = np.dstack([smooth(1), smooth(2), smooth(3)])
    write(tmp_path / "colour" / "1.png", colour)
    found = Images.open(tmp_path / "colour").read(1)
    assert found is not None
    np.testing.assert_allclose(found, cv2.cvtColor(colour, cv2.COLOR_BGR2GRAY).astype(float), atol=1)
    # A camera of 12 bit: 16 levels of 256 would be left if 16 were believed.
    for number, factor in ((1, 2), (2, 14), (3, 16)):
        write(tmp_path / "deep" / f"{number}.tif", smooth(number).astype(np.uint16) * factor)
    deep = Images.open(tmp_path / "deep")
    same(deep.read(1), smooth(1) // 8)
    same(deep.read(3), smooth(3))
    write(tmp_path / "full" / "1.png", smooth(1).astype(np.uint16) * 257)
    same(Images.open(tmp_path / "full").read(1), smooth(1))
    write(tmp_path / "float" / "1.tif", smooth(1).astype(np.float32))
    with pytest.raises(InputError, match="float32"):
        Images.open(tmp_path / "float")


def test_nothing_to_read_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "bad").mkdir()
    (tmp_path / "bad" / "a_1.png").write_bytes(b"")
    (tmp_path / "a.avi").write_bytes(b"RIFF nothing")
    (tmp_path / "a.txt").write_text("")
    for name, text in (
        ("missing", "no such folder"),
        ("empty", "holds no image"),
        ("bad", "a_1.png is empty"),
        ("a.avi", "not a video"),
        ("a.txt", "expected a folder of images"),
    ):
        with pytest.raises(InputError, match=text):
            Images.open(tmp_path / name)


class Watched:
    """A video capture that counts its jumps, and frames that are passed over."""

    def __init__(self, capture: Any) -> None:
        self.capture = capture
        self.jumps = self.grabs = 0

    def grab(self) -> Any:
        self.grabs += 1
        return self.capture.grab()

    def set(self, what: int, value: float) -> Any:
        self.jumps += what == cv2.CAP_PROP_POS_FRAMES
        return self.capture.set(what, value)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.capture, name)


def test_a_video_is_read_in_order_without_jumps(tmp_path: Path) -> None:
    file = tmp_path / "left.avi"
    writer = cv2.VideoWriter(str(file), cv2.VideoWriter_fourcc(*"MJPG"), 25, (64, 48))
    for number in range(12):
        writer.write(np.full((48, 64, 3), 20 * number, np.uint8))
    writer.release()
    images = Images.open(file)
    assert images.numbers == list(range(12))
    assert images.size == (64, 48)
    stored = StoredFilm(file)
    stored._capture = watched = Watched(stored._opened())
    for number in (0, 1, 2, 3, 6, 7):
        same(images.read(number), frame := stored.grey(number))
        assert abs(float(frame.mean()) - 20 * number) < 3
    assert watched.jumps == 0
    same(images.read(4), stored.grey(4))
    assert watched.jumps == 1
    assert images.read(12) is None
    assert "no image with the number 12" in images.troubles[12]
    images.close()
    half = tmp_path / "half.avi"
    half.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    try:
        short = Images.open(half)
    except InputError:
        return
    assert short.read(0) is not None
    assert short.read(11) is None


_DYING = """
import ctypes, sys
from bcid.base.answering import answer
from bcid.vision.decoder import grey_image

def reply(content):
    if content == b"dies":
        ctypes.string_at(0)
    return grey_image(content)

sys.exit(answer(reply, ["cv2"]))
"""


def test_image_that_kills_its_decoder_is_a_trouble_of_that_image(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "dying.py").write_text(_DYING, encoding="utf-8")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.setattr("bcid.vision.images._DECODER", "dying")
    for number in (3, 4, 5, 6, 7):
        (folder / f"bad_{number}.png").write_bytes(b"dies")
    images = Images.open(folder)
    for number in (3, 4, 5):
        assert images.read(number) is None
        assert images.troubles[number] == (
            f"bad_{number}.png cannot be read: the reader died, code -11; is it whole? Copy it again"
        )
        same(images.read(10), smooth(10))
    assert images.read(6) is None
    # It is not started without end.
    assert images.read(7) is None
    assert "the reader had to be started 4 times" in images.troubles[7]


def test_image_file_of_30_gigabytes_is_not_read(folder: Path) -> None:
    with (folder / "hole_3.png").open("wb") as stream:
        stream.truncate(30_000_000_000)
    images = Images.open(folder)
    assert images.read(3) is None
    assert images.troubles[3] == "hole_3.png is no file of at most 1 GB"


def _stating(file: Path, frames: int, more: int = 0) -> Path:
    """A film of 12 frames that states another count, with `more` bytes behind its end."""
    writer = cv2.VideoWriter(str(file), cv2.VideoWriter_fourcc(*"MJPG"), 25, (64, 48))
    for number in range(12):
        writer.write(np.full((48, 64, 3), 20 * number, np.uint8))
    writer.release()
    content = bytearray(file.read_bytes())
    # The length of its stream (AVISTREAMHEADER, dwLength).
    at = content.index(b"vids") + 32
    assert content[at : at + 4] == (12).to_bytes(4, "little")
    content[at : at + 4] = frames.to_bytes(4, "little")
    file.write_bytes(bytes(content) + bytes(more))
    return file


def test_film_that_states_more_frames_than_bytes_is_refused(tmp_path: Path) -> None:
    file = _stating(tmp_path / "left.avi", 50_000_000)
    with pytest.raises(InputError, match=rf"left\.avi: states 50000000 frames, expected 1 to {file.stat().st_size};"):
        Images.open(file)
    _stating(file, 50_000_000, more=60_000_000)
    with pytest.raises(InputError, match=r"left\.avi: states 50000000 frames, expected 1 to 10000000;"):
        Images.open(file)


def test_film_that_is_shorter_than_it_states_is_left_at_its_end(tmp_path: Path) -> None:
    stored = StoredFilm(_stating(tmp_path / "left.avi", 5000))
    stored._capture = watched = Watched(stored._opened())
    with pytest.raises(InputError, match="shorter than it says"):
        stored.grey(80)
    assert watched.grabs == 13


def test_film_without_a_frame_that_can_be_read_is_given_up(tmp_path: Path) -> None:
    file = _stating(tmp_path / "left.avi", 5000, more=5000)
    content = bytearray(file.read_bytes())
    for found in re.finditer(rb"00dc(....)\xff\xd8", bytes(content), re.DOTALL):
        length = int.from_bytes(found[1], "little")
        content[found.end(1) : found.end(1) + length] = bytes(length)
    file.write_bytes(content)
    with pytest.raises(InputError, match=r"left\.avi: none of its first 1000 images can be read"):
        Images.open(file)
