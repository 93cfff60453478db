"""`bcid compare`, `diagnose`, `fit` and `explain` as jobs: read, check, work, and write everything into a run folder."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from bcid.collective import on_root
from bcid.compare import words
from bcid.compare.adequacy import FALSE_ALARMS, groups, judge
from bcid.compare.buckling import leave_out
from bcid.compare.explain import Explanation, Plan, Rival, Rung, explain, refit_candidates
from bcid.compare.fit import Fit, fit, held_out
from bcid.compare.missing import Ranking, neutral_values, rank
from bcid.compare.separate import Pull, separating_pulls
from bcid.compare.state import State
from bcid.compare.twin import Twin
from bcid.compare.where import MissingForce, missing_force
from bcid.errors import BcidError, InputError, nearest
from bcid.fingerprint import file_fingerprint, fingerprint
from bcid.forms import effects
from bcid.forms.effects.effect import Effect
from bcid.forms.forward import check_geometry
from bcid.forms.model import Dose, Model, check_physics
from bcid.forms.patches import divided
from bcid.measurement import AXES, Measurement
from bcid.progress import Progress, Silent
from bcid.run import Run
from bcid.scene import Scene
from bcid.search.job import body_parts, scene_content
from bcid.units import unit_factor

MODEL_FORMAT = "bcid-model/1"


@dataclass(frozen=True)
class Source:
    """What a comparison starts from.

    Attributes:
        scene_file, measurement_file: as the user gave them.
        model: with effects and values.
        anchors: the anchored patches; None where they are to be found.
        free: fitted numbers.
        files: effect files of the user.
    """

    scene_file: Path
    measurement_file: Path
    scene: Scene
    measurement: Measurement
    model: Model
    anchors: frozenset[str] | None
    free: tuple[str, ...] = ()
    files: tuple[Path, ...] = ()

    @property
    def own(self) -> list[Effect]:
        """The user's effects."""
        return [effects.load(path) for path in self.files]

    def inputs(self, options: Any) -> dict[str, Any]:
        """Fingerprints of what a result depends on."""
        return {
            "scene": fingerprint(
                {"scene": scene_content(self.scene), "geometry": file_fingerprint(self.scene.geometry)}
            ),
            "measurement": self.measurement.fingerprint(),
            "model": self.model.constants() | {"name": self.model.name},
            "anchors": None if self.anchors is None else sorted(self.anchors),
            "effects": [file_fingerprint(path) for path in self.files],
            "options": options,
        }


def from_files(scene_file: Path, measurement_file: Path, files: Sequence[Path], comm: Any) -> Source:
    """A scene and a measurement, with the anchors to be found; collective."""
    scene = on_root(comm, lambda: Scene.read(scene_file, physics=check_physics))
    measurement = on_root(comm, lambda: Measurement.read(measurement_file))
    measurement.check(scene)
    scene = divided(scene, comm)
    check_geometry(scene, 0, comm)
    source = Source(scene_file, measurement_file, scene, measurement, Model.of(scene), None, (), tuple(files))
    on_root(comm, lambda: [effect.name for effect in source.own] and None)
    return source


def from_run(folder: Path, files: Sequence[Path], comm: Any) -> Source:
    """What an earlier run (identify, compare, diagnose, fit or explain) ended with; collective.

    Raises:
        InputError: the folder is not a finished run, or scene or measurement have changed since.
    """
    run = on_root(comm, lambda: Run.open(folder))
    if run.record["state"] != "finished":
        raise InputError(f"{folder}: the run is {run.record['state']}; finish it first, with the command that began it")
    names = run.record.get("names", {})
    if not {"scene", "measurement"} <= set(names):
        raise InputError(f"{folder}: holds a run of '{run.record['command']}', which names no scene and measurement")
    stored = on_root(comm, lambda: run.read_json("model.json") if (folder / "model.json").is_file() else None)
    own = tuple(Path(name) for name in (stored or {}).get("files", []))
    source = from_files(
        Path(names["scene"]), Path(names["measurement"]), (*own, *(f for f in files if f not in own)), comm
    )
    for what in ("scene", "measurement"):
        if source.inputs(None)[what] != run.record["inputs"].get(what):
            raise InputError(f"{folder}: the {what} {names[what]} has changed since; repeat the run")
    if stored is None:
        anchored = on_root(comm, lambda: run.read_json("identification.json"))["anchored"]
        return replace(source, anchors=frozenset(str(name) for name in anchored))
    return replace(source, **_stored_model(source, stored, folder))


