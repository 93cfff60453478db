"""Scores of the hidden study: truths against diagnoses, from result files alone."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Any

import numpy as np

from validation.synthetic.judge import QUESTIONS, VISIBLE, Verdicts, hidden, judge, named
from validation.synthetic.told import calibration
from validation.synthetic.wilson import rate

Json = Mapping[str, Any]
Judged = Sequence[tuple[Json, Verdicts]]

SIZE_BINS = (0.5, 1.0, 2.0, 3.0, 5.0, 20.0)
# Noise, mm.
NOISE_BINS = (0.02, 0.05, 0.1, 0.2, 0.3, 0.5)


@dataclass(frozen=True)
class RateGoal:
    """A rate that shall be reached.

    Attributes:
        question: whose answers are counted.
        least, most: the rate, at least and at most; None where the rate is only told.
        nuisances: of the cases that count; None for all.
        noise: statements of the noise of the cases that count; () for all.
    """

    question: str
    least: float | None
    most: float = 1.0
    nuisances: bool | None = None
    noise: tuple[str, ...] = ()

    def asks(self, truth: Json) -> bool:
        """Whether a case counts."""
        under = truth["conditions"]
        return self.nuisances in (None, under["nuisances"]) and (not self.noise or under["noise"] in self.noise)


GOALS = {
    "named": RateGoal("named", 0.95, nuisances=False),
    "first": RateGoal("first", 0.90, nuisances=False),
    "first two": RateGoal("first two", 0.99, nuisances=False),
    "parameters": RateGoal("parameters", 0.90, nuisances=False),
    "intervals": RateGoal("intervals", 0.93, 0.97, noise=("right", "unstated")),
    "stiffness": RateGoal("stiffness", 0.93, 0.97),
    "held out": RateGoal("held out", 0.95, nuisances=False),
    "held out, mesh": RateGoal("held out, mesh", None, nuisances=False),
    "adequate": RateGoal("adequate", 0.93, 0.97, noise=("right",)),
    "not misnamed": RateGoal("not misnamed", 0.95),
    "both": RateGoal("both", 0.70, nuisances=False),
    "anchors": RateGoal("anchors", 0.95, nuisances=False),
    "named, inexact": RateGoal("named", 0.85, nuisances=True),
    "settled, inexact": RateGoal("settled", 0.97, nuisances=True),
    "no false name, inexact": RateGoal("no false name", 0.95, nuisances=True),
    "held out, inexact": RateGoal("held out", None, nuisances=True),
    "noise told": RateGoal("noise told", 0.95),
    "noise trusted": RateGoal("noise trusted", 0.95),
}
# Expected calibration error, part of the sure answers that are wrong, and CPU seconds of a diagnosis, at most.
CALIBRATED, SURE_AND_WRONG, MEDIAN, LARGEST = 0.05, 0.03, 20.0, 120.0


def scores(results: Sequence[Json]) -> dict[str, Any]:
    """Rates for the goals, by body, conditions, size, noise and effect, calibration, confusion, and what it took."""
    made = [(result["truth"], judge(result)) for result in results if result["truth"] is not None]
    asked = [(t, v) for t, v in made if t["kind"] == "none" or t["size"] >= VISIBLE]
    hiding = [(t, v) for t, v in made if t["kind"] != "none"]
    singles = [(t, v) for t, v in asked if t["kind"] in ("one", "outside")]
    return {
        "cases": len(results),
        "states": dict(Counter(result["state"] for result in results)),
        "failures": {str(r["index"]): r["reason"] for r in results if r["state"] != "done"},
        "rates": {name: _reached(goal, asked) for name, goal in GOALS.items()},
        "calibration": calibration(results),
        "by_body": _split(asked, lambda t: t["body"]),
        "by_nuisances": _split(asked, lambda t: "on" if t["conditions"]["nuisances"] else "off"),
        "by_noise_statement": _split(asked, lambda t: t["conditions"]["noise"]),
        "by_mesh": _split(asked, lambda t: t["conditions"]["mesh"]),
        "by_size": _binned([(t["size"], v) for t, v in hiding], SIZE_BINS),
        "by_noise": _binned([(t["noise"] * 1e3, v) for t, v in asked], NOISE_BINS),
        "by_effect": _split(singles, lambda t: hidden(t)[0]),
        "confusion": confusion(results),
        "cpu_seconds": _seconds(results),
    }


def _reached(goal: RateGoal, asked: Judged) -> dict[str, Any]:
    answers = list(chain.from_iterable(v[goal.question] for t, v in asked if goal.asks(t)))
    found = rate(answers)
    met = None
    if goal.least is not None and answers:
        met = goal.least <= found["rate"] <= goal.most
    return found | {"question": goal.question, "goal": goal.least, "most": goal.most, "reached": met}


def _seconds(results: Sequence[Json]) -> dict[str, Any] | None:
    """CPU seconds of the diagnoses; one that ran out of time took longer than any."""
    took = [r["cpu_seconds"] for r in results if r["diagnosis"] is not None]
    took += [math.inf for r in results if r["state"] == "timeout"]
    if not took:
        return None
    # JSON has no infinity.
    median, largest = (value if math.isfinite(value) else None for value in (float(np.median(took)), max(took)))
    return {"median": median, "largest": largest}


def _all(verdicts: Sequence[Verdicts]) -> dict[str, Any]:
    """Rates of the questions that were asked."""
    rates = {name: rate(list(chain.from_iterable(v[name] for v in verdicts))) for name in QUESTIONS}
    return {name: found for name, found in rates.items() if found["count"]}


def _split(made: Judged, group: Callable[[Json], str]) -> dict[str, Any]:
    """Rates by group."""
    names = sorted({group(truth) for truth, _ in made})
    return {name: _all([v for t, v in made if group(t) == name]) for name in names}


def _binned(made: Sequence[tuple[float, Verdicts]], edges: Sequence[float]) -> list[dict[str, Any]]:
    """Rates by the bin of a number; the first and last bin take what lies beyond the edges."""
    place = np.clip(np.digitize([x for x, _ in made], edges) - 1, 0, len(edges) - 2)
    return [
        {
            "from": edges[k],
            "to": edges[k + 1],
            "rates": _all([v for p, (_, v) in zip(place, made, strict=True) if p == k]),
        }
        for k in range(len(edges) - 1)
    ]


def confusion(results: Sequence[Json]) -> dict[str, dict[str, int]]:
    """How often what was hidden (by size: below 3 noises it is marked "small") was given which verdict."""
    counts: dict[str, Counter[str]] = {}
    for result in results:
        truth, diagnosis = result["truth"], result["diagnosis"]
        if truth is None:
            continue
        small = truth["kind"] != "none" and truth["size"] < VISIBLE
        true = "+".join(hidden(truth)) + (", small" if small else "")
        verdict = result["state"] if diagnosis is None else "+".join(named(diagnosis))
        counts.setdefault(true, Counter())[verdict] += 1
    return {true: dict(sorted(counts[true].items(), key=lambda item: -item[1])) for true in sorted(counts)}
