"""How many answers about worlds outside the family are certain and wrong, and how many are sure where that is possible."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from statistics import median
from typing import Any

from validation.golden.score import CERTAIN
from validation.outside.worlds import CASES, KINDS, draw
from validation.synthetic.judge import named, verdict_right
from validation.text_table import TextTable

Json = Mapping[str, Any]
# An answer with more than this is sure.
SURE = 0.90
_HEAD = (
    "kind",
    "measurements",
    "no answer",
    "verdict certain, wrong",
    "anchors certain, wrong",
    "verdict sure",
    "anchors sure",
    "CPU s",
)


def right_verdict(truth: Json, diagnosis: Json) -> bool:
    """Whether the verdict is one of those that an ideal observer may give, see `validation.outside.worlds`."""
    if verdict_right(truth, diagnosis):
        return True
    (what,) = truth["effects"] if truth["kind"] == "outside" else (None,)
    return what is not None and set(named(diagnosis)) <= {*KINDS[what["effect"]].accepted, "unknown"}


def right_anchors(truth: Json, diagnosis: Json) -> bool:
    """Whether the anchored patches are right but for those that nobody can decide."""
    if truth["anchored"] is None:
        return False
    return not (set(diagnosis["anchored"]) ^ set(truth["anchored"])) - set(truth["not_asked"])


_QUESTIONS = {
    "verdict": ("verdict_probability", right_verdict),
    "anchors": ("anchors_probability", right_anchors),
}


def certain_and_wrong(answer: Json, question: str) -> bool:
    """Whether the `verdict` or the `anchors` of an answer have more than 95 % and are wrong."""
    if answer["truth"] is None or answer["diagnosis"] is None:
        return False
    probability, right = _QUESTIONS[question]
    return answer["diagnosis"][probability] > CERTAIN and not right(answer["truth"], answer["diagnosis"])


def decidable(answer: Json, question: str) -> bool:
    """Whether an ideal observer can decide: the verdict always, the anchors where some set of them is right."""
    return answer["truth"] is not None and (question == "verdict" or answer["truth"]["anchored"] is not None)


def sure_and_right(answer: Json, question: str) -> bool:
    """Whether the `verdict` or the `anchors` of an answer have more than 90 % and are right."""
    if answer["truth"] is None or answer["diagnosis"] is None:
        return False
    probability, right = _QUESTIONS[question]
    return answer["diagnosis"][probability] > SURE and right(answer["truth"], answer["diagnosis"])


def text(answers: Mapping[str, Json]) -> str:
    """One row for each kind, whether the goal is met, and each answer that is certain and wrong."""
    return "\n".join([table(answers).text(), "", *summary(answers)])


def table(answers: Mapping[str, Json]) -> TextTable:
    """One row for each kind."""
    title = "Worlds outside the family: certain above 95 %, sure above 90 % and right where it can be decided"
    return TextTable(title, _HEAD, tuple(_row(kind, group) for kind, group in _groups(answers).items()))


def summary(answers: Mapping[str, Json]) -> list[str]:
    """Whether the goal is met, and each answer that is certain and wrong."""
    return [*_goal(_groups(answers)), *_wrong(answers)]


def _groups(answers: Mapping[str, Json]) -> dict[str, list[Json]]:
    """Answers by the kinds that have some."""
    found = {kind: [answer for answer in answers.values() if answer["kind"] == kind] for kind in KINDS}
    return {kind: group for kind, group in found.items() if group}


def _row(kind: str, group: list[Json]) -> tuple[str, ...]:
    wrong = (str(sum(certain_and_wrong(answer, question) for answer in group)) for question in _QUESTIONS)
    lost = sum(answer["diagnosis"] is None for answer in group)
    sure = ("{} of {}".format(*_sure(group, question)) for question in _QUESTIONS)
    return (kind, str(len(group)), str(lost), *wrong, *sure, f"{median(answer['cpu_seconds'] for answer in group):.0f}")


def _sure(group: list[Json], question: str) -> tuple[int, int]:
    able = [answer for answer in group if decidable(answer, question)]
    return sum(sure_and_right(answer, question) for answer in able), len(able)


def _goal(groups: Mapping[str, list[Json]]) -> Iterable[str]:
    """At most one certain and wrong in each kind; at least half sure where an ideal observer can decide."""
    bold, silent = [], []
    for kind, group in groups.items():
        if sum(any(certain_and_wrong(answer, question) for question in _QUESTIONS) for answer in group) > 1:
            bold.append(kind)
        if any(2 * sure < able for sure, able in (_sure(group, question) for question in _QUESTIONS)):
            silent.append(kind)
    for goal, missed in (
        ("at most one certain and wrong in each kind", bold),
        ("at least half sure where it can be decided", silent),
    ):
        # One measurement of a kind cannot miss a goal that allows one.
        few = any(len(group) < CASES for group in groups.values())
        met = f"not missed, by fewer than {CASES} measurements of a kind" if few else "met"
        yield f"goal, {goal}: " + (f"missed ({', '.join(missed)})" if missed else met)


def _wrong(answers: Mapping[str, Json]) -> Iterable[str]:
    for name, answer in answers.items():
        for question in _QUESTIONS:
            if certain_and_wrong(answer, question):
                found, truth = answer["diagnosis"], answer["truth"]
                value = found["verdict"] if question == "verdict" else " ".join(found["anchored"]) or "none"
                yield f"{name}: {question} {value} with {found[_QUESTIONS[question][0]]:.4f}; {_true_anchors(name, truth)}"


def _true_anchors(name: str, truth: Json) -> str:
    """Those of the scene's body, or of the body whose markers were measured, for which the scene has no right ones."""
    if truth["anchored"] is not None:
        return f"true anchors: {' '.join(truth['anchored'])}"
    kind, _, index = name.rpartition("-")
    return f"no set is right (of the other body: {' '.join(draw(kind, int(index))['other']['anchored'])})"