def _stored_model(source: Source, stored: Any, folder: Path) -> dict[str, Any]:
    try:
        model = replace(source.model, doses=(), values={k: float(v) for k, v in stored["law"].items()})
        for entry in stored["effects"]:
            values = {k: float(v) for k, v in entry["values"].items()}
            model = model + Dose(find_effect(entry["effect"], source.own), values, place=entry["place"])
        return {
            "model": model,
            "anchors": frozenset(str(name) for name in stored["anchored"]),
            "free": tuple(str(name) for name in stored["free"]),
        }
    except InputError as error:
        raise InputError(f"{folder / 'model.json'}: is damaged ({error}); repeat the run") from None
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(f"{folder / 'model.json'}: is damaged ({error!r}); repeat the run") from None


def find_effect(name: str, own: Iterable[Effect]) -> Effect:
    """An effect of the user's files or of the catalogue."""
    mine = {effect.name: effect for effect in own}
    if name in mine:
        return mine[name]
    if name not in effects.names():
        raise InputError(f"unknown effect '{name}'; {nearest(name, [*effects.names(), *mine])}")
    return effects.effect(name)


# -- the jobs
# ------------------------------------------------------------------------------------------------------------------


def run_compare(
    folder: Path,
    output: Path,
    comm: Any,
    progress: Progress | None = None,
    overwrite: bool = False,
    level: int | None = None,
) -> Path:
    """Is the model of a run adequate, and where does it fail? Collective; returns the folder written."""
    source = from_run(folder, (), comm)

    def work(twin: Twin) -> Outcome:
        fitted = _present(twin, source)
        rung = Rung(fitted, judge(fitted.state), held_out(fitted))
        return Outcome((rung,), missing_force(fitted.state))

    return _job("compare", source, output, {"level": level}, comm, progress, overwrite, level, work)


def run_diagnose(
    folder: Path,
    output: Path,
    comm: Any,
    progress: Progress | None = None,
    overwrite: bool = False,
    level: int | None = None,
    files: Sequence[Path] = (),
    only: Sequence[str] | None = None,
) -> Path:
    """Which effect is missing in the model of a run? Collective; returns the folder written."""
    source = from_run(folder, files, comm)
    for name in only or ():
        find_effect(name, source.own)

    def work(twin: Twin) -> Outcome:
        fitted = _present(twin, source)
        adequacy = judge(fitted.state)
        ranking = rank(fitted.state, source.own, only)
        rivals = refit_candidates(fitted, [(row, fitted.state) for row in ranking.rows], Plan()) if ranking.rows else []
        rung = Rung(fitted, adequacy, held_out(fitted), ranking, tuple(rivals))
        return Outcome((rung,), None if adequacy.adequate else missing_force(fitted.state))

    options = {"level": level, "only": list(only) if only else None}
    return _job("diagnose", source, output, options, comm, progress, overwrite, level, work)


def run_fit(
    folder: Path,
    output: Path,
    comm: Any,
    progress: Progress | None = None,
    overwrite: bool = False,
    level: int | None = None,
    files: Sequence[Path] = (),
    add: Sequence[str] = (),
    free: Sequence[str] = (),
    fixed: Sequence[str] = (),
) -> Path:
    """Add effects to the model of a run, refit it, and compare the errors; collective; returns the folder written.

    Args:
        add: effects, as "gravity" or "soft_anchor:3" with a place, or "gravity:weight=9810" with values to start from.
        free: further numbers to fit, such as "young".
        fixed: numbers to keep, such as "gravity.weight".
    """
    source = from_run(folder, files, comm)
    doses = [_wanted(text, source) for text in add]
    model = source.model
    for one in doses:
        if one.label in {present.label for present in model.doses}:
            raise InputError(
                f"--add {one.label}: the model {model.name} has it already; fit it with --free, or leave it out"
            )
        model = model + one
    _names(model, source, free, fixed)

    def work(twin: Twin) -> Outcome:
        before = _present(twin, source)
        rungs = [Rung(before, judge(before.state), held_out(before))]
        fitted = before
        for one in doses:
            fitted = _added(fitted, one, free, fixed)
        names = _names(fitted.state.model, source, free, fixed)
        again = fit(fitted.state, names)
        mesh = twin.mesh_error(again.state.model, again.state.anchors, again.state.reply)
        again = fit(State.of(twin, again.state.model, again.state.anchors, mesh, names, again.state.reply), names)
        rungs.append(Rung(again, judge(again.state), held_out(again)))
        return Outcome(tuple(rungs), missing_force(again.state))

    options = {"level": level, "add": list(add), "free": list(free), "fixed": list(fixed)}
    return _job("fit", source, output, options, comm, progress, overwrite, level, work)


