"""Summaries: sentences and tables of records."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
import runs

from bcid.results.common_rows import ParameterRow
from bcid.results.diagnosis_record import (
    BREAKING,
    ChangePointRow,
    DiagnosisRecord,
    DiscrepancyRecord,
    EvidenceRow,
    Finding,
    HypothesisRow,
    ModelRow,
    NextStep,
    PosteriorRow,
    SensitivityRow,
    SeparatingPull,
)
from bcid.results.exploration_record import ExplorationRecord
from bcid.results.identification_record import IdentificationRecord
from bcid.results.summary import diagnosis_summary, exploration_summary, identification_summary

DIAGNOSIS = DiagnosisRecord.from_json(runs.diagnosis())
ROW = EvidenceRow(
    anchored=("1",), effects=(), unknown=False, probability=0.9, misfit=0, volume=0, occam=0, discrepancy=0, prior=0
)


def row(anchored: str, effects: str = "", unknown: bool = False, probability: float = 0.5) -> HypothesisRow:
    names = tuple(filter(None, effects.split("+")))
    return HypothesisRow(anchored=tuple(anchored), effects=names, unknown=unknown, probability=probability)


def explained(verdict: str = "gravity", **more: Any) -> DiagnosisRecord:
    """A diagnosis whose anchors and effects were searched."""
    posterior = PosteriorRow(effects={verdict: 0.97, "unknown": 0.03}, patches={"left": 1.0}, hypotheses=(row("1"),))
    known = {"verdict": verdict, "verdict_probability": 0.97, "anchors_probability": 0.98, "posterior": posterior}
    return replace(DIAGNOSIS, **(known | more))


def text(record: DiagnosisRecord, force: DiscrepancyRecord | None = None) -> str:
    return diagnosis_summary(record, force)


def test_summary_of_a_missing_effect_names_it_with_its_probability_and_the_error() -> None:
    first, *rest = text(explained()).splitlines()
    assert first == (
        "Missing in the plain model: gravity (97 %). The error falls from 1.42 to 0.21 mm (noise 0.2 mm). Anchored: {left} (98 %)."
    )
    assert rest[0] == "  gravity: weight = 1257.6 ± 9.4 N/m^3"
    assert "How probable: gravity 97 %, something unknown 3 %." in rest


def test_summary_in_metres_is_the_same() -> None:
    assert text(DIAGNOSIS.converted("m")) == text(DIAGNOSIS)


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ({"verdict": "none"}, "Nothing is missing that these data could show (97 %). The neo-Hookean + gravity model"),
        ({"verdict": "none", "adequate": False}, "do not quite explain that"),
        ({"verdict": "unknown"}, "None of the known effects explains this measurement: 0.21 mm are left"),
        ({"adequate": False}, "With that the model is not adequate either"),
        (
            {"far_above_noise": True, "rms": 14.0},
            "WARNING: the model misses the measurement by 70.0 times the noise (14 mm",
        ),
        ({"noise_stated": False}, "WARNING: no noise is known: 0.2 mm is only estimated"),
        ({"noise_warning": "the noise is stated as 0.1 mm"}, "WARNING: the noise is stated as 0.1 mm."),
        ({"remarks": ("markers 3 and 7 look swapped",)}, "LOOK AT THIS FIRST: markers 3 and 7 look swapped."),
        ({"ambiguous_with": ("none",)}, "These data cannot tell gravity from: nothing missing."),
        ({"anchors_certain": False}, "These data do not tell for certain which patches hold the body."),
        ({"skipped": ("pulls: failed",)}, "Not evaluated, because that failed:\n  pulls: failed"),
        ({"curvature": {"3": 0.04}}, "In action 3 that moves the body otherwise than to first order"),
        ({"adequate": None}, "has NOTHING AGAINST IT (p = 0.5; whether it is adequate cannot be told without"),
        ({"unfitted_probability": 0.08}, "8 % of the probability is of hypotheses that were not fitted"),
    ],
)
def test_summary_of_a_condition_says_it(more: dict[str, Any], words: str) -> None:
    assert words in text(explained(**more))
    assert words not in text(explained())


def test_summary_without_a_search_has_no_probabilities() -> None:
    shown = text(replace(DIAGNOSIS, verdict="unknown", ranking=()))
    assert shown.startswith("The neo-Hookean + gravity model is not adequate: it misses the measurement by 0.21 mm")
    assert "%" not in shown.splitlines()[0]
    assert "How probable" not in shown


def test_summary_of_a_discrepancy_says_when_it_begins() -> None:
    change = ChangePointRow(action="lift", step=5, probability=0.97)
    shown = text(explained("unknown", change_point=change))
    assert "It is not there from the start (97 %, if it is unknown), and shows by step 5 of action lift" in shown
    assert "Look where the force" not in shown
    breaking = Finding(BREAKING, 1e-9, "from step 7 of action 1 on it is 4 times as large")
    assert "It fits at first and fails later: from step 7" in text(explained("unknown", tests=(breaking,)))
    assert "Look where the force" in text(explained("unknown"))


def test_summary_of_other_anchors_splits_the_fall_of_the_error() -> None:
    def model(name: str, anchored: str, rms: float) -> ModelRow:
        return ModelRow(model=name, anchored=tuple(anchored), rms=rms, adequate=False, p_value=0.0)

    models = (model("neo_hooke", "1", 1.4), model("neo_hooke", "2", 2.0), model("neo_hooke + gravity", "2", 0.2))
    assert "Alone, the plain model does best with {1}; with {2} it leaves 2 mm: the rest is the effect's." in text(
        explained(model_sequence=models)
    )
    near = tuple(replace(one, rms=0.3, normalised_rms=size) for one, size in zip(models, (3.0, 2.0, 1.0), strict=True))
    assert "hardly falls, from 0.3 to 0.3 mm (noise 0.2 mm); in units of what noise" in text(
        explained(model_sequence=near)
    )


def test_summary_names_effects_that_act_alone_and_what_acts_beside_something_unknown() -> None:
    effects = {"gravity": 0.5, "gravity+swelling": 0.3, "unknown": 0.2}
    likely = (row("3", "gravity"), row("3", "obstacle", unknown=True, probability=0.2))
    posterior = PosteriorRow(effects=effects, patches={"3": 1.0}, hypotheses=likely)
    shown = text(explained(posterior=posterior))
    assert (
        "How probable: gravity alone 50 %, gravity+swelling 30 %, something unknown, most likely beside obstacle, 20 %."
        in shown
    )
    assert "  {3} + obstacle and something unknown: 20 %" in shown


def test_summary_says_where_a_better_hypothesis_fits_no_better() -> None:
    """Of another set; that an effect that is not there would fit a little better is no surprise."""
    wide = replace(ROW, anchored=("1", "2"), misfit=-0.5, volume=-7.0)
    assert "{1} fits no better than {1 2}: the rest of the table makes it more probable." in text(
        explained(evidence_split=(ROW, wide))
    )
    assert "         -7.0" in text(explained(evidence_split=(ROW, wide)))
    effect = replace(ROW, effects=("gravity",), misfit=0.5, occam=-2.5)
    assert "fits no better" not in text(explained(evidence_split=(ROW, effect)))
    assert "Why this and not that" not in text(explained(evidence_split=(ROW,)))


def test_summary_says_on_which_inputs_the_answer_depends() -> None:
    depends = SensitivityRow.from_json(runs.answer_at(2.0, []) | {"verdict": "none", "shift": "+0.06"})
    same = SensitivityRow.from_json(runs.answer_at(-2.0, ["left"]) | {"input": "noise", "label": "the noise"})
    shown = text(explained(scene_sensitivity=(depends, same)))
    assert "Poisson's ratio +0.06: nothing missing (97 %), anchored {} (96 %)" in shown
    assert "the noise" not in shown
    assert "The answer is the same for noise at ±2 standard deviations." in text(explained(scene_sensitivity=(same,)))


def test_summary_says_what_to_do_next() -> None:
    step = NextStep(kind="pull", text="pull grasp I", expected_bits=0.42)
    known = {"least_bits": 0.05, "next_steps": (step,)}
    assert "0.42 bits: pull grasp I" in text(explained(entropy=0.8, **known))
    assert "nothing that is computed here gives 0.05 bits of the 0.8" in text(
        explained(entropy=0.8, least_bits=0.05, next_steps=())
    )
    assert "Open is only what was not fitted" in text(explained(entropy=0.01, **known))
    assert "What to do next" not in text(explained(entropy=None))


def test_summary_names_the_pull_that_separates() -> None:
    pull = SeparatingPull(grasp="I", direction="+x", distance=8.0, sigmas=12.0)
    assert "best: grasp I along +x by 8 mm (12 sigma apart)." in text(explained(separating_pulls=(pull,)))
    weak = replace(pull, sigmas=1.0)
    assert "No pull along an axis would separate them" in text(explained(separating_pulls=(weak,)))


def test_summary_of_a_missing_force_names_its_largest_parts() -> None:
    one = {"position": [10.0, 20.0, 30.0], "force": [0.0, -0.1, 0.0], "stderr": 0.01}
    content = {"explained_fraction": 0.9, "rms": 0.22, "steady": [one], "growing": {"1": [one]}, "length_unit": "mm"}
    force = DiscrepancyRecord.from_json(content | {"together": {"steady": one, "growing": {"1": one}}})
    shown = text(DIAGNOSIS, force)
    assert "A smooth force on the body would explain 90 % of what is beyond noise (residual then 0.22 mm)" in shown
    assert "  at (10 20 30) mm: (+0.00 -100.00 +0.00) mN ± 10.00, action 1, growing" in shown
    assert "No missing force can be told" in text(DIAGNOSIS, replace(force, explained_fraction=0.05))


def test_summary_of_an_identification_states_sets_and_how_they_were_found() -> None:
    record = IdentificationRecord.from_json(runs.identification() | {"scene": "slab"})
    shown = identification_summary(record)
    assert shown.startswith("Anchored patches of slab: {left}  (probability 98 %)\n")
    assert "  {left right} misses by 0.3 mm where {left} misses by 0.21, probability 2 %\n" in shown
    assert "Certified: of all 4 sets 2 were followed to the end, 0 until they had lost, 0 failed, 2 were not" in shown
    without = replace(record, patches={}, alternatives=())
    assert "slab: no patch is a candidate; what is held is known." in identification_summary(without)
    classes = ((("left",), ("left", "right")), (("right",),))
    assert "These data cannot tell it from: {left right}." in identification_summary(replace(record, classes=classes))
    partly = identification_summary(replace(record, partly_held={"left": "x"}))
    assert "   left       99 %  anchored along x" in partly


def test_summary_of_an_identification_warns_first() -> None:
    record = IdentificationRecord.from_json(runs.identification() | {"scene": "slab"})
    lines = identification_summary(replace(record, outliers=("6",))).splitlines()
    assert lines[0].startswith("WARNING: fiducial(s) 6 do not go with the body")
    other = replace(record.alternatives[0], failure="no equilibrium")
    open_set = replace(record, alternatives=(other,), not_converged=(other.anchored,))
    assert "WARNING: {left right} could not be followed to the end (no equilibrium)" in identification_summary(open_set)
    assert "WARNING: no set explains this measurement" in identification_summary(replace(record, adequate=False))


@pytest.mark.parametrize(
    ("reason", "words"),
    [
        ("decided", "Anchored patches and effect of slab: {left} + gravity  (probability 98 %, after 2 pulls)"),
        ("inseparable", "Not decided after 2 pulls: no allowed pull separates {left}, {right}"),
        ("unexplained", "Not decided after 2 pulls: no hypothesis explains what was seen; the likeliest is {left}"),
        ("budget", "Not decided: the budget is used (2 pulls); the likeliest is {left} + gravity (probability 98 %)"),
    ],
)
def test_summary_of_an_exploration_says_how_it_ended(reason: str, words: str) -> None:
    effects = {"effects": {"": 0.1, "gravity": 0.9}, "effect": "gravity", "scene": "slab", "telling_pull": 2}
    steps = [step | {"effects": effects["effects"], "effect_bits": 0.5} for step in runs.exploration()["steps"]]
    sets = [{"anchored": ["left"], "effect": ""}, {"anchored": ["right"], "effect": ""}]
    content = runs.exploration() | effects | {"reason": reason, "not_separated": sets, "steps": steps}
    record = ExplorationRecord.from_json(content)
    shown = exploration_summary(record)
    assert shown.startswith(words)
    assert "Pull 2 () told them apart most: 0.50 bits about the effect." in shown
    assert "  pull          none     gravity" in shown
    assert "No pull told them apart." in exploration_summary(replace(record, telling_pull=None))
    parameters = {"weight": ParameterRow(value=1257.6, stderr=9.4, unit="N/m^3")}
    assert "  weight = 1257.6 ± 9.4 N/m^3" in exploration_summary(replace(record, parameters=parameters))
    assert "WARNING: something is missing in the model" in exploration_summary(replace(record, adequate=False))
