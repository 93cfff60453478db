"""What a comparison writes: diagnosis, model, missing force, residuals and the summary."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from bcid.base.tails import normal_tail
from bcid.base.units import unit_factor
from bcid.forms.course import course_of
from bcid.forms.gripper_force import ROWS
from bcid.forms.model import Model, Term
from bcid.inference import nuisance_text
from bcid.inference.data import Data
from bcid.inference.hypotheses import patches
from bcid.inference.thresholds import THRESHOLDS
from bcid.measurement import AXES, WRENCH
from bcid.measurement.compared import LeftOut
from bcid.predict.predictor import Predictor
from bcid.search.answer import answer_text, diagnosis_text
from bcid.search.answer.adequacy import groups, judge
from bcid.search.answer.diagnosis import Diagnosis
from bcid.search.answer.explanation import Explanation, ModelStep, Onset, explains
from bcid.search.answer.identify_run import body_parts, inputs_in_words, odd, stiffness_in_words
from bcid.search.answer.source import Source, stored_effect
from bcid.search.answer.where import MissingForce, Place
from bcid.search.fitting import courses, curvature
from bcid.search.fitting.fit import Fit
from bcid.search.fitting.fitted_hypothesis import FittedHypothesis
from bcid.search.fitting.ranking import Ranking
from bcid.search.fitting.state import detailed

MODEL_FORMAT = "bcid-model/1"
Array = NDArray[np.float64]
# So many of the likeliest hypotheses are told.
_HYPOTHESES = 12


def collect(predictor: Predictor, done: Diagnosis) -> dict[str, Any]:
    """Arrays that need every rank: displacements and the parts of the prediction by effect. Collective."""
    state = done.rungs[-1].state
    parts = {}
    for one in state.model.terms:
        without = predictor.predict(state.model.without(one.label), state.anchors)
        parts[one.label] = (state.prediction.positions - without.positions)[:, : len(predictor.scene.fiducials)]
    found, mesh = detailed(state), predictor.forward(state.model).mesh
    return {"parts": parts, "mesh": mesh, "displacement": found.displacement, "energy": found.energy}


def documents(source: Source, done: Diagnosis, content: dict[str, Any]) -> dict[str, Any]:
    """What a run folder holds of a diagnosis, by file name: JSON objects, datasets and texts.

    `content` is what `collect` gave.
    """
    name = source.measurement.units.length
    unit = unit_factor(name, "m")
    shares = {label: float(np.sqrt(np.nanmean(part**2))) for label, part in content["parts"].items()}
    remarks = source.measurement.remarks
    diagnosis = diagnosis_json(done, unit) | {"length_unit": name, "remarks": list(remarks)}
    diagnosis["contributions"] = {label: share / unit for label, share in shares.items()}
    found: dict[str, Any] = {"diagnosis.json": diagnosis, "model.json": model_json(done.rungs[-1], source)}
    if done.explanation is not None:
        found["identification.json"] = done.explanation.identification.to_json(unit) | {"length_unit": name}
    found["residuals.nc"] = residual_dataset(done, content["parts"])
    found["body.nc"] = body_parts(
        source.scene, content["mesh"], content["displacement"], content["energy"], diagnosis["anchored"]
    )
    if done.where is not None:
        found["where.json"] = where_json(done.where, unit) | {"length_unit": name}
    last = done.rungs[-1].state
    left_out = LeftOut.of(last.predictor.whole, last.predictor.measurement, last.predicted)
    diagnosis["left_out"] = left_out.to_json(unit) if left_out else None
    tested = [f"{left_out}."] if left_out else []
    inputs = inputs_in_words(source.scene, source.measurement, content["mesh"])
    lines = [*summary(done, shares, remarks), "", *tested, *inputs]
    return found | {"summary.txt": "\n".join(lines) + "\n"}


def model_json(rung: ModelStep, source: Source) -> dict[str, Any]:
    """The model with its values, from which another run can start."""
    model = rung.state.model
    return {
        "format": MODEL_FORMAT,
        "law": {name: float(value) for name, value in model.law.complete(model.values).items()},
        "effects": [{**stored_effect(d.effect), "place": d.place, "values": dict(d.values)} for d in model.terms],
        "anchored": sorted(rung.state.anchors, key=list(source.scene.patches).index),
        "free": list(rung.state.free),
        "files": [str(path) for path in source.files],
    }


def finite(value: float | None) -> float | None:
    """A number for JSON, which knows no infinity."""
    return None if value is None or not math.isfinite(value) else float(value)


def diagnosis_json(done: Diagnosis, unit: float) -> dict[str, Any]:
    """The content of `diagnosis.json`; lengths in units of `unit` (m)."""
    last = done.rungs[-1]
    state, stiffness = last.state, last.fitted.stiffness
    asked = next((rung for rung in done.rungs if rung.ranking is not None), None)
    order = list(state.predictor.whole.patches)
    found = done.explanation
    if found is not None:
        verdict = found.verdict
    else:
        beyond = state.model.added(Model.of(state.predictor.whole))
        added = "+".join(dict.fromkeys(d.effect.name for d in beyond if _seen(last.fitted, d)))
        adequate = last.adequacy.adequate
        named = adequate or (bool(added) and explains(done.rungs[0].fitted, last.fitted))
        verdict = (added or "none") if named else "unknown"
        if asked is not None and asked.rivals and not adequate:
            first = asked.rivals[0]
            named = judge(first.fitted.state).adequate or explains(last.fitted, first.fitted)
            verdict = first.effect if named else "unknown"
    return (beliefs(found, order) if found is not None else {}) | {
        "adequate": last.adequacy.told,
        "p_value": last.adequacy.p_value,
        "false_alarm_rate": THRESHOLDS.false_alarms,
        "rms": state.rms / unit,
        "noise_rms": state.noise / unit,
        "noise_stated": state.predictor.data.stated,
        "rough_rms": state.rough / unit,
        "nuisances": nuisance_text.to_json(state.told),
        "curvature": {action: missed / unit for action, missed in curvature.allowed(state).items()},
        "stiffness": stiffness.to_json() if stiffness else None,
        "law": last.fitted.law,
        "discretisation_rms": state.errors.mesh_rms / unit if state.errors.mesh.known else None,
        "held_out_rms": None if last.held_out is None else last.held_out / unit,
        "anchored": sorted(state.anchors, key=order.index),
        "verdict": verdict,
        "model": last.name,
        "adopted": [
            {"effect": d.effect.name, "place": d.place, "parameters": _parameters(d, *_own(last.fitted, d))}
            for d in state.model.terms
        ],
        "courses": courses.to_json(last.fitted),
        "warnings": list(last.fitted.warnings),
        "skipped": list(state.predictor.skipped),
        "tests": [
            {"name": f.name, "p_value": f.p_value, "decides": f.decides, "text": f.text} for f in last.adequacy.findings
        ],
        "residual_by": groups(state),
        "first_ranked": [row.effect for row in diagnosis_text.ordered(asked.ranking, asked.rivals)]
        if asked and asked.ranking
        else [],
        "ranking": _ranking(asked.ranking, asked.rivals, unit, order) if asked and asked.ranking else [],
        "not_applicable": asked.ranking.excluded if asked and asked.ranking else {},
        "cannot_be_told_from": list(found.ambiguous) if found else [],
        "separating_pulls": [
            {"grasp": p.grasp, "direction": p.direction, "distance": p.distance / unit, "sigmas": p.sigmas}
            for p in done.pulls
        ],
        "scene_sensitivity": [row.to_json(order) for row in done.sensitivity],
        "open_bits": None if done.next_steps is None else done.next_steps.open,
        "next_steps": [step.to_json(unit) for step in done.next_steps.steps] if done.next_steps else [],
        "ladder": [
            {
                "model": rung.name,
                "anchored": sorted(rung.state.anchors, key=order.index),
                "rms": rung.state.rms / unit,
                "held_out_rms": None if rung.held_out is None else rung.held_out / unit,
                "adequate": rung.adequacy.told,
                "p_value": rung.adequacy.p_value,
            }
            for rung in done.rungs
        ],
    }


def beliefs(found: Explanation, order: list[str]) -> dict[str, Any]:
    """How probable verdict, anchors and the likeliest hypotheses are."""
    odds = found.odds
    hypotheses = [
        {
            "anchored": sorted(h.anchors, key=order.index),
            "effects": h.effect.split("+") if h.effect else [],
            "unknown": h.unknown,
            "probability": p,
        }
        for h, p in list(odds.probabilities.items())[:_HYPOTHESES]
    ]
    return {
        "verdict_probability": found.probability,
        "anchors_probability": found.held_by,
        "anchors_certain": found.held_by >= THRESHOLDS.credible,
        "probabilities": {
            "effects": odds.verdicts,
            "patches": patches(odds.probabilities, order),
            "hypotheses": hypotheses,
        },
        "neglected": found.neglected,
        "evidence_split": [one.to_json(order) for one in found.splits],
        "begins": _onset(found.begins),
        "noise_doubt": diagnosis_text.noise_doubt(found),
    }


def _onset(found: Onset | None) -> dict[str, Any] | None:
    """By when something unknown has begun."""
    return None if found is None else {"action": found.action, "step": found.step, "probability": found.probability}


def _seen(fitted: Fit, one: Term) -> bool:
    """Whether an effect differs from nothing by more than its standard error lets expect; always, when it was not fitted."""
    errors, model = _own(fitted, one)[0], fitted.state.model
    if course_of(one.effect) and any(p.name in errors for p in one.effect.amounts):
        return courses.seen(fitted, one, 2 * normal_tail(THRESHOLDS.detection))
    for p in one.effect.amounts:
        neutral = model.neutral(p)
        if p.name not in errors or neutral is None:
            continue
        value, error = one.values[p.name], errors[p.name]
        if p.reciprocal:
            value, neutral, error = 1 / value, 0.0, error / value**2
        if abs(value - neutral) > 3 * error:
            return True
    return not any(p.name in errors for p in one.effect.amounts)


def _own(fitted: Fit, one: Term) -> tuple[dict[str, float], dict[str, float]]:
    """Standard errors and limits of an effect's own numbers."""
    return diagnosis_text.own(fitted, one, fitted.stderr), diagnosis_text.own(fitted, one, fitted.limits)


