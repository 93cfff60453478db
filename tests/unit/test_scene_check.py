"""`bcid scene check`: the table, the warnings, the picture, and what is said of a wrong scene."""

import dataclasses
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from bcid.app import scene_command
from bcid.app.cli import main
from bcid.base.errors import InputError
from bcid.forms.scene_check import check_scene
from bcid.forms.scene_table import columns, table
from bcid.scene import Scene
from validation.reliability.scanned import box, save, scene_of, scene_text

ROOT = Path(__file__).resolve().parents[2]
SLAB = ROOT / "examples/scenes/slab.toml"


def test_the_slab_in_a_table(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["scene", "check", str(SLAB)]) == 0
    said = capsys.readouterr().out
    assert "slab: slab.geo, volume 100 cm^3, boundary 240 cm^2, from (0, 0, 0) to (100, 10, 100) mm" in said
    assert [line.split()[0] for line in said.splitlines() if line.startswith("level ")] == ["level"] * 5
    lines = {line.split("  ")[0]: line.split() for line in said.splitlines()}
    assert lines["level 0 (elements of 50 mm)"][-3:] == ["27", "36", "342"]
    assert lines["bottom"][1:4] == ["13", "100", "cm^2"]
    assert lines["16"] == ["16", "(75,", "10,", "87.5)", "on", "it"]
    # The grasps of the coarsest mesh are narrower than those of the others.
    assert (
        "grasp I, grasp II, grasp III: the area on finer levels is not that on level 0 (up to 5 times as large)" in said
    )