def run_explain(
    scene_file: Path,
    measurement_file: Path,
    folder: Path,
    options: Plan | None,
    comm: Any,
    progress: Progress | None = None,
    overwrite: bool = False,
    files: Sequence[Path] = (),
) -> Path:
    """Anchors and missing effects, unattended, until adequate or unknown; collective; returns the folder written."""
    plan = options or Plan()
    source = from_files(scene_file, measurement_file, files, comm)
    for name in plan.only or ():
        find_effect(name, source.own)

    def work(twin: Twin) -> Outcome:
        found = explain(twin, plan, source.model, source.own, progress)
        needs_where = not found.last.adequacy.adequate
        where = missing_force(found.last.state) if needs_where else None
        if where is None and len(found.rungs) > 1:
            where = missing_force(found.rungs[0].state)
        pulls = _pulls(found) if found.ambiguous else []
        return Outcome(found.rungs, where, found, tuple(pulls))

    return _job("explain", source, folder, asdict(plan), comm, progress, overwrite, plan.level, work)


def _pulls(found: Explanation) -> list[Pull]:
    """Pulls that tell the adopted effect from the next best."""
    best, other = found.rungs[-2].rivals[0], next(r for r in found.rungs[-2].rivals if r.effect == found.ambiguous[0])
    return separating_pulls(best.fitted.state, other.fitted.state)[:5]


def _present(twin: Twin, source: Source) -> Fit:
    """The model of a run on the twin; its fitted numbers are fitted again, for the level may be another."""
    assert source.anchors is not None
    leave_out(twin, source.model, source.anchors)
    return fit(State.of(twin, source.model, source.anchors, None, source.free), source.free)


def _wanted(text: str, source: Source) -> Dose:
    """An effect to add, as "name", "name:place", "name:parameter=value" and combinations with commas."""
    name, _, rest = text.partition(":")
    effect = find_effect(name, source.own)
    values, place = neutral_values(source.model, effect), ""
    for part in (p for p in rest.split(",") if p):
        key, equals, value = part.partition("=")
        if not equals:
            place = key
            continue
        try:
            values[key] = float(value)
        except ValueError:
            raise InputError(
                f"--add {text}: '{value}' is not a number; values are in SI units (degrees for angles)"
            ) from None
    known = effect.places(source.scene, source.anchors or frozenset()) if effect.places else [""]
    if place not in known:
        there = [k for k in known if k]
        if not place and there:
            raise InputError(f"--add {text}: say where, as --add {name}:{there[0]}; known: {', '.join(there)}")
        reason = f"place '{place}': {nearest(place, there)}" if there else "it has no places"
        raise InputError(f"--add {text}: {reason}")
    return Dose(effect, values, place=place)


def _names(model: Model, source: Source, free: Sequence[str], fixed: Sequence[str]) -> tuple[str, ...]:
    """Numbers to fit: those fitted before, those of added effects, and what the user asks for."""
    begun = set(source.model.constants())
    names = [*source.free, *(n for n in model.constants() if n not in begun and not n.endswith(".onset")), *free]
    known = model.constants()
    for name in (*free, *fixed):
        if name not in known:
            raise InputError(f"the model {model.name} has no number '{name}'; {nearest(name, known)}")
    return tuple(dict.fromkeys(name for name in names if name not in fixed))


