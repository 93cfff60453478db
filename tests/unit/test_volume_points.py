"""Digital volume correlation: points inside a body, on a grid or anywhere, in the files that programs write."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from bcid import Measurement
from bcid.base.errors import InputError
from bcid.base.text_file import read_toml
from bcid.measurement.inspection import import_file

Array = NDArray[np.float64]

STEPS, SHAPE = 3, (4, 3, 5)
# Rest positions and displacements, mm, and the quality of each; one point was not correlated in one step.
GRID = np.stack(np.meshgrid(*(np.linspace(2, 20, n) for n in SHAPE), indexing="ij"), axis=-1)
MOVED = 0.01 * np.arange(STEPS)[:, None, None, None, None] * GRID * [1.0, -0.3, 0.2]
QUALITY = np.random.default_rng(0).uniform(0.6, 1.0, (STEPS, *SHAPE))
LOST = 2, 3, 2, 4
MOVED[LOST], QUALITY[LOST] = 0.0, 0.0
POINTS = GRID.reshape(-1, 3)
EXPECTED = (GRID + MOVED).reshape(STEPS, -1, 3) * 1e-3
EXPECTED[LOST[0], np.ravel_multi_index(LOST[1:], SHAPE)] = np.nan


def table(path: Path, columns: Sequence[str], rows: Array) -> None:
    lines = [",".join("" if np.isnan(value) else repr(float(value)) for value in row) for row in rows]
    path.write_text("\n".join([",".join(columns), *lines]) + "\n", encoding="utf-8")


def rows(step: int) -> Array:
    return np.column_stack([POINTS, MOVED[step].reshape(-1, 3), QUALITY[step].ravel()])


NAMES = ["x", "y", "z", "u", "v", "w", "corr"]


def tables(names: Sequence[str]) -> Callable[[Path], str]:
    def write(folder: Path) -> str:
        for step in range(STEPS):
            table(folder / f"dvc_{step}.csv", names, rows(step)[:, : len(names)])
        return "dvc_*.csv"

    return write


def shuffled(folder: Path) -> str:
    """Rows in another order in each file, and those that were not correlated left out."""
    rng = np.random.default_rng(1)
    for step in range(STEPS):
        whole = rows(step)
        table(folder / f"dvc_{step}.csv", NAMES, whole if step == 0 else rng.permutation(whole[whole[:, 6] > 0]))
    return "dvc_*.csv"


def one_table(folder: Path) -> str:
    whole = np.vstack([np.column_stack([np.full(len(POINTS), step), rows(step)]) for step in range(STEPS)])
    table(folder / "dvc.csv", ["step", *NAMES], whole)
    return "dvc.csv"


def fields(step: int | None = None) -> dict[str, Array]:
    """Arrays by name, of one step or with the steps in front."""
    part = slice(None) if step is None else step
    moved = {name: MOVED[part][..., axis] for axis, name in enumerate("uvw")}
    return {name: GRID[..., axis] for axis, name in enumerate("xyz")} | moved | {"zncc": QUALITY[part]}


def mat(folder: Path) -> str:
    from scipy.io import savemat

    savemat(folder / "dvc.mat", fields())
    return "dvc.mat"


def mat_steps_behind(folder: Path) -> str:
    from scipy.io import savemat

    behind = {name: np.moveaxis(array, 0, -1) if array.ndim == 4 else array for name, array in fields().items()}
    savemat(folder / "dvc.mat", behind)
    return "dvc.mat"


def mat_a_step(folder: Path) -> str:
    from scipy.io import savemat

    for step in range(STEPS):
        savemat(folder / f"dvc_{step}.mat", fields(step))
    return "dvc_*.mat"


def npz(folder: Path) -> str:
    moved, quality = MOVED.reshape(STEPS, -1, 3), QUALITY.reshape(STEPS, -1)
    np.savez_compressed(folder / "dvc.npz", points=POINTS, displacements=moved, corr=quality)
    return "dvc.npz"


def npz_a_step(folder: Path) -> str:
    for step in range(STEPS):
        np.savez(folder / f"dvc_{step}.npz", points=GRID, disp=MOVED[step], corr=QUALITY[step])
    return "dvc_*.npz"


def hdf5_planes(folder: Path) -> str:
    """Rest positions as those of the planes of the grid, and a group for each step."""
    import h5py

    with h5py.File(folder / "dvc.h5", "w") as file:
        for axis, name in enumerate("xyz"):
            file[name] = np.linspace(2, 20, SHAPE[axis])
        for step in range(STEPS):
            for name in ("u", "v", "w", "zncc"):
                file[f"step_{step}/{name}"] = fields(step)[name]
    return "dvc.h5"


WRITERS = {
    "a table a step": tables(NAMES),
    "capitals, zncc": tables(["X", "Y", "Z", "U", "V", "W", "zncc"]),
    "disp_x": tables(["x", "y", "z", "disp_x", "disp_y", "disp_z", "quality"]),
    "ux, with units": tables([*(f"{n} [mm]" for n in ("x", "y", "z", "ux", "uy", "uz")), "cc"]),
    "another order, lost rows": shuffled,
    "one table": one_table,
    "MAT": mat,
    "MAT, steps behind": mat_steps_behind,
    "a MAT file a step": mat_a_step,
    "NPZ": npz,
    "an NPZ file a step": npz_a_step,
    "HDF5, planes": hdf5_planes,
}


@pytest.mark.parametrize("write", WRITERS.values(), ids=WRITERS)
def test_points_of_a_volume_are_fiducials_that_were_lost_where_nothing_correlates(
    write: Callable[[Path], str], tmp_path: Path
) -> None:
    found = import_file(tmp_path / write(tmp_path))
    seen = Measurement.read(found.mapping)
    assert seen.cloud is None
    np.testing.assert_allclose(seen.positions, EXPECTED, atol=1e-12)
    assert found.fiducials is not None
    rest = read_toml(found.fiducials)["fiducials"]
    assert list(rest) == seen.fiducial_names
    assert [float(v) for v in rest["7"].split()[:3]] == pytest.approx(POINTS[6])


def test_points_that_are_correlated_badly_are_dropped_by_a_bound(tmp_path: Path) -> None:
    found = import_file(tmp_path / mat(tmp_path))
    text = found.mapping.read_text(encoding="utf-8")
    assert "# least_correlation = 0.5" in text
    found.mapping.write_text(text.replace("# least_correlation = 0.5", "least_correlation = 0.8"), encoding="utf-8")
    lost = ~np.isfinite(Measurement.read(found.mapping).positions[..., 0])
    np.testing.assert_array_equal(lost, QUALITY.reshape(STEPS, -1) < 0.8)


def test_a_quality_that_is_zero_everywhere_is_none(tmp_path: Path) -> None:
    np.savez(tmp_path / "dvc.npz", points=GRID, disp=MOVED, corr=0 * QUALITY)
    found = import_file(tmp_path / "dvc.npz")
    assert "the quality of all points is 0: it is not used" in found.text
    assert np.isfinite(Measurement.read(found.mapping).positions).all()


def test_a_file_that_begins_with_a_load_begins_with_the_state_of_reference(tmp_path: Path) -> None:
    np.savez(tmp_path / "dvc.npz", points=GRID, disp=MOVED[1:], corr=QUALITY[1:])
    found = import_file(tmp_path / "dvc.npz")
    seen = Measurement.read(found.mapping)
    np.testing.assert_allclose(seen.positions, EXPECTED, atol=1e-12)
    assert list(seen.data["time"].values) == [0, 1, 2]
    # Numbers of frames are those of the file.
    text = found.mapping.read_text(encoding="utf-8").replace("# first = 0", "first = 1")
    found.mapping.write_text(text, encoding="utf-8")
    np.testing.assert_allclose(Measurement.read(found.mapping).positions, EXPECTED[[0, 2]], atol=1e-12)


GRASPS = "action,step,time,grasp,x,y,z,qw,qx,qy,qz\n" + "".join(
    f"1,{step},{step},II,{0.2 * step},0,0,1,0,0,0\n" for step in range(STEPS)
)


def with_grasps(folder: Path, grasps: str, more: str = "") -> Measurement:
    np.savez(folder / "dvc.npz", points=GRID, disp=MOVED[1:], corr=QUALITY[1:])
    mapping = import_file(folder / "dvc.npz").mapping
    (folder / "grasps.csv").write_text(grasps, encoding="utf-8")
    text = mapping.read_text(encoding="utf-8").replace("# grasps = ", "grasps = ")
    mapping.write_text(more + text, encoding="utf-8")
    return Measurement.read(mapping)


def test_the_gripper_of_a_field_has_the_poses_of_a_table(tmp_path: Path) -> None:
    (action,) = with_grasps(tmp_path, GRASPS).actions
    assert action.grasp == "II"
    np.testing.assert_allclose(action.translation[:, 0], [0, 0.2e-3, 0.4e-3])
    np.testing.assert_allclose(action.rotation, [[1, 0, 0, 0]] * STEPS)


@pytest.mark.parametrize(
    ("grasps", "more", "said"),
    [
        (GRASPS.rpartition("1,2,")[0], "", "action 1: holds no pose for step 2; steps count the frames that are used"),
        (GRASPS + "1,3,3,II,1,0,0,1,0,0,0\n", "", "a pose for step 3, which the recording has not"),
        (GRASPS.replace("\n1,", "\n2,"), "", "action '2' is not in the recording"),
        (GRASPS, 'grasp = "II"\n', "grasps: is the whole motion of the gripper; leave grasp out"),
    ],
)
def test_poses_of_other_steps_are_refused(tmp_path: Path, grasps: str, more: str, said: str) -> None:
    with pytest.raises(InputError, match=said):
        with_grasps(tmp_path, grasps, more)


def no_w(folder: Path) -> str:
    for step in range(STEPS):
        table(folder / f"dvc_{step}.csv", ["x", "y", "z", "u", "v"], rows(step)[:, :5])
    return "dvc_*.csv"


def no_places(folder: Path) -> str:
    table(folder / "dvc.csv", ["u", "v", "w"], rows(1)[:, 3:6])
    return "dvc.csv"


def other_points(folder: Path) -> str:
    for step in range(STEPS):
        there = rows(step)
        there[:, :3] += 0.5 * step
        table(folder / f"dvc_{step}.csv", NAMES, there)
    return "dvc_*.csv"


def stored(names: Sequence[str], **more: Array) -> Callable[[Path], str]:
    def write(folder: Path) -> str:
        np.savez(folder / "dvc.npz", **{name: array for name, array in fields().items() if name in names}, **more)  # type: ignore[arg-type]
        return "dvc.npz"

    return write


def other_sizes(folder: Path) -> str:
    for step in range(STEPS):
        np.savez(folder / f"dvc_{step}.npz", points=POINTS[: 60 - step], disp=MOVED[step].reshape(-1, 3)[: 60 - step])
    return "dvc_*.npz"


def twice(folder: Path) -> str:
    """Without steps, the points of all steps are one frame."""
    whole = np.vstack([np.column_stack([np.arange(len(POINTS)), rows(step)]) for step in range(STEPS)])
    table(folder / "dvc.csv", ["id", *NAMES], whole)
    return "dvc.csv"


@pytest.mark.parametrize(
    ("write", "said"),
    [
        (no_w, "it has the displacements u and v, but no w"),
        (no_places, "it has the displacements u, v, w, but no positions at rest"),
        (other_points, "only 0 stand where one of those stands at rest"),
        (twice, "holds 120 points twice; a column of steps would tell its frames apart"),
        (stored(["x", "y", "z", "u", "v"]), "displacements u and v, but no w, and its points have a z"),
        (stored(["u", "v", "w"]), r"displacements \(u, v, w\), but no positions at rest"),
        (stored(["u", "v", "w"], x=np.arange(7.0), y=np.arange(3.0), z=np.arange(5.0)), "are not of the same points"),
        (other_sizes, "is 59 x 3, in dvc_0.npz it is 60 x 3; every step needs the same points"),
    ],
)
def test_incomplete_files_are_refused_in_words(write: Callable[[Path], str], said: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=said):
        import_file(tmp_path / write(tmp_path))


def test_python_objects_in_an_archive_are_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / "dvc.npz", points=np.array([{"x": 1}], dtype=object), disp=MOVED)
    with pytest.raises(InputError, match="is not a readable NPZ file"):
        import_file(tmp_path / "dvc.npz")


def test_chosen_points_of_a_large_grid_do_not_lie_in_one_plane(tmp_path: Path) -> None:
    """Every hundredth of 50 x 50 x 20 points, the last counting first, would have one z."""
    grid = np.stack(np.meshgrid(np.arange(50.0), np.arange(50.0), np.arange(20.0), indexing="ij"), axis=-1)
    np.savez(tmp_path / "dvc.npz", points=grid, disp=np.stack([0 * grid, 0.1 * grid]))
    found = import_file(tmp_path / "dvc.npz")
    rest = Measurement.read(found.mapping).positions[0] * 1e3
    assert 400 < len(rest) <= 500
    assert [len(np.unique(rest[:, axis].round(6))) for axis in range(3)] == [50, 50, 20]