def _parameters(
    one: Term, errors: Mapping[str, float], limits: Mapping[str, float], identifiable: bool = True
) -> dict[str, Any]:
    return {
        p.name: {
            "value": finite(one.values[p.name]) if identifiable else None,
            "stderr": finite(errors.get(p.name)),
            "limit": finite(limits.get(p.name)),
            "unit": p.unit,
        }
        for p in one.effect.parameters
    }


def _ranking(
    ranking: Ranking, rivals: Sequence[FittedHypothesis], unit: float, order: list[str]
) -> list[dict[str, Any]]:
    best: dict[str, FittedHypothesis] = {}
    for rival in rivals:
        best.setdefault(rival.effect, rival)
    rows = []
    for row in diagnosis_text.ordered(ranking, rivals):
        own = best.get(row.effect)
        one = own.term if own else row.term
        told = _own(own.fitted, one) if own else (row.stderr, {})
        rows.append(
            {
                "effect": row.effect,
                "place": one.place,
                "anchored": sorted(own.anchors, key=order.index) if own else None,
                "parameters": _parameters(one, *told, row.identifiable or own is not None),
                "score": row.score,
                "p_value": row.p_value,
                "expected_rms": row.expected_rms / unit,
                "fitted_rms": own.fitted.state.rms / unit if own else None,
                "held_out_rms": finite(own.held_out / unit) if own and own.held_out is not None else None,
                "power": row.power,
                "confounded_with": list(row.confounded_with),
                "identifiable": row.identifiable,
                "tried": row.tried,
            }
        )
    return rows


