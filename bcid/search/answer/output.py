"""What a comparison writes: diagnosis, model, missing force, residuals and the summary."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from bcid.base.tails import normal_tail
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
from bcid.results.common_rows import ParameterRow
from bcid.results.diagnosis_record import (
    DiagnosisRecord,
    DiscrepancyRecord,
    ForceRow,
    ModelRow,
    PosteriorRow,
    RankedEffect,
    SelectedEffect,
    TotalForce,
)
from bcid.results.summary import diagnosis_summary
from bcid.search.answer.adequacy import groups, judge
from bcid.search.answer.diagnosis import Diagnosis
from bcid.search.answer.evidence_split import hypothesis_row
from bcid.search.answer.explanation import Explanation, ModelStep, explains
from bcid.search.answer.identification_job import body_parts, inputs_in_words, left_out_row
from bcid.search.answer.source import Source, stored_effect
from bcid.search.answer.where import MissingForce, Place
from bcid.search.fitting import courses, curvature
from bcid.search.fitting.fit import Fit
from bcid.search.fitting.fitted_hypothesis import FittedHypothesis
from bcid.search.fitting.ranking import Ranking, Row
from bcid.search.fitting.state import detailed
from bcid.search.settings import SETTINGS

MODEL_FORMAT = "bcid-model/1"
Array = NDArray[np.float64]
# So many of the likeliest hypotheses are reported.
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


def documents(source: Source, done: Diagnosis, content: dict[str, Any], head: Sequence[str] = ()) -> dict[str, Any]:
    """What a run folder holds of a diagnosis, by file name: records, the model as JSON, datasets and texts.

    `content` is what `collect` gave, `head` lines of the summary in place of its conclusion.
    """
    unit, last = source.measurement.units.length, done.rungs[-1].state
    shares = {label: float(np.sqrt(np.nanmean(part**2))) for label, part in content["parts"].items()}
    left_out = LeftOut.of(last.predictor.whole, last.predictor.measurement, last.predicted)
    diagnosis = replace(
        diagnosis_record(done),
        remarks=source.measurement.remarks,
        contributions=shares,
        left_out=left_out_row(left_out),
        body=tuple(inputs_in_words(source.scene, source.measurement, content["mesh"])),
    )
    force = None if done.where is None else discrepancy_record(done.where)
    found: dict[str, Any] = {
        "diagnosis.json": diagnosis.converted(unit),
        "model.json": model_json(done.rungs[-1], source),
        "residuals.nc": residual_dataset(done, content["parts"]),
    }
    if done.explanation is not None:
        found["identification.json"] = done.explanation.identification.converted(unit)
    if force is not None:
        found["discrepancy.json"] = force.converted(unit)
    found["body.nc"] = body_parts(
        source.scene, content["mesh"], content["displacement"], content["energy"], diagnosis.anchored
    )
    return found | {"summary.txt": diagnosis_summary(diagnosis, force, head)}


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


def diagnosis_record(done: Diagnosis) -> DiagnosisRecord:
    """The content of `diagnosis.json`, but for what other files tell; lengths in m."""
    last = done.rungs[-1]
    state, stiffness, order = last.state, last.fitted.stiffness, list(last.state.predictor.whole.patches)
    asked = next((rung for rung in done.rungs if rung.ranking is not None), None)
    found = DiagnosisRecord(
        verdict=done.explanation.verdict if done.explanation else _verdict(done, asked),
        anchored=_anchored(state.anchors, order),
        model=last.name,
        adequate=last.adequacy.told,
        p_value=last.adequacy.p_value,
        false_alarm_rate=THRESHOLDS.false_alarms,
        rms=state.rms,
        held_out_rms=last.held_out,
        far_above_noise=state.rms > THRESHOLDS.residual * state.noise and not last.adequacy.adequate,
        noise_rms=state.noise,
        noise_stated=state.predictor.data.stated,
        noise_like_rms=state.rough,
        discretisation_rms=state.errors.mesh_rms if state.errors.mesh.known else None,
        input_uncertainties=nuisance_text.rows(state.told),
        curvature=curvature.allowed(state),
        stiffness=stiffness.record() if stiffness else None,
        law=last.fitted.law,
        selected_effects=tuple(_selected(last.fitted, term) for term in state.model.terms),
        time_histories=courses.time_histories(last.fitted),
        model_sequence=tuple(_model_row(rung, order) for rung in done.rungs),
        tests=last.adequacy.findings,
        residual_by=groups(state),
        ranking=ranked_effects(asked.ranking, asked.rivals, order) if asked and asked.ranking else (),
        variants_tried=asked.ranking.tried if asked and asked.ranking else 0,
        not_applicable=asked.ranking.excluded if asked and asked.ranking else {},
        separating_pulls=done.pulls,
        scene_sensitivity=tuple(row.row(order) for row in done.sensitivity),
        entropy=done.next_steps.open if done.next_steps else None,
        least_bits=SETTINGS.helping,
        next_steps=done.next_steps.steps if done.next_steps else (),
        warnings=tuple(last.fitted.warnings),
        skipped=tuple(state.predictor.skipped),
    )
    return with_posterior(found, done.explanation, order) if done.explanation else found


def with_posterior(record: DiagnosisRecord, found: Explanation, order: Sequence[str]) -> DiagnosisRecord:
    """The record with how probable verdict, anchors and the likeliest hypotheses are."""
    odds = found.odds
    likely = list(odds.probabilities.items())[:_HYPOTHESES]
    hypotheses = tuple(hypothesis_row(h, p, order) for h, p in likely)
    return replace(
        record,
        verdict_probability=found.probability,
        anchors_probability=found.held_by,
        anchors_certain=found.held_by >= THRESHOLDS.credible,
        ambiguous_with=found.ambiguous,
        posterior=PosteriorRow(
            effects=odds.verdicts, patches=patches(odds.probabilities, order), hypotheses=hypotheses
        ),
        unfitted_probability=found.neglected,
        without_stiffness=tuple(hypothesis_row(r.hypothesis, 0.0, order) for r in found.slack),
        evidence_split=tuple(one.row(order) for one in found.splits),
        change_point=found.change_point,
        noise_warning=noise_warning(found),
    )


def noise_warning(found: Explanation) -> str:
    """Why the noise that is stated is not believed; "" where it is, or where none is stated."""
    if found.noise is None or not found.last.state.predictor.data.stated:
        return ""
    share = found.noise.factor
    rest = "; the rest of it is taken for errors that persist along trajectories" if share < 1 else ""
    return (
        f"the noise is stated as {found.noise.sigma / share * 1e3:.3g} mm, but what is left of it, smooth parts aside, "
        f"is {share:.2g} times as large ({found.noise.sigma * 1e3:.3g} mm), which is taken instead{rest}"
    )


def own(fitted: Fit, one: Term, of: Mapping[str, float]) -> dict[str, float]:
    """What a fit has of the numbers of one of its effects, by parameter."""
    return {name: of[one.full(name)] for name in one.values if one.full(name) in of}


def _ordered(ranking: Ranking, rivals: Sequence[FittedHypothesis]) -> list[Row]:
    """Rows with the refitted effects first, the best of them on top."""
    place: dict[str, int] = {}
    for i, rival in enumerate(rivals):
        place.setdefault(rival.effect, i)
    return sorted(ranking.rows, key=lambda row: place.get(row.effect, len(place)))


def _verdict(done: Diagnosis, asked: ModelStep | None) -> str:
    """The verdict where anchors and effects were not searched."""
    last = done.rungs[-1]
    adequate = last.adequacy.adequate
    if asked is not None and asked.rivals and not adequate:
        first = asked.rivals[0]
        named = judge(first.fitted.state).adequate or explains(last.fitted, first.fitted)
        return first.effect if named else "unknown"
    beyond = last.state.model.added(Model.of(last.state.predictor.whole))
    added = "+".join(dict.fromkeys(d.effect.name for d in beyond if _seen(last.fitted, d)))
    named = adequate or (bool(added) and explains(done.rungs[0].fitted, last.fitted))
    return (added or "none") if named else "unknown"


def _anchored(anchors: frozenset[str], order: Sequence[str]) -> tuple[str, ...]:
    return tuple(name for name in order if name in anchors)


def _model_row(rung: ModelStep, order: Sequence[str]) -> ModelRow:
    return ModelRow(
        model=rung.name,
        anchored=_anchored(rung.state.anchors, order),
        rms=rung.state.rms,
        normalised_rms=math.sqrt(rung.state.chi2 / len(rung.state.predictor.data)),
        held_out_rms=rung.held_out,
        adequate=rung.adequacy.told,
        p_value=rung.adequacy.p_value,
    )


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
    return own(fitted, one, fitted.stderr), own(fitted, one, fitted.limits)


def _selected(fitted: Fit, one: Term) -> SelectedEffect:
    return SelectedEffect(effect=one.effect.name, place=one.place, parameters=_parameters(one, *_own(fitted, one)))


def _parameters(
    one: Term, errors: Mapping[str, float], limits: Mapping[str, float], identifiable: bool = True
) -> dict[str, ParameterRow]:
    return {
        p.name: ParameterRow(
            value=finite(one.values[p.name]) if identifiable else None,
            stderr=finite(errors.get(p.name)),
            limit=finite(limits.get(p.name)),
            unit=p.unit,
        )
        for p in one.effect.parameters
    }


def ranked_effects(
    ranking: Ranking, rivals: Sequence[FittedHypothesis], order: Sequence[str]
) -> tuple[RankedEffect, ...]:
    """Rows of a ranking with what was fitted of them, the best first; lengths in m. `order` has the patches of the scene."""
    best: dict[str, FittedHypothesis] = {}
    for rival in rivals:
        best.setdefault(rival.effect, rival)
    rows = []
    for row in _ordered(ranking, rivals):
        own = best.get(row.effect)
        one = own.term if own else row.term
        errors = _own(own.fitted, one) if own else (row.stderr, {})
        rows.append(
            RankedEffect(
                effect=row.effect,
                place=one.place,
                anchored=_anchored(own.anchors, order) if own else None,
                parameters=_parameters(one, *errors, row.identifiable or own is not None),
                score=float(row.score),
                p_value=row.p_value,
                expected_rms=row.expected_rms,
                fitted_rms=own.fitted.state.rms if own else None,
                held_out_rms=finite(own.held_out) if own else None,
                power=row.power,
                confounded_with=tuple(row.confounded_with),
                identifiable=row.identifiable,
                tried=row.tried,
            )
        )
    return tuple(rows)


def discrepancy_record(found: MissingForce) -> DiscrepancyRecord:
    """The content of `discrepancy.json`; lengths in m."""

    def row(place: Place) -> ForceRow:
        position, force = (tuple(map(float, values)) for values in (place.position, place.force))
        return ForceRow(position=position, force=force, stderr=float(place.stderr))

    together = {name: row(force.together) for name, force in found.growing.items()}
    return DiscrepancyRecord(
        explained_fraction=found.explained,
        rms=found.rms,
        steady=tuple(map(row, found.steady.regions)),
        growing={name: tuple(map(row, force.regions)) for name, force in found.growing.items()},
        together=TotalForce(steady=row(found.steady.together), growing=together),
    )


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
