"""Proposals: files of terms, what is refused, what is written and shown, and how the study judges them."""

from __future__ import annotations

import json
import math
import re
import shutil
from dataclasses import asdict, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import runs
from mpi4py import MPI

from bcid.app.cli import main
from bcid.base.errors import InputError, SolveError
from bcid.base.options import ExplainOptions, ProposeOptions
from bcid.base.run_folder import RunFolder
from bcid.forms import effects
from bcid.forms.mesh import level_mesh
from bcid.forms.model import Term, check_physics
from bcid.forms.simulate import simulate
from bcid.grammar import proposal_text
from bcid.grammar.effect_file import made, source
from bcid.grammar.energies import directions, energies
from bcid.grammar.family import Family
from bcid.grammar.other_laws import other_laws
from bcid.grammar.proposal_job import effect_names
from bcid.grammar.propose import Proposal
from bcid.grammar.replaced_law import APART, COUPLED, ReplacedLaw
from bcid.inference.continuation import ContinuationError
from bcid.measurement import Measurement
from bcid.predict.predictor import Predictor
from bcid.report import tables
from bcid.report.found import Found
from bcid.report.page import write_report
from bcid.results.proposal_record import ProposalRecord
from bcid.scene import Scene
from bcid.scene.motions import motion
from bcid.search.answer.source import stored_effect
from validation.beyond import beyond_case
from validation.beyond.beyond_study import judge, rates, table
from validation.beyond.mesh_floor import BeyondMesh, MeshFloor
from validation.beyond.true_laws import LAWS, true_scene
from validation.synthetic import truth
from validation.synthetic.chance import generator


def family(name: str, law: ReplacedLaw = APART) -> Family:
    return next(f for f in (*energies(5e3, law), *other_laws(5e3, law)) if f.name == name)


def test_directions_cover_half_of_the_sphere() -> None:
    angles = np.radians([[d["azimuth"], d["elevation"]] for d in directions()])
    a, e = angles.T
    vectors = np.column_stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
    rng = np.random.default_rng(0)
    probes = rng.normal(size=(200, 3))
    probes /= np.linalg.norm(probes, axis=1)[:, None]
    nearest = np.degrees(np.arccos(np.clip(np.abs(probes @ vectors.T).max(axis=1), -1, 1)))
    assert nearest.max() < 20


def test_the_file_of_a_term_is_the_effect_that_was_fitted(tmp_path: Path) -> None:
    file = tmp_path / "stiffer.py"
    file.write_text(source(family("exponential"), "stiffer", {"rate": 4.5, "c": 800.0}, "", ["Seen once."]), "utf-8")
    found = effects.load(file)
    assert found.name == "stiffer"
    assert {p.name: p.default for p in found.shapes} == {"rate": 4.5}
    # How much there is of it is fitted: it begins with none.
    assert [(p.name, p.neutral) for p in found.amounts] == [("c", 0.0)]
    assert "Seen once." in file.read_text("utf-8")


