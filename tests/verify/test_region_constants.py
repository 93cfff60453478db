"""Constants of the law that regions of the body have of their own: stated ones, and a Poisson's ratio that is asked about."""

from __future__ import annotations

import importlib.util
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from mpi4py import MPI
from scipy.optimize import brentq
from verify.problems import box, scene_of, straight

from bcid import Measurement, Scene
from bcid.base.errors import InputError
from bcid.base.options import ExplainOptions
from bcid.forms.forward import Forward
from bcid.forms.model import Model, Term, check_physics
from bcid.forms.solver.equilibrium import Settings
from bcid.predict.predictor import Predictor
from bcid.scene.parts import BodyRegion, Box, Material
from bcid.search.answer.explanation import Explanation
from bcid.search.explain import explain

OWN = "region_compressibility(ball).poisson"
RIVALS = ("region_compressibility", "region_stiffness", "inclusion", "swelling")
YOUNG, POISSON = 15e3, 0.35
# Two layers of one thickness, one above the other.
SIZE, PRESS = 0.02, 0.003
LOWER = BodyRegion(box=Box((-1.0, -1.0, -1.0), (1.0, 1.0, SIZE / 2)))


def layers(formulation: str = "displacement", degree: int = 1, **region: object) -> Scene:
    """A cube of two layers, whose sides slide and whose bottom is held: nothing moves but along z."""
    scene = scene_of((), "z1", (SIZE / 2, SIZE / 2, SIZE), fiducials={"middle": (SIZE / 2, SIZE / 2, SIZE / 2)})
    held = {"x0": (0,), "x1": (0,), "y0": (1,), "y1": (1,), "z0": (2,)}
    lower = {"lower": replace(LOWER, **region)} if region else {}  # type: ignore[arg-type]
    material = Material("neo_hooke", {"young": f"{YOUNG} Pa", "poisson": POISSON}, formulation)
    levels = tuple(replace(level, degree=degree) for level in scene.levels)
    return replace(scene, held=held, regions=lower, material=material, levels=levels)


def interface(scene: Scene, *effects: Term, bricks: int = 4) -> float:
    """How far the interface is pressed down, m, on a mesh with so many bricks along z."""
    model = Model.of(scene)
    for effect in effects:
        model = model + effect
    forward = Forward(scene, 0, None, model, Settings(rtol=1e-11), box((SIZE,) * 3, (2, 2, bricks)))
    found = forward.predict((), [straight((0.0, 0.0, -PRESS), 3, "z1")])
    forward.destroy()
    assert found.complete
    return float(scene.rest[0, 2] - found.positions[-1, 0, 2])


def pressure(stretch: float, young: float, poisson: float) -> float:
    """Nominal stress of uniaxial strain, mu (s - 1/s) + lambda ln(s)/s (Bonet & Wood 2008, section 6.4.3)."""
    shear = young / (2 * (1 + poisson))
    lame = 2 * shear * poisson / (1 - 2 * poisson)
    return float(shear * (stretch - 1 / stretch) + lame * np.log(stretch) / stretch)


def in_series(young: float, poisson: float) -> float:
    """How far the interface is pressed down where both layers bear one stress, m."""
    half = SIZE / 2

    def difference(down: float) -> float:
        lower = pressure(1 - down / half, young, poisson)
        return lower - pressure(1 - (PRESS - down) / half, YOUNG, POISSON)

    return float(brentq(difference, 0.0, PRESS, xtol=1e-14))


@pytest.mark.parametrize(
    ("constants", "young", "poisson"),
    [
        ({"poisson": 0.1}, YOUNG, 0.1),
        ({"poisson": 0.45}, YOUNG, 0.45),
        ({"young": "45 kPa"}, 45e3, POISSON),
        ({"young": "5 kPa", "poisson": 0.48}, 5e3, 0.48),
    ],
)
def test_two_layers_bear_one_stress_as_in_closed_form(
    constants: dict[str, object], young: float, poisson: float
) -> None:
    expected = in_series(young, poisson)
    assert abs(expected - PRESS / 2) > 0.1e-3
    assert interface(layers(constants=constants)) == pytest.approx(expected, rel=1e-9)


def test_its_own_stiffness_is_the_ratio_and_its_own_poisson_the_effect() -> None:
    thrice = interface(layers(ratio=3.0))
    assert interface(layers(constants={"young": f"{3 * YOUNG} Pa"})) == pytest.approx(thrice, rel=1e-9)
    asked = Term("region_compressibility", {"poisson": 0.1}, place="lower")
    expected = in_series(YOUNG, 0.1)
    bare = replace(layers(), regions={"lower": LOWER})
    assert interface(bare, asked) == pytest.approx(expected, rel=1e-9)
    everywhere = Term("compressibility", {"poisson": 0.2})
    before, after = interface(bare, asked, everywhere), interface(bare, everywhere, asked)
    assert before == pytest.approx(after, rel=1e-9)
    assert abs(before - expected) > 0.01 * expected
    with pytest.raises(InputError, match="region 'upper' is not in the scene"):
        interface(bare, Term("region_compressibility", {"poisson": 0.1}, place="upper"))


