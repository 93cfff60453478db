"""Points of a surface in place of markers: planes through them, marks, what of them is compared, and what is found with them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import bcid
from bcid.base.errors import InputError
from bcid.base.options import IdentifyOptions
from bcid.forms import effects
from bcid.forms.forward import Forward
from bcid.forms.mesh import level_mesh
from bcid.forms.model import Model, Term, check_physics
from bcid.forms.probes import Probe, SensitivityRequest
from bcid.forms.sensitivity import Sensitivity
from bcid.forms.simulate import simulate, simulated_cloud
from bcid.forms.solver.equilibrium import Settings
from bcid.inference.data import Data
from bcid.inference.misfit import Misfit
from bcid.measurement import Action, Measurement
from bcid.measurement.contents import Cloud, motions_dataset
from bcid.measurement.frame_error import FrameError
from bcid.measurement.plane_fits import Pieces, fit_planes
from bcid.scene import Level, Scene, motions
from bcid.search.answer.association import Association

NOISE = 0.3e-3
HELD = ["3", "4"]


@pytest.fixture(scope="module")
def slab(project: Path) -> Scene:
    """The slab without markers, on two coarse levels."""
    scene = Scene.read(project / "examples" / "scenes" / "slab.toml", physics=check_physics)
    return replace(scene, levels=(Level(2, 0.05), Level(2, 0.014)), fiducials={})


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(5)


# -- planes


def pieces(rng: np.random.Generator, count: int, points: int, hidden: int) -> tuple[Pieces, np.ndarray]:
    """Tilted planes with a tenth of points that are of something else; the last few are of nothing else."""
    truth = np.column_stack([rng.normal(0, 2e-3, count), rng.normal(0, 0.1, (count, 2))])
    number = np.repeat(np.arange(count), points)
    across = rng.uniform(-5e-3, 5e-3, (len(number), 2))
    heights = truth[number, 0] + np.sum(truth[number, 1:] * across, axis=1) + rng.normal(0, NOISE, len(number))
    other = (rng.random(len(number)) < 0.1) | (number >= count - hidden)
    heights[other] = rng.uniform(-0.02, 0.02, other.sum())
    unstated, usual = np.full(len(number), np.nan), np.full(count, float(points))
    return Pieces(number, heights, across, unstated, np.full(count, 2e-3), usual), truth


def test_planes_are_those_of_the_surface_and_their_errors_what_they_state(rng: np.random.Generator) -> None:
    given, truth = pieces(rng, 400, 10, 100)
    found = fit_planes(given)
    seen = np.isfinite(found.offset)
    assert seen[300:].mean() < 0.02, "planes of chance"
    assert seen[:300].mean() > 0.97
    assert found.noise == pytest.approx(NOISE, rel=0.05)
    missed = (found.offset - truth[:, 0])[seen] / found.sigma[seen]
    assert np.sqrt(np.mean(missed**2)) == pytest.approx(1.0, abs=0.15)
    assert np.abs(missed).max() < 5


def test_a_stated_noise_weighs_points_and_is_not_undercut(rng: np.random.Generator) -> None:
    given, truth = pieces(rng, 100, 12, 0)
    stated = np.where(rng.random(len(given.heights)) < 0.5, NOISE, 10 * NOISE)
    found = fit_planes(
        replace(given, stated=stated, heights=given.heights + rng.normal(0, np.sqrt(stated**2 - NOISE**2)))
    )
    seen = np.isfinite(found.offset)
    missed = (found.offset - truth[:, 0])[seen] / found.sigma[seen]
    assert np.sqrt(np.mean(missed**2)) == pytest.approx(1.0, abs=0.2)
    careful = fit_planes(replace(given, stated=np.full(len(given.heights), 3 * NOISE)))
    assert np.nanmedian(careful.sigma) > 2.5 * np.nanmedian(fit_planes(given).sigma)


# -- what is compared


@pytest.fixture(scope="module")
def along(slab: Scene) -> tuple[Scene, Measurement, Callable[[np.ndarray], np.ndarray]]:
    """A marker and three marks, one of them out of sight in one frame; and what is to be seen of values (frames, rows, 3)."""
    places = {"1": (0.02, 0.01, 0.03), **{f"surface {k}": (0.02 + 0.015 * k, 0.01, 0.04) for k in (1, 2, 3)}}
    scene = replace(slab, levels=slab.levels[:1], fiducials=places, surface=("surface 1", "surface 2", "surface 3"))
    made = simulate(scene, HELD, motions.motion("pull", "II", 1, 0.01, 2), noise=NOISE, level=0)
    count = len(made.positions)
    normals = np.full((count, 4, 3), np.nan)
    normals[:, 1:] = Rotation.random(3 * count, random_state=1).as_matrix()[:, 0].reshape(count, 3, 3)
    data = made.data.assign(normal=(("frame", "fiducial", "axis"), normals))
    data["position"][1, 2] = np.nan
    used = [(f, r) for f in range(count) for r in range(4) if (f, r) != (1, 2)]

    def shown(values: np.ndarray) -> np.ndarray:
        parts = [
            values[f, r] if r == 0 else np.einsum("a,a...->...", normals[f, r], values[f, r])[None] for f, r in used
        ]
        return np.concatenate(parts)

    return scene, replace(made, data=data), shown


def test_data_and_misfit_take_one_component_of_a_mark(along: tuple) -> None:
    scene, measurement, shown = along
    data = Data(scene, measurement)
    assert data.values == pytest.approx(shown(np.nan_to_num(measurement.positions)))
    assert data.along.sum() == len(data) - 3 * len(measurement.positions)
    other = np.random.default_rng(2).normal(size=measurement.positions.shape)
    assert data.vector(other) == pytest.approx(shown(other))
    assert data.vector(data.spread(data.values)[..., None] * np.ones(2)).shape == (len(data), 2)
    residual = shown(other - np.nan_to_num(measurement.positions))
    misfit = Misfit(scene, measurement)
    chi2 = sum(misfit.frame(k, frame)[0] for k, frame in enumerate(other))
    assert chi2 == pytest.approx(residual @ residual / NOISE**2)
    assert misfit.distance(other, np.zeros_like(other)) == pytest.approx(np.sqrt(np.mean(shown(other) ** 2)))


def test_the_turn_of_a_camera_moves_values_as_its_modes_say(along: tuple) -> None:
    """Against what the turned points show."""
    scene, measurement, shown = along
    data = Data(scene, measurement)
    centre, size = np.array([0.05, 0.0, 0.05]), 1e-5
    modes = FrameError(centre, np.diag([1.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0])).modes(data.points)
    moved = data.moved(modes)
    for axis in range(3):
        turn = Rotation.from_rotvec(size * np.eye(3)[axis]).as_matrix()
        change = shown((data.points - centre) @ turn.T + centre - data.points) / size
        assert min(np.abs(moved - s * change[:, None]).max(axis=0).min() for s in (1, -1)) < 1e-4


def test_sensitivities_along_normals_agree_with_differences(along: tuple) -> None:
    scene, measurement, shown = along
    gravity = effects.effect("gravity")
    weight = 5.0

    def positions(amount: float) -> np.ndarray:
        model = Model.of(scene) + Term(gravity, {"weight": amount})
        forward = Forward(scene, 0, model=model, settings=Settings(rtol=1e-11))
        try:
            return forward.predict(HELD, measurement.actions).positions
        finally:
            forward.destroy()

    forward = Forward(scene, 0, settings=Settings(rtol=1e-11))
    prediction = forward.predict(HELD, measurement.actions, keep=True)
    sensitivity = Sensitivity(forward)
    wanted = SensitivityRequest((Probe(Term(gravity, {"weight": 0.0}), ("weight",)),))
    found = sensitivity.of(HELD, measurement.actions, prediction, wanted)
    by_tangent = Data(scene, measurement).vector(found.probes[0]["weight"])
    sensitivity.destroy()
    forward.destroy()
    at = [positions(amount) for amount in (0.0, weight, 2 * weight)]
    differences = shown(-3 * at[0] + 4 * at[1] - at[2]) / (2 * weight)
    assert by_tangent == pytest.approx(differences, rel=1e-3, abs=1e-3 * np.abs(differences).max())


# -- clouds


def looking_down(
    scene: Scene, pulls: list[Action], count: int, rng: np.random.Generator
) -> tuple[Measurement, np.ndarray]:
    """What a camera above sees of a slab of cubic elements on another mesh, and where the surface is (frames, nodes, 3).

    A tenth of the points is up to 20 mm off, in every other frame a third is out of sight, and a hand lies over the grip.
    """
    true = replace(scene, levels=(Level(3, 0.014),))
    mesh = level_mesh(true, true.levels[0])
    forward = Forward(true, 0, settings=Settings(rtol=1e-6), mesh=mesh)
    prediction = forward.detail(HELD, pulls, forward.predict(HELD, pulls, keep=True))
    forward.destroy()
    assert prediction.displacement is not None
    top = mesh.boundary[(mesh.points[mesh.boundary][:, :, 1] > 0.0099).all(axis=1)]
    times = [float(step) for pull in pulls for step in pull.steps]
    none = np.zeros((len(times), 0, 3))
    made = Measurement(motions_dataset(pulls, times, [], none), source="a camera")
    cloud = simulated_cloud(made, mesh, top, prediction.displacement, count, NOISE, rng)
    points, frame = cloud.points.copy(), cloud.frame
    hand = (points[:, 0] > 0.08) & (np.abs(points[:, 2] - 0.05) < 0.012)
    points[hand, 1] += rng.uniform(0.008, 0.02, hand.sum())
    off = rng.random(len(points)) < 0.1
    points[off] += rng.uniform(-0.02, 0.02, (off.sum(), 3))
    kept = (points[:, 0] > 0.033) | (frame % 2 == 0)
    return replace(made, cloud=replace(cloud, points=points[kept], sigma=cloud.sigma[kept], frame=frame[kept])), top


@pytest.fixture(scope="module")
def filmed(slab: Scene) -> Measurement:
    pulls = motions.motion("complex", "II", 1, 0.015, 8)
    return looking_down(slab, pulls, 500, np.random.default_rng(3))[0]


def test_marks_lie_where_the_cloud_at_rest_is(slab: Scene, filmed: Measurement) -> None:
    marks = Association(slab, filmed).marks
    assert 20 < len(marks.middle) < 60
    assert marks.rest[:, 1] == pytest.approx(0.01)
    assert not ((marks.rest[:, 0] > 0.085) & (np.abs(marks.rest[:, 2] - 0.05) < 0.008)).any(), "below the hand"


def test_a_body_without_markers_is_identified(slab: Scene, filmed: Measurement) -> None:
    found = bcid.identify(slab, filmed, options=IdentifyOptions())
    assert found.anchored == tuple(HELD)
    assert found.probability > 0.99
    assert "Surface: " in found.summary
    assert " 0 fiducials" in found.summary


def test_that_points_are_lost_once_the_body_moves_is_said(slab: Scene, filmed: Measurement) -> None:
    """Of frames in which a plate lies far above what the gripper can move."""
    association, cloud = Association(slab, filmed), filmed.cloud
    assert cloud is not None
    known = association.scene, Model.of(slab), HELD
    assert association.about(*known).remarks == ()
    lifted = cloud.points + np.where(cloud.frame[:, None] > 0, [0.0, 0.05, 0.0], 0.0)
    lost = replace(filmed, cloud=replace(cloud, points=lifted))
    association.measurement = lost
    assert "only < 0.01 % do when the body moves" in association.about(*known).remarks[0]
    association.destroy()


def test_a_model_is_compared_with_what_a_surface_shows(slab: Scene, filmed: Measurement) -> None:
    found = bcid.compare(slab, filmed, HELD, level=1)
    assert found.adequate
    assert set(found.residual_by["axis"]) == {"normal"}
    assert {name.split()[0] for name in found.residual_by["fiducial"]} == {"surface"}


@pytest.mark.parametrize(("factor", "shift"), [(1e3, 0.0), (1.0, 0.06)])
def test_points_of_something_else_are_refused_in_words(
    slab: Scene, filmed: Measurement, factor: float, shift: float
) -> None:
    assert filmed.cloud is not None
    wrong = replace(filmed, cloud=replace(filmed.cloud, points=factor * filmed.cloud.points + [0.0, shift, 0.0]))
    with pytest.raises(InputError, match=r"from that of the body.*check length_unit"):
        Association(slab, wrong)


def test_too_few_points_and_what_covers_the_body_are_refused_in_words(slab: Scene, filmed: Measurement) -> None:
    cloud = filmed.cloud
    assert cloud is not None
    few = np.arange(len(cloud.points)) % 15 == 0
    thin = replace(cloud, points=cloud.points[few], sigma=cloud.sigma[few], frame=cloud.frame[few])
    with pytest.raises(InputError, match="at least 40 in each are needed"):
        Association(slab, replace(filmed, cloud=thin))
    sheet = replace(cloud, points=cloud.points * [1.0, 0.0, 1.0] + [0.0, 0.03, 0.0])
    with pytest.raises(InputError, match="no part of the surface is recognised"):
        Association(slab, replace(filmed, cloud=sheet))


def test_a_cloud_is_written_and_read_again(filmed: Measurement, tmp_path: Path) -> None:
    assert filmed.cloud is not None
    with_sigma = replace(filmed, cloud=replace(filmed.cloud, sigma=np.full(len(filmed.cloud.points), 1e-4)))
    with_sigma.write(tmp_path / "folder")
    assert not (tmp_path / "folder" / "fiducials.csv").exists()
    with_sigma.to_netcdf(tmp_path / "file.nc")
    for read in (Measurement.read(tmp_path / "folder"), Measurement.read(tmp_path / "file.nc")):
        assert read.cloud is not None
        assert read.cloud.points == pytest.approx(filmed.cloud.points, abs=1e-12)
        assert read.cloud.sigma == pytest.approx(1e-4)
        assert (read.cloud.numbers(read.data) == filmed.cloud.numbers(filmed.data)).all()
        assert read.fiducial_names == []
    changed = replace(filmed, cloud=replace(filmed.cloud, points=filmed.cloud.points + 1e-6))
    assert changed.fingerprint() != filmed.fingerprint()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("action,step,time,x,y\na,0,0,1,2\n", "column z is missing"),
        ("action,step,time,x,y,z\n", "holds no point"),
        ("action,step,time,x,y,z\na,0,0,1,2,none\n", "z: expected a finite number, found 'none'"),
        ("action,step,time,x,y,z,sigma\na,0,0,1,2,3,-1\n", "sigma: expected a positive number"),
        ("action,step,time,x,y,z\na,0,0,1,2\n", "has 5 values"),
        ("action,step,time,x,y,z\na,1,0,1,2,3\na,0,1,1,2,3\n", "stands after step 1"),
    ],
)
def test_a_table_of_points_that_is_wrong_is_refused(text: str, message: str, tmp_path: Path) -> None:
    units = 'format = "bcid-measurement/1"\nlength_unit = "mm"\ntime_unit = "s"\nforce_unit = "N"\n'
    (tmp_path / "measurement.toml").write_text(units)
    (tmp_path / "grasps.csv").write_text("action,step,time,grasp,x,y,z,qw,qx,qy,qz\n")
    (tmp_path / "surface.csv").write_text(text)
    with pytest.raises(InputError, match=message):
        Measurement.read(tmp_path)


def test_points_of_frames_that_are_not_compared_do_not_count(filmed: Measurement) -> None:
    cloud = filmed.cloud
    assert isinstance(cloud, Cloud)
    numbers = cloud.numbers(filmed.data.isel(frame=[0, 2]))
    assert (numbers[cloud.frame == 2] == 1).all()
    assert (numbers[(cloud.frame != 0) & (cloud.frame != 2)] == -1).all()
