"""PLY files whose head has no end: refused by every reader, never waited for."""

from pathlib import Path

import numpy as np
import pytest

from bcid.base.errors import InputError
from bcid.forms.mesh.surface_file import read_surface
from bcid.measurement import Measurement
from validation.reliability import scanned

HEADER = 'format = "bcid-measurement/1"\nlength_unit = "m"\ntime_unit = "s"\nforce_unit = "N"\n'


def read_cloud(file: Path) -> np.ndarray:
    """The points of a file as the cloud of the only step of a measurement, m."""
    folder = file.parent
    (folder / "measurement.toml").write_text(f'{HEADER}[surface]\nclouds = "{file.stem}{{step}}.ply"\n')
    (folder / "grasps.csv").write_text("action,step,time,grasp,x,y,z,qw,qx,qy,qz\na,0,0,I,0,0,0,1,0,0,0\n")
    file.rename(folder / f"{file.stem}0.ply")
    cloud = Measurement.read(folder).cloud
    assert cloud is not None
    return cloud.points


READERS = {"surface": read_surface, "cloud": read_cloud}


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
    np.testing.assert_allclose(read_cloud(file), points, atol=1e-6)