@pytest.mark.parametrize("scene", ["neo_hooke", "mooney_rivlin"])
@pytest.mark.parametrize(
    ("name", "shapes", "law", "constants"),
    [
        ("second_for_first", {}, "mooney_rivlin", {"c10": 0.0, "c01": 0.5}),
        ("first_apart", {}, "mooney_rivlin", {"c10": 0.5, "c01": 0.0}),
        ("longest_stretch", {"power": 8.0}, "ogden", {"alpha1": 8.0, "mu1": 2 / 8.0}),
        ("shortest_stretch", {"power": -6.0}, "ogden", {"alpha1": -6.0, "mu1": -2 / 6.0}),
        (
            "strain_exponential",
            {"azimuth": 30.0, "elevation": 0.0, "rate": 5.0, "along": 3.0, "sliding": 0.5},
            "fung",
            {"bf": 15.0, "bt": 5.0, "bfs": 2.5, "angle": 30.0, "c": 6 / (2 * 2.5 + 5.0)},
        ),
    ],
)
def test_all_of_the_law_may_be_another_one(
    name: str, shapes: dict[str, float], law: str, constants: dict[str, float], scene: str
) -> None:
    """With as much of the term as the shear modulus the plain law and its term are the other law."""
    import ufl

    from bcid.forms import materials
    from bcid.forms.kinematics import Kinematics
    from bcid.forms.model import Model

    shear, other = 5e3, materials.law(law)
    stated = {"young": 2.7 * shear} if scene == "neo_hooke" else {"c10": shear / 2, "c01": 0.0}
    plain = Model(materials.law(scene), stated | {"poisson": 0.35})
    replaced = ReplacedLaw.of(plain)
    assert replaced is (COUPLED if scene == "neo_hooke" else APART)
    if name == "first_apart" and not replaced.coupled:
        return
    effect = made(source(family(name, replaced), "other", shapes, "", ()))
    # Of the second invariant twice as much goes with the modulus.
    amount = {"c": shear / 2 if name == "second_for_first" else shear}
    values = {k: shear * v if k in ("mu1", "c", "c10", "c01") else v for k, v in constants.items()} | {"poisson": 0.35}
    for stretch in ([1.2, 0.9, 0.95], [1.1, 1.1, 0.8], [1.0, 1.0, 1.0]):
        gradient = np.diag(stretch) + 0.1 * np.eye(3, k=1)
        kin = Kinematics.from_gradient(ufl.as_matrix(gradient.tolist()), ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0)))
        found = float(plain.law.psi(kin, plain.values) + effect.energy(SimpleNamespace(kin=kin), shapes | amount))
        expected = float(other.energy(kin, other.complete(values)))
        # Of Fung's law the volumetric part is the first Lame constant's; of the others the bulk modulus's.
        bulk = 2 * 0.35 / 0.3 if law == "fung" else 2 * 1.35 / 0.9
        expected += float(shear * bulk / 2 * kin.lnJ**2)
        assert found == pytest.approx(expected, rel=1e-6, abs=1e-3), stretch


@pytest.mark.parametrize("catalogue", ["", "active_stress"])
def test_the_file_of_a_term_in_time_is_known_by_its_own_name(tmp_path: Path, catalogue: str) -> None:
    from dataclasses import replace

    steady = family("fibre_stress")
    steady = replace(steady, catalogue=catalogue, times=(0.0, 10.0, 25.0))
    file = tmp_path / "beating.py"
    file.write_text(source(steady, "beating", {}, "", ["Swings."]), "utf-8")
    found = effects.load(file)
    assert found.name == "beating"
    amount = "amplitude" if catalogue else "c"
    assert [p.name for p in found.amounts] == [f"{amount}_{k}" for k in (1, 2, 3)]
    # A run's model names the file, not a course of something that is in no catalogue.
    assert stored_effect(found) == {"effect": "beating"}


def test_what_cannot_be_searched_is_refused() -> None:
    with pytest.raises(InputError, match="at least 1"):
        ProposeOptions(max_effects=0).check()
    with pytest.raises(InputError, match=r"kind 'energies': .*energy"):
        ProposeOptions(kinds=("energies",)).check()
    with pytest.raises(InputError, match=r"must end in \.py"):
        effect_names(Path("term.txt"), 2)
    assert effect_names(Path("made/spot.py"), 2) == ["spot", "spot_2"]


