"""`bcid compare`, `diagnose`, `fit` and `explain` as jobs: read, check, work, and write everything into a run folder."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from bcid.base.collective import on_root
from bcid.base.errors import InputError, nearest
from bcid.base.progress import Progress
from bcid.base.run import Run
from bcid.compare.adequacy import judge
from bcid.compare.buckling import leave_out
from bcid.compare.explain import Explanation, Plan, Rung, explain
from bcid.compare.fit import Fit, fit, held_out
from bcid.compare.joint import promised
from bcid.compare.missing import rank
from bcid.compare.output import Outcome, collect, write
from bcid.compare.rivals import contest
from bcid.compare.separate import Pull, separating_pulls
from bcid.compare.source import Source, find_effect, from_files, from_run
from bcid.compare.state import State
from bcid.compare.twin import Twin
from bcid.compare.variants import neutral_values
from bcid.compare.where import missing_force
from bcid.forms import effects
from bcid.forms.model import Dose, Model
from bcid.search.farm import label

# -- the jobs
# ------------------------------------------------------------------------------------------------------------------


def run_compare(
    folder: Path,
    output: Path,
    comm: Any,
    progress: Progress | None = None,
    overwrite: bool = False,
    level: int | None = None,
    files: Sequence[Path] = (),
) -> Path:
    """Is the model of a run adequate, and where does it fail? Collective; returns the folder written."""
    source = from_run(folder, files, comm)

    def work(twin: Twin) -> Outcome:
        fitted = _present(twin, source, progress)
        rung = Rung(fitted, judge(fitted.state), held_out(fitted))
        return Outcome((rung,), missing_force(fitted.state))

    return _job("compare", source, output, {"level": level}, comm, overwrite, level, work)


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
        fitted = _present(twin, source, progress)
        adequacy = judge(fitted.state)
        ranking = rank(fitted.state, effects.catalogue(only, source.own))
        rivals = contest(fitted.state, promised(fitted.state, ranking), Plan().fitted)
        rung = Rung(fitted, adequacy, held_out(fitted), ranking, tuple(rivals))
        return Outcome((rung,), None if adequacy.adequate else missing_force(fitted.state))

    options = {"level": level, "only": list(only) if only else None}
    return _job("diagnose", source, output, options, comm, overwrite, level, work)


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
        before = _present(twin, source, progress)
        rungs = [Rung(before, judge(before.state), held_out(before))]
        state = before.state
        for one in doses:
            state = _added(state, one)
        names = _names(state.model, source, free, fixed)
        again = fit(state, names)
        mesh = twin.mesh_error(again.state.model, again.state.anchors, again.state.reply)
        again = fit(State.of(twin, again.state.model, again.state.anchors, mesh, names, again.state.reply), names)
        rungs.append(Rung(again, judge(again.state), held_out(again)))
        return Outcome(tuple(rungs), missing_force(again.state))

    options = {"level": level, "add": list(add), "free": list(free), "fixed": list(fixed)}
    return _job("fit", source, output, options, comm, overwrite, level, work)


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
    if progress is not None:
        for text in source.measurement.remarks:
            progress.say(f"look at this first: {text}")

    def work(twin: Twin) -> Outcome:
        found = explain(twin, plan, source.model, source.own, progress)
        needs_where = not found.last.adequacy.adequate
        where = missing_force(found.last.state) if needs_where else None
        if where is None and len(found.rungs) > 1:
            where = missing_force(found.rungs[0].state)
        pulls = _pulls(found) if found.ambiguous else []
        return Outcome(found.rungs, where, found, tuple(pulls))

    return _job("explain", source, folder, asdict(plan), comm, overwrite, plan.level, work)


def _pulls(found: Explanation) -> list[Pull]:
    """Pulls that tell the adopted effect from the next best."""
    best, other = found.rungs[-2].rivals[0], next(r for r in found.rungs[-2].rivals if r.effect == found.ambiguous[0])
    return separating_pulls(best.fitted.state, other.fitted.state)[:5]


def _present(twin: Twin, source: Source, progress: Progress | None) -> Fit:
    """The model of a run on the twin; its fitted numbers are fitted again, for the level may be another."""
    assert source.anchors is not None
    if progress is not None:
        progress.say(
            f"comparing {source.model.name}, anchors {label(source.anchors, source.scene.patches)}, on two meshes"
        )
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
    names = [*source.free, *(name for dose in model.added(source.model) for name in dose.free), *free]
    known = model.constants()
    for name in (*free, *fixed):
        if name not in known:
            raise InputError(f"the model {model.name} has no number '{name}'; {nearest(name, known)}")
    return tuple(dict.fromkeys(name for name in names if name not in fixed))


def _added(state: State, one: Dose) -> State:
    """The model with an effect, begun where its signature says, unless the user gave values."""
    given = one.values != neutral_values(state.model, one.effect)
    if not given:
        found = promised(state, rank(replace(state, free=()), [one.effect]))
        rivals = contest(state, [p for p in found if p.place == one.place or not one.place], Plan().fitted)
        if rivals:
            return rivals[0].fitted.state
    moved = {
        p.name: p.typical if p.reciprocal else one.values[p.name] + (0.0 if given else 0.1 * p.typical)
        for p in one.effect.amounts
        if not (given and math.isfinite(one.values[p.name]))
    }
    model = state.model + one.with_values(moved)
    return State.of(state.twin, model, state.anchors, state.errors.mesh, state.free)


def _job(
    command: str,
    source: Source,
    folder: Path,
    options: Any,
    comm: Any,
    overwrite: bool,
    level: int | None,
    work: Callable[[Twin], Outcome],
) -> Path:
    levels = len(source.scene.levels)
    if level is not None and not 0 <= level < levels:
        raise InputError(f"--level {level}: the scene has levels 0 to {levels - 1}")
    run: Run | None = None

    def begin() -> None:
        nonlocal run
        run = Run.start(folder, command, source.inputs(options), overwrite)

    on_root(comm, begin)
    with run.watched() if run else nullcontext():
        twin = Twin(source.scene, source.measurement, comm, level)
        try:
            done = work(twin)
            content = collect(twin, done)
            on_root(comm, lambda: write(run, source, twin, done, content, comm.size))
        finally:
            twin.destroy()
    return folder
