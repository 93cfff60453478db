"""The verdict of a run: one sentence, and the few numbers that go with it."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

from bcid.base.units import for_people, percent, uncertain
from bcid.report import exploration_picture as exploration
from bcid.report.found import Found
from bcid.report.text import amount, patches
from bcid.results import diagnosis_words, identification_words
from bcid.results.common_rows import ParameterRow
from bcid.results.diagnosis_record import DiagnosisRecord, SelectedEffect, TimeHistory
from bcid.results.exploration_record import ExplorationRecord
from bcid.results.identification_record import IdentificationRecord
from bcid.results.words import plain

# Amounts of an effect that a reader looks for first.
_AMOUNTS = 3
_GOES_ON = ["The same command goes on where it was."]


@dataclass(frozen=True)
class Verdict:
    """What came out.

    Attributes:
        sentence: the whole in one sentence.
        lead: what follows from it.
        numbers: name and value of what a reader looks for first.
        doubts: what must be known beside it.
    """

    sentence: str
    numbers: list[tuple[str, str]] = field(default_factory=list)
    doubts: list[str] = field(default_factory=list)
    lead: str = ""


def verdict(found: Found) -> Verdict:
    """The verdict of a run of any kind and state; raises whatever damaged files make it raise."""
    if found.state == "failed":
        reason = str(found.record.get("reason", "no reason is noted"))
        return Verdict(f"This run ended early: {reason.rstrip('.')}.", doubts=_GOES_ON)
    if found.state != "finished":
        return Verdict("This run is not finished, or was killed.", doubts=_GOES_ON)
    for name, said in _KINDS.items():
        if (one := getattr(found, name)) is not None:
            return said(found, one)
    first = next((line for line in found.summary.splitlines() if line.strip()), "")
    return Verdict(first or "The run holds no result that a report can show.")


def _body(found: Found) -> str:
    return f"The {found.scene}" if found.scene else "The body"


def _asks(found: Found) -> bool:
    """Whether the scene has candidate patches; a run that did not search for anchors does not say it."""
    return found.identification is None or bool(found.identification.patches)


def _diagnosis(found: Found, d: DiagnosisRecord) -> Verdict:
    first, *more = diagnosis_words.conclusion(d)
    sentence, stop, lead = first.partition(". ")
    texts = (*more, *diagnosis_words.warnings(d), *diagnosis_words.open_questions(d))
    doubts = [_capital(text.strip()) for text in texts]
    notes = [*_remarks(d.remarks), *(f"Note: {warning}" for warning in d.warnings)]
    return Verdict(sentence + stop.strip(), _numbers(found, d), [*doubts, *notes], lead)


def _numbers(found: Found, d: DiagnosisRecord) -> list[tuple[str, str]]:
    models = d.model_sequence
    errors = {"error before": models[0].rms, "error after": models[-1].rms}
    if len(models) == 1:
        errors = {"error": models[0].rms}
    errors["noise"] = d.noise_rms
    numbers = [(name, f"{value:.3g} mm") for name, value in errors.items()]
    if d.verdict_probability is not None:
        numbers.append(("probability", percent(d.verdict_probability)))
    if d.anchors_probability is not None and _asks(found):
        numbers.append(("of the anchors", percent(d.anchors_probability)))
    if d.held_out_rms is not None:
        numbers.append(("held out", f"{d.held_out_rms:.3g} mm"))
    for one in d.selected_effects:
        known = [(name, number) for name, number in one.parameters.items() if number.value is not None]
        numbers += _swings(d, one) or [_pair(one.effect, *pair) for pair in known[:_AMOUNTS]]
    return numbers


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]


def _remarks(texts: Sequence[str]) -> list[str]:
    """What is odd about the measurement."""
    return [f"Look at this first: {text}." for text in texts]


def _swings(d: DiagnosisRecord, one: SelectedEffect) -> list[tuple[str, str]]:
    """Between which values the amounts of an effect go, if they follow courses: of those that move most, in their errors."""
    effect = one.effect.removesuffix("_in_time"), one.place
    courses = [row for row in d.time_histories if (row.effect, row.place) == effect]
    found = []
    for row in sorted(courses, key=lambda row: -_moves(row))[:_AMOUNTS]:
        (low, _, _), (high, _, unit) = (for_people(end(row.values), None, row.unit) for end in (min, max))
        told = f"{uncertain(low)} to {uncertain(high, None, unit)}"
        found.append((f"{plain(row.effect)}: {plain(row.amount)}", told))
    return found


def _moves(course: TimeHistory) -> float:
    """By how many of its largest standard errors an amount goes up and down; 0 where one is not known."""
    errors = [error or math.inf for error in course.stderr]
    return float((max(course.values) - min(course.values)) / max(errors))


def _pair(effect: str, name: str, number: ParameterRow) -> tuple[str, str]:
    value = amount(name, number).removeprefix(plain(name)).removeprefix(" =").strip()
    return f"{plain(effect)}: {plain(name)}", value


def _identification(found: Found, d: IdentificationRecord) -> Verdict:
    noise = d.noise_rms
    left = f"{d.rms:.3g} mm" + (f", where the noise is {noise:.3g} mm" if noise else "")
    held = f"{_body(found)} is held at {patches(d.anchored)}, with probability {percent(d.probability)}; the model"
    sentence = f"{held if _asks(found) else 'The model'} misses the measurement by {left}."
    doubts = [*_remarks(d.remarks), *(_capital(text) for text in identification_words.warnings(d))]
    if not d.adequate and noise:
        sentence = f"No set of anchors explains this measurement: the best, {patches(d.anchored)}, misses it by {left}."
    numbers = [("anchored", " ".join(d.anchored) or "none"), ("probability", percent(d.probability))]
    numbers.append(("residual", f"{d.rms:.3g} mm"))
    numbers += [("noise", f"{noise:.3g} mm")] if noise else []
    p = d.discrepancy_probability
    numbers += [("something is missing", percent(p))] if p is not None else []
    return Verdict(sentence, [*numbers, ("certified", "yes" if d.certified else "no")], doubts)


def _exploration(_: Found, d: ExplorationRecord) -> Verdict:
    numbers = [("anchored", " ".join(d.anchored) or "none"), ("probability", percent(d.probability))]
    numbers += [("pulls", str(len(d.steps))), ("entropy", f"{d.entropy:.2g} bits")]
    numbers += [("effect", plain(d.effect))] if d.effect else []
    return Verdict(f"{_capital(exploration.title(d))}.", numbers)


def _calibration(_: Found, d: dict[str, Any]) -> Verdict:
    numbers = [("error", f"{d['error']:.3f} px"), ("baseline", f"{d['baseline']['value'] * 1e3:.2f} mm")]
    numbers += [("angle", f"{d['angle']['value']:.2f} deg"), ("pairs", str(len(d["pairs"])))]
    return Verdict(f"Calibration of two cameras: {d['verdict']}.", numbers)


def _tracking(_: Found, d: dict[str, Any]) -> Verdict:
    share = f"{100 * d['seen']:.1f} %"
    sentence = (
        f"{d['beads']} beads were followed through {d['frames']} pairs of images: {share} of their positions are known."
    )
    numbers = [("standard deviation", f"{d['sigma'] * 1e3:.2g} mm"), ("seen", share)]
    return Verdict(sentence, numbers, [str(warning) for warning in d["warnings"]])


_KINDS: dict[str, Callable[[Found, Any], Verdict]] = {
    "diagnosis": _diagnosis,
    "identification": _identification,
    "exploration": _exploration,
    "calibration": _calibration,
    "tracking": _tracking,
}


def lacking(found: Found) -> list[str]:
    """What a run has not, and which command would make it: sentences."""
    if found.command == "study":
        return ["a body, residuals and models: a study is told by its table"]
    if found.command in ("calibrate", "track"):
        return [f"a body, anchors and models: bcid {found.command} makes what bcid identify starts from"]
    if found.state != "finished":
        return ["its result: the same command goes on where it was"]
    body, explored = found.body is not None and found.positions is not None, found.exploration is not None
    diagnosis = found.diagnosis
    texts = {
        "the body in 3-D and residuals: give a pull of steps/ to bcid identify or explain": explored and not body,
        "the body in 3-D and residuals: body.nc or the positions are not in the folder": not explored and not body,
        "a sequence of models and missing effects: bcid diagnose RUN makes them": not explored and diagnosis is None,
        "a table of missing effects: none was ranked; bcid diagnose RUN does it": diagnosis is not None
        and not diagnosis.ranking,
        "probabilities of the patches: they are in the run of bcid identify or explain that it started from": not explored
        and found.identification is None,
        "posterior by pull: bcid explore makes it": not explored,
    }
    return [text for text, lacks in texts.items() if lacks]