def test_a_file_that_is_there_is_not_overwritten(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "spot.py"
    file.write_text("mine", "utf-8")
    assert main(["propose", str(tmp_path / "run"), "-o", str(file)]) == 2
    assert f"{file}: exists already" in capsys.readouterr().err
    assert file.read_text("utf-8") == "mine"
    assert main(["propose", str(tmp_path / "run"), "-o", str(tmp_path / "soft-spot.py")]) == 2
    assert "cannot be the name of an effect" in capsys.readouterr().err


def test_where_nothing_can_be_written_is_said_before_the_search(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "taken").write_text("a file")
    (tmp_path / "run").mkdir()
    output = tmp_path / "taken/spot.py"
    assert main(["propose", str(tmp_path / "run"), "-o", str(output)]) == 3
    assert str(output.parent) in capsys.readouterr().err


@pytest.mark.parametrize(("last", "warned"), [(0.0626, True), (0.0560, True), (0.0200, False), (0.0079, False)])
def test_a_term_that_lowers_no_error_is_told_as_such(last: float, warned: bool) -> None:
    def rung(rms: float) -> Any:
        return SimpleNamespace(state=SimpleNamespace(rms=rms, noise=0.0078), adequacy=SimpleNamespace(adequate=True))

    explanation = SimpleNamespace(rungs=[rung(0.0598)], last=rung(last))
    found: Any = SimpleNamespace(explanation=explanation, complete=True)
    assert ("does not fall" in proposal_text._rest(found)) is warned


@pytest.mark.parametrize(
    ("unknown", "told"), [(0.28, "With 28 % something else"), (0.02, "Nothing else is seen to be missing")]
)
def test_what_may_be_missing_besides_is_told(unknown: float, told: str) -> None:
    rung = SimpleNamespace(state=SimpleNamespace(rms=0.2, noise=0.2), adequacy=SimpleNamespace(adequate=True))
    odds = SimpleNamespace(verdicts={"spot": 1 - unknown, "unknown": unknown})
    explanation: Any = SimpleNamespace(rungs=(rung,), last=rung, odds=odds)
    entry: Any = SimpleNamespace()
    assert told in proposal_text._left(Proposal(explanation, (entry,), (), 1))
    document = PROPOSAL | {"complete": unknown < 0.05, "discrepancy_probability": unknown}
    assert told.lower() in tables.proposal_table(ProposalRecord.from_json(document)).caption.lower()


PROPOSAL: dict[str, Any] = {
    "length_unit": "mm",
    "proposed": [
        {
            "effect": "spot", "family": "spring_at_a_spot", "kind": "boundary", "about": "springs hold it", "formula": "w k/2 u^2",
            "place": "", "file": "",
            "parameters": {
                "stiffness": {"value": 3.4e5, "stderr": 2.9e4, "unit": "Pa/m"},
                "cx": {"value": 0.0443, "stderr": 0.0005, "unit": "m"},
            },
        }
    ],
    "complete": True, "discrepancy_probability": 0.0, "explained_fraction": 0.9999, "scored": 2091, "law_form": None,
    "path": [
        {
            "beside": "neo_hooke", "selected": "spring_at_a_spot", "rms": 0.204,
            "candidates": [
                {"family": "spring_at_a_spot", "expected_rms": 0.397, "log_evidence": 20032.0},
                {"family": "outer_stop", "expected_rms": 0.8, "log_evidence": 19000.0},
                {"family": "volume", "expected_rms": 0.9, "log_evidence": None},
            ],
        }
    ],
}  # fmt: skip


def test_tables_tell_numbers_with_intervals_and_what_competed() -> None:
    told = tables.proposal_table(ProposalRecord.from_json(PROPOSAL))
    assert told.rows[0][:3] == ["spring at a spot", "w k/2 u^2", "stiffness"]
    assert told.rows[0][3] == "340000 ± 57000 Pa/m"
    assert told.rows[1][2:4] == ["cx", "44.30 ± 0.98 mm"]
    path = tables.path_table(ProposalRecord.from_json(PROPOSAL))
    assert [row[3] for row in path.rows] == ["+0.0", "−1032.0", ""]
    assert path.rows[0][4] == "0.204 mm when fitted"
    assert path.strong == {0}
    for made_of in (told, path):
        assert all(len(row) == len(made_of.columns) for row in (*made_of.rows, *made_of.exact))


def test_a_report_shows_what_is_proposed(tmp_path: Path) -> None:
    folder = runs.explained(tmp_path / "run")
    runs.rewrite(folder, "proposal.json", json.dumps(PROPOSAL))
    runs.seal(folder, "proposal.json")
    assert not Found.read(folder).troubles
    page = write_report([folder], tmp_path / "page.html").path.read_text("utf-8")
    assert "Beyond the catalogue" in page
    assert "340000 ± 57000 Pa/m" in page


def result(kind: str, **found: Any) -> dict[str, Any]:
    known = {
        "kind": kind,
        "body": "slab",
        "size": 5.0,
        "anchored": ["3", "4"],
        "not_asked": ["7"],
        "term": {"cx": 0.05, "cy": 0.0, "cz": 0.04, "radius": 0.01},
        "floor": 2.2e-4,
        "refused": ["the slab folds"],
    }
    told = {
        "verdict": "none",
        "anchored": ["3", "4"],
        "held_out": 2.1e-4,
        "terms": [],
        "verdicts": {},
        "energy_apart": 0.03,
    } | found
    return {"truth": known, "found": told, "cpu_seconds": 50.0}


def test_how_far_a_proposed_term_is_from_the_true_one(project: Path) -> None:
    """A spot by its middle, a named patch by its nearest point; what acts everywhere is nowhere."""
    scene = Scene.read(project / "examples" / "scenes" / "slab.toml", physics=check_physics)
    predictor = Predictor(scene, simulate(scene, {"3"}, motion("pull", "II", steps=2), level=0), MPI.COMM_SELF, level=0)
    mesh = level_mesh(scene, scene.levels[0])
    middle = mesh.points[mesh.select(scene.patches["5"], "5")[0]].mean(axis=0)
    truth = dict(zip(("cx", "cy", "cz"), map(float, middle), strict=True))
    spot = {"cx": truth["cx"] + 0.003, "cy": truth["cy"], "cz": truth["cz"] - 0.004}
    ball, weight = effects.effect("inclusion"), Term(effects.effect("gravity"), {"weight": 1.0})
    values = {p.name: 1.0 for p in ball.parameters} | spot
    # The slab is 10 mm thick.
    far = truth | {"cy": 0.03 if truth["cy"] > 0.005 else -0.02}
    assert beyond_case._apart(predictor, Term(ball, values), truth) == pytest.approx(0.005)
    assert beyond_case._apart(predictor, replace(weight, place="5"), truth) == pytest.approx(0.0, abs=1e-9)
    assert beyond_case._apart(predictor, replace(weight, place="5"), far) == pytest.approx(0.02)
    assert beyond_case._apart(predictor, weight, truth) is None
    predictor.destroy()


def test_cases_are_judged_question_by_question() -> None:
    near = {"family": "spring_at_a_spot", "apart": 0.005}
    right = judge(result("held patch", terms=[near], verdicts={"spring_at_a_spot": 0.9}))
    assert right["place"]
    assert right["kind right"]
    assert right["among likely"]
    assert right["held out"]
    assert not judge(result("held patch", terms=[near | {"apart": 0.03}]))["place"]
    # The same on a named surface is of the same kind; where it acts on all of the skin, its place is wrong.
    named = judge(result("held patch", terms=[near | {"family": "spring", "apart": 0.0}]))
    assert named["place"]
    assert named["kind right"]
    assert not judge(result("held patch", terms=[near | {"family": "spring", "apart": None}]))["place"]
    assert not judge(result("held patch"))["kind right"]
    assert not judge(result("suction", terms=[near]))["kind right"]
    assert not judge(result("gent", held_out=2.5e-4))["held out"]
    assert judge(result("gent"))["energy"]
    assert not judge(result("gent", energy_apart=0.06))["energy"]
    assert not judge(result("none", terms=[near]))["nothing"]
    assert right["anchors"]
    # Nobody could tell whether the seventh patch is anchored.
    assert judge(result("none", anchored=["3", "4", "7"]))["anchors"]
    assert not judge(result("none", anchored=["3", "7"]))["anchors"]
    judged = [judge(result("none")), right]
    found = rates(judged)
    assert found["boundary: place"]["met"] == 1
    assert found["laws: held out"]["count"] == 0
    numbered = [one | {"index": k} for k, one in enumerate(judged)]
    text = table({"cases": 2, "judged": numbered, "rates": found, "lost": {"0003": "why"}})
    assert "spring_at_a_spot 1" in text
    # Size, what is held out, and what the truth itself has there, in noises.
    assert re.search(r"0001 +slab +held patch +5\.0 +1\.05 +1\.10", text)
    assert "0003: why" in text


def test_a_case_is_compared_as_far_as_it_can_be_followed(
    project: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = (project / "examples/scenes/slab.toml").read_text("utf-8")
    geometry = re.search(r'^file = "(.*)"$', scene, re.MULTILINE)
    assert geometry is not None
    (tmp_path / "scene.toml").write_text(
        scene.replace(geometry[1], str(project / "examples/scenes" / geometry[1])), "utf-8"
    )
    shutil.copytree(project / "examples/measurements/slab-34-heavy", tmp_path / "measurement")
    (tmp_path / "truth.json").write_text(json.dumps({"kind": "stop"}), "utf-8")
    seen: list[Measurement] = []

    def proposed(scene: Any, measurement: Measurement, known: Any) -> dict[str, Any]:
        seen.append(measurement)
        if len(seen) == 1:
            came = np.ones(len(measurement.positions), dtype=bool)
            came[measurement.actions[-1].frames[-1]] = False
            raise ContinuationError("it buckles", "no set can be followed", came)
        return dict(known)

    monkeypatch.setattr(beyond_case, "_proposed", proposed)
    assert beyond_case.proposed(tmp_path) == {"kind": "stop"}
    assert len(seen[1].positions) == len(seen[0].positions) - 1


def test_a_truth_that_the_working_mesh_does_not_show_is_refused(project: Path) -> None:
    from dataclasses import replace

    from bcid import Scene
    from bcid.forms.model import check_physics
    from bcid.forms.simulate import simulate
    from bcid.measurement import Action
    from bcid.scene import Level, Material

    scene = Scene.read(project / "examples/scenes/slab.toml", physics=check_physics)
    scene = replace(scene, levels=(Level(2, 0.05), Level(2, 0.025)), noise_sigma=2e-4)
    unturned, steps = np.tile([1.0, 0.0, 0.0, 0.0], (4, 1)), np.arange(4)
    ways = {"1": (0.004, 0.0, 0.0), "2": (0.0, 0.004, 0.0)}
    pulls = [
        Action(name, 4 * k + steps, steps, "I", steps[:, None] * np.array(way), unturned)
        for k, (name, way) in enumerate(ways.items())
    ]
    other = replace(scene, material=Material("ogden", {"poisson": 0.35, "mu1": "-900 Pa", "alpha1": -12.0}))
    seen = simulate(replace(other, levels=(Level(3, 0.02),)), ("3", "4"), pulls, level=0, noise=2e-4)
    floor = MeshFloor.of(other, seen, frozenset("34"), None)
    assert floor.held_out is not None
    assert 1.8e-4 < floor.rms < floor.held_out < 3e-4
    with pytest.raises(BeyondMesh, match="the truth leaves"):
        MeshFloor.of(other, seen, frozenset("45"), None)


def test_patches_that_hardly_show_are_not_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    case: Any = SimpleNamespace(noise=2e-4, body=SimpleNamespace(coarse=None))
    scene: Any = None
    toggles = {"1": 1.9e-4, "2": 2.1e-4, "3": math.nan}
    monkeypatch.setattr(truth, "_plain", lambda *args: (None, toggles))
    assert truth.untold_patches(scene, case) == ["1"]

    def buckles(*args: object) -> None:
        raise SolveError("it buckles")

    monkeypatch.setattr(truth, "_plain", buckles)
    assert truth.untold_patches(scene, case) == []


@pytest.mark.parametrize("law", LAWS)
def test_hidden_laws_are_as_stiff_as_the_scenes_at_small_strain(law: str) -> None:
    from bcid import Model, Scene
    from bcid.base.shipped import shipped

    scene = Scene.read(shipped("examples/scenes/slab.toml"))
    expected = float(Model.of(scene).law.shear(Model.of(scene).law.complete(Model.of(scene).values)))
    for seed in range(5):
        model = Model.of(true_scene(law, generator(seed), scene))
        shear = float(model.law.shear(model.law.complete(model.values)))
        # Of Fung's law the mean coefficient stands for the isotropic one; fibres add to the ground substance.
        assert (
            0.3 < shear / expected < 3.5
            if law in ("fung", "holzapfel_gasser_ogden")
            else shear == pytest.approx(expected)
        )


@pytest.mark.parametrize(
    ("more", "ended", "verdict", "known"),
    [
        ([], "", "unknown", True),
        ([], "failed", "unknown", True),
        ([], "finished", "unknown", False),
        ([], "failed", "gravity", False),
        (["--max-effects", "1"], "failed", "unknown", False),
        (["--overwrite"], "failed", "unknown", False),
        (["--no-propose"], "failed", "unknown", False),
    ],
)
def test_killed_while_it_proposes_explain_goes_on_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, more: list[str], ended: str, verdict: str, known: bool
) -> None:
    monkeypatch.chdir(tmp_path)
    run = RunFolder.start("run", "explain", {"options": json.loads(json.dumps(asdict(ExplainOptions())))})
    run.record["names"] = {"scene": "scene.toml", "measurement": "seen"}
    run.write_json("diagnosis.json", runs.diagnosis() | {"verdict": verdict})
    run.write_text("summary.txt", "the result\n")
    run.finish({})
    if ended:
        begun = RunFolder.start("run/propose", "propose", {})
        begun.finish({}) if ended == "finished" else begun.fail("killed")
    done: list[str] = []

    def explained(_: Path) -> Path:
        done.append("explained")
        return Path("run")

    def proposed(folder: Path) -> Path:
        done.append("proposed")
        made = RunFolder.start(tmp_path / folder, "propose", {}, overwrite=True)
        made.write_text("summary.txt", "Proposed: springs\n")
        made.finish({})
        return folder

    runs.play(monkeypatch, runs.Played(explained))
    monkeypatch.setattr("bcid.grammar.proposal_job.ProposalJob.of_run", lambda *_: runs.Played(proposed))
    assert main(["explain", "scene.toml", "seen", "-o", "run", "--quiet", "--no-picture", *more]) == 0
    assert ("explained" not in done) == known
    assert ("proposed" in done) == (verdict == "unknown" and "--no-propose" not in more)


def test_explain_goes_on_where_no_known_effect_explains(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    asked: list[Path] = []

    def finished(folder: Path, command: str, verdict: str, summary: str) -> None:
        run = RunFolder.start(folder, command, {}, overwrite=True)
        run.write_json("diagnosis.json", runs.diagnosis() | {"verdict": verdict})
        run.write_text("summary.txt", summary)
        run.finish({})

    def proposed(folder: Path) -> Path:
        asked.append(folder)
        finished(folder, "propose", "unknown", "Proposed: springs\n")
        return folder

    def of_run(run: Path, output: Path | None, *_: Any) -> runs.Played:
        assert (run, output) == (tmp_path / "made", None)
        return runs.Played(proposed, [Path("proposed/proposed_term.py")])

    runs.play(monkeypatch, runs.Played(lambda _: tmp_path / "made"))
    monkeypatch.setattr("bcid.grammar.proposal_job.ProposalJob.of_run", of_run)
    words = ["explain", "scene.toml", "seen", "-o", "run", "--quiet", "--no-picture"]
    for verdict, more, expected in (("gravity", [], 0), ("unknown", ["--no-propose"], 0), ("unknown", [], 1)):
        finished(tmp_path / "made", "explain", verdict, "the result\n")
        assert main([*words, *more]) == 0
        assert asked == [tmp_path / "made" / "propose"] * expected
    out = capsys.readouterr().out
    assert "Proposed: springs" in out
    assert "proposed_term.py (use it with --effects" in out
