"""Results of expensive steps on disk: found again where they are the same, and only there."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

from bcid.forms import effect_trial as trial
from bcid.forms import effects
from bcid.forms.course import in_time
from bcid.forms.model import Anchors, Model, Term
from bcid.forms.probes import Probe, Sensitivities, SensitivityRequest
from bcid.forms.set_tangent import StepTangent
from bcid.forms.simulate import recorded
from bcid.forms.solver.equilibrium import Settings
from bcid.measurement import Action
from bcid.predict import questions, store
from bcid.predict.predictor import Predictor
from bcid.predict.pull_prediction import PullPrediction
from bcid.predict.result_formats import PullFormat, SensitivitiesFormat, TangentsFormat
from bcid.predict.store import PredictionStore, packed, unpacked


class Plain:
    """A number as it is."""

    def arrays(self, result: float) -> tuple[dict[str, Any], Any]:
        return {"number": np.array(result)}, None

    def result(self, arrays: dict[str, Any], notes: Any) -> float:
        return float(arrays["number"])


class Spoken:
    """Keeps what is said."""

    def __init__(self) -> None:
        self.lines: list[str] = []

    def say(self, text: str) -> None:
        self.lines.append(text)

    def step(self, *_: object) -> None:
        pass


def asked(folder: Path, questions: list[str], inputs: Any = None, spoken: Spoken | None = None) -> tuple[int, int]:
    """Ask for results, which are numbered as they are computed; how many were known, and how many not."""
    kept = PredictionStore(folder, MPI.COMM_SELF, inputs, spoken)
    for question in questions:
        kept.result(lambda question=question: question, Plain(), lambda: float(kept.computed))  # type: ignore[misc]
    return kept.recalled, kept.computed


def test_what_was_asked_before_is_known(tmp_path: Path) -> None:
    assert asked(tmp_path / "kept", ["a", "b", "a"]) == (0, 3)
    spoken = Spoken()
    assert asked(tmp_path / "kept", ["a", "b", "a", "a"], spoken=spoken) == (3, 1)
    assert spoken.lines == ["going on with an interrupted run: 3 predictions and sensitivities are there already"]


def test_the_same_question_has_an_answer_each_time(tmp_path: Path) -> None:
    for _ in range(2):
        kept = PredictionStore(tmp_path, MPI.COMM_SELF)
        answers = [kept.result(lambda: "a", Plain(), lambda: float(kept.computed)) for _ in range(3)]  # noqa: B023
        assert answers == [0.0, 1.0, 2.0]


def test_of_many_questions_those_are_computed_that_are_not_known_or_not_known_enough(tmp_path: Path) -> None:
    asked: list[list[int]] = []

    def work(numbers: Sequence[int]) -> list[float]:
        asked.append(list(numbers))
        return [10.0 + k for k in numbers]

    def of(questions: list[str], least: float = 0.0) -> list[float]:
        kept = PredictionStore(tmp_path, MPI.COMM_SELF, shared=True)
        return kept.results(questions, Plain(), work, lambda found: found >= least)

    assert of(["a", "b"]) == [10.0, 11.0]
    assert of(["b", "c", "a"]) == [11.0, 11.0, 10.0]
    assert of(["c", "a"], least=10.5) == [11.0, 11.0]
    assert of(["a", "b", "c"]) == [11.0, 11.0, 11.0]
    assert asked == [[0, 1], [1], [1]]


def test_pulls_come_back_as_they_were() -> None:
    whole = PullPrediction(np.random.default_rng(0).normal(size=(3, 4, 3)), 1.5, 0.2, 0.9)
    arrays, notes = unpacked(packed(*PullFormat().arrays(whole)))
    again = PullFormat().result(arrays, notes)
    np.testing.assert_array_equal(again.positions, whole.positions)
    assert (again.force, again.strain, again.eigenvalue, again.detailed) == (1.5, 0.2, 0.9, True)


def test_other_inputs_and_other_code_begin_anew(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked(tmp_path, ["a"], {"scene": 1})
    spoken = Spoken()
    assert asked(tmp_path, ["a"], {"scene": 2}, spoken) == (0, 1)
    assert spoken.lines == ["begun anew: what an interrupted run left was computed by other code, or of other inputs"]
    assert len(list(tmp_path.iterdir())) == 1
    monkeypatch.setattr(store, "_code", lambda: "other")
    assert asked(tmp_path, ["a"], {"scene": 2}) == (0, 1)


def test_shared_store_other_inputs_and_end_of_run_remove_nothing(tmp_path: Path) -> None:
    for inputs in ({"scene": 1}, {"scene": 2}):
        kept = PredictionStore.of_run(tmp_path / "run", MPI.COMM_SELF, inputs, shared=tmp_path / "shared")
        assert kept.result(lambda: "a", Plain(), lambda: 1.0) == 1.0
        kept.clear()
    assert len(list((tmp_path / "shared").iterdir())) == 2
    kept = PredictionStore.of_run(tmp_path / "other", MPI.COMM_SELF, {"scene": 1}, shared=tmp_path / "shared")
    assert kept.result(lambda: "a", Plain(), lambda: 2.0) == 1.0
    assert (kept.recalled, kept.computed) == (1, 0)


def test_what_was_written_in_part_is_removed(tmp_path: Path) -> None:
    (tmp_path / ".a.partial").write_text("half")
    spoken = Spoken()
    assert asked(tmp_path, [], spoken=spoken) == (0, 0)
    assert not list(tmp_path.iterdir())
    assert not spoken.lines


def test_what_is_damaged_is_computed_again(tmp_path: Path) -> None:
    asked(tmp_path, ["a"])
    (file,) = tmp_path.iterdir()
    sound = file.read_bytes()
    foreign = packed({"other": np.zeros(1)})
    bad = sealed({"arrays": {"number": ["|O", [1]]}})
    for content in (b"", sound[:-1], sound[:20], sound[:-1] + b"?", foreign, bad):
        file.write_bytes(content)
        assert asked(tmp_path, ["a"]) == (0, 1)
        assert file.read_bytes() == sound


def test_it_stays_small(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(store, "_MOST", 250)
    spoken = Spoken()
    assert asked(tmp_path, ["a", "b", "c", "d"], spoken=spoken) == (0, 4)
    assert len(list(tmp_path.iterdir())) == 2
    assert spoken.lines == [f"{tmp_path} is full: killed from now on, the run would go on from here"]


def sealed(head: Any, rest: bytes = b"") -> bytes:
    """Bytes with a right checksum."""
    text = head if isinstance(head, bytes) else json.dumps(head | {"notes": None}).encode()
    content = len(text).to_bytes(8, "little") + text + rest
    return sha256(content).digest() + content


@pytest.mark.parametrize(
    "content",
    [
        b"",
        sealed(b"[" * 100_000),
        sealed(b"\xff"),
        sealed({"arrays": {"a": ["|O", [1]]}}, b"8" * 8),
        sealed({"arrays": {"a": ["<f8", [2]]}}, b"8" * 8),
        sealed({"arrays": {"a": ["<U2", [1]]}}, b"8" * 8),
    ],
    ids=["nothing", "nested", "no text", "objects", "too short", "words"],
)
def test_only_whole_arrays_of_numbers_are_read(content: bytes) -> None:
    with pytest.raises(ValueError):
        unpacked(content)


def test_arrays_come_back_as_they_were() -> None:
    made = {"a": np.arange(6.0).reshape(2, 3).T, "b": np.zeros((0, 3), np.float32), "c": np.array([True, False])}
    made |= {"d": np.array(7), "e": np.array([np.nan, np.inf, -0.0])}
    found, notes = unpacked(packed(made, {"why": "µ"}))
    assert notes == {"why": "µ"}
    for name, array in made.items():
        assert found[name].dtype == array.dtype
        assert found[name].shape == array.shape
        assert found[name].tobytes() == np.ascontiguousarray(array).tobytes()
        found[name][...] = 0


def test_sensitivities_come_back_as_they_were() -> None:
    weight, angle = np.arange(12.0).reshape(2, 2, 3), np.full((2, 2, 3), np.nan)
    weight[1, 0] = np.nan
    angle[1] = 2.0
    forces = np.ones((2, 2, 3, 4, 3), np.float32)
    made = Sensitivities([{"weight": weight}, {}, {"angle": angle}], {"young": weight}, forces=forces)
    form = SensitivitiesFormat(3)
    arrays, notes = form.arrays(made)
    assert len(arrays["probe 2 angle"]) == 1
    found = form.result(arrays, notes)
    assert [sorted(probe) for probe in found.probes] == [["weight"], [], ["angle"]]
    assert found.stiffness is None
    for one, other in zip(found.arrays, made.arrays, strict=True):
        assert one.dtype == other.dtype
        assert np.array_equal(one, other, equal_nan=True)


@pytest.mark.parametrize("count", [0, 2])
def test_tangents_come_back_as_they_were(count: int) -> None:
    made = {3 * k: StepTangent(np.eye(2) * k, np.ones(2), np.zeros((3, 2)), np.arange(3.0)) for k in range(count)}
    found = TangentsFormat().result(*TangentsFormat().arrays(made))
    assert list(found) == list(made)
    assert all(np.array_equal(found[k].compliance, made[k].compliance) for k in made)


def test_other_models_are_other_questions() -> None:
    plain = Model.of(trial.scene())
    gravity, tension = effects.effect("gravity"), effects.effect("active_stress")
    numbers = {p.name: 1.0 + k for k, p in enumerate(tension.parameters)}
    heavy = plain + Term(gravity, {"weight": 1000.0})
    asked = [plain, heavy, heavy.with_values({"gravity.weight": 1000.001}), plain + Term(tension, numbers)]
    asked += [plain + Term(gravity, {"weight": 1000.0}, "gravity", place="2"), plain + Anchors({"1"})]
    for times in ([0.0, 1.0], [0.0, 2.0]):
        timed = in_time(gravity, times)
        asked.append(plain + Term(timed, {p.name: 1000.0 for p in timed.parameters}))
    assert len({questions.of_model(model) for model in asked}) == len(asked)
    # What rounding changes is the same question.
    assert questions.of_model(heavy.with_values({"gravity.weight": 1000.0 + 1e-12})) == questions.of_model(heavy)


def test_other_wishes_are_other_questions() -> None:
    gravity = Term("gravity", {"weight": 0.0})
    asked = [
        SensitivityRequest(),
        SensitivityRequest((Probe(gravity, ("weight",)),)),
        SensitivityRequest((Probe(gravity, ()),)),
        SensitivityRequest(law=("young",)),
    ]
    asked += [
        SensitivityRequest(stiffness=True),
        SensitivityRequest(places=True),
        SensitivityRequest(forces=np.ones((2, 1))),
        SensitivityRequest(forces=np.zeros((2, 1))),
    ]
    assert len({questions.of_wanted(wanted) for wanted in asked}) == len(asked)


def test_other_motions_settings_and_steps_are_other_questions(monkeypatch: pytest.MonkeyPatch) -> None:
    # The file of the geometry is none: nothing is meshed.
    monkeypatch.setattr("bcid.predict.predictor.pair", lambda scene, *_: scene.levels)
    scene = replace(trial.scene(), geometry=Path(__file__))
    way = np.linspace(0, 1e-3, 5)[:, None] * [1.0, 0, 0]
    seen = []
    for part in (1.0, 1.001):
        pull = Action("1", np.arange(5), np.arange(5), "gripper", part * way, np.tile([1.0, 0, 0, 0], (5, 1)))
        seen.append(recorded(scene, [pull], np.tile(scene.rest, (5, 1, 1)), 0.0, np.random.default_rng(0)))
    made = [Predictor(scene, measurement, MPI.COMM_SELF, 0) for measurement in seen]
    made += [Predictor(scene, seen[0], MPI.COMM_SELF, 0, Settings()), made[0].thinned(2, made[0].settings)[0]]
    made += [made[0].thinned(1, made[0].settings)[0]]
    made += [Predictor(replace(scene, down=(1.0, 0.0, 0.0)), seen[0], MPI.COMM_SELF, 0)]
    assert len({predictor._identity for predictor in made}) == len(made)
    assert made[0]._identity == Predictor(scene, seen[0], MPI.COMM_SELF, 0)._identity
