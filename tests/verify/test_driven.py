"""Places that measured points drive: a block that is cut out of a larger body, and a clamp that is not rigid."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from bcid import Measurement, Scene
from bcid.app.cli import main
from bcid.base.errors import InputError
from bcid.exploration.moves import limits_of
from bcid.forms.model import Model, Term, check_physics
from bcid.forms.simulate import simulate
from bcid.measurement import Action
from bcid.predict.predictor import Predictor
from bcid.scene.parts import Driven, Level, Limits
from bcid.search.answer.source import fitting
from bcid.search.fitting.fit import Fit, fit
from bcid.search.fitting.state import State

BALL = "region_stiffness(ball)"
COUNT, STIFF = 5, 40e3

BAR = """format = "bcid-scene/1"
name = "bar"
noise_sigma = "0.01 mm"

[geometry]
file = "{geometry}"
length_unit = "mm"
parameters = {{ x1 = 60, y1 = 12, z1 = 8 }}

[[levels]]
element_size = "8 mm"
degree = 2

[[levels]]
element_size = "5 mm"
degree = 2

[material]
law = "neo_hooke"
young = "30 kPa"
poisson = 0.4

[uncertainty]
markers = 0
dimensions = 0
borders = 0
camera = 0
force_gain = 0
force_bias = 0
force_drift = 0
grip = 0
grip_turn = 0

[held]
foot = {{ plane = {{ point = "0 0 0 mm", normal = [1, 0, 0] }} }}

[grasps]
jaw = {{ on = {{ plane = {{ point = "60 0 0 mm", normal = [1, 0, 0] }} }}, centre = "60 6 4 mm" }}

