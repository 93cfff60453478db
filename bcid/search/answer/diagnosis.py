"""A diagnosis: is a model adequate, where does it fail, which effect is missing, what does it do once it is added."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from bcid.base.collective import Comm
from bcid.base.errors import InputError, SolveError, evaluating, nearest
from bcid.base.options import ExplainOptions
from bcid.base.progress import Progress, Silent
from bcid.base.units import WIDE
from bcid.forms import effects
from bcid.forms.model import Model, Term
from bcid.inference.continuation import truncate_to_converged
from bcid.inference.hypotheses import label
from bcid.measurement import Measurement
from bcid.predict.mesh_ladder import mesh_error
from bcid.predict.predictor import Predictor
from bcid.predict.store import PredictionStore
from bcid.results.diagnosis_record import SeparatingPull
from bcid.scene import Scene
from bcid.search.answer.adequacy import judge
from bcid.search.answer.explanation import Explanation, ModelStep
from bcid.search.answer.next_steps import NextSteps, next_steps
from bcid.search.answer.scene_sensitivity import AnswerAt, fitted_hypotheses, scene_sensitivity
from bcid.search.answer.separate import separating_pulls
from bcid.search.answer.source import Source
from bcid.search.answer.surface_rounds import settled
from bcid.search.answer.where import MissingForce, missing_force
from bcid.search.explain import explain
from bcid.search.fitting.buckled_frames import leave_out
from bcid.search.fitting.curvature import bent
from bcid.search.fitting.fit import Fit, fit
from bcid.search.fitting.fitted_hypothesis import fitted_beside, refit
from bcid.search.fitting.held_out import held_out
from bcid.search.fitting.ranking import rank
from bcid.search.fitting.state import State
from bcid.search.fitting.variants import neutral_values

T = TypeVar("T")
# Chi-squares that differ by less are equal: the data prefer neither by more than a factor of 1.6.
_EQUAL = 1.0


@dataclass(frozen=True)
class Diagnosis:
    """What was found about a model.

    Attributes:
        rungs: the ladder of models, the one that was begun with first.
        where: the force that would explain what the model misses; None where it was not asked for.
        explanation: anchors and effects, where they were searched.
        pulls: pulls that would tell explanations apart.
        sensitivity: the answer where inputs of the scene are off.
        next_steps: what would tell explanations apart; None where the answer is certain.
    """

    rungs: tuple[ModelStep, ...]
    where: MissingForce | None
    explanation: Explanation | None = None
    pulls: tuple[SeparatingPull, ...] = ()
    sensitivity: tuple[AnswerAt, ...] = ()
    next_steps: NextSteps | None = None


def on_predictor(
    source: Source,
    comm: Comm,
    level: int | None,
    progress: Progress | None,
    work: Callable[[Predictor, Source], Diagnosis],
    use: Callable[[Predictor, Source, Diagnosis], T],
    store: PredictionStore | None = None,
) -> T:
    """What `use` makes of the diagnosis of a source's measurement, or of as much of it as can be followed; collective.

    Args:
        source: scene, measurement and model; `work` and `use` get it with the measurement that was followed.
        comm, level, progress: of the predictor.
        work: makes the diagnosis.
        use: while the predictor is there.
        store: of the predictor.
    """

    def attempt(seen: Measurement) -> T:
        made: list[Predictor] = []

        def search(scene: Scene, seen: Measurement) -> tuple[Source, Diagnosis]:
            made.append(Predictor(scene, seen, comm, level, progress=progress, store=store))
            here = replace(source, scene=scene, measurement=seen)
            return here, work(made[-1], here)

        def found(done: tuple[Source, Diagnosis]) -> tuple[Scene, Model, frozenset[str]]:
            last = done[1].rungs[-1].state
            return done[0].scene, last.model, last.anchors

        speaking = progress or Silent()
        try:
            begun = source.model, source.anchors
            (here, done), marked = settled(
                source.scene, seen, comm, speaking, *begun, search, found, lambda _: made.pop().destroy()
            )
            return use(made[-1], replace(here, measurement=marked), done)
        finally:
            for predictor in made:
                predictor.destroy()

    return truncate_to_converged(source.measurement, attempt)


def compared(predictor: Predictor, source: Source) -> Diagnosis:
    """Is the source's model adequate with its anchors, and where does it fail? Collective on the predictor's ranks."""
    fitted = _present(predictor, source)
    rung = ModelStep(fitted, judge(fitted.state), held_out(fitted))
    return Diagnosis((rung,), missing_force(fitted.state))


def diagnosed(predictor: Predictor, source: Source, only: Sequence[str] | None = None) -> Diagnosis:
    """Which effect is missing in the source's model? Collective on the predictor's ranks.

    `only` names the effects to look at; all of the catalogue and of the source by default.
    """
    fitted = _present(predictor, source)
    adequacy = judge(fitted.state)
    predictor.progress.say("ranking the effects by what they would explain")
    ranking = rank(fitted.state, effects.catalogue(only, source.own))
    predictor.progress.say("fitting the most promising of them")
    rivals = fitted_beside(fitted.state, effects.catalogue(only, source.own), ExplainOptions().fitted)
    rung = ModelStep(fitted, adequacy, held_out(fitted), ranking, tuple(rivals))
    return Diagnosis((rung,), None if adequacy.adequate else missing_force(fitted.state))


def refitted(
    predictor: Predictor,
    source: Source,
    terms: Sequence[Term] = (),
    free: Sequence[str] = (),
    fixed: Sequence[str] = (),
) -> Diagnosis:
    """The source's model with more effects, refitted, beside the model before. Collective on the predictor's ranks.

    Args:
        terms: effects to add, with values to start from.
        free: further numbers to fit, such as "young".
        fixed: numbers to keep, such as "gravity.weight".
    """
    before = _present(predictor, source)
    rungs = [ModelStep(before, judge(before.state), held_out(before))]
    state = before.state
    for one in terms:
        predictor.progress.say(f"adding {one.label}")
        state = _added(state, one)
    names = numbers_to_fit(state.model, source, free, fixed)
    again, minima = fit_twice(state, names)
    mesh = mesh_error(predictor, again.state.model, again.state.anchors, again.state.prediction)
    state = State.of(predictor, again.state.model, again.state.anchors, mesh, names, again.state.prediction)
    again = bent(fit(state, names))
    again = replace(again, warnings=(*again.warnings, *([minima] if minima else [])))
    rungs.append(ModelStep(again, judge(again.state), held_out(again)))
    return Diagnosis(tuple(rungs), missing_force(again.state))


def explained(predictor: Predictor, source: Source, options: ExplainOptions) -> Diagnosis:
    """Anchors and missing effects, until the model is adequate or nothing helps. Collective on the predictor's ranks."""
    found = explain(predictor, options, source.model, source.own)
    where, pulls, sensitivity, steps = None, list[SeparatingPull](), list[AnswerAt](), None
    # What is computed about the answer costs no answer where it fails.
    with suppress(SolveError), evaluating("the missing force", predictor.skip):
        where = None if found.last.adequacy.adequate else missing_force(found.last.state)
        if where is None and len(found.rungs) > 1:
            where = missing_force(found.rungs[0].state)
    with suppress(SolveError), evaluating("pulls that separate explanations", predictor.skip):
        pulls = _pulls(found) if found.open else []
    with suppress(SolveError), evaluating("the answer with other inputs of the scene", predictor.skip):
        fitted = fitted_hypotheses(found)
        sensitivity = scene_sensitivity(found, fitted)
        steps = next_steps(found, fitted, pulls)
    return Diagnosis(found.rungs, where, found, tuple(pulls), tuple(sensitivity), steps)


