"""Anchors and effects as hypotheses about a measurement, and what is reported of their posterior."""

from __future__ import annotations

import math
import time
from collections.abc import Collection, Iterable, Sequence
from dataclasses import replace

import numpy as np

from bcid.base.errors import SolveError
from bcid.base.options import ExplainOptions
from bcid.base.units import p_value, percent
from bcid.forms import effects
from bcid.forms.effects.effect import Effect
from bcid.forms.model import Model
from bcid.inference.hypotheses import Hypothesis, label, log_prior
from bcid.inference.mesh_error import MeshError
from bcid.predict.predictor import Predictor
from bcid.results.words import ADEQUACY
from bcid.search.answer.adequacy import judge
from bcid.search.answer.anchor_answer import AnchorAnswer
from bcid.search.answer.explanation import Explanation, ModelStep, explains, verdict_of
from bcid.search.candidates import Candidates, Known
from bcid.search.fitting.fit import Fit
from bcid.search.fitting.fitted_hypothesis import FittedHypothesis, best_first
from bcid.search.fitting.held_out import held_out
from bcid.search.fitting.loosened import slackens
from bcid.search.fitting.state import State
from bcid.search.full_search import FullSearch
from bcid.search.searched import searched

Anchored = frozenset[str]
# Springs so many times as soft as the fitted ones hold nothing where those hardly do.
_SOFTER = 100.0


def explain(
    predictor: Predictor,
    options: ExplainOptions | None = None,
    model: Model | None = None,
    more: Iterable[Effect] = (),
    candidates: Candidates | None = None,
) -> Explanation:
    """Find anchors and missing effects until the model is adequate, or say that nothing explains the data; collective.

    Args:
        predictor: of the measurement; its progress is told what goes on.
        options: how far to go.
        model: where to begin; by default the scene's model.
        more: effects beyond the catalogue.
        candidates: what may be missing; by default all effects of the catalogue, and `more`.

    Raises:
        InputError: the options name an unknown effect or level.
        ContinuationError: no anchor set can be followed to the end with the plain model, or the answer stands for one that cannot.
    """
    options = options or ExplainOptions()
    candidates = candidates or Known(tuple(effects.catalogue(options.only, more)))
    start = time.perf_counter()
    chosen = options

    def search(base: State, sets: Sequence[Anchored]) -> FullSearch:
        return FullSearch(base, candidates, sets, chosen.max_effects, chosen.fitted, chosen.sets)

    queue = searched(predictor, model or Model.of(predictor.scene), (), search)
    best = queue.table.best()
    check_not_stood_for(best, queue.table.refused, queue.model)
    return _explanation(queue, best, time.perf_counter() - start)


# -- the answer
# --------------------------------------------------------------------------------------------------------------------


def _explanation(queue: FullSearch, best: FittedHypothesis, seconds: float) -> Explanation:
    """What is reported of a search; collective."""
    table, predictor = queue.table, queue.predictor
    plain = next(r for r in table.full if not r.names)
    same = next((r for r in table.full if not r.names and r.anchors == best.anchors), plain)
    rungs = [_model_step(rival) for rival in ([plain] if same is plain else [plain, same])]
    single = best_first(r for r in [*table.full, *table.rough] if len(r.names) == 1)
    rungs[-1] = replace(rungs[-1], ranking=queue.missing(same), rivals=tuple(single))
    if len(best.names) > 1:
        first = next((r for r in table.full if r.names == best.names[:1]), None)
        rungs += [_model_step(first)] if first else []
    if best.names:
        rungs.append(_model_step(best))
    odds = table.odds
    nearly = bool(best.names) and explains(rungs[0].fitted, rungs[-1].fitted)
    verdict = verdict_of(best.names, odds.best.unknown, nearly, rungs[-1].adequacy.adequate)
    found = Explanation(
        verdict,
        odds,
        tuple(rungs),
        replace(AnchorAnswer(table, best).identification(), remarks=predictor.measurement.remarks, seconds=seconds),
        tuple(table.full),
        predictor.noise,
        dict(predictor.trajectories),
        seconds,
        table.neglected,
        refuted=not (best.names or rungs[-1].adequacy.adequate),
    )
    anchors = label(best.anchors, predictor.scene.patches)
    predictor.progress.say(f"{verdict}, {percent(found.probability)}; anchors {anchors}, {percent(found.held_by)}")
    return found


def _model_step(rival: FittedHypothesis) -> ModelStep:
    """One model of the ladder, judged; collective."""
    state, adequacy = rival.fitted.state, judge(rival.fitted.state)
    word = ADEQUACY[adequacy.told]
    verdict = f"{word} ({p_value(adequacy.p_value)})" if adequacy.told is False else word
    state.predictor.progress.say(
        f"{state.model.name}, anchors {label(state.anchors, state.predictor.scene.patches)}: residual {state.rms * 1e3:.3g} mm, "
        f"noise {state.noise * 1e3:.3g} mm, mesh {state.errors.mesh_rms * 1e3:.2g} mm: {verdict}"
    )
    apart = rival.held_out if rival.held_out is not None else held_out(rival.fitted)
    return ModelStep(rival.fitted, adequacy, apart)


def check_not_stood_for(best: FittedHypothesis, refused: Collection[Hypothesis], begun: Model) -> None:
    """A patch that gives does not stand for a set without it that cannot be followed; collective.

    Held as softly as if it were not held it shows what that set does, in all steps: it is likelier than the answer where the answer
    is nothing else.

    Args:
        best: the answer.
        refused: hypotheses that cannot be followed to the end.
        begun: the model without added effects.

    Raises:
        ContinuationError: it stands for one, so that what this cannot be followed in is not to be compared.
    """
    state = best.fitted.state
    for term in state.model.terms:
        others = "+".join(name for name in best.names if name != term.effect.name)
        without = state.anchors - {term.place}
        if not (slackens(term.effect) and term.place and Hypothesis(without, others) in refused):
            continue
        (stiffness,) = term.values
        soft = term.with_values({stiffness: term.values[stiffness] / _SOFTER})
        model = state.model.without(term.label)
        if _log_without(best, model + soft, begun) > best.log:
            # Followed again, it says how far it can be compared.
            State.of(state.predictor, model, without, MeshError.unknown(state.predictor.data.mask.shape))


def _log_without(best: FittedHypothesis, model: Model, begun: Model) -> float:
    """Logarithm of evidence and prior of a model with other numbers than those of the answer, one effect counting as none."""
    state, count = best.fitted.state, len(best.names) - 1
    try:
        there = State.of(state.predictor, model, state.anchors, best.judged.errors.mesh)
    except SolveError:
        return -math.inf
    found = FittedHypothesis.of(Fit.at(there), begun, best.known).evidence
    plain, forced = (log_prior(count, unknown, best.known) for unknown in (False, True))
    return float(np.logaddexp(found.plain + plain, found.forced + forced))