def _added(before: Fit, one: Dose, free: Sequence[str], fixed: Sequence[str]) -> Fit:
    """The model with an effect, begun where its signature says, unless the user gave values."""
    state = before.state
    given = one.values != neutral_values(state.model, one.effect)
    if not given:
        ranking = rank(
            replace(state, free=()), (one.effect,) if one.effect.name not in effects.names() else (), [one.effect.name]
        )
        rows = [(row, state) for row in ranking.rows if row.dose.place == one.place or not one.place]
        rivals = refit_candidates(before, rows, Plan())
        if rivals:
            return rivals[0].fitted
    moved = {
        p.name: p.typical if p.reciprocal else one.values[p.name] + (0.0 if given else 0.1 * p.typical)
        for p in one.effect.amounts
        if not (given and math.isfinite(one.values[p.name]))
    }
    model = state.model + one.with_values(moved)
    return Fit(State.of(state.twin, model, state.anchors, state.errors.mesh, state.free), (), *_nothing(state))


def _nothing(state: State) -> tuple[Any, ...]:
    return np.zeros((0, 0)), np.zeros((len(state.twin.data), 0)), (), 0


@dataclass(frozen=True)
class Outcome:
    """What a job found."""

    rungs: tuple[Rung, ...]
    where: MissingForce | None
    explanation: Explanation | None = None
    pulls: tuple[Pull, ...] = ()


def _job(
    command: str,
    source: Source,
    folder: Path,
    options: Any,
    comm: Any,
    progress: Progress | None,
    overwrite: bool,
    level: int | None,
    work: Callable[[Twin], Outcome],
) -> Path:
    progress = progress or Silent()
    levels = len(source.scene.levels)
    if level is not None and not 0 <= level < levels:
        raise InputError(f"--level {level}: the scene has levels 0 to {levels - 1}")
    run: Run | None = None
    twin = None

    def begin() -> None:
        nonlocal run
        run = Run.start(folder, command, source.inputs(options), overwrite)

    on_root(comm, begin)
    try:
        twin = Twin(source.scene, source.measurement, comm, level, None, progress)
        done = work(twin)
        content = _collect(twin, done)
        on_root(comm, lambda: _write(run, source, twin, done, content, comm.size))
    except BaseException as error:
        if comm.rank == 0 and run is not None:
            run.fail(str(error) if isinstance(error, BcidError) else type(error).__name__)
        raise
    finally:
        if twin is not None:
            twin.destroy()
    return folder


# -- what is written
# ----------------------------------------------------------------------------------------------------------


def _collect(twin: Twin, done: Outcome) -> dict[str, Any]:
    """Arrays that need every rank: displacements and the parts of the prediction by effect. Collective."""
    state = done.rungs[-1].state
    parts = {}
    for one in state.model.doses:
        without = twin.predict(state.model.without(one.label), state.anchors)
        parts[one.label] = state.reply.positions - without.positions
    displacement = np.full((len(twin.data.mask), len(twin.forward(state.model).mesh.points), 3), np.nan)
    forward = twin.forward(state.model)
    for action in twin.actions:
        part = state.reply.parts.get(action.name)
        if part is not None and part.states is not None:
            for frame in action.frames:
                nodes = part.states[int(frame)][forward.body.displacement_dofs].reshape(-1, 3)
                displacement[frame] = forward.body.at_mesh_nodes(nodes)
    total = np.full_like(displacement, np.nan)
    for found in twin.comm.allgather(displacement):
        total = np.where(np.isnan(total), found, total)
    return {"parts": parts, "displacement": total, "mesh": forward.mesh}


def _write(run: Run | None, source: Source, twin: Twin, done: Outcome, content: dict[str, Any], ranks: int) -> None:
    assert run is not None
    name = source.measurement.units.length
    unit = unit_factor(name, "m")
    diagnosis = diagnosis_json(done, unit) | {"length_unit": name}
    run.write_json("diagnosis.json", diagnosis)
    run.write_json("model.json", model_json(done.rungs[-1], source))
    if done.explanation is not None:
        run.write_json("identification.json", done.explanation.identification.to_json(unit) | {"length_unit": name})
    run.write_dataset("residuals.nc", residual_dataset(done, content["parts"]))
    run.write_dataset("body.nc", _body(source.scene, done, content))
    if done.where is not None:
        run.write_json("where.json", where_json(done.where, unit) | {"length_unit": name})
    run.write_text("summary.txt", "\n".join(summary(done, unit, name)) + "\n")
    run.record |= {
        "names": {"scene": str(source.scene_file), "measurement": str(source.measurement_file)},
        "ranks": ranks,
        "trajectories": {k: round(v, 3) for k, v in twin.trajectories.items()},
        "mesh": content["mesh"].fingerprint(),
    }
    run.finish({key: diagnosis[key] for key in ("adequate", "verdict", "anchored", "rms", "noise_rms")})


