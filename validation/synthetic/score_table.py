"""The scores of the hidden study as text."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from validation.synthetic.judge import QUESTIONS, VISIBLE
from validation.synthetic.score import CALIBRATED, LARGEST, MEDIAN, SURE_AND_WRONG

Json = Mapping[str, Any]
_SPLITS = {
    "body": "by_body",
    "nuisances": "by_nuisances",
    "statement of the noise": "by_noise_statement",
    "mesh": "by_mesh",
}
# A row for each effect, columns for what depends on it.
_OF_EFFECTS = ("named", "first two", "parameters", "intervals", "not misnamed", "anchors")


def table(found: Json) -> str:
    """Goals first, then what the rates depend on."""
    states = ", ".join(f"{count} {state}" for state, count in sorted(found["states"].items()))
    asked = f" of {found['asked']}" if found.get("asked", found["cases"]) > found["cases"] else ""
    lines = [f"Hidden study: {found['cases']}{asked} cases ({states})"]
    lines += _seconds(found["cpu_seconds"])
    lines += ["", f"Cases with effects of at least {VISIBLE:g} times the noise, and those without any:", ""]
    lines.append(f"{'':24}{'goal':>11}{'rate':>7}{'cases':>9}   95 % interval   met")
    lines += [_goal(name, rate) for name, rate in found["rates"].items()]
    lines += ["", *(f"{name:16}{about}" for name, about in QUESTIONS.items())]
    lines += _calibration(found["calibration"])
    for title, key in _SPLITS.items():
        lines += _columns(f"By {title}:", found[key])
    for title, key in (("size (noises)", "by_size"), ("noise (mm)", "by_noise")):
        lines += _columns(f"By {title}:", {f"{b['from']:g} to {b['to']:g}": b["rates"] for b in found[key]})
    lines += ["", "By effect:", "", f"{'':20}" + "".join(f"{question:>14}" for question in _OF_EFFECTS)]
    lines += [
        f"{name:20}" + "".join(_cell(rates, q) for q in _OF_EFFECTS) for name, rates in found["by_effect"].items()
    ]
    lines += ["", "Verdicts (how often) by what was hidden:", ""]
    lines += [
        f"{true:32}" + ", ".join(f"{verdict} {count}" for verdict, count in verdicts.items())
        for true, verdicts in found["confusion"].items()
    ]
    if found["failures"]:
        lines += ["", "Cases without a diagnosis:", ""]
        lines += [f"{index:>6}  {reason}" for index, reason in found["failures"].items()]
    return "\n".join(lines) + "\n"


def _met(reached: bool | None) -> str:
    return {None: "-", True: "yes", False: "NO"}[reached]


def _seconds(cpu: Json | None) -> list[str]:
    if cpu is None:
        return []
    parts = []
    for name, goal in (("median", MEDIAN), ("largest", LARGEST)):
        told = "out of time" if cpu[name] is None else f"{cpu[name]:.0f}"
        parts.append(f"{name} {told} (goal {goal:.0f}: {_met(cpu[name] is not None and cpu[name] <= goal)})")
    return [f"CPU seconds of a diagnosis: {', '.join(parts)}"]


def _goal(name: str, rate: Json) -> str:
    least, most = rate["goal"], rate["most"]
    goal = "-" if least is None else f"{least:.0%}" if most == 1 else f"{least:.0%}-{most:.0%}"
    if rate["rate"] is None:
        return f"{name:24}{goal:>11}{'-':>7}{'0':>9}   {'':15} -"
    count, interval = f"{rate['met']}/{rate['count']}", f"{rate['low']:.0%} to {rate['high']:.0%}"
    return f"{name:24}{goal:>11}{rate['rate']:>7.0%}{count:>9}   {interval:15} {_met(rate['reached'])}"


def _calibration(found: Json) -> list[str]:
    """Of verdicts and anchored sets together."""
    if not found["count"]:
        return ["", "No diagnosis told how probable its answers are."]
    error, sure = found["expected_error"], found["sure_and_wrong"]
    lines = ["", "Told probabilities of verdicts and of anchored sets, and how often they were right (all sizes):", ""]
    lines.append(f"{'told':16}{'on average':>12}{'right':>8}{'answers':>9}   95 % interval")
    for b in found["bins"]:
        name = f"{b['from']:g} to {b['to']:g}"
        if b["count"]:
            told, interval = f"{b['told']:.1%}", f"{b['low']:.0%} to {b['high']:.0%}"
            lines.append(f"{name:16}{told:>12}{b['rate']:>8.0%}{b['count']:>9}   {interval}")
        else:
            lines.append(f"{name:16}{'-':>12}{'-':>8}{0:>9}")
    reached = f"goal {CALIBRATED:g}: {_met(error <= CALIBRATED)}"
    lines += ["", f"expected calibration error {error:.3f} ({reached}); by chance alone {found['by_chance']:.3f}"]
    if sure["count"]:
        reached = _met(sure["rate"] <= SURE_AND_WRONG)
        count = f"{sure['met']} of {sure['count']}"
        lines.append(
            f"told with 95 % or more and wrong: {count}, {sure['rate']:.1%} (goal {SURE_AND_WRONG:.0%}: {reached})"
        )
    return lines


def _columns(title: str, groups: Mapping[str, Json]) -> list[str]:
    """A row for each question, a column for each group."""
    asked: Sequence[str] = [q for q in QUESTIONS if any(q in rates for rates in groups.values())]
    lines = ["", title, "", f"{'':16}" + "".join(f"{name:>14}" for name in groups)]
    return lines + [f"{q:16}" + "".join(_cell(rates, q) for rates in groups.values()) for q in asked]


def _cell(rates: Json, question: str) -> str:
    told = f"{rates[question]['rate']:.0%} of {rates[question]['count']}" if question in rates else "-"
    return f"{told:>14}"
