"""Parts of the body with a known outline: how stiff they are, on meshes that are not fitted to them."""

from __future__ import annotations

import importlib.util
import math
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from mpi4py import MPI

from bcid import Scene
from bcid.base.errors import InputError
from bcid.base.options import ExplainOptions
from bcid.forms.effects import effect
from bcid.forms.mesh import level_mesh
from bcid.forms.mesh.body_mesh import BodyMesh, volumes
from bcid.forms.mesh.shares import share
from bcid.forms.model import Model, Term, check_physics
from bcid.inference.nuisances import Nuisances
from bcid.measurement import Measurement
from bcid.predict.predictor import Predictor
from bcid.scene.parts import BodyRegion, Box, Level, Polygon, Sphere
from bcid.search.answer.explanation import Explanation
from bcid.search.explain import explain

RATIO = "region_stiffness(inlay).ratio"
RIVALS = ("region_stiffness", "inclusion", "strain_stiffening")
# An L, in m.
CORNERS = tuple((x / 1e3, y / 1e3, 0.0) for x, y in ((0, 0), (40, 0), (40, 20), (20, 20), (20, 40), (0, 40)))
CAP = math.pi * (4 * 100 - 2 * 8 / 3)


@pytest.fixture(scope="module")
def sheet(project: Path) -> Scene:
    return Scene.read(project / "examples" / "scenes" / "inlay.toml", physics=check_physics)


@pytest.fixture(scope="module")
def maker(project: Path) -> ModuleType:
    """The script that makes the shipped measurement."""
    spec = importlib.util.spec_from_file_location("make_inlay", project / "examples" / "make_inlay.py")
    assert spec is not None
    assert spec.loader is not None
    found = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(found)
    return found


@pytest.fixture(scope="module")
def mesh(sheet: Scene) -> BodyMesh:
    """The sheet on a fine mesh."""
    return level_mesh(sheet, Level(1, 0.003))


@pytest.fixture(scope="module")
def stiff(maker: ModuleType) -> Measurement:
    """Of an inlay four times as stiff as the sheet."""
    found: Measurement = maker.simulated(4.0)
    return found


def explained(scene: Scene, measured: Measurement) -> Explanation:
    predictor = Predictor(scene, measured, MPI.COMM_SELF)
    found = explain(predictor, ExplainOptions(only=RIVALS))
    predictor.destroy()
    return found


@pytest.mark.parametrize("ratio", [1.0, 0.5, 8.0])
def test_stiffness_of_an_inlay_is_found_on_a_mesh_that_is_not_fitted_to_it(
    sheet: Scene, maker: ModuleType, ratio: float
) -> None:
    found = explained(sheet, maker.simulated(ratio))
    if ratio == 1.0:
        assert found.verdict == "none"
        return
    assert found.verdict == "region_stiffness"
    value, error = found.last.fitted.values[RATIO], found.last.fitted.stderr[RATIO]
    assert abs(value - ratio) < 2 * error < 0.15 * ratio


def test_without_its_region_the_inlay_is_something_else_or_known(sheet: Scene, stiff: Measurement) -> None:
    assert "region_stiffness" not in explained(replace(sheet, regions={}), stiff).verdict
    known = replace(sheet, regions={"inlay": replace(sheet.regions["inlay"], ratio=4.0)})
    assert Model.of(known).constants()[RATIO] == 4.0
    assert explained(known, stiff).verdict == "none"


def test_borders_of_a_region_are_as_uncertain_as_those_of_patches(sheet: Scene, stiff: Measurement) -> None:
    exact = replace(sheet, uncertainty=replace(sheet.uncertainty, borders=0.0))
    wide, narrow = (explained(scene, stiff).last.fitted.stderr[RATIO] for scene in (sheet, exact))
    assert wide > 1.2 * narrow


@pytest.mark.parametrize(
    ("region", "volume"),
    [
        (BodyRegion(box=Box((0.01, 0.01, -1.0), (0.03, 0.02, 1.0))), 20 * 10 * 4),
        (BodyRegion(sphere=Sphere((0.04, 0.02, 0.002), 0.01)), CAP),
        (BodyRegion(outline=Polygon(CORNERS, (0, 0, 1))), 1200 * 4),
        (BodyRegion(outline=Polygon(CORNERS, (0, 0, -1))), 1200 * 4),
        (BodyRegion(box=Box((0.0, 0.0, 0.0), (0.02, 0.04, 0.004)), sphere=Sphere((0.0, 0.02, 0.002), 0.01)), CAP / 2),
    ],
)
def test_shares_add_up_to_the_volume_of_a_shape(mesh: BodyMesh, region: BodyRegion, volume: float) -> None:
    found = share(mesh, region, "part")
    assert float(found @ volumes(mesh.points, mesh.cells)) * 1e9 == pytest.approx(volume, rel=0.01)


