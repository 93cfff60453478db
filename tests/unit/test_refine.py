"""Refinement: the names of parts, which cuts stay, what is split, and truths that only a part of a patch explains."""

import json
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import xarray as xr

from bcid.base.errors import InputError
from bcid.base.options import IdentifyOptions
from bcid.base.progress import Silent
from bcid.base.run_folder import sealed
from bcid.forms.mesh.patches import halves
from bcid.forms.simulate import simulate
from bcid.measurement import Measurement
from bcid.scene import Level, Region, Scene
from bcid.scene.motions import about_x, actions
from bcid.search.answer.refine import (
    Refinement,
    Tree,
    _Rounds,
    anchors,
    expanded,
    identify_refined,
    is_part,
    resolved,
    significant_splits,
)
from bcid.search.hill_climbing import Candidate
from bcid.search.identify import identify

ROOT = Path(__file__).resolve().parents[2]
SLAB = Scene.read(ROOT / "examples/scenes/slab.toml")
FEW = replace(SLAB, patches={name: SLAB.patches[name] for name in "2378"})
# Five steps that pull and lift.
MOTION = actions([(np.arange(5)[:, None] * np.array([0.004, 0.001, 0.0]), about_x(np.zeros(5)))], "II")
NOISE = 0.3e-3
OPTIONS = IdentifyOptions(level=1)


def cut(scene: Scene, *names: str) -> Scene:
    for name in names:
        scene = halves(scene, name)
    return scene


@cache
def seen(*anchored: str, cuts: tuple[str, ...] = ()) -> Measurement:
    """What the markers show, made with quadratic elements of 20 mm."""
    scene = replace(cut(FEW, *cuts), levels=(Level(2, 0.020),))
    return simulate(scene, anchored, MOTION, level=0, noise=NOISE, random_state=1)


def refine(measurement: Measurement, rounds: int, scene: Scene = FEW) -> Refinement:
    return identify_refined(scene, measurement, None, OPTIONS, rounds)


def test_names_of_parts() -> None:
    assert is_part("7.1", "7")
    assert is_part("edge.4.2.1", "edge.4")
    assert not any(is_part(name, "7") for name in ("7", "7.3", "71", "17.1", "7.10", "7.1x"))
    assert anchors({"7.1", "7.2"}, "7") is True
    assert anchors({"7"}, "7.2.1") is True
    assert anchors({"7.1", "7.2.1", "7.2.2"}, "7") is True
    assert anchors({"7.1", "7.2.1"}, "7") is None
    assert anchors({"7.1"}, "7.2") is False
    assert anchors({"71", "7.3"}, "7") is False


def test_sets_in_terms_of_other_patches() -> None:
    coarse, fine = ["3", "7"], ["3", "7.1", "7.2.1", "7.2.2"]
    assert expanded({"7"}, fine) == {"7.1", "7.2.1", "7.2.2"}
    assert expanded({"3", "7.1", "7.2.1", "7.2.2"}, coarse) == {"3", "7"}
    assert expanded({"3", "7.1"}, coarse) is None
    assert expanded((), fine) == frozenset()
    assert resolved({"3", "7.1"}, coarse) == [{"3", "7"}, {"3"}]
    assert resolved({"3"}, fine) == [{"3"}]


@pytest.mark.parametrize(
    ("probability", "kept"),
    [
        ({"7.1": 1.0, "7.2": 0.0}, ["7"]),
        ({"7.1": 1.0, "7.2": 1.0}, []),
        ({"7.1": 0.0, "7.2": 0.0}, []),
        ({"7.1": 0.99, "7.2": 0.0}, []),
        ({"7.1": 1.0, "7.2.1": 1.0, "7.2.2": 0.0}, ["7", "7.2"]),
        ({"7.1": 1.0, "7.2.1": 0.0, "7.2.2": 0.0}, ["7"]),
        ({"7.1": 1.0, "7.2.1": 0.5, "7.2.2": 0.0}, ["7"]),
        ({"7.1": 0.5, "7.2.1": 0.5, "7.2.2": 0.5}, []),
    ],
)
def test_cuts_stay_whose_sides_differ(probability: dict[str, float], kept: list[str]) -> None:
    refined = {"7": ("7.1", "7.2")} | ({} if "7.2" in probability else {"7.2": ("7.2.1", "7.2.2")})
    assert significant_splits(refined, probability) == {name: refined[name] for name in kept}


