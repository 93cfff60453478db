"""Every example runs, and its numbers are the ones it promises."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from examples.loading import EXAMPLES, load
from mpi4py import MPI
from numpy.typing import NDArray

from bcid import Measurement, Model, Scene
from bcid.predict.predictor import Predictor
from bcid.scene.uncertainty import Uncertainty
from bcid.search.fitting.fit import fit
from bcid.search.fitting.state import State
from bcid.vision.triangulate import linear, triangulate

Array = NDArray[np.float64]


def test_07_strip(real_data: Callable[[str], Path], tmp_path: Path) -> None:
    """The published points are found again; an incompressible strip is too narrow, and Poisson's ratio is that of its width."""
    example, folder = load("07_strip"), real_data("duodic_rubber")
    found = example.main(folder, tmp_path / "strip")
    table = np.genfromtxt(folder / "uniaxial_points.csv.gz", delimiter=",", names=True)
    published = np.column_stack([table[f"{axis}_mm"] for axis in "XYZ"]).reshape(found.positions.shape)
    # By homogeneous least squares, as there; the table has five digits.
    left, right = (np.column_stack([table[f"{axis}{n}_px"] for axis in "uv"]) - 1 for n in (1, 2))
    rig = example.calibration(folder)
    again = linear(replace(rig, translation=rig.translation * 1e3), left, right).reshape(published.shape)
    error = again - published
    assert np.nanmax(np.abs(error)) < 7e-6
    assert np.sqrt(np.nanmean(error**2)) == pytest.approx(1e-5 / np.sqrt(12), rel=0.05)
    assert np.abs(np.nanmean(error, axis=(0, 1))).max() < 1e-7
    assert np.nanmax(np.abs(found.positions * 1e3 - published)) < 2e-3
    measured, rubber, fitted = found.width
    assert found.stretch == pytest.approx(1.2615, abs=1e-3)
    assert rubber == pytest.approx(found.stretch**-0.5, abs=1e-3)
    assert 0.013 < measured - rubber < 0.018
    assert abs(fitted - measured) < 0.006
    # Young's modulus does not matter, so the logarithms of the two measured stretches tell Poisson's ratio.
    assert found.fitted.values["poisson"] == pytest.approx(-np.log(measured) / np.log(found.stretch), abs=0.015)
    assert Measurement.read(tmp_path / "strip").positions.shape == found.measurement.positions.shape


def test_07_steps_of_a_stage_are_measured(real_data: Callable[[str], Path]) -> None:
    """A speckled cylinder at 15 places, 0.2 mm apart. Published: 1.3 ± 1.1 µm for 3475 points, of which every fourth is here."""
    folder = real_data("duodic_rubber")
    table = np.genfromtxt(folder / "rbm_points.csv.gz", delimiter=",", names=True)
    left, right = (np.column_stack([table[f"{axis}{n}_px"] for axis in "uv"]) - 1 for n in (1, 2))
    places = triangulate(load("07_strip").calibration(folder), left, right).positions
    states, points = (table[name].astype(int) for name in ("state", "point"))
    everywhere = np.flatnonzero(np.bincount(points) == states.max() + 1)
    assert len(everywhere) == 869
    kept = np.isin(points, everywhere)
    order = np.lexsort((points[kept], states[kept]))
    track = places[kept][order].reshape(states.max() + 1, len(everywhere), 3)
    stage = np.unique(table["stage_mm"]) * 1e-3
    error = np.abs(np.linalg.norm(track - track[0], axis=2) - stage[:, None])[1:]
    assert error.mean() == pytest.approx(1.72e-6, abs=0.02e-6)
    assert error.std() == pytest.approx(1.10e-6, abs=0.02e-6)


def test_make_inlay(tmp_path: Path) -> None:
    made = load("make_inlay").main(tmp_path / "made")
    shipped = Measurement.read(EXAMPLES / "measurements/inlay-4")
    assert np.nanmax(np.abs(made.positions - shipped.positions)) < 1e-9
    assert np.isnan(shipped.positions[..., 2]).all()


def test_make_cut(tmp_path: Path) -> None:
    made = load("make_cut").main(tmp_path / "made")
    shipped = Measurement.read(EXAMPLES / "measurements/cut-5")
    assert np.abs(made.positions - shipped.positions).max() < 1e-9


def test_make_foam(tmp_path: Path) -> None:
    made = load("make_foam").main(tmp_path / "made")
    shipped = Measurement.read(EXAMPLES / "measurements/foam")
    assert np.abs(made.positions - shipped.positions).max() < 1e-9


def test_03_beams_stiffness_is_in_its_interval_with_the_usual_uncertainties() -> None:
    example = load("03_beam")
    weighing = replace(Scene.read(EXAMPLES / "scenes/beam.toml"), uncertainty=Uncertainty())
    measurement, _ = example.states_of_rest(replace(weighing, effects={}))
    predictor = Predictor(weighing, measurement, MPI.COMM_SELF)
    found = fit(State.of(predictor, Model.of(weighing), example.CLAMPED), ("young",))
    predictor.destroy()
    assert abs(found.values["young"] - 263_824) < 1.96 * found.stderr["young"] < 80e3


