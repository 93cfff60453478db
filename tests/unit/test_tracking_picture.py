"""The picture of a tracking run: it is the run's own, and decoded elsewhere."""

from __future__ import annotations

import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
import runs
import xarray as xr

from bcid.base.errors import InputError
from bcid.base.run_folder import RunFolder
from bcid.report.export import draw_pictures
from bcid.report.found import Found
from bcid.report.gallery import drawings
from bcid.report.tracks_picture import rest_picture

_DRAWN = np.random.default_rng(0).integers(0, 256, (90, 60, 3), np.uint8)


@pytest.fixture
def tracked(tmp_path: Path) -> Path:
    """A finished run of `bcid track`."""
    run = runs.started(tmp_path / "run", "track")
    found = {"frames": 2, "beads": 2, "seen": 1.0, "sigma": 1e-4, "warnings": []}
    values = np.random.default_rng(0).uniform(size=(2, 2, 3))
    data = {
        "position": (("frame", "fiducial", "axis"), values),
        "covariance": (("frame", "fiducial", "axis", "axis2"), np.tile(1e-8 * np.eye(3), (2, 2, 1, 1))),
        "misfit": (("frame", "fiducial"), values[..., 0]),
        "step": ("frame", [0, 1]),
    }
    run.write_documents({"tracking.json": found, "tracking.nc": xr.Dataset(data, {"fiducial": ["a", "b"]})})
    run.write_bytes("rest.png", bytes(cv2.imencode(".png", _DRAWN)[1]))
    run.finish({})
    return tmp_path / "run"


def _drawn(folder: Path) -> None:
    """Draw it both ways, as `bcid track` and as `bcid report` do."""
    for one in drawings(Found.read(folder)):
        one.draw()


def test_picture_of_a_run_is_what_was_drawn(tracked: Path) -> None:
    np.testing.assert_array_equal(rest_picture(RunFolder.open(tracked)), _DRAWN[..., ::-1])
    _drawn(tracked)
    assert draw_pictures(tracked)[0].stat().st_size > 10_000


def test_picture_that_the_run_did_not_write_is_not_shown(tmp_path: Path, tracked: Path) -> None:
    shutil.move(tracked / "rest.png", tmp_path / "other.png")
    (tracked / "rest.png").symlink_to(tmp_path / "other.png")
    for read in (draw_pictures, _drawn):
        with pytest.raises(InputError, match=r"rest\.png: cannot be read: .*expected a regular file, no link"):
            read(tracked)
    (tracked / "rest.png").unlink()
    (tracked / "rest.png").write_bytes(bytes(cv2.imencode(".png", _DRAWN[1:])[1]))
    for read in (draw_pictures, _drawn):
        with pytest.raises(InputError, match=r"rest\.png: is damaged: it is not what the run wrote"):
            read(tracked)


@pytest.mark.parametrize("content", [b"", b"GIF89a", b"\x89PNG\r\n\x1a\n" + bytes(100)])
def test_picture_that_is_none_is_refused(tracked: Path, content: bytes) -> None:
    (tracked / "rest.png").write_bytes(content)
    runs.seal(tracked, "rest.png")
    with pytest.raises(InputError, match=r"rest\.png: is damaged and cannot be read: .*; repeat the run"):
        draw_pictures(tracked)