def check_terms(source: Source, terms: Sequence[Term], free: Sequence[str], fixed: Sequence[str]) -> None:
    """Refuse effects that the source's model has already, and numbers that it has not, before anything is computed.

    Raises:
        InputError: names what is wrong.
    """
    model = source.model
    for one in terms:
        if one.label in {present.label for present in model.terms}:
            raise InputError(
                f"--add {one.label}: the model {model.name} has it already; fit it with --free, or leave it out"
            )
        model = model + one
    numbers_to_fit(model, source, free, fixed)


def numbers_to_fit(model: Model, source: Source, free: Sequence[str], fixed: Sequence[str]) -> tuple[str, ...]:
    """Numbers to fit: those fitted before, those of added effects, and what the user asks for."""
    names = [*source.free, *(name for term in model.added(source.model) for name in term.free), *free]
    known = model.constants()
    for name in (*free, *fixed):
        if name not in known:
            raise InputError(f"the model {model.name} has no number '{name}'; {nearest(name, known)}")
    return tuple(dict.fromkeys(name for name in names if name not in fixed))


def _present(predictor: Predictor, source: Source) -> Fit:
    """The model of a run on the predictor; its fitted numbers are fitted again, for the level may be another."""
    assert source.anchors is not None
    predictor.progress.say(
        f"comparing {source.model.name}, anchors {label(source.anchors, source.scene.patches)}, on two meshes"
    )
    leave_out(predictor, source.model, source.anchors)
    return bent(fit(State.of(predictor, source.model, source.anchors, None, source.free), source.free))