class Searches:
    """Stands in for the search: the same patches are always anchored, the residual is given, and all is decided or not."""

    def __init__(self, anchored: str, rms: float, probability: float = 1.0) -> None:
        self.anchored, self.rms, self.probability = anchored.split(), rms, probability
        self.level, self.mesh_error = 3, 0.0
        self.asked: list[tuple[list[str], list[Candidate]]] = []

    def __call__(self, scene: Scene, options: IdentifyOptions, start: Sequence[Candidate]) -> Any:
        self.asked.append((list(scene.patches), list(start)))
        best = expanded(self.anchored, scene.patches)
        assert best is not None
        return SimpleNamespace(
            anchored=tuple(p for p in scene.patches if p in best),
            patches={p: self.probability if p in best else 1 - self.probability for p in scene.patches},
            rms=self.rms * NOISE,
            noise_rms=NOISE,
            levels=(self.level,),
            discretisation_rms=self.mesh_error * NOISE,
            alternatives=(),
        )

    def run(self, rounds: int, level: int = 3, mesh_error: float = 0.0, scene: Scene = SLAB) -> list[list[str]]:
        """The patches of every search."""
        self.level, self.mesh_error = level, mesh_error
        self.rounds = _Rounds(Tree(scene, None), IdentifyOptions(), Silent(), self, 1000)
        self.rounds.run(rounds)
        return [patches for patches, _ in self.asked]


def test_the_border_is_split_once_when_everything_is_well() -> None:
    """Two rounds are asked for, one is made: nothing is left to ask."""
    searches = Searches("7", 1.0)
    assert searches.run(2) == [
        list(SLAB.patches),
        ["1", "2.1", "2.2", "3.1", "3.2", *"456", "7.1", "7.2", "8.1", "8.2"],
    ]
    whole = {"7.1", "7.2"}
    assert searches.asked[1][1] == [
        whole,
        whole | {"2.1", "2.2"},
        whole | {"3.1", "3.2"},
        set(),
        whole | {"8.1", "8.2"},
    ]
    assert searches.rounds.log[-1] == "round 2: every patch is decided"
    assert searches.rounds.refined == {}
    assert list(searches.rounds.scene.patches) == list(SLAB.patches)


def test_undecided_patches_are_split_wherever_they_are() -> None:
    searches = Searches("1", 1.0, probability=0.97)
    assert len(searches.run(1)[1]) == 16
    assert searches.rounds.log[0].startswith("round 1: undecided: 1 2 3 4 5 6 7 8; split 1 2 3 4 5 6 7 8")
    assert len(Searches("1", 1.0, probability=0.995).run(1)[1]) == 10


def test_what_was_cut_in_vain_is_cut_deeper_together_with_the_others() -> None:
    searches = Searches("1", 2.0)
    _, first, second = searches.run(2)
    assert first == ["1.1", "1.2", "2.1", "2.2", *"345678"]
    assert [p for p in second if p.startswith("1.")] == ["1.1.1", "1.1.2", "1.2.1", "1.2.2"]
    assert [p for p in second if p.startswith("5.")] == ["5.1", "5.2"]
    assert searches.rounds.log[0].startswith("round 1: no set explains the measurement (residual 0.6 mm)")


def test_the_error_of_the_mesh_explains_a_residual() -> None:
    searches = Searches("1", 2.0)
    assert len(searches.run(2, mesh_error=1.8)) == 2
    assert searches.rounds.log[-1] == "round 2: every patch is decided"
    assert len(Searches("1", 2.0).run(2, mesh_error=1.5)) == 3
    assert len(Searches("1", 1.06).run(2)) == 2, "1000 coordinates scatter by so much"
    assert len(Searches("1", 1.08).run(2)) == 3


def test_halves_are_not_smaller_than_the_elements() -> None:
    """Patches of 50 mm on elements of 20 mm are cut once, on elements of 7.2 mm as often as asked."""
    second = Searches("1", 2.0).run(2, level=1)[2]
    assert second == [half for p in SLAB.patches for half in (f"{p}.1", f"{p}.2")]
    searches = Searches("1", 2.0)
    coarse = replace(SLAB, levels=(Level(1, 0.060),))
    searches.level = 0
    searches.rounds = _Rounds(Tree(coarse, None), IdentifyOptions(), Silent(), searches, 1000)
    searches.rounds.found = searches(SLAB, IdentifyOptions(), ())
    assert searches.rounds.split(dict.fromkeys(SLAB.patches, 1)) == {}


@pytest.mark.parametrize(("better", "sure", "kept"), [(True, 1.0, ["7"]), (True, 0.9, []), (False, 1.0, [])])
def test_halves_stay_that_differ_for_sure_and_explain_more(better: bool, sure: float, kept: list[str]) -> None:
    asked: list[list[str]] = []

    def search(scene: Scene, _options: IdentifyOptions, _start: Sequence[Candidate]) -> Any:
        asked.append([p for p in scene.patches if is_part(p, "7")])
        on = "7.1" if "7.1" in scene.patches else "7"
        chance = {p: {on: sure, "7.2": 0.0}.get(p, 0.0) for p in scene.patches}
        rms = (1.0 if better else 2.5) if on == "7.1" else 2.0
        about = {"noise_rms": NOISE, "levels": (3,), "discretisation_rms": None, "alternatives": ()}
        return SimpleNamespace(anchored=(on,), patches=chance, rms=rms * NOISE, **about)

    rounds = _Rounds(Tree(SLAB, None), IdentifyOptions(), Silent(), search, 1000)
    rounds.run(1)
    again = [[]] if sure < 1.0 else []
    # Border patches that were cut as well are merged again.
    assert asked[:2] == [[], ["7.1", "7.2"]]
    assert asked[-1] == (again[0] if again else ["7.1", "7.2"])
    assert list(rounds.refined) == kept
    assert rounds.found.anchored == (("7.1",) if kept else ("7",))


