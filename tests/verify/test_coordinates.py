"""One camera, and a load cell with one axis: coordinates and forces that were not measured are left out, not made up."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bcid.base.options import IdentifyOptions
from bcid.forms.gripper_force import ForceScale
from bcid.forms.simulate import simulate
from bcid.inference.data import Data, robust_noise
from bcid.measurement import Measurement
from bcid.scene import Level, Scene
from bcid.search.identify import identify

# In the image of a camera that looks along z.
SEEN = [0, 1]
ON_SECOND = IdentifyOptions(level=1)


@pytest.fixture(scope="module")
def slab(project: Path) -> Scene:
    scene = Scene.read(project / "examples" / "scenes" / "slab.toml")
    return replace(scene, patches={name: scene.patches[name] for name in "1234"})


@pytest.fixture(scope="module")
def measured(project: Path) -> Measurement:
    """Of the slab with patches 1 and 2 anchored."""
    return Measurement.read(project / "examples" / "measurements" / "slab-12-semicircle")


def with_z(measured: Measurement, z: np.ndarray | float) -> Measurement:
    """The measurement with other third coordinates."""
    data = measured.data.copy(deep=True)
    data["position"][..., 2] = z
    return replace(measured, data=data)


def flat(slab: Scene, measured: Measurement) -> Measurement:
    """With the third coordinates that the markers have at rest, as software for plane images writes them."""
    return with_z(measured, np.array([slab.fiducials[name][2] for name in measured.fiducial_names]))


def test_one_camera_sees_what_is_attached(slab: Scene, measured: Measurement, tmp_path: Path) -> None:
    with_z(measured, np.nan).write(tmp_path / "plane")
    text = (tmp_path / "plane" / "fiducials.csv").read_text(encoding="utf-8")
    columns = [",".join(line.split(",")[:6]) for line in text.splitlines()]
    (tmp_path / "plane" / "fiducials.csv").write_text("\n".join(columns) + "\n", encoding="utf-8")
    plane = Measurement.read(tmp_path / "plane")
    assert np.isnan(plane.positions[..., 2]).all()
    np.testing.assert_allclose(plane.positions[..., SEEN], measured.positions[..., SEEN])
    found = identify(slab, plane, options=ON_SECOND)
    assert (found.anchored, found.probability > 0.99, found.discrepancy_probability < 0.5) == (("1", "2"), True, True)
    wrong = identify(slab, flat(slab, measured), options=ON_SECOND)
    assert wrong.discrepancy_probability > 0.99 or wrong.anchored != ("1", "2"), (
        "a coordinate that is made up is believed"
    )


def test_every_axis_has_its_noise(slab: Scene, measured: Measurement) -> None:
    rng = np.random.default_rng(5)
    noisy = with_z(measured, measured.positions[..., 2] + rng.normal(0, 3e-3, measured.positions.shape[:2]))
    sigma = np.broadcast_to([1e-4, 1e-4, 3e-3], noisy.positions.shape)
    stated = replace(noisy, data=noisy.data.assign(sigma=(("frame", "fiducial", "axis"), sigma)))
    data = Data(slab, stated)
    # Of the motion nothing is left: the noise of x and y is three times what is stated, that of z is as stated.
    residual = data.vector(rng.normal(0, [3e-4, 3e-4, 3e-3], noisy.positions.shape))
    found = robust_noise(data, residual)
    assert found is not None
    assert found.axes is not None
    assert found.axes[0] == found.axes[1] == pytest.approx(3, rel=0.1)
    assert found.axes[2] == 1.0
    assert (found.surprising, found.factor) == (True, found.axes[0])
    believed = data.with_noise(found).sigma
    assert {axis: float(believed[data.axis == axis].mean()) for axis in range(3)} == pytest.approx(
        {0: 3e-4, 1: 3e-4, 2: 3e-3}, rel=0.1
    )
    # What never changes tells of no noise.
    held = Data(slab, flat(slab, measured))
    still = robust_noise(held, np.where(held.axis == 2, 0.0, held.values))
    assert still is not None
    assert still.sigma > 1e-5


def test_one_axis_of_a_load_cell_tells_how_stiff_the_body_is(
    slab: Scene, measured: Measurement, tmp_path: Path
) -> None:
    finer = replace(slab, levels=(Level(2, 0.020),))
    made = simulate(finer, {"1", "2"}, measured.actions, noise=3e-4, random_state=3, wrench=True, wrench_noise=0.002)
    made.write(tmp_path / "one")
    lines = (tmp_path / "one" / "wrench.csv").read_text(encoding="utf-8").splitlines()
    assert lines[0] == "action,step,time,fx,fy,fz,tx,ty,tz"
    kept = ["action,step,time,fy", *(",".join(line.split(",")[i] for i in (0, 1, 2, 4)) for line in lines[1:])]
    (tmp_path / "one" / "wrench.csv").write_text("\n".join(kept) + "\n", encoding="utf-8")
    one = Measurement.read(tmp_path / "one")
    assert np.isfinite(one.wrenches).all(axis=0).tolist() == [False, True, False, False, False, False]
    np.testing.assert_allclose(one.wrenches[:, 1], made.wrenches[:, 1])
    data = Data(slab, one, ForceScale.of(slab, one))
    assert ((data.kind > 0).sum(), set(data.axis[data.kind > 0])) == (len(one.wrenches), {1})
    one.write(tmp_path / "again")
    np.testing.assert_array_equal(Measurement.read(tmp_path / "again").wrenches, one.wrenches)
    found = identify(slab, one, options=ON_SECOND)
    assert (found.anchored, found.probability > 0.99) == (("1", "2"), True)
    assert found.stiffness is not None
    young = found.stiffness.constants["young"]
    assert young.stderr is not None
    assert abs(young.value - young.scene) < 2 * young.stderr < 0.2 * young.scene
