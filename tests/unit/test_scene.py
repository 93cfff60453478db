"""The scene file: what it holds, and what is said when it is wrong."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bcid.base.errors import InputError
from bcid.forms.model import Model, check_physics
from bcid.scene import Box, Scene

ROOT = Path(__file__).resolve().parents[2]
GOOD = f"""
format = "bcid-scene/1"
name = "bar"
down = [0, 0, -2]
noise_sigma = "0.3 mm"
[geometry]
file = "{ROOT / "meshes/geo/slab.geo"}"
length_unit = "mm"
[[levels]]
element_size = "50 mm"
degree = 2
[material]
law = "neo_hooke"
young = "15 kPa"
poisson = 0.35
[patches]
"1" = "patch_1"
"2" = {{ box = ["0 0 99.9 mm", "50 10 100.1 mm"] }}
[grasps]
II = {{ on = "grasp_II", centre = "90 5 50 mm" }}
[fiducials]
"1" = "15 10 12.5 mm"
"""


def write(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "scene.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_everything_is_si(tmp_path: Path) -> None:
    scene = Scene.read(write(tmp_path, GOOD), physics=check_physics)
    assert scene.levels[0].element_size == pytest.approx(0.05)
    assert scene.grasps["II"].centre == pytest.approx((0.09, 0.005, 0.05))
    assert scene.down == (0.0, 0.0, -1.0)
    assert scene.fibre_axes == ((1.0, 0.0, 0.0), (0.0, -1.0, 0.0))
    assert replace(scene, fibre_plane=((0.0, 1.0, 0.0), (0.0, 0.0, 1.0))).fibre_axes[1] == (0.0, 0.0, 1.0)
    assert scene.noise_sigma == pytest.approx(0.3e-3)
    assert isinstance(scene.patches["2"].box, Box)
    np.testing.assert_allclose(scene.rest, [[0.015, 0.010, 0.0125]])
    assert Model.of(scene).values == {"young": 15e3, "poisson": 0.35}


def test_what_is_not_known_exactly_has_a_standard_deviation(tmp_path: Path) -> None:
    table = '[uncertainty]\nmarkers = "0.4 mm"\ngrip_turn = "0 deg"\ncamera = 0\ndimensions = 0.03\n'
    stated = Scene.read(write(tmp_path, GOOD + table)).uncertainty
    assert (stated.markers, stated.grip_turn, stated.dimensions) == (pytest.approx(0.4e-3), 0.0, 0.03)
    # Nothing is nothing in any unit.
    assert stated.camera == 0.0
    # What is not said is what is usual for the size of the body, and Poisson's ratio stays below a half.
    assert stated.borders is None
    usual = stated.of(0.1, 0.47)
    assert (usual.markers, usual.borders, usual.poisson) == (stated.markers, pytest.approx(1e-3), pytest.approx(0.01))
    assert Scene.read(write(tmp_path, GOOD)).uncertainty.of(0.1, None).poisson == 0.03
    wrong = '[uncertainty]\nmarkers = 0.4\npoisson = "3 %"\nmarker = "1 mm"\nborders = "-1 mm"\n'
    with pytest.raises(InputError) as caught:
        Scene.read(write(tmp_path, GOOD + wrong))
    for problem in ("uncertainty.markers", "uncertainty.poisson", "did you mean 'markers'", "must be zero or positive"):
        assert problem in str(caught.value)


def test_the_length_of_a_pixel_is_a_factor_near_one(tmp_path: Path) -> None:
    stated = Scene.read(write(tmp_path, GOOD + "[uncertainty]\nscale = 0.02\nscale_of_gripper = true\n"))
    assert (stated.uncertainty.scale, stated.uncertainty.scale_of_gripper) == (0.02, True)
    plain = Scene.read(write(tmp_path, GOOD))
    assert plain.uncertainty.of(0.1).scale == 0.0
    assert stated.fingerprint() != plain.fingerprint()
    # As before there was such a key.
    assert plain.fingerprint() == "3c8b0d97d8f73ea6"
    for lines, said in (
        ("scale = 0.5", "0.5 is no factor near 1; at most 0.3"),
        ('scale = "2 %"', "expected a number"),
        ("scale_of_gripper = 1", "scale_of_gripper: expected true or false, found 1"),
        ("scale = 0\nscale_of_gripper = true", "share no factor"),
    ):
        with pytest.raises(InputError, match=said):
            Scene.read(write(tmp_path, GOOD + f"[uncertainty]\n{lines}\n"))


def test_a_support_is_one_of_the_places(tmp_path: Path) -> None:
    text = GOOD.replace('name = "bar"', 'name = "bar"\nsupport = "floor"') + '[places]\nfloor = "patch_7"\n'
    assert Scene.read(write(tmp_path, text)).support == "floor"
    assert Scene.read(write(tmp_path, GOOD)).support == ""
    with pytest.raises(InputError, match="support: place 'flor' is not defined; did you mean 'floor'"):
        Scene.read(write(tmp_path, text.replace('support = "floor"', 'support = "flor"')))


def test_divided_patches_wait_for_a_mesh(tmp_path: Path) -> None:
    table = '{ on = ["patch_1", "patch_2"], box = ["0 0 0 mm", "9 9 9 mm"], divide = "2 cm" }'
    scene = Scene.read(write(tmp_path, GOOD.replace('"1" = "patch_1"', f'"1" = {table}\n"1a" = "patch_3"')))
    assert scene.divide == {"1": pytest.approx(0.02)}
    assert scene.patches["1"].groups == ("patch_1", "patch_2")
    assert scene.patches["1"].box == Box((0.0, 0.0, 0.0), pytest.approx((0.009, 0.009, 0.009)))  # type: ignore[arg-type]


def test_shipped_scenes_are_valid() -> None:
    for path in sorted((ROOT / "examples/scenes").glob("*.toml")):
        scene = Scene.read(path, physics=check_physics)
        assert scene.patches or scene.held or scene.driven
        assert scene.fiducials


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("bcid-scene/1", "bcid-scene/9", "format: expected"),
        ('name = "bar"', "nam = 3", "nam: unknown key; did you mean 'name'"),
        ("[0, 0, -2]", "[0, 0, 0]", "down: expected three numbers"),
        ("[0, 0, -2]", "[0, 0, nan]", "down: expected three numbers"),
        ("[0, 0, -2]", "[0, 0, -2]\nfibre_plane = [1, 0, 0]", "fibre_plane: expected two directions"),
        ("[0, 0, -2]", "[0, 0, -2]\nfibre_plane = [[1, 0, 0], [0, 0, 0]]", "fibre_plane: expected three numbers"),
        ("[0, 0, -2]", "[0, 0, -2]\nfibre_plane = [[1, 0, 0], [1, 1, 0]]", "fibre_plane: the directions must be"),
        ('"0.3 mm"', '"-0.3 mm"', "noise_sigma: '-0.3 mm' must be positive"),
        ('"0.3 mm"', "0.3", "noise_sigma: 0.3 has no unit"),
        ("slab.geo", "slob.geo", "geometry.file:.*no such file"),
        ('length_unit = "mm"', 'length_unit = "kg"', "geometry.length_unit"),
        ('length_unit = "mm"', "", "geometry.length_unit: is missing"),
        ('element_size = "50 mm"', 'element_size = "0 mm"', "element_size: '0 mm' must be positive"),
        ('element_size = "50 mm"', 'element_size = "-5 mm"', "must be positive"),
        ('element_size = "50 mm"', "", "element_size: is missing"),
        ("degree = 2", "degree = 3", "degree: expected 1 or 2"),
        ("degree = 2", "degree = true", "degree: expected 1 or 2"),
        ("[[levels]]", "[levels]", "levels: expected at least one"),
        ('law = "neo_hooke"', 'law = "neohook"', "did you mean 'neo_hooke'"),
        ('young = "15 kPa"', 'young = "15 mm"', "material.young: unit 'mm' cannot be used"),
        ('young = "15 kPa"', "young = 15", "material.young: 15 has no unit"),
        ('young = "15 kPa"', "", "parameter 'young' is missing"),
        ('young = "15 kPa"', 'young = "-1 kPa"', "young = -1000 Pa is outside"),
        ("poisson = 0.35", "poisson = 0.5", "needs the mixed formulation"),
        ("poisson = 0.35", "poisson = 0.7", "outside the allowed range"),
        ("poisson = 0.35", "poisson = nan", "not a finite number"),
        ("poisson = 0.35", "poisson = true", "expected a number"),
        ("poisson = 0.35", 'poisson = 0.35\nformulation = "mixd"', "did you mean 'mixed'"),
        ("poisson = 0.35", "poisson = 0.35\nviscous = 3.0", "unknown parameter 'viscous'"),
        ('"1" = "patch_1"', '"1" = 7', "patches.1: expected a physical group"),
        ('"1" = "patch_1"', '"a b" = "patch_1"', "must have 1 to 64 characters"),
        ('"50 10 100.1 mm"', '"50 10 mm"', "has 2 number"),
        ('"50 10 100.1 mm"', '"-50 10 100.1 mm"', "first corner must not exceed"),
        (
            '"1" = "patch_1"',
            '"1" = { devide = "5 mm", on = "patch_1" }',
            "patches.1.devide: unknown key; did you mean 'divide'",
        ),
        ('"1" = "patch_1"', '"1" = { divide = "5 mm" }', "scene.toml:17: patches.1: expected a physical group"),
        ('"1" = "patch_1"', '"1" = { on = 5, divide = "5 mm" }', "patches.1.on: expected names of physical groups"),
        ('"1" = "patch_1"', '"1" = { on = "patch_1", divide = 5 }', "scene.toml:17: patches.1.divide: 5 has no unit"),
        ('"1" = "patch_1"', '"1" = { on = "patch_1", divide = "0 mm" }', "patches.1.divide: '0 mm' must be positive"),
        ('"1" = "patch_1"', '"1" = { on = "patch_1", divide = "-5 mm" }', "divide: '-5 mm' must be positive"),
        ('"1" = "patch_1"', '"1" = { on = "patch_1", divide = "5 kg" }', "divide: unit 'kg' cannot be used"),
        (
            '"1" = "patch_1"',
            '"1" = { on = "patch_1", divide = "5 mm" }\n"1.3" = "patch_3"',
            "scene.toml:17: patches.1: patch '1.3' has the name of a piece of it",
        ),
        (
            '"1" = "patch_1"',
            '"1" = { on = { box = 3 }, divide = "5 mm" }',
            "patches.1.on: expected names of physical groups",
        ),
        ('centre = "90 5 50 mm"', 'centre = "90 5 50 mm", divide = "5 mm"', "grasps.II.divide: unknown key"),
        ('centre = "90 5 50 mm"', 'center = "90 5 50 mm"', "grasps.II: expected on"),
        ('"1" = "15 10 12.5 mm"', '"1" = [15, 10, 12.5]', "fiducials.1: .* has no unit"),
        ('[fiducials]\n"1" = "15 10 12.5 mm"', "", "fiducials: none is defined"),
        ("[patches]", "[patch]", "patches: none is defined"),
        (
            'name = "bar"',
            'name = "bar"\nsupport = "floor"',
            "scene.toml:4: support: place 'floor' is not defined; none is",
        ),
        ('name = "bar"', 'name = "bar"\nsupport = 3', "support: expected text, found 3"),
        ('name = "bar"', 'name = "bar"\nsupport = "II"', "support: place 'II' is not defined"),
        ("[fiducials]", '[effects.gravty]\nweight = "1 N/m^3"\n[fiducials]', "did you mean 'gravity'"),
        ("[fiducials]", "[effects.gravity]\nweight = 1.0\n[fiducials]", "has no unit"),
    ],
)
def test_every_mistake_is_named(tmp_path: Path, old: str, new: str, said: str) -> None:
    assert old in GOOD
    with pytest.raises(InputError, match=said) as error:
        Scene.read(write(tmp_path, GOOD.replace(old, new)), physics=check_physics)
    assert "scene.toml" in str(error.value)


def test_all_mistakes_at_once_with_their_lines(tmp_path: Path) -> None:
    text = GOOD.replace('"15 kPa"', "15").replace("degree = 2", "degree = 4").replace("length_unit", "lenght_unit")
    with pytest.raises(InputError) as error:
        Scene.read(write(tmp_path, text.replace('"0.3 mm"', '"3 kg"')))
    said = str(error.value)
    assert all(word in said for word in ("degree", "lenght_unit", "noise_sigma"))
    assert "scene.toml:5: noise_sigma" in said


@pytest.mark.parametrize("text", ["[geometry\n", "a = 1\na = 2\n", "\0", "format = 'x\n"])
def test_broken_toml(tmp_path: Path, text: str) -> None:
    with pytest.raises(InputError, match="not a TOML file"):
        Scene.read(write(tmp_path, text))


def test_missing_file_and_folder(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such scene file"):
        Scene.read(tmp_path / "none.toml")
    with pytest.raises(InputError, match="is a folder"):
        Scene.read(tmp_path)