def test_too_many_patches_are_not_made() -> None:
    searches = Searches("1", 2.0)
    assert max(len(patches) for patches in searches.run(5)) == 64


def test_names_that_halves_need_are_refused() -> None:
    scene = replace(SLAB, patches={"a": Region(("patch_1",)), "a.2.1": Region(("patch_2",))})
    with pytest.raises(InputError, match=r"patch 'a\.2\.1' has the name of a part of patch 'a'; rename one"):
        identify_refined(scene, seen("3", "8"), rounds=1)
    with pytest.raises(InputError, match="refine = -1: must be at least 0"):
        refine(seen("3", "8"), -1)


def test_half_of_a_patch_is_found_from_another_mesh() -> None:
    """The truth has quadratic elements, the search linear ones: what remains is the mesh, not the half that is not anchored."""
    measurement = seen("7.1", cuts=("7",))
    coarse = identify(FEW, measurement, None, OPTIONS)
    assert coarse.rms > 2 * NOISE, "no set of whole patches explains it"
    fine = refine(measurement, 1)
    assert fine.found.anchored == ("7.1",)
    assert fine.found.probability > 0.95
    assert fine.found.rms < 1.1 * NOISE
    assert fine.refined == {"7": ("7.1", "7.2")}
    assert list(fine.scene.patches) == ["2", "3", "7.1", "7.2", "8"]
    assert fine.evaluations[1] > fine.found.evaluations[1]


def test_whole_patches_are_left_alone() -> None:
    measurement = seen("3", "8")
    plain, fine = identify(FEW, measurement, None, OPTIONS), refine(measurement, 2)
    assert fine.refined == {}
    assert fine.found.anchored == plain.anchored == ("3", "8")
    assert fine.found.probability == plain.probability
    assert fine.found.patches == plain.patches
    assert len(fine.log) == 3, "one round that kept nothing, and one that found nothing to do"


def test_a_search_with_pieces_starts_where_all_of_them_are_seen() -> None:
    """Sixteen pieces of 12.5 mm on two triangles, then on twenty-six; `identify` divides by itself."""
    scene = replace(FEW, patches={"e": FEW.patches["7"]}, divide={"e": 0.0125})
    measurement = simulate(scene, {"e.4"}, MOTION, level=1, noise=NOISE, random_state=1)
    found = identify(scene, measurement, None, OPTIONS)
    assert "e.4" in found.anchored
    assert list(found.patches) == [f"e.{i}" for i in range(1, 17)]


def test_a_run_folder_holds_the_refined_patches(tmp_path: Path) -> None:
    text = (ROOT / "examples/scenes/slab.toml").read_text(encoding="utf-8").replace("../../", f"{ROOT}/")
    for name in "14568":
        text = text.replace(f'"{name}" = "patch_{name}"\n', "")
    (tmp_path / "scene.toml").write_text(text, encoding="utf-8")
    seen("7.1", cuts=("7",)).write(tmp_path / "made")
    call = [
        "identify",
        "scene.toml",
        "made",
        "-o",
        "run",
        "--level",
        "1",
        "--quiet",
    ]
    command = [sys.executable, "-m", "bcid", *call, "--refine", "1"]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, timeout=280, check=False)
    assert done.returncode == 0, done.stderr
    assert "Anchored patches of slab: {7.1}" in done.stdout
    assert "round 1: kept the halves of 7" in done.stdout
    result = json.loads((tmp_path / "run/identification.json").read_text(encoding="utf-8"))
    assert result["anchored"] == ["7.1"]
    assert result["refined"] == {"7": ["7.1", "7.2"]}
    assert len(result["rounds"]) == 2
    with xr.open_dataset(tmp_path / "run/body.nc") as body:
        names = [str(name) for name in body["place_name"].values]
        assert names[1:5] == ["patch 2", "patch 3", "patch 7.1", "patch 7.2"]
        assert set(range(1, 5)) <= set(body["place"].values.tolist())
    assert (tmp_path / "run/picture.png").stat().st_size > 20_000

    # Killed before it wrote its result: everything that was computed is taken, and the result is the same.
    record = json.loads((tmp_path / "run/run.json").read_text(encoding="utf-8"))
    (tmp_path / "run/run.json").write_text(json.dumps(sealed(record | {"state": "running"})), encoding="utf-8")
    again = subprocess.run(
        [*command, "--no-picture"], capture_output=True, text=True, cwd=tmp_path, timeout=280, check=False
    )
    assert again.returncode == 0, again.stderr
    assert json.loads((tmp_path / "run/identification.json").read_text(encoding="utf-8")) == result