def test_a_wrong_scene_is_told_as_a_whole(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = SLAB.read_text(encoding="utf-8").replace("../../meshes", str(ROOT / "meshes"))
    wrong = text.replace('"1" = "patch_1"', '"1" = "patch_x"').replace('young = "15 kPa"', 'young = "15 mm"')
    (tmp_path / "wrong.toml").write_text(wrong, encoding="utf-8")
    assert main(["scene", "check", str(tmp_path / "wrong.toml"), "-o", str(tmp_path / "p.png")]) == 2
    said = capsys.readouterr()
    assert "young" in said.err
    assert said.out == ""
    (tmp_path / "wrong.toml").write_text(wrong.replace('young = "15 mm"', 'young = "15 kPa"'), encoding="utf-8")
    assert main(["scene", "check", str(tmp_path / "wrong.toml"), "-o", str(tmp_path / "p.png")]) == 2
    assert "no physical group 'patch_x'; did you mean" in capsys.readouterr().err
    assert [file.name for file in tmp_path.iterdir()] == ["wrong.toml"]


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (["scene"], "check"),
        (["scene", "chek", "a.toml"], "chek"),
        (["scene", "check", "none.toml"], "no such scene file"),
        (["scene", "check", str(SLAB), "-o", "picture.pdf"], "the picture is a PNG file; name it picture.png"),
    ],
)
def test_what_is_asked_wrongly(
    arguments: list[str], word: str, capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    try:
        code = main(arguments)
    except SystemExit as end:
        code = int(end.code or 0)
    assert code == 2
    assert word in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def scanned(folder: Path, **more: object) -> Scene:
    patches = 'a = { normal = [0, 0, -1], within = "5 deg", box = ["-1 -1 -1 mm", "30 99 99 mm"] }\n'
    patches += 'b = { normal = [0, 0, -1], within = "5 deg" }'
    return scene_of(
        save(folder / "b.ply", *box(cells=6)),
        **{
            "sizes": (10, 5),
            "patches": patches,
            "grasps": 'I = { on = { normal = [1, 0, 0], within = "5 deg" }, centre = "60 20 10 mm" }',
            "fiducials": 'top = "30 20 20 mm"\nover = "10 10 20.9 mm"\ndeep = "40 20 14 mm"\nlow = "40 20 0 mm"',
            **more,
        },
    )


def test_distances_areas_and_what_looks_odd(tmp_path: Path) -> None:
    found = check_scene(scanned(tmp_path))
    away = {marker.name: marker.distance * 1e3 for marker in found.markers}
    assert away == pytest.approx({"top": 0, "over": 0.9, "deep": -6, "low": 0}, abs=1e-6)
    assert [marker.patch for marker in found.markers] == ["", "", "", "b"]
    areas = {place.name: place.area * 1e6 for place in found.places}
    assert areas["b"] == pytest.approx(2400)
    assert areas["I"] == pytest.approx(800)
    assert [rung.meshed for rung in found.rungs] == [True, True]
    said = "\n".join(found.warnings)
    assert "patches a and b share" in said
    assert "fiducials over are off the body" in said
    assert "fiducial low is on patch b" in said
    assert "0.9 mm outside" in table(found)
    assert "6 mm inside" in table(found)


def test_fine_levels_are_not_meshed_and_their_numbers_are_near(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = scanned(tmp_path, sizes=(10, 4))
    made = check_scene(scene).rungs[1]
    monkeypatch.setattr("bcid.forms.scene_check._MESHED", 500)
    guessed = check_scene(scene).rungs[1]
    assert made.meshed
    assert not guessed.meshed
    for name in ("nodes", "cells", "unknowns"):
        assert getattr(guessed, name) == pytest.approx(getattr(made, name), rel=0.3)
    assert "about" in table(check_scene(scene))


def test_levels_that_get_coarser_are_noted(tmp_path: Path) -> None:
    assert "level 1 has no more unknowns than level 0" in " ".join(
        check_scene(scanned(tmp_path, sizes=(8, 12))).warnings
    )


def test_fiducials_off_the_body_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="fiducial a at 0 0 90 mm lies 70 mm outside the body"):
        check_scene(scanned(tmp_path, fiducials='a = "0 0 90 mm"'))


def test_what_was_mended_is_said(tmp_path: Path) -> None:
    points, triangles = box(cells=6)
    path = save(tmp_path / "b.ply", points, np.vstack([triangles[1:], triangles[1:4]]))
    scene = scene_of(path, fiducials='a = "10 10 20 mm"')
    said = table(check_scene(scene))
    assert "note: 3 triangles that stood there twice were left out" in said
    assert "note: 1 hole(s) were closed" in said


def test_the_picture_shows_patches_grasps_and_fiducials(tmp_path: Path) -> None:
    """Every place has its colour somewhere in it, and there is something in both halves."""
    from matplotlib.colors import to_rgb
    from matplotlib.image import imread

    scene = scanned(tmp_path)
    only = dataclasses.replace(scene, patches={"b": scene.patches["b"]})
    scene_command._draw(check_scene(only), tmp_path / "p.png")
    image = imread(tmp_path / "p.png")[:, :, :3]
    assert image.shape[1] > 1800
    for colour in ("#0072b2", "#e69f00"):
        # Lit from different sides: the hue counts.
        near = (
            np.abs(image / image.max(axis=2, keepdims=True).clip(1e-3) - np.array(to_rgb(colour)) / max(to_rgb(colour)))
            < 0.08
        )
        assert near.all(axis=2).sum() > 3000
    assert (image[:, : image.shape[1] // 2] < 0.9).any()
    assert (image[:, image.shape[1] // 2 :] < 0.9).any()
    assert [file.name for file in tmp_path.glob("*.png")] == ["p.png"]


def test_without_pyvista_the_table_is_printed(tmp_path: Path) -> None:
    scanned(tmp_path, sizes=(15,))
    code = "import sys; sys.modules['pyvista'] = None; from bcid.app.cli import main; sys.exit(main(sys.argv[1:]))"
    command = [sys.executable, "-c", code, "scene", "check", "scene.toml", "-o", "p.png"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 3
    assert "volume 48 cm^3" in done.stdout
    assert "pyvista is not installed: pip install 'bcid[report]'" in done.stderr
    assert not (tmp_path / "p.png").exists()


def test_two_ranks_say_it_once(tmp_path: Path) -> None:
    """PETSc begins on all ranks or none, and rank 0 prints."""
    scanned(tmp_path, sizes=(15,))
    command = ["mpirun", "-n", "2", sys.executable, "-m", "bcid", "scene", "check", "scene.toml"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=280, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("volume 48 cm^3") == 1


def test_columns_are_as_wide_as_need_be() -> None:
    assert columns(("a", "bbb"), [("long", "1"), ("x", "")]) == ["a     bbb", "long  1", "x"]


def test_a_scanned_body_is_simulated_and_identified(tmp_path: Path) -> None:
    """From a painted surface to the patch that holds it, through the commands."""
    points, triangles = box(cells=6)
    painted = (points[:, 0] < 1).astype(np.int32)
    path = save(tmp_path / "block.ply", points, triangles, attachment=painted)
    text = scene_text(
        path.name,
        sizes=(15,),
        patches='back = { painted = "attachment", value = 1 }\nunder = { normal = [0, 0, -1], within = "30 deg" }',
        grasps='I = { on = { normal = [1, 0, 0], within = "30 deg" }, centre = "60 20 10 mm" }',
        fiducials="\n".join(
            f'm{i} = "{x} {y} 20 mm"' for i, (x, y) in enumerate((x, y) for x in (15, 30, 45) for y in (8, 32))
        ),
    )
    (tmp_path / "scene.toml").write_text(text, encoding="utf-8")
    scene, made, run = (str(tmp_path / name) for name in ("scene.toml", "made", "run"))
    pull = ["--motion", "pull", "--amplitude", "4 mm", "--steps", "2", "--noise", "0.05 mm", "--quiet"]
    for arguments in (
        ["simulate", scene, "--anchors", "back", *pull, "-o", made],
        ["identify", scene, made, "--no-picture", "--quiet", "-o", run],
    ):
        done = subprocess.run([sys.executable, "-m", "bcid", *arguments], capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
    assert "back" in (tmp_path / "run/summary.txt").read_text(encoding="utf-8").splitlines()[0]
    import json

    assert json.loads((tmp_path / "run/identification.json").read_text(encoding="utf-8"))["anchored"] == ["back"]