def where_json(found: MissingForce, unit: float) -> dict[str, Any]:
    """The missing force: places in units of length, forces in N."""

    def row(place: Place) -> dict[str, Any]:
        return {"position": list(place.position / unit), "force": list(map(float, place.force)), "stderr": place.stderr}

    return {
        "explained": found.explained,
        "rms": found.rms / unit,
        "steady": [row(place) for place in found.steady.regions],
        "growing": {name: [row(place) for place in force.regions] for name, force in found.growing.items()},
        "together": {
            "steady": row(found.steady.together),
            "growing": {name: row(force.together) for name, force in found.growing.items()},
        },
    }


def residual_dataset(done: Diagnosis, parts: dict[str, Any]) -> xr.Dataset:
    """Measured and predicted positions of the first and the last model, and what each effect contributes (m), by frame.

    Where force and torque were measured, they too (N, N m).
    """
    first, last = done.rungs[0].state, done.rungs[-1].state
    data, dims = last.predictor.data, ("frame", "fiducial", "axis")
    measurement = last.predictor.measurement.data
    arrays = {
        "measured": data.measured,
        "predicted_first": first.predicted,
        "predicted": last.predicted,
        "sigma": data.spread(last.errors.sigma),
        "mesh_error": last.errors.mesh.left,
    }
    count = len(data.scene.fiducials)
    content: dict[str, Any] = {
        **{name: (dims, array[:, :count]) for name, array in arrays.items()},
        **_wrenches(data, arrays),
        "rest": (dims[1:], data.scene.rest),
        "grasp": ("frame", measurement["grasp"].values.astype(str)),
    }
    for number, (label, part) in enumerate(parts.items()):
        content[f"part_{number}"] = (dims, part, {"effect": label})
    coords: dict[str, Any] = {
        "fiducial": data.scene.fiducial_names,
        "axis": AXES,
        **({"component": WRENCH} if data.forces else {}),
        "action": ("frame", measurement["action"].values.astype(str)),
        "step": ("frame", measurement["step"].values),
        "time": ("frame", measurement["time"].values),
    }
    attrs = {"model_first": done.rungs[0].name, "model": done.rungs[-1].name}
    return xr.Dataset(content, coords, attrs)