def test_03_beam(capsys: pytest.CaptureFixture[str]) -> None:
    example = load("03_beam")
    found = example.main()
    assert not found.verdict.adequate
    assert found.plain.rms == pytest.approx(3.97e-3, rel=0.02)
    assert found.rivals[0].effect == "gravity"
    assert found.ranking.rows[0].effect == "gravity"
    # With so few numbers a camera that has moved would do as well, but it predicts a load case worse from the other.
    assert found.ranking.rows[0].confounded_with == ("camera_offset",)
    held_out = {rival.effect: rival.held_out for rival in found.rivals[:2]}
    assert held_out["gravity"] == pytest.approx(0.48e-3, rel=0.05)
    assert held_out["camera_offset"] > 1.2 * held_out["gravity"]
    # 1070 kg/m^3 times 9.80709 m/s^2, and the stiffness that was published.
    assert found.weight.values["gravity.weight"] == pytest.approx(10493.59, rel=0.02)
    assert found.young.values["young"] == pytest.approx(263824, rel=0.02)
    assert found.weight.state.rms < 0.5e-3
    assert found.young.state.rms < 0.5e-3
    # The clamp is as good as rigid: nothing of its compliance is seen.
    assert found.clamp.stderr["soft_anchor.stiffness"] > found.clamp.values["soft_anchor.stiffness"]
    assert found.repeatability == pytest.approx(0.236e-3, rel=0.01)
    assert not found.strict.adequate
    assert found.stand.term.label == "marker_stand(tip1)"
    # The scene says 6 mm, from the published places of the markers.
    assert found.stood.values["marker_stand(tip1).height"] == pytest.approx(6e-3, abs=1.5e-3)
    assert found.stood.state.rms < 1.1 * found.repeatability
    assert "weight fitted" in capsys.readouterr().out


def test_the_beams_quoted_deflections_are_those_of_the_recordings(real_data: Callable[[str], Path]) -> None:
    folder = real_data("clamped_beam_dragonskin10")
    for name, runs in load("03_beam").RUNS.items():
        for letter, quoted in zip("ab", runs, strict=True):
            table = np.genfromtxt(folder / f"{name}_V2_{letter}.csv", delimiter=",", names=True)
            path = np.column_stack([table[f"tip{i}_{axis}_mm"] for i in (1, 2, 3) for axis in "xyz"])
            time = table["t_s"]
            moved = path[time > time[-1] - 0.5].mean(axis=0) - path[np.abs(time).argmin()]
            assert moved.reshape(3, 3) == pytest.approx(np.array(quoted), abs=0.01)


def test_04_tension(capsys: pytest.CaptureFixture[str]) -> None:
    found = load("04_tension").main()
    # A shear modulus of 17.2 kPa and 2.6 % are published for the whole curve to a stretch of 3.
    assert found.plain.values["young"] / 3 == pytest.approx(17.2e3, rel=0.02)
    rows = {row.effect: row for row in found.ranking.rows}
    # One even pull cannot tell them apart.
    alike = {"strain_stiffening", "fibres", "swelling", "obstacle"}
    assert {row.effect for row in found.ranking.rows[:4]} == alike
    assert set(rows["strain_stiffening"].confounded_with) == alike - {"strain_stiffening"}
    assert rows["strain_stiffening"].p_value < 1e-20
    assert found.stiffening.state.rms < 0.35 * found.plain.state.rms
    plain, stiffening, yeoh = found.errors
    assert plain == pytest.approx(0.0247, abs=0.001)
    assert stiffening == pytest.approx(0.0077, abs=0.0007)
    assert yeoh < stiffening
    assert "with strain_stiffening" in capsys.readouterr().out
    # A shear modulus of 15.2 kPa is that of the curve up to a stretch of 1.5.
    young, error = found.young
    assert young / 3 == pytest.approx(15.2e3, rel=0.02)
    assert 0 < error < 0.05 * young


def test_the_bars_quoted_points_are_on_the_published_curve(real_data: Callable[[str], Path]) -> None:
    example = load("04_tension")
    file = real_data("soft_robotics_materials_db") / "Ecoflex 00-30.csv"
    lines = file.read_text(encoding="latin-1").splitlines()
    first = 1 + next(i for i, line in enumerate(lines) if line.startswith("Time"))
    rows = [tuple(map(float, line.split(";")[3:5])) for line in lines[first:] if line.strip("; ")]
    curve = [(strain, 1e3 * stress) for strain, stress in rows]
    for strain, stress in example.CURVE:
        assert min(abs(s - strain) + abs(p - stress) for s, p in curve) < 1e-6
    whole = [point for point in curve if point[0] < 2.0]
    assert len(whole) > 50
    plain, stiffening, _ = example.main(whole).errors
    assert plain == pytest.approx(0.0256, abs=0.003)
    assert stiffening < 0.5 * plain


def test_the_force_tells_how_stiff_a_body_is() -> None:
    example = load("08_forces")
    value, error = example.main()
    assert value == pytest.approx(example.TRUE, rel=0.1)
    assert abs(value - example.TRUE) < 2.5 * error


def test_every_example_has_a_test_and_can_be_loaded() -> None:
    tested = "".join(path.read_text(encoding="utf-8") for path in Path(__file__).parents[1].glob("*/test_*examples.py"))
    for path in EXAMPLES.glob("[0-9]*.py"):
        assert f'load("{path.stem}")' in tested
        assert callable(load(path.stem).main)