def model_json(rung: Rung, source: Source) -> dict[str, Any]:
    """The model with its values, from which another run can start."""
    model = rung.state.model
    return {
        "format": MODEL_FORMAT,
        "law": {name: float(value) for name, value in model.law.complete(model.values).items()},
        "effects": [{"effect": d.effect.name, "place": d.place, "values": dict(d.values)} for d in model.doses],
        "anchored": sorted(rung.state.anchors, key=list(source.scene.patches).index),
        "free": list(rung.state.free),
        "files": [str(path) for path in source.files],
    }


def finite(value: float | None) -> float | None:
    """A number for JSON, which knows no infinity."""
    return None if value is None or not math.isfinite(value) else float(value)


def diagnosis_json(done: Outcome, unit: float) -> dict[str, Any]:
    """The content of `diagnosis.json`; lengths in units of `unit` (m)."""
    last = done.rungs[-1]
    state = last.state
    asked = next((rung for rung in done.rungs if rung.ranking is not None), None)
    order = list(state.twin.whole.patches)
    found = done.explanation
    if found is not None:
        verdict = found.verdict
    else:
        added = "+".join(dict.fromkeys(d.effect.name for d in state.model.doses if _seen(last.fitted, d)))
        verdict = (added or "none") if last.adequacy.adequate else "unknown"
        if asked is not None and asked.rivals and not last.adequacy.adequate:
            verdict = asked.rivals[0].effect if judge(asked.rivals[0].fitted.state).adequate else "unknown"
    return {
        "adequate": last.adequacy.adequate,
        "p_value": last.adequacy.p_value,
        "false_alarm_rate": FALSE_ALARMS,
        "rms": state.rms / unit,
        "noise_rms": state.noise / unit,
        "discretisation_rms": state.errors.mesh.rms / unit if state.errors.mesh.known else None,
        "held_out_rms": None if last.held_out is None else last.held_out / unit,
        "anchored": sorted(state.anchors, key=order.index),
        "verdict": verdict,
        "model": state.model.name,
        "adopted": [
            {"effect": d.effect.name, "place": d.place, "parameters": _parameters(d, _own(last.fitted, d))}
            for d in state.model.doses
        ],
        "warnings": list(last.fitted.warnings),
        "tests": [
            {"name": f.name, "p_value": f.p_value, "decides": f.decides, "text": f.text} for f in last.adequacy.findings
        ],
        "residual_by": groups(state),
        "first_ranked": [row.effect for row in words.ordered(asked.ranking, asked.rivals)]
        if asked and asked.ranking
        else [],
        "ranking": _ranking(asked.ranking, asked.rivals, unit, order) if asked and asked.ranking else [],
        "not_applicable": asked.ranking.excluded if asked and asked.ranking else {},
        "cannot_be_told_from": list(found.ambiguous) if found else [],
        "separating_pulls": [
            {"grasp": p.grasp, "direction": p.direction, "distance": p.distance / unit, "sigmas": p.sigmas}
            for p in done.pulls
        ],
        "ladder": [
            {
                "model": rung.state.model.name,
                "anchored": sorted(rung.state.anchors, key=order.index),
                "rms": rung.state.rms / unit,
                "held_out_rms": None if rung.held_out is None else rung.held_out / unit,
                "adequate": rung.adequacy.adequate,
                "p_value": rung.adequacy.p_value,
            }
            for rung in done.rungs
        ],
    }


def _seen(fitted: Fit, one: Dose) -> bool:
    """Whether an effect differs from nothing by more than its standard error lets expect; always, when it was not fitted."""
    errors, model = _own(fitted, one), fitted.state.model
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


