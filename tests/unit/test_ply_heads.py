"""PLY files whose head has no end: refused by every reader, never waited for."""

from pathlib import Path

import numpy as np
import pytest

from bcid.base.errors import InputError
from bcid.forms.mesh.surface_file import read_surface
from bcid.measurement.formats.cloud_file import _read
from validation.reliability import scanned

READERS = {"surface": read_surface, "cloud": _read}


@pytest.mark.parametrize("kind", READERS)
@pytest.mark.parametrize("cut", [30, 60, 90])
@pytest.mark.timeout(30)
def test_a_ply_file_whose_head_has_no_end_is_refused(tmp_path: Path, kind: str, cut: int) -> None:
    file = scanned.save(tmp_path / "body.ply", *scanned.box())
    content = file.read_bytes()
    file.write_bytes(content[:cut] + content[content.index(b"end_header") + 11 :])
    with pytest.raises(InputError, match="its head has no line end_header: it is truncated, or no PLY file"):
        READERS[kind](file)


def test_a_whole_ply_file_is_read(tmp_path: Path) -> None:
    points, triangles = scanned.box()
    file = scanned.save(tmp_path / "body.ply", points, triangles)
    np.testing.assert_allclose(read_surface(file).points, points)
    np.testing.assert_allclose(_read(file), points)
