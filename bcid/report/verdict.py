"""The verdict of a run: one sentence, and the few numbers that go with it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from bcid.base.units import falls, for_people, percent, uncertain
from bcid.base.verdict_words import NO_EFFECTS, not_adequate_either, used_up
from bcid.report import exploration_picture as exploration
from bcid.report.found import Found
from bcid.report.text import amount, listed, model_name, patches, plain

# Of a run that does not say itself whether the set explains the measurement: a residual of so many times the noise does not.
_EXPLAINED = 2.0


@dataclass(frozen=True)
class Verdict:
    """What came out.

    Attributes:
        sentence: the whole in one sentence.
        numbers: name and value of what a reader looks for first.
        doubts: what must be known beside it.
    """

    sentence: str
    numbers: list[tuple[str, str]]
    doubts: list[str]


def verdict(found: Found) -> Verdict:
    """The verdict of a run of any kind and state; raises whatever damaged files make it raise."""
    if found.state == "failed":
        reason = str(found.record.get("reason", "no reason is noted"))
        return Verdict(f"This run ended early: {reason.rstrip('.')}.", [], ["The same command goes on where it was."])
    if found.state != "finished":
        return Verdict("This run is not finished, or was killed.", [], ["The same command goes on where it was."])
    documents = found.documents
    if "diagnosis" in documents:
        return _diagnosis(found, documents["diagnosis"])
    if "identification" in documents:
        return _identification(found, documents["identification"])
    if "exploration" in documents:
        return _exploration(documents["exploration"])
    if "calibration" in documents:
        return _calibration(documents["calibration"])
    if "tracking" in documents:
        return _tracking(documents["tracking"])
    first = next((line for line in found.summary.splitlines() if line.strip()), "")
    return Verdict(first or "The run holds no result that a report can show.", [], [])


def _body(found: Found) -> str:
    return f"The {found.scene}" if found.scene else "The body"


def _asks(found: Found) -> bool:
    """Whether the scene has candidate patches (an older run folder does not say, and has)."""
    return found.documents.get("identification", {}).get("patches", True) != {}


def _diagnosis(found: Found, d: dict[str, Any]) -> Verdict:
    unit, noise, ladder = d["length_unit"], d["noise_rms"], d["ladder"]
    held = f"{_body(found)} is held at {patches(d['anchored'])}, and " if _asks(found) else ""
    first, last = ladder[0], ladder[-1]
    left = f"{last['rms']:.3g} {unit}, where the noise is {noise:.3g} {unit}"
    if d["verdict"] == "none":
        word = {
            True: "is adequate",
            False: "is not quite adequate, though nothing is seen to be missing",
            None: "has nothing against it",
        }[d["adequate"]]
        sentence = (
            f"{held}the {model_name(last['model'])} model {word}: it misses the measurement by {left} and the scene may be "
            "slightly wrong."
        )
    elif d["verdict"] == "unknown" and d["ranking"]:
        sentence = f"None of the known effects explains this measurement: the closest model misses it by {left}."
    elif d["verdict"] == "unknown":
        sentence = f"The {model_name(last['model'])} model is not adequate: it misses the measurement by {left}."
    else:
        effects = listed([plain(name) for name in d["verdict"].split("+")])
        fitted = next((row["fitted_rms"] for row in d["ranking"] if row["effect"] == d["verdict"]), None)
        if len(ladder) == 1 and fitted is not None:
            after = f"with it the error {falls(first['rms'], fitted, noise, unit)}"
        elif len(ladder) > 1:
            after = f"with it the error {falls(first['rms'], last['rms'], noise, unit)}"
        else:
            after = f"the error is {last['rms']:.3g} {unit}"
        whose, plainly = f"{held}its" if held else "the", "plain " if len(ladder) > 1 else ""
        sentence = f"{whose} {plainly}model lacks {effects}: {after} (noise {noise:.3g} {unit})."
    if begins := d.get("begins"):
        sentence += f" It is not there from the start, and shows by step {begins['step']} of action {begins['action']}."
    numbers = [("error before", f"{first['rms']:.3g} {unit}")] if len(ladder) > 1 else []
    numbers += [("error after" if numbers else "error", f"{last['rms']:.3g} {unit}"), ("noise", f"{noise:.3g} {unit}")]
    for name, key in (("probability", "verdict_probability"), ("of the anchors", "anchors_probability")):
        if key in d and (key == "verdict_probability" or _asks(found)):
            numbers.append((name, percent(d[key])))
    if d.get("held_out_rms") is not None:
        numbers.append(("held out", f"{d['held_out_rms']:.3g} {unit}"))
    for one in d["adopted"]:
        numbers += (
            _swings(d, one)
            or [_pair(one["effect"], name, p) for name, p in one["parameters"].items() if p["value"] is not None][:3]
        )
    doubts = [*_remarks(d), *(f"Note: {warning}" for warning in d["warnings"])]
    doubts += _used_up(d)
    if d["adequate"] is False and set(d["verdict"].split("+")) <= {one["effect"] for one in d["adopted"]}:
        doubts.insert(0, not_adequate_either(d["p_value"]))
    if not d.get("noise_stated", True):
        doubts.insert(
            0,
            "No noise is stated: it was estimated from the measurement itself, so that no model can be called adequate.",
        )
    if d.get("noise_doubt"):
        doubts.insert(0, f"{d['noise_doubt'][0].upper()}{d['noise_doubt'][1:]}.")
    if d["cannot_be_told_from"]:
        others = [NO_EFFECTS.get(n) or plain(n) for n in d["cannot_be_told_from"]]
        doubts.append(f"These data cannot tell it from {listed(others)}.")
    if not d.get("anchors_certain", True):
        doubts.append("These data do not tell for certain which patches hold the body.")
    return Verdict(f"{sentence[:1].upper()}{sentence[1:]}", numbers, doubts)


def _remarks(d: dict[str, Any]) -> list[str]:
    """What is odd about the measurement."""
    return [f"Look at this first: {text}." for text in d.get("remarks", ())]


def _used_up(d: dict[str, Any]) -> list[str]:
    """By how much more the scene is wrong than it says (an older run folder says it only at length)."""
    larger = [one for one in d.get("nuisances", ()) if one["used_up"]]
    texts = used_up([(one["used_up"], one.get("used_up_briefly", one["used_up"])) for one in larger])
    return [f"{text[0].upper()}{text[1:]}." for text in texts]


def _swings(d: dict[str, Any], one: dict[str, Any]) -> list[tuple[str, str]]:
    """Between which values the amounts of an effect go, if they follow courses: of those that move most, in their errors."""
    courses = [
        row
        for row in d.get("courses", ())
        if (f"{row['effect']}_in_time", row["place"]) == (one["effect"], one["place"])
    ]
    courses.sort(key=lambda row: -_moves(row))
    found = []
    for row in courses[:3]:
        ends = [for_people(end, None, row["unit"]) for end in (min(row["values"]), max(row["values"]))]
        told = f"{uncertain(ends[0][0])} to {uncertain(ends[1][0], None, ends[1][2])}"
        found.append((f"{plain(row['effect'])}: {plain(row['amount'])}", told))
    return found


def _moves(course: dict[str, Any]) -> float:
    """By how many of its largest standard errors an amount goes up and down; 0 where one is not known."""
    errors = [error or math.inf for error in course["stderr"]]
    return float((max(course["values"]) - min(course["values"])) / max(errors))


def _pair(effect: str, name: str, number: dict[str, Any]) -> tuple[str, str]:
    told = amount(name, number)
    key, _, value = told.partition(" = " if " = " in told else ": ")
    return f"{plain(effect)}: {key}", value


def _identification(found: Found, d: dict[str, Any]) -> Verdict:
    unit, noise = d["length_unit"], d["noise_rms"]
    held = (
        f"{_body(found)} is held at {patches(d['anchored'])}, with probability {percent(d['probability'])}; the model"
    )
    misses = f"{held if _asks(found) else 'The model'} misses the measurement by {d['rms']:.3g} {unit}"
    beside = f", where the noise is {noise:.3g} {unit}" if noise else ""
    sentence = f"{misses}{beside}."
    doubts = _remarks(d)
    if not noise:
        doubts.append("No noise is stated: whether this set explains the measurement cannot be told.")
    if noise and not d.get("explains", d["rms"] <= _EXPLAINED * noise):
        sentence = f"No set of anchors explains this measurement: the best, {patches(d['anchored'])}, misses it by "
        sentence += f"{d['rms']:.3g} {unit}, where the noise is {noise:.3g} {unit}."
        doubts.append("Probabilities compare the sets with each other only; see bcid explain for what may be missing.")
    doubts += _used_up(d)
    if d.get("astray"):
        doubts.append(f"Left out, for they do not go with the body: fiducials {', '.join(d['astray'])}.")
    doubts += [
        f"{patches(names)} could not be followed to the end, and may be the answer by the frames before."
        for names in d.get("unfollowed", ())
    ]
    numbers = [("anchored", " ".join(d["anchored"]) or "none"), ("probability", percent(d["probability"]))]
    numbers.append(("residual", f"{d['rms']:.3g} {unit}"))
    numbers += [("noise", f"{noise:.3g} {unit}")] if noise else []
    if d.get("missing") is not None:
        numbers.append(("something is missing", percent(d["missing"])))
    numbers.append(("certified", "yes" if d["certified"] else "no"))
    return Verdict(sentence, numbers, doubts)


def _exploration(d: dict[str, Any]) -> Verdict:
    title = exploration.title(d)
    numbers = [("anchored", " ".join(d["anchored"]) or "none"), ("probability", percent(d["probability"]))]
    numbers += [("pulls", str(len(d["steps"]))), ("entropy", f"{d['entropy']:.2g} bits")]
    if d["effect"]:
        numbers.append(("effect", plain(d["effect"])))
    return Verdict(f"{title[:1].upper()}{title[1:]}.", numbers, [])


def _calibration(d: dict[str, Any]) -> Verdict:
    sentence = f"Calibration of two cameras: {d['verdict']}."
    return Verdict(
        sentence,
        [
            ("error", f"{d['error']:.3f} px"),
            ("baseline", f"{d['baseline']['value'] * 1e3:.2f} mm"),
            ("angle", f"{d['angle']['value']:.2f} deg"),
            ("pairs", str(len(d["pairs"]))),
        ],
        [],
    )


def _tracking(d: dict[str, Any]) -> Verdict:
    share = f"{100 * d['seen']:.1f} %"
    sentence = (
        f"{d['beads']} beads were followed through {d['frames']} pairs of images: {share} of their positions are known."
    )
    numbers = [("standard deviation", f"{d['sigma'] * 1e3:.2g} mm"), ("seen", share)]
    return Verdict(sentence, numbers, [str(warning) for warning in d["warnings"]])