def _own(fitted: Fit, one: Dose) -> dict[str, float]:
    prefix = f"{one.label}."
    return {n.removeprefix(prefix): e for n, e in fitted.stderr.items() if n.startswith(prefix)}


def _parameters(one: Dose, errors: dict[str, float], identifiable: bool = True) -> dict[str, Any]:
    return {
        p.name: {
            "value": finite(one.values[p.name]) if identifiable else None,
            "stderr": finite(errors.get(p.name)),
            "unit": p.unit,
        }
        for p in one.effect.parameters
    }


def _ranking(ranking: Ranking, rivals: Sequence[Rival], unit: float, order: list[str]) -> list[dict[str, Any]]:
    best: dict[str, Rival] = {}
    for rival in rivals:
        best.setdefault(rival.effect, rival)
    rows = []
    for row in words.ordered(ranking, rivals):
        own = best.get(row.effect)
        one, errors = (own.dose, words.errors_of(own)) if own else (row.dose, row.stderr)
        rows.append(
            {
                "effect": row.effect,
                "place": one.place,
                "anchored": sorted(own.anchors, key=order.index) if own else None,
                "parameters": _parameters(one, errors, row.identifiable or own is not None),
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

    def table(places: Sequence[Any]) -> list[dict[str, Any]]:
        return [
            {"position": list(p.position / unit), "force": list(map(float, p.force)), "stderr": p.stderr}
            for p in places
        ]

    growing = {name: table(places) for name, places in found.growing.items()}
    return {"explained": found.explained, "rms": found.rms / unit, "steady": table(found.steady), "growing": growing}


def residual_dataset(done: Outcome, parts: dict[str, Any]) -> xr.Dataset:
    """Measured and predicted positions of the first and the last model, and what each effect contributes (m), by frame."""
    first, last = done.rungs[0].state, done.rungs[-1].state
    data, dims = last.twin.data, ("frame", "fiducial", "axis")
    measurement = last.twin.measurement.data
    content: dict[str, Any] = {
        "measured": (dims, data.measured),
        "predicted_first": (dims, first.predicted),
        "predicted": (dims, last.predicted),
        "sigma": (dims, data.spread(last.errors.sigma)),
        "mesh_error": (dims, last.errors.mesh.left),
        "rest": (dims[1:], data.scene.rest),
        "grasp": ("frame", measurement["grasp"].values.astype(str)),
    }
    for number, (label, part) in enumerate(parts.items()):
        content[f"part_{number}"] = (dims, part, {"effect": label})
    coords = {
        "fiducial": data.scene.fiducial_names,
        "axis": AXES,
        "action": ("frame", measurement["action"].values.astype(str)),
        "step": ("frame", measurement["step"].values),
        "time": ("frame", measurement["time"].values),
    }
    attrs = {"model_first": first.model.name, "model": last.model.name}
    return xr.Dataset(content, coords, attrs)


def _body(scene: Scene, done: Outcome, content: dict[str, Any]) -> xr.Dataset:
    return body_parts(scene, content["mesh"], content["displacement"])


def summary(done: Outcome, unit: float, name: str) -> list[str]:
    """The result in plain sentences."""
    lines: list[str] = []
    if done.explanation is not None:
        lines += [*words.conclusion(done.explanation, unit, name, done.pulls), ""]
    lines += ["The ladder of models:", *words.ladder(done.rungs, unit, name), ""]
    for rung in done.rungs:
        lines += [*words.verdict(rung.state, rung.adequacy, unit, name), ""]
        if rung.fitted.coordinates:
            lines += [f"  {words.dose(d, _own(rung.fitted, d))}" for d in rung.state.model.doses]
            lines += [f"  Note: {text}" for text in rung.fitted.warnings] + [""]
        if rung.ranking is not None:
            lines += [
                "Which effect is missing?",
                *words.table(rung.ranking, rung.rivals, rung.state.rms, unit, name),
                "",
            ]
    lines += words.worst(done.rungs[-1].state if not done.rungs[-1].adequacy.adequate else done.rungs[0].state)
    if done.where is not None:
        lines += ["", *words.force(done.where, unit, name)]
    return lines
