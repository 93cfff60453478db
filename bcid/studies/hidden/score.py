"""Scores of the hidden study: truths against diagnoses, from result files alone."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from scipy.stats import binomtest

Result = Mapping[str, Any]
Verdicts = dict[str, bool | None]

# From this size on (in units of noise) the goals hold.
VISIBLE = 3.0
SIZE_BINS = (0.5, 1.0, 2.0, 3.0, 5.0, 20.0)
# Noise, mm.
NOISE_BINS = (0.1, 0.2, 0.3, 0.4, 0.5)
NEAR, DEGREES, HELD_OUT = 0.2, 15.0, 1.2

# What is asked for each case, and the part of the cases for which it shall be so.
GOALS = {
    "named": (0.90, "one effect: the verdict is that effect"),
    "first": (0.90, "one effect: it is ranked first"),
    "first two": (0.97, "one effect: it is among the first two"),
    "parameters": (0.90, "one effect: amounts within 20 %, directions within 15 deg, places right"),
    "held out": (0.90, "one, two or none: held-out error at most 1.2 times the noise"),
    "adequate": (0.95, "nothing hidden: the model is called adequate"),
    "not misnamed": (0.90, "outside the catalogue: the verdict is 'unknown', or 'none'"),
    "both": (0.70, "two effects: the verdict names both"),
    "anchors": (0.95, "every case: the anchored patches are right"),
}


def judge(result: Result) -> Verdicts:
    """For each goal whether the case meets it; None where the goal does not ask. A case without a diagnosis meets none."""
    truth, diagnosis = result["truth"], result["diagnosis"]
    verdicts: Verdicts = dict.fromkeys(GOALS)
    if truth is None:
        return verdicts
    for goal, (kinds, met) in _JUDGES.items():
        if truth["kind"] in kinds:
            verdicts[goal] = diagnosis is not None and met(truth, diagnosis)
    return verdicts


def named(diagnosis: Mapping[str, Any]) -> list[str]:
    """Effects of the verdict without their places, sorted: "gravity+soft_anchor(7)" gives gravity, soft_anchor."""
    return sorted(part.split("(")[0].strip() for part in str(diagnosis["verdict"]).split("+"))


def hidden(truth: Mapping[str, Any]) -> list[str]:
    """Names of the hidden effects, sorted; ["none"] if there is none."""
    return sorted(effect["effect"] for effect in truth["effects"]) or ["none"]


def ranked(diagnosis: Mapping[str, Any], count: int) -> list[str]:
    """The first names of the ranking, each once."""
    names = diagnosis.get("first_ranked") or [entry["effect"] for entry in diagnosis["ranking"]]
    return list(dict.fromkeys(str(name).split("(")[0].strip() for name in names))[:count]


def _named(truth: Mapping[str, Any], diagnosis: Mapping[str, Any]) -> bool:
    return named(diagnosis) == hidden(truth)


def _among(count: int) -> Callable[[Mapping[str, Any], Mapping[str, Any]], bool]:
    return lambda truth, diagnosis: hidden(truth)[0] in ranked(diagnosis, count)


def _held_out(truth: Mapping[str, Any], diagnosis: Mapping[str, Any]) -> bool:
    error, noise = diagnosis.get("held_out_rms"), diagnosis.get("noise_rms")
    return error is not None and noise is not None and error <= HELD_OUT * noise


def parameters_right(truth: Mapping[str, Any], diagnosis: Mapping[str, Any]) -> bool:
    """Whether the adopted effect has the amounts, direction and place of the hidden one."""
    effect = truth["effects"][0]
    for entry in diagnosis.get("adopted", ()):
        if str(entry["effect"]).split("(")[0] == effect["effect"]:
            found = {name: _value(value) for name, value in entry["parameters"].items()}
            if entry.get("place", "") != effect["place"] or not set(effect["parameters"]) <= set(found):
                return False
            return _amounts_right(effect, found) and _shapes_right(effect, found)
    return False


def _value(written: Any) -> float:
    value = written["value"] if isinstance(written, Mapping) else written
    return math.nan if value is None else float(value)


def _amounts_right(effect: Mapping[str, Any], found: Mapping[str, float]) -> bool:
    """Their vector, in units of their scales from the neutral values, is within 20 % in length and 15 degrees in direction."""
    amounts = {n: p for n, p in effect["parameters"].items() if p["role"] == "amount"}
    if any(p["reciprocal"] for p in amounts.values()):
        return all(abs(found[n] / p["value"] - 1) <= NEAR for n, p in amounts.items())
    true, seen = (
        np.array([(values[n] - p["neutral"]) / p["scale"] for n, p in amounts.items()])
        for values in ({n: p["value"] for n, p in amounts.items()}, found)
    )
    length = float(np.linalg.norm(true))
    if not abs(np.linalg.norm(seen) - length) <= NEAR * length:
        return False
    cosine = float(true @ seen) / (length * float(np.linalg.norm(seen)))
    return cosine >= math.cos(math.radians(DEGREES))


def _shapes_right(effect: Mapping[str, Any], found: Mapping[str, float]) -> bool:
    """Angles within 15 degrees; a centre no further off than the radius. Time constants and radii are not asked for."""
    parameters = effect["parameters"]
    for name, p in parameters.items():
        if p["role"] == "shape" and p["unit"] == "deg":
            period = p["period"] or 360.0
            off = abs((found[name] - p["value"] + period / 2) % period - period / 2)
            if not off <= DEGREES:
                return False
    # Through the thickness a centre cannot be seen.
    centre = [n for n in ("cx", "cz") if n in parameters]
    off = math.sqrt(sum((found[n] - parameters[n]["value"]) ** 2 for n in centre))
    return not centre or off <= parameters["radius"]["value"]


_JUDGES: dict[str, tuple[tuple[str, ...], Callable[[Mapping[str, Any], Mapping[str, Any]], bool]]] = {
    "named": (("one",), _named),
    "first": (("one",), _among(1)),
    "first two": (("one",), _among(2)),
    "parameters": (("one",), parameters_right),
    "held out": (("none", "one", "two"), _held_out),
    "adequate": (("none",), lambda truth, diagnosis: bool(diagnosis["adequate"]) and named(diagnosis) == ["none"]),
    "not misnamed": (("outside",), lambda truth, diagnosis: named(diagnosis) in (["unknown"], ["none"])),
    "both": (("two",), _named),
    "anchors": (
        ("none", "one", "two", "outside"),
        lambda truth, diagnosis: sorted(diagnosis["anchored"]) == sorted(truth["anchored"]),
    ),
}


def wilson(met: int, count: int) -> tuple[float, float]:
    """95 % interval of a rate (Wilson, J. Am. Stat. Assoc. 22, 1927)."""
    if count == 0:
        return 0.0, 1.0
    interval = binomtest(met, count).proportion_ci(method="wilson")
    return float(interval.low), float(interval.high)


def scores(results: Sequence[Result]) -> dict[str, Any]:
    """Rates for the goals, by size, noise and effect, the confusion matrix, and what the diagnoses took."""
    made = [(result["truth"], judge(result)) for result in results if result["truth"] is not None]
    asked = [(t, v) for t, v in made if t["kind"] == "none" or t["size"] >= VISIBLE]
    rates = {goal: _rate([v[goal] for _, v in asked]) | {"goal": wanted} for goal, (wanted, _) in GOALS.items()}
    hiding = [(t, v) for t, v in made if t["kind"] != "none"]
    noises = [(t["noise"] * 1e3, v) for t, v in asked]
    singles = [(t, v) for t, v in asked if t["kind"] in ("one", "outside")]
    cpu = [result["cpu_seconds"] for result in results if result["diagnosis"] is not None]
    return {
        "cases": len(results),
        "states": dict(Counter(result["state"] for result in results)),
        "failures": {str(r["index"]): r["reason"] for r in results if r["state"] != "done"},
        "rates": rates,
        "by_size": _binned([(t["size"], v) for t, v in hiding], SIZE_BINS),
        "by_noise": _binned(noises, NOISE_BINS),
        "by_effect": {name: _all([v for t, v in singles if hidden(t) == [name]]) for name in _names(singles)},
        "confusion": confusion(results),
        "cpu_seconds": {"median": float(np.median(cpu)), "largest": max(cpu)} if cpu else None,
    }


def _names(made: Sequence[tuple[Mapping[str, Any], Verdicts]]) -> list[str]:
    return sorted({hidden(truth)[0] for truth, _ in made})


def _rate(verdicts: Sequence[bool | None]) -> dict[str, Any]:
    asked = [verdict for verdict in verdicts if verdict is not None]
    low, high = wilson(sum(asked), len(asked))
    rate = sum(asked) / len(asked) if asked else None
    return {"met": sum(asked), "count": len(asked), "rate": rate, "low": low, "high": high}


def _all(verdicts: Sequence[Verdicts]) -> dict[str, Any]:
    """Rates of the goals that were asked."""
    rates = {goal: _rate([verdict[goal] for verdict in verdicts]) for goal in GOALS}
    return {goal: rate for goal, rate in rates.items() if rate["count"]}


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


def confusion(results: Sequence[Result]) -> dict[str, dict[str, int]]:
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


# -- the table
# ------------------------------------------------------------------------------------------------------------------


def table(found: Mapping[str, Any]) -> str:
    """The scores as text."""
    states = ", ".join(f"{count} {state}" for state, count in sorted(found["states"].items()))
    lines = [f"Hidden study: {found['cases']} cases ({states})"]
    if found["cpu_seconds"]:
        cpu = found["cpu_seconds"]
        lines.append(f"CPU seconds of a diagnosis: median {cpu['median']:.0f}, largest {cpu['largest']:.0f}")
    lines += ["", f"Cases with effects of at least {VISIBLE:g} times the noise, and those without any:", ""]
    lines.append(f"{'':14}{'goal':>6}{'rate':>7}{'cases':>9}   95 % interval   met")
    lines += [_goal_line(goal, rate) for goal, rate in found["rates"].items()]
    lines += ["", *(f"{goal:14}{about}" for goal, (_, about) in GOALS.items())]
    for title, key, unit in (("size (noises)", "by_size", ""), ("noise (mm)", "by_noise", "")):
        lines += ["", f"By {title}:", "", f"{'':14}" + "".join(f"{goal:>14}" for goal in GOALS)]
        lines += [_row(f"{b['from']:g} to {b['to']:g}{unit}", b["rates"]) for b in found[key]]
    lines += ["", "By effect:", "", f"{'':20}" + "".join(f"{goal:>14}" for goal in GOALS)]
    lines += [_row(name, rates, 20) for name, rates in found["by_effect"].items()]
    lines += ["", "Verdicts (how often) by what was hidden:", ""]
    lines += [
        f"{true:32}" + ", ".join(f"{verdict} {count}" for verdict, count in verdicts.items())
        for true, verdicts in found["confusion"].items()
    ]
    if found["failures"]:
        lines += ["", "Cases without a diagnosis:", ""]
        lines += [f"{index:>6}  {reason}" for index, reason in found["failures"].items()]
    return "\n".join(lines) + "\n"


def _goal_line(goal: str, rate: Mapping[str, Any]) -> str:
    if rate["rate"] is None:
        return f"{goal:14}{rate['goal']:>6.0%}{'-':>7}{'0':>9}   {'':15} -"
    met = "yes" if rate["rate"] >= rate["goal"] else "NO"
    count, interval = f"{rate['met']}/{rate['count']}", f"{rate['low']:.0%} to {rate['high']:.0%}"
    return f"{goal:14}{rate['goal']:>6.0%}{rate['rate']:>7.0%}{count:>9}   {interval:15} {met}"


def _row(name: str, rates: Mapping[str, Any], width: int = 14) -> str:
    cells = (f"{rates[g]['rate']:.0%} of {rates[g]['count']}" if g in rates else "-" for g in GOALS)
    return f"{name:{width}}" + "".join(f"{cell:>14}" for cell in cells)
