"""The verdict of a run: one sentence, and the few numbers that go with it."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

from bcid.base.units import falls, for_people, percent, uncertain
from bcid.report import exploration_picture as exploration
from bcid.report.found import Found
from bcid.report.text import amount, listed, model_name, patches, plain
from bcid.results.common_rows import InputUncertaintyRow, ParameterRow
from bcid.results.diagnosis_record import DiagnosisRecord, SelectedEffect, TimeHistory
from bcid.results.exploration_record import ExplorationRecord
from bcid.results.identification_record import IdentificationRecord
from bcid.results.words import NO_EFFECTS, exceeding, not_adequate_either

# Amounts of an effect that a reader looks for first.
_AMOUNTS = 3
_GOES_ON = ["The same command goes on where it was."]


@dataclass(frozen=True)
class Verdict:
    """What came out.

    Attributes:
        sentence: the whole in one sentence.
        numbers: name and value of what a reader looks for first.
        doubts: what must be known beside it.
    """

    sentence: str
    numbers: list[tuple[str, str]] = field(default_factory=list)
    doubts: list[str] = field(default_factory=list)


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
    sentence = _conclusion(found, d)
    if begins := d.change_point:
        sentence += f" It is not there from the start, and shows by step {begins.step} of action {begins.action}."
    return Verdict(_capital(sentence), _numbers(found, d), _doubts(d))


def _conclusion(found: Found, d: DiagnosisRecord) -> str:
    noise, models = d.noise_rms, d.model_sequence
    first, last = models[0], models[-1]
    held = f"{_body(found)} is held at {patches(d.anchored)}, and " if _asks(found) else ""
    model, left = model_name(last.model), f"{last.rms:.3g} mm, where the noise is {noise:.3g} mm"
    if d.verdict == "none":
        words = {True: "is adequate", None: "has nothing against it"}
        word = words.get(d.adequate, "is not quite adequate, though nothing is seen to be missing")
        return (
            f"{held}the {model} model {word}: it misses the measurement by {left} and the scene may be slightly wrong."
        )
    if d.verdict == "unknown" and d.ranking:
        return f"None of the known effects explains this measurement: the closest model misses it by {left}."
    if d.verdict == "unknown":
        return f"The {model} model is not adequate: it misses the measurement by {left}."
    effects = listed([plain(name) for name in d.verdict.split("+")])
    fitted = next((row.fitted_rms for row in d.ranking if row.effect == d.verdict), None)
    if len(models) > 1:
        fitted = last.rms
    after = f"the error is {last.rms:.3g} mm"
    if fitted is not None:
        after = f"with it the error {falls(first.rms, fitted, noise, 'mm')}"
    whose = f"{held}its" if held else "the"
    return f"{whose} {'plain ' if len(models) > 1 else ''}model lacks {effects}: {after} (noise {noise:.3g} mm)."


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


def _doubts(d: DiagnosisRecord) -> list[str]:
    doubts = []
    if d.noise_warning:
        doubts.append(f"{_capital(d.noise_warning)}.")
    if not d.noise_stated:
        text = (
            "No noise is stated: it was estimated from the measurement itself, so that no model can be called adequate."
        )
        doubts.append(text)
    if d.adequate is False and set(d.verdict.split("+")) <= {one.effect for one in d.selected_effects}:
        doubts.append(not_adequate_either(d.p_value))
    doubts += [
        *_remarks(d.remarks),
        *(f"Note: {warning}" for warning in d.warnings),
        *wrong_inputs(d.input_uncertainties),
    ]
    if d.ambiguous_with:
        others = [NO_EFFECTS.get(name) or plain(name) for name in d.ambiguous_with]
        doubts.append(f"These data cannot tell it from {listed(others)}.")
    if d.anchors_certain is False:
        doubts.append("These data do not tell for certain which patches hold the body.")
    return doubts


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]


def _remarks(texts: Sequence[str]) -> list[str]:
    """What is odd about the measurement."""
    return [f"Look at this first: {text}." for text in texts]


def wrong_inputs(rows: Sequence[InputUncertaintyRow]) -> list[str]:
    """By how much more the scene is wrong than it says."""
    return [f"{_capital(text)}." for text in exceeding(rows)]


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
    told = amount(name, number)
    key, _, value = told.partition(" = " if " = " in told else ": ")
    return f"{plain(effect)}: {key}", value


def _identification(found: Found, d: IdentificationRecord) -> Verdict:
    noise = d.noise_rms
    left = f"{d.rms:.3g} mm" + (f", where the noise is {noise:.3g} mm" if noise else "")
    held = f"{_body(found)} is held at {patches(d.anchored)}, with probability {percent(d.probability)}; the model"
    sentence = f"{held if _asks(found) else 'The model'} misses the measurement by {left}."
    doubts = _remarks(d.remarks)
    if not noise:
        doubts.append("No noise is stated: whether this set explains the measurement cannot be told.")
    elif not d.adequate:
        best = patches(d.anchored)
        sentence = f"No set of anchors explains this measurement: the best, {best}, misses it by {left}."
        doubts.append("Probabilities compare the sets with each other only; see bcid explain for what may be missing.")
    doubts += wrong_inputs(d.input_uncertainties)
    if d.outliers:
        doubts.append(f"Left out, for they do not go with the body: fiducials {', '.join(d.outliers)}.")
    for names in d.not_converged:
        text = "could not be followed to the end, and may be the answer by the frames before."
        doubts.append(f"{patches(names)} {text}")
    numbers = [("anchored", " ".join(d.anchored) or "none"), ("probability", percent(d.probability))]
    numbers.append(("residual", f"{d.rms:.3g} mm"))
    numbers += [("noise", f"{noise:.3g} mm")] if noise else []
    numbers += (
        [("something is missing", percent(d.discrepancy_probability))] if d.discrepancy_probability is not None else []
    )
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