{driven}
[fiducials]
"""


def bar(folder: Path, project: Path, driven: str = "") -> Scene:
    """A bar between a foot and a jaw, with markers along it and on the face that the jaw holds."""
    places = [(x, y, 8) for x in (10, 20, 30, 40, 50) for y in (2, 6, 10)]
    places += [(60, y, z) for y in (0, 4, 8, 12) for z in (0, 4, 8)]
    lines = [f'm{i} = "{x} {y} {z} mm"' for i, (x, y, z) in enumerate(places)]
    folder.mkdir()
    path = folder / "bar.toml"
    text = BAR.format(geometry=project / "meshes" / "geo" / "block.geo", driven=driven)
    path.write_text(text + "\n".join(lines), encoding="utf-8")
    return Scene.read(path, physics=check_physics)


def stretched(scene: Scene, by: float = 0.006) -> list[Action]:
    """The jaw moves along the bar."""
    steps = np.arange(COUNT)
    way = np.linspace(0, by, COUNT)[:, None] * [1.0, 0.0, 0.0]
    return [Action("1", steps, steps, "jaw", way, np.tile([1.0, 0.0, 0.0, 0.0], (COUNT, 1)))]


@pytest.fixture(scope="module")
def soft_clamp(tmp_path_factory: pytest.TempPathFactory, project: Path) -> Measurement:
    """The bar of 40 kPa in a clamp that gives, with the force on it; on a finer mesh."""
    scene = bar(tmp_path_factory.mktemp("soft") / "bar", project)
    true = replace(scene, levels=(Level(2, 0.0035),))
    model = Model.of(true).with_values({"young": STIFF}) + Term("grasp_compliance", {"stiffness": 4e6})
    return simulate(
        true, (), stretched(true), noise=0.01e-3, random_state=1, model=model, wrench=True, wrench_noise=1e-3
    )


def stiffness(scene: Scene, measured: Measurement) -> Fit:
    fitted, seen = fitting(scene, measured, MPI.COMM_SELF)
    predictor = Predictor(fitted, seen, MPI.COMM_SELF, level=0)
    found = fit(State.of(predictor, Model.of(fitted), frozenset()), ("young",))
    predictor.destroy()
    return found


def test_a_clamp_that_gives_moves_as_the_markers_on_it(tmp_path: Path, project: Path, soft_clamp: Measurement) -> None:
    """Its own way is further than that of what it holds: the stiffness from that is too low, and known too well."""
    rigid = stiffness(bar(tmp_path / "rigid", project), soft_clamp)
    driven = stiffness(bar(tmp_path / "driven", project, '[driven]\njaw = { near = "0.5 mm" }\n'), soft_clamp)
    assert rigid.values["young"] < 0.9 * STIFF
    assert driven.values["young"] == pytest.approx(STIFF, abs=2 * driven.stderr["young"])
    assert driven.stderr["young"] < 0.05 * STIFF
    assert driven.state.rms < 0.015e-3 < rigid.state.rms


@pytest.fixture(scope="module")
def cut(project: Path) -> Scene:
    return Scene.read(project / "examples" / "scenes" / "cut.toml", physics=check_physics)


@pytest.fixture(scope="module")
def volume(project: Path) -> Measurement:
    return Measurement.read(project / "examples" / "measurements" / "cut-5")


def test_errors_of_the_points_are_in_the_covariance(cut: Scene, volume: Measurement) -> None:
    """Points that drive with ten times the noise of those inside: residuals of the true model are as large as is expected."""
    driving = fitting(cut, volume, MPI.COMM_SELF)[0].driven["surface"].markers
    rng, data = np.random.default_rng(7), volume.data.copy(deep=True)
    chosen = {"fiducial": [volume.fiducial_names.index(name) for name in driving]}
    data["position"][chosen] += rng.normal(0, 0.1e-3, data["position"][chosen].shape)
    data["sigma"] = data["position"].copy(data=np.full(data["position"].shape, 0.01e-3))
    data["sigma"][chosen] = 0.1e-3
    scene, seen = fitting(
        replace(cut, levels=(Level(2, 0.006), Level(2, 0.0045))), replace(volume, data=data), MPI.COMM_SELF
    )
    predictor = Predictor(scene, seen, MPI.COMM_SELF, level=0)
    model = Model.of(scene) + Term("region_stiffness", {"ratio": 5.0}, place="ball")
    state = State.of(predictor, model, frozenset())
    sizes = [np.mean(errors.whiten(state.residual) ** 2) for errors in (state.errors, state.errors.without(["driven"]))]
    predictor.destroy()
    assert sizes[0] == pytest.approx(1.0, abs=0.1)
    assert sizes[1] > 2


def test_a_gap_is_filled_from_the_points_beside_it(cut: Scene, volume: Measurement) -> None:
    whole = fitting(cut, volume, MPI.COMM_SELF)[1].actions[0].boundary["surface"]
    data = volume.data.copy(deep=True)
    data["position"][{"frame": 3, "fiducial": 0}] = np.nan
    found = fitting(cut, replace(volume, data=data), MPI.COMM_SELF)[1].actions[0].boundary["surface"]
    assert np.isfinite(found).all()
    assert np.abs(found - whole).max() < 0.1e-3


@pytest.mark.parametrize(
    ("driven", "text"),
    [
        ('surface = { plane = { point = "20 0 0 mm", normal = [1, 0, 0] } }', "what drives it"),
        ('surface = { near = "1 mm" }', "a place on the boundary"),
        ('surface = { plane = { point = "20 0 0 mm", normal = [1, 0, 0] }, markers = ["p0", "p1"] }', "3 different"),
        (
            'surface = { plane = { point = "20 0 0 mm", normal = [1, 0, 0] }, markers = ["p0", "p1", "q"] }',
            "'q' is not",
        ),
        ('surface = { plane = { point = "20 0 0 mm", normal = [1, 0, 0] }, near = "1 mm", along = "normal" }', "axes"),
        ('surface = { plane = { point = "20 0 0 mm", normal = [1, 0, 0] }, near = "1" }', "unit"),
        ('surface = { plane = { point = "20 0 0 mm", normal = [1, 0, 0] }, near = "1 um" }', "9 fiducials|needed"),
        ('surface = { plane = { point = "20 0 0 mm", normal = [1, 0, 0] }, near = "1 mm", by = 3 }', "by"),
    ],
)
def test_an_incomplete_description_is_refused(
    cut: Scene, tmp_path: Path, driven: str, text: str, capsys: pytest.CaptureFixture[str]
) -> None:
    written = Path(cut.source).read_text(encoding="utf-8")
    line = next(line for line in written.splitlines() if line.startswith("surface = "))
    path = tmp_path / "cut.toml"
    geometry = Path(cut.source).parent / "../../meshes/geo/block.geo"
    changed = written.replace(line, driven).replace("../../meshes/geo/block.geo", str(geometry))
    # The nearest points are on the surface: they are taken away to leave too few.
    changed = changed if "um" not in driven else re.sub(r'^(p\d+ = ")20 ', r"\g<1>20.1 ", changed, flags=re.MULTILINE)
    path.write_text(changed, encoding="utf-8")
    assert main(["scene", "check", str(path)]) == 2
    said = capsys.readouterr()
    assert any(part in said.err for part in text.split("|"))
    assert "Traceback" not in said.err


def test_what_was_not_measured_drives_nothing(cut: Scene, volume: Measurement) -> None:
    flat = volume.data.copy(deep=True)
    flat["position"][{"axis": 2}] = np.nan
    with pytest.raises(InputError, match=r'z of its points was not measured; write along = \["x", "y"\]'):
        fitting(cut, replace(volume, data=flat), MPI.COMM_SELF)
    gone = volume.data.copy(deep=True)
    gone["position"][{"frame": 2}] = np.nan
    with pytest.raises(InputError, match="in step 2 of action 1 0 of its 266 points are seen along x"):
        fitting(cut, replace(volume, data=gone), MPI.COMM_SELF)
    every = replace(cut, driven={"surface": Driven(near=1.0)})
    with pytest.raises(InputError, match="none is left to compare the model with"):
        fitting(every, volume, MPI.COMM_SELF)


def test_nothing_is_made_up_where_there_is_no_measurement(cut: Scene) -> None:
    steps = np.arange(2)
    still = Action("1", steps, steps, "", np.zeros((2, 3)), np.tile([1.0, 0.0, 0.0, 0.0], (2, 1)))
    with pytest.raises(InputError, match=r"driven\.surface moves as measured points do, which cannot be simulated"):
        simulate(cut, (), [still])
    with pytest.raises(InputError, match="cannot be explored"):
        limits_of(replace(cut, limits=Limits(0.01)))


def test_a_place_may_be_driven_along_some_axes_only(cut: Scene, volume: Measurement) -> None:
    """Along the others it is free: the sides of a block that is stretched by its ends draw in."""
    flat = volume.data.copy(deep=True)
    flat["position"][{"axis": 2}] = np.nan
    scene = replace(cut, driven={"surface": replace(cut.driven["surface"], along=(0, 1))}, places=cut.places)
    scene, seen = fitting(scene, replace(volume, data=flat), MPI.COMM_SELF)
    predictor = Predictor(scene, seen, MPI.COMM_SELF, level=0)
    held = replace(predictor.scene, held={}).driven["surface"]
    found = predictor.forward(Model.of(scene)).equilibrium.supports
    assert held.along == (0, 1)
    assert 0 < len(found.prescribed) < found.body.unknowns
    assert len(found.prescribed) % 2 == 0
    predictor.destroy()


def test_of_very_many_points_means_of_neighbours_drive(cut: Scene, volume: Measurement) -> None:
    """A field that is as dense as one likes costs no more, and leads the place the same way."""
    copies = 3
    names = [f"{name}.{k}" for name in volume.fiducial_names for k in range(copies)]
    rng = np.random.default_rng(3)
    shifts = rng.uniform(-0.3e-3, 0.3e-3, (len(names), 3))
    rest = np.repeat(cut.rest, copies, axis=0) + shifts
    data = volume.data.isel(fiducial=np.repeat(np.arange(len(cut.rest)), copies)).assign_coords(fiducial=names)
    data["position"] = data["position"] + shifts
    dense = replace(
        cut, fiducials={n: (float(x), float(y), float(z)) for n, (x, y, z) in zip(names, rest, strict=True)}
    )
    scene, seen = fitting(dense, replace(volume, data=data), MPI.COMM_SELF)
    driven = scene.driven["surface"]
    assert len(driven.markers) > 700
    assert len(driven.points) <= 512
    whole, usual = fitting(cut, volume, MPI.COMM_SELF)
    ends = [
        one.kriging.weights(cut.rest[:40]) @ measured.actions[0].boundary["surface"][-1]
        for one, measured in ((driven, seen), (whole.driven["surface"], usual))
    ]
    assert np.abs(ends[0] - ends[1]).max() < 0.1e-3 < np.abs(ends[1]).max()