def test_the_mixed_formulation_has_them_to_first_order() -> None:
    """Its pressure is continuous, and that of the layers is not."""
    expected, mixed = in_series(YOUNG, 0.1), layers("mixed", 2, constants={"poisson": 0.1})
    coarse, fine = (abs(interface(mixed, bricks=count) - expected) for count in (4, 8))
    assert fine < 0.6 * coarse < 0.03 * expected


@pytest.fixture(scope="module")
def gel(project: Path) -> Scene:
    return Scene.read(project / "examples" / "scenes" / "foam.toml", physics=check_physics)


@pytest.fixture(scope="module")
def maker(project: Path) -> ModuleType:
    """The script that makes the shipped measurement, on a mesh that is fitted to the ball."""
    spec = importlib.util.spec_from_file_location("make_foam", project / "examples" / "make_foam.py")
    assert spec is not None
    assert spec.loader is not None
    found = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(found)
    return found


def explained(scene: Scene, measured: Measurement) -> Explanation:
    predictor = Predictor(scene, measured, MPI.COMM_SELF)
    found = explain(predictor, ExplainOptions(only=RIVALS))
    predictor.destroy()
    return found


@pytest.mark.parametrize("poisson", [0.2, 0.45])
def test_poisson_of_a_ball_is_found_on_a_mesh_that_is_not_fitted_to_it(
    gel: Scene, maker: ModuleType, poisson: float
) -> None:
    found = explained(gel, maker.simulated(poisson))
    if poisson == 0.45:
        assert found.verdict == "none"
        return
    assert found.verdict == "region_compressibility"
    value, error = found.last.fitted.values[OWN], found.last.fitted.stderr[OWN]
    assert abs(value - poisson) < 2 * error < 0.03


def test_a_ball_of_foam_that_is_known_leaves_nothing_missing(gel: Scene, maker: ModuleType) -> None:
    seen = maker.simulated(0.2)
    known = replace(gel, regions={"ball": replace(gel.regions["ball"], constants={"poisson": 0.2})})
    assert known.fingerprint() != gel.fingerprint()
    assert explained(known, seen).verdict == "none"
    unknown = explained(replace(gel, regions={}), seen).verdict
    assert unknown not in ("none", "region_compressibility")


def test_a_region_without_constants_keeps_its_fingerprint(project: Path) -> None:
    """Runs of earlier versions are still of this scene."""
    assert Scene.read(project / "examples" / "scenes" / "inlay.toml").fingerprint() == "92bc19c846f8a767"


@pytest.mark.parametrize(
    ("written", "words"),
    [
        ("constants = 3", "regions.ball.constants: expected a table"),
        ("constants = {}", "regions.ball.constants: names none"),
        ("constants = { c01 = 3 }", "regions.ball.constants: .*unknown parameter 'c01'; known: young, poisson"),
        ("constants = { young = 3 }", "regions.ball.constants.young: "),
        ("constants = { poisson = true }", "regions.ball.constants.poisson: expected a number"),
        ("constants = { poisson = 0.6 }", "poisson = 0.6 is outside the allowed range"),
        ("constants = { poisson = 0.5 }", "needs the mixed formulation"),
        ('ratio = 2\nconstants = { young = "3 kPa" }', "regions.ball.constants.young: there is a ratio as well"),
        ("poisson = 0.2", "regions.ball.poisson: unknown key"),
    ],
)
def test_wrong_constants_are_refused_in_words(gel: Scene, tmp_path: Path, written: str, words: str) -> None:
    with pytest.raises(InputError, match=words):
        Scene.read(changed(gel, tmp_path, written), physics=check_physics)


def test_what_a_region_and_an_effect_state_both_is_refused(gel: Scene, tmp_path: Path) -> None:
    path = changed(gel, tmp_path, "constants = { poisson = 0.2 }")
    effect = '\n[effects.region_compressibility]\nplace = "ball"\npoisson = 0.3\n'
    path.write_text(path.read_text(encoding="utf-8") + effect, encoding="utf-8")
    with pytest.raises(InputError, match=r"effects\.region_compressibility says it as well; state it once"):
        Scene.read(path, physics=check_physics)


def test_a_stiffness_may_be_asked_about_beside_a_poisson_that_is_known(gel: Scene, tmp_path: Path) -> None:
    scene = Scene.read(changed(gel, tmp_path, "ratio = 2\nconstants = { poisson = 0.2 }"), physics=check_physics)
    model = Model.of(scene)
    assert model.region_constants == {"ball": {"poisson": 0.2}}
    assert model.constants()["region_stiffness(ball).ratio"] == 2.0


def changed(scene: Scene, folder: Path, written: str) -> Path:
    """The scene's file with more lines in the entry of its region."""
    text = Path(scene.source).read_text(encoding="utf-8").replace("../../meshes/geo/block.geo", str(scene.geometry))
    path = folder / "scene.toml"
    path.write_text(text.replace("[regions.ball]", f"[regions.ball]\n{written}"), encoding="utf-8")
    return path