def _added(state: State, one: Term) -> State:
    """The model with an effect, begun where its sensitivity says, unless the user gave values."""
    given = one.values != neutral_values(state.model, one.effect)
    if not given:
        row = rank(replace(state, free=()), [one.effect], place=one.place or None).rows[0]
        rivals = refit(state, row, state.model, 1)
        if rivals:
            return rivals[0].fitted.state
    moved = {
        p.name: p.scale if p.reciprocal else one.values[p.name] + (0.0 if given else 0.1 * p.scale)
        for p in one.effect.amounts
        if not (given and math.isfinite(one.values[p.name]))
    }
    model = state.model + one.with_values(moved)
    return State.of(state.predictor, model, state.anchors, state.errors.mesh, state.free)


def _pulls(found: Explanation) -> list[SeparatingPull]:
    """Pulls that tell the last model from the next best, of those that were compared with all steps."""
    last = found.last.state
    others = [r for r in found.rivals if (r.fitted.state.model.name, r.anchors) != (last.model.name, last.anchors)]
    return separating_pulls(last, others[0].fitted.state)[:5] if others else []


def fit_twice(start: State, names: Sequence[str]) -> tuple[Fit, str]:
    """A fit of numbers of a model, of which constants of the law are begun at a second point as well; collective.

    The second point lies a notable change away from where the first fit ended, in another direction for each constant in turn.

    Args:
        start: where to begin.
        names: full names of the numbers.

    Returns:
        The better of both, and a warning where they end in different minima, else "".

    Raises:
        InputError, SolveError: as `bcid.search.fitting.fit.fit`, of the first.
    """
    first = fit(start, names)
    second = _again(first, names)
    if second is None:
        return first, ""
    best, other = (second, first) if second.state.chi2 < first.state.chi2 - _EQUAL else (first, second)
    apart = {name for name, value in best.values.items() if _differ(best, other, name, value)}
    if not apart:
        return best, ""
    worse = other.state.chi2 - best.state.chi2
    ends = ", ".join(f"{name} = {other.values[name]:.4g}" for name in best.values if name in apart)
    fits = "fits as well" if worse < _EQUAL else f"is worse by {worse:.3g} in chi-square"
    return best, f"another starting point ends in a minimum at {ends}, which {fits}"


def _again(first: Fit, names: Sequence[str]) -> Fit | None:
    """The fit from the second starting point; None without constants of the law, and where it cannot be followed."""
    law = [c for c in first.coordinates if c.name in first.state.model.values]
    moved = {}
    for number, c in enumerate(law):
        lower, upper = c.bounds
        at = c.of(first.values[c.name])
        step = c.scale if number % 2 == 0 else -c.scale
        step = step if lower < at + step < upper else -step
        moved[c.name] = c.allowed(float(np.clip(at + step, lower, upper)))
    if not moved:
        return None
    with suppress(InputError, SolveError):
        state = first.state
        begun = State.of(
            state.predictor, state.model.with_values(moved), state.anchors, state.errors.mesh, tuple(names)
        )
        return fit(begun, names)
    return None


def _differ(one: Fit, other: Fit, name: str, value: float) -> bool:
    """Whether two fits have values of a number whose 95 % intervals do not meet."""
    return abs(value - other.values[name]) > WIDE * (one.stderr[name] + other.stderr[name])