def test_physical_volumes_are_parts_of_the_mesh_and_stay_so_when_it_is_refined(sheet: Scene) -> None:
    fitted = replace(sheet, parameters={"fitted": 1.0}, regions={})
    mesh = level_mesh(fitted, Level(1, 0.004))
    sizes = []
    for one in (mesh, mesh.refined()):
        found = share(one, BodyRegion(volumes=("inlay",)), "inlay")
        assert set(found.tolist()) == {0.0, 1.0}
        sizes.append(float(found @ volumes(one.points, one.cells)) * 1e9)
    assert sizes[0] == pytest.approx(math.pi * 12 * 8 * 4, rel=0.05)
    assert sizes[1] == pytest.approx(sizes[0])
    assert mesh.parts.keys() == {"body", "inlay"}


@pytest.mark.parametrize(
    ("region", "words"),
    [
        (BodyRegion(volumes=("scar",)), "no physical volume 'scar'; did you mean|it has|body"),
        (BodyRegion(sphere=Sphere((1.0, 0.0, 0.0), 0.01)), "holds nothing of the body"),
        (BodyRegion(box=Box((-1.0, -1.0, -1.0), (1.0, 1.0, 1.0))), "holds the whole body"),
    ],
)
def test_regions_that_choose_nothing_are_refused(sheet: Scene, region: BodyRegion, words: str) -> None:
    with pytest.raises(InputError, match=words):
        level_mesh(replace(sheet, regions={"scar": region}), sheet.levels[0])


@pytest.mark.parametrize(
    ("written", "words"),
    [
        ('scar = "volume"', "regions.scar: expected a table with volume, box, sphere, outline and/or label"),
        ('scar = { outline = ["0 0 0 mm", "1 0 0 mm"], along = [0, 0, 1] }', "expected three corners or more"),
        ('scar = { outline = ["0 0 0 mm", "9 0 0 mm", "9 9 0 mm"] }', "regions.scar.along: is missing"),
        ('scar = { volume = "scar", along = [0, 0, 1] }', "belongs to an outline"),
        ('scar = { volume = "scar", ratio = -2 }', "regions.scar.ratio"),
        ('scar = { volume = "scar", ratio = 900 }', "ratio = 900 is outside the allowed range"),
        ('scar = { volume = "scar", young = "3 kPa" }', "unknown key"),
    ],
)
def test_wrong_regions_are_refused_in_words(project: Path, tmp_path: Path, written: str, words: str) -> None:
    text = (project / "examples" / "scenes" / "inlay.toml").read_text(encoding="utf-8")
    before, _, after = text.partition("[regions.inlay]")
    geometry = project / "meshes" / "geo" / "sheet.geo"
    rest = after[after.index("[fiducials]") :]
    text = f"{before}[regions]\n{written}\n\n{rest}".replace("../../meshes/geo/sheet.geo", str(geometry))
    (tmp_path / "scene.toml").write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=words.replace("(", r"\(")):
        Scene.read(tmp_path / "scene.toml", physics=check_physics)


def test_nothing_is_lost_between_two_regions(mesh: BodyMesh) -> None:
    left = share(mesh, BodyRegion(box=Box((-1.0, -1.0, -1.0), (0.033, 1.0, 1.0))), "left")
    right = share(mesh, BodyRegion(box=Box((0.033, -1.0, -1.0), (1.0, 1.0, 1.0))), "right")
    np.testing.assert_allclose(left + right, 1.0)


def test_an_effect_that_changes_the_stiffness_elsewhere_has_no_borders(sheet: Scene, mesh: BodyMesh) -> None:
    own = replace(effect("region_stiffness"), name="own", places=lambda _scene, _anchors: ["jaw"])
    model, nuisances = Model.of(sheet), Nuisances(sheet, mesh)
    count = len(nuisances.wanted(model, ()).probes)
    assert len(nuisances.wanted(model + Term(own, {"ratio": 2.0}, place="jaw"), ()).probes) == count
    assert len(nuisances.wanted(model + Term("region_stiffness", {"ratio": 2.0}, place="inlay"), ()).probes) > count