def _wrenches(data: Data, arrays: Mapping[str, Array]) -> dict[str, Any]:
    """Force and torque of arrays whose last rows they are."""
    if data.forces is None:
        return {}
    dims = "frame", "component"
    return {f"wrench_{name}": (dims, data.forces.wrenches(array[:, -ROWS:])) for name, array in arrays.items()}


def summary(done: Diagnosis, shares: Mapping[str, float], remarks: Sequence[str] = ()) -> list[str]:
    """The result in plain sentences, lengths in mm.

    Args:
        shares: how much each effect moves the fiducials (RMS, m).
        remarks: what is odd about the measurement, to be said first.
    """
    unit, name = 1e-3, "mm"
    lines = [*odd(remarks), *diagnosis_text.warning(done.rungs[-1])]
    if done.explanation is not None:
        doubt = diagnosis_text.noise_doubt(done.explanation)
        lines += [f"WARNING: {doubt}."] if doubt else []
        lines += [*diagnosis_text.conclusion(done.explanation, unit, name, done.pulls), ""]
        lines += [*diagnosis_text.beliefs(done.explanation), ""]
        lines += answer_text.sensitivity(done.sensitivity, list(done.rungs[-1].state.predictor.whole.patches))
        lines += answer_text.next_steps(done.next_steps)
    skipped = done.rungs[-1].state.predictor.skipped
    if skipped:
        lines += ["Not evaluated, because that failed:", *(f"  {text}" for text in skipped), ""]
    lines += ["The ladder of models:", *diagnosis_text.ladder(done.rungs, unit, name), ""]
    if shares:
        parts = ", ".join(f"{label} {share / unit:.3g} {name}" for label, share in shares.items())
        lines += [f"What each effect adds to the positions (RMS): {parts}.", ""]
    for rung in done.rungs:
        lines += [*diagnosis_text.verdict(rung.state, rung.adequacy, unit, name), ""]
        told = stiffness_in_words(rung.fitted.stiffness)
        lines += [*told, ""] if told else []
        constants = diagnosis_text.law(rung.fitted)
        lines += [*constants, ""] if constants else []
        if rung.fitted.coordinates:
            lines += [f"  {diagnosis_text.term(d, *_own(rung.fitted, d))}" for d in rung.state.model.terms]
            lines += [f"  {diagnosis_text.in_time(row)}" for row in courses.to_json(rung.fitted)]
            lines += [f"  Note: {text}" for text in rung.fitted.warnings] + [""]
        if rung.ranking is not None:
            lines += [
                "Which effect is missing?",
                *diagnosis_text.table(rung.ranking, rung.rivals, rung.state.rms, unit, name),
                "",
            ]
    lines += diagnosis_text.worst(done.rungs[-1].state if not done.rungs[-1].adequacy.adequate else done.rungs[0].state)
    if done.where is not None:
        lines += ["", *diagnosis_text.force(done.where, unit, name)]
    return lines
