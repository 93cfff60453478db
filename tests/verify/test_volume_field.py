"""Volume correlation from the file to the anchors: points inside of a slab, simulated by elements of another degree and size."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from bcid import IdentifyOptions, Measurement, Scene, identify
from bcid.base.errors import InputError
from bcid.forms.model import check_physics
from bcid.forms.simulate import simulate
from bcid.measurement import Action
from bcid.measurement.folder_writer import grasp_lines
from bcid.measurement.inspection import import_file
from bcid.scene import Level

Array = NDArray[np.float64]

ANCHORS, STEPS, NOISE = frozenset("34"), 5, 0.1e-3
# Of the positions so many were not correlated; what a file has there is no displacement.
FAILED = 0.05


def grid() -> Array:
    """A regular grid inside of the slab, none of it on its surface, shape (12, 3, 12, 3), m."""
    axes = np.linspace(0.005, 0.085, 12), np.linspace(0.002, 0.008, 3), np.linspace(0.005, 0.095, 12)
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)


@pytest.fixture(scope="module")
def folder(project: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """With the file of a scanner, of the loaded steps alone, and the poses of the stage."""
    made = tmp_path_factory.mktemp("volume")
    slab = Scene.read(project / "examples" / "scenes" / "slab.toml", physics=check_physics)
    points = grid()
    places = {str(k + 1): (float(x), float(y), float(z)) for k, (x, y, z) in enumerate(points.reshape(-1, 3))}
    true = replace(slab, fiducials=places, levels=(Level(3, 0.016),))
    steps, still = np.arange(STEPS), np.tile([1.0, 0.0, 0.0, 0.0], (STEPS, 1))
    pull = Action("1", steps, steps, "II", 2.5e-3 * steps[:, None] * np.array([0.8, 0.0, 0.6]), still)
    seen = simulate(true, ANCHORS, [pull], noise=NOISE)
    moved = (seen.positions - true.rest).reshape(STEPS, *points.shape)[1:]
    rng = np.random.default_rng(4)
    quality = rng.uniform(0.7, 1.0, moved.shape[:-1])
    failed = rng.random(quality.shape) < FAILED
    quality[failed], moved[failed] = 0.0, rng.normal(0.0, 5e-3, (int(failed.sum()), 3))
    fields = {name: 1e3 * moved[..., axis] for axis, name in enumerate("uvw")} | {"zncc": quality}
    np.savez_compressed(made / "scan.npz", **fields, **{n: 1e3 * points[..., k] for k, n in enumerate("xyz")})  # type: ignore[arg-type]
    (made / "grasps.csv").write_text("\n".join(grasp_lines([pull], 1e-3, 1.0)) + "\n", encoding="utf-8")
    return made


@pytest.fixture(scope="module")
def imported(project: Path, folder: Path) -> tuple[Scene, Path]:
    """As a user does it: the mapping with the poses named, and the scene with the table of the points."""
    found = import_file(folder / "scan.npz")
    text = found.mapping.read_text(encoding="utf-8").replace("# grasps = ", "grasps = ")
    found.mapping.write_text(text, encoding="utf-8")
    assert found.fiducials is not None
    scene = (project / "examples" / "scenes" / "slab.toml").read_text(encoding="utf-8")
    scene = scene.replace("../../meshes", str(project / "meshes")).replace('"0.3 mm"', f'"{1e3 * NOISE} mm"')
    scene = re.sub(r"(?ms)^\[fiducials\].*", "", scene) + found.fiducials.read_text(encoding="utf-8")
    (folder / "scene.toml").write_text(scene, encoding="utf-8")
    return Scene.read(folder / "scene.toml", physics=check_physics), found.mapping


def test_points_inside_of_a_body_tell_its_anchors(imported: tuple[Scene, Path]) -> None:
    scene, mapping = imported
    seen = Measurement.read(mapping)
    assert seen.cloud is None
    assert len(seen.fiducial_names) == 432
    assert np.isfinite(seen.positions[0]).all()
    lost = ~np.isfinite(seen.positions[1:, :, 0])
    assert 0.5 * FAILED < lost.mean() < 2 * FAILED
    found = identify(scene, seen)
    assert set(found.anchored) == ANCHORS
    assert found.probability > 0.99
    assert found.discrepancy_probability is not None
    assert found.discrepancy_probability < 0.1
    assert found.noise_rms is not None
    assert found.rms < 1.2 * found.noise_rms


def test_points_that_were_not_correlated_spoil_the_answer_where_they_are_believed(imported: tuple[Scene, Path]) -> None:
    scene, mapping = imported
    believed = mapping.with_name("believed.toml")
    text = mapping.read_text(encoding="utf-8")
    assert 'quality = "zncc"' in text
    believed.write_text(text.replace('quality = "zncc"', ""), encoding="utf-8")
    found = identify(scene, Measurement.read(believed), options=IdentifyOptions(exhaustive="no", level=1))
    assert found.rms > 5 * NOISE
    assert found.probability < 0.5


def test_the_state_of_reference_is_missed_where_it_is_not_named(imported: tuple[Scene, Path]) -> None:
    _, mapping = imported
    loaded = mapping.with_name("loaded.toml")
    text = mapping.read_text(encoding="utf-8")
    loaded.write_text(text.replace('rest = "reference"', ""), encoding="utf-8")
    with pytest.raises(InputError, match="a pose for step 4, which the recording has not"):
        Measurement.read(loaded)
