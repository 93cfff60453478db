"""The score of answers: the logarithm to base 2 of the probability that they give to the truth, compared case by case.

The truth is the class that an ideal observer cannot separate: patches that move the markers by less than the noise, and effects
smaller than three noises, may be either way. The logarithm is floored at -10; an answer that failed has the floor. Verdict and
anchors are scored apart.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from statistics import median
from typing import Any

from validation.synthetic.judge import verdict_right
from validation.text_table import TextTable

Json = Mapping[str, Any]
FLOOR = -10.0
# An answer with at least this probability is certain.
CERTAIN = 0.95


def verdict_bits(answer: Json) -> float | None:
    """Of the verdict; None where the truth is not published."""
    return _bits_of(answer, _right_verdicts)


def anchor_bits(answer: Json) -> float | None:
    """Of the anchored patches; None where the truth is not published."""
    return _bits_of(answer, _right_anchors)


def _bits_of(answer: Json, right: Callable[[Json, Json], Iterable[float]]) -> float | None:
    """Of what is right by truth and diagnosis."""
    truth, diagnosis = _known(answer), answer["diagnosis"]
    if truth is None:
        return None
    return FLOOR if diagnosis is None else _bits(sum(right(truth, diagnosis)))


def _known(answer: Json) -> Json | None:
    """The truth as the blinded study writes it: that of a law or a term beyond the catalogue is outside of it."""
    truth: Json | None = answer["truth"]
    if truth is None or truth["kind"] == "unpublished":
        return None
    if "effects" in truth:
        return truth
    if truth["kind"] == "none":
        return {**truth, "effects": []}
    return {**truth, "kind": "outside", "effects": [{"effect": truth["kind"], "size": truth["size"]}]}


def _right_verdicts(truth: Json, diagnosis: Json) -> Iterable[float]:
    effects = diagnosis["posterior"]["effects"]
    return (p for verdict, p in effects.items() if verdict_right(truth, {"verdict": verdict}))


def _right_anchors(truth: Json, diagnosis: Json) -> Iterable[float]:
    """Of the reported set its whole probability; of others that of the hypotheses that are listed."""
    apart, anchored, reported = set(truth["not_asked"]), set(truth["anchored"]), set(diagnosis["anchored"])
    listed = [(set(one["anchored"]), one["probability"]) for one in diagnosis["posterior"]["hypotheses"]]
    sets = [(reported, diagnosis["anchors_probability"]), *((s, p) for s, p in listed if s != reported)]
    return (p for s, p in sets if not (s ^ anchored) - apart)


def certain_and_wrong(answer: Json) -> list[str]:
    """Which of verdict and anchors are certain and wrong."""
    truth, diagnosis = _known(answer), answer["diagnosis"]
    if truth is None or diagnosis is None:
        return []
    wrong = []
    if diagnosis["verdict_probability"] >= CERTAIN and not verdict_right(truth, diagnosis):
        wrong.append("verdict")
    apart = set(truth["not_asked"])
    if diagnosis["anchors_probability"] >= CERTAIN and (set(diagnosis["anchored"]) ^ set(truth["anchored"])) - apart:
        wrong.append("anchors")
    return wrong


def text(before: Mapping[str, Json], after: Mapping[str, Json]) -> str:
    """Frozen and other answers side by side, case by case, with the means over the cases that both have."""
    return "\n".join([table(before, after).text(), "", *summary(before, after)])


def table(before: Mapping[str, Json], after: Mapping[str, Json]) -> TextTable:
    """Frozen and other answers, case by case."""
    rows = [_row(name, before[name], after[name]) for name in after if name in before]
    head = ("case", "verdict", "probability", "anchors", "probability", "verdict bits", "now", "anchor bits", "now")
    return TextTable("Golden cases: frozen -> now", (*head, "solves", "CPU s"), tuple(rows))


def _row(name: str, old: Json, new: Json) -> tuple[str, ...]:
    def change(of: str) -> str:
        values = [_value(one, of) for one in (old, new)]
        return values[0] if values[0] == values[1] else " -> ".join(values)

    bits = [_number(score(one)) for score in (verdict_bits, anchor_bits) for one in (old, new)]
    cost = [f"{_solves(old)} -> {_solves(new)}", f"{_seconds(old)} -> {_seconds(new)}"]
    about = [change(of) for of in ("verdict", "verdict_probability", "anchored", "anchors_probability")]
    return (name, *about, *bits, *cost)


def summary(before: Mapping[str, Json], after: Mapping[str, Json]) -> list[str]:
    """Means over the cases that both have, and which answers are certain and wrong, or missing."""
    names = [name for name in after if name in before]
    lines = [f"{len(names)} of {len(before)} frozen cases compared"]
    for title, score in (("verdict", verdict_bits), ("anchors", anchor_bits)):
        pairs = [(score(before[name]), score(after[name])) for name in names]
        known = [(a, b) for a, b in pairs if a is not None and b is not None]
        if known:
            old, new = (sum(values) / len(known) for values in zip(*known, strict=True))
            worst = min(b - a for a, b in known)
            lines.append(
                f"{title}: mean log2 probability of the truth {old:.3f} -> {new:.3f}; worst change {worst:.2f}"
            )
    lines.append(
        _cost(before, after, [name for name in names if before[name]["trajectories"] and after[name]["trajectories"]])
    )
    for title, answers in (("frozen", before), ("now", after)):
        wrong = [f"{name} ({what})" for name in names for what in certain_and_wrong(answers[name])]
        lines.append(f"certain (95 %) and wrong, {title}: {', '.join(wrong) or 'none'}")
    failed = [name for name in names if after[name]["diagnosis"] is None]
    return [*lines, f"without an answer now: {', '.join(failed) or 'none'}"]


def _cost(before: Mapping[str, Json], after: Mapping[str, Json], names: list[str]) -> str:
    """Forward trajectories of the cases that have some, and CPU seconds."""
    old, new = ([sum(answers[name]["trajectories"].values()) for name in names] for answers in (before, after))
    cpu = [sum(answers[name]["cpu_seconds"] for name in names) for answers in (before, after)]
    middle = f"{median(old):.0f} -> {median(new):.0f}" if names else "none"
    return f"forward trajectories: median {middle}, sum {sum(old):.0f} -> {sum(new):.0f}; CPU s {cpu[0]:.0f} -> {cpu[1]:.0f}"


def _bits(probability: float) -> float:
    return max(FLOOR, math.log2(min(probability, 1.0))) if probability > 0 else FLOOR


def _value(answer: Json, of: str) -> str:
    if answer["diagnosis"] is None:
        return "failed"
    value = answer["diagnosis"][of]
    if isinstance(value, float):
        return f"{value:.3f}"
    return " ".join(value) if isinstance(value, list) else str(value)


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.2f}"


def _solves(answer: Json) -> str:
    return "-" if answer["trajectories"] is None else f"{sum(answer['trajectories'].values()):.0f}"


def _seconds(answer: Json) -> str:
    return f"{answer.get('cpu_seconds') or answer['seconds']:.0f}"
