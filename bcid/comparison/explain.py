"""The whole loop: anchors and effects as hypotheses, weighed together, until one is found, or none explains the data."""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bcid.base.errors import InputError, SolveError
from bcid.base.units import p_value, percent
from bcid.comparison.adequacy import judge
from bcid.comparison.buckled_frames import leave_out
from bcid.comparison.candidates import Candidates, Known
from bcid.comparison.contest import GLANCE, Contest, contest, glanced
from bcid.comparison.curvature import bent
from bcid.comparison.explanation import Explanation, Rung, explains, verdict_of
from bcid.comparison.first_sets import first_sets
from bcid.comparison.fit import Fit, fit
from bcid.comparison.held_out import held_out
from bcid.comparison.hypothesis_table import HypothesisTable
from bcid.comparison.ranking import Ranking, rank
from bcid.comparison.rivals import (
    UNLIKELY,
    WORTH,
    Rival,
    added,
    best_first,
    promoted,
    sets_about,
)
from bcid.comparison.settle import settled
from bcid.comparison.state import State
from bcid.comparison.told_anchors import told_anchors
from bcid.comparison.unfollowed import check_not_stood_for
from bcid.forms import effects
from bcid.forms.effects.effect import Effect
from bcid.forms.model import Model
from bcid.inference.criteria import LIKELIER
from bcid.inference.data import told_noise
from bcid.inference.hypotheses import Hypothesis
from bcid.inference.outcome import label
from bcid.predict.predictor import Predictor

Array = NDArray[np.float64]
Anchored = frozenset[str]
# So many hypotheses are fitted to all steps, and the best on so many other sets.
_PROMOTED, _MOVED = 3, 3
# So many of what may hold the body in the place of a patch besides.
_STOOD_IN = 2
# So many others that seem likelier than these are fitted too, as long as no more of them than this cannot be followed; and more, up
# to a limit, while one of them is believed more than all else together.
_CONFIRMED, _REFUSED, _LIMIT = 3, 6, 9
# A hypothesis with more than this probability is fitted to all steps.
_WORTH = 0.05


@dataclass(frozen=True)
class ExplainOptions:
    """How far the loop goes.

    Attributes:
        level: of the ladder, that both meshes go by; by default the last with at most 40,000 unknowns.
        effects: effects that may be adopted together at most.
        fitted: effects that are refitted at each step, on a few steps of each action; large ones besides, see `contest`.
        sets: anchor sets that are weighed, at each step.
        only: names of the effects to look at; all by default.
    """

    level: int | None = None
    effects: int = 2
    fitted: int = 5
    sets: int = 28
    only: tuple[str, ...] | None = None


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
        NotFollowed: no anchor set can be followed to the end with the plain model, or the answer stands for one that cannot.
    """
    options = options or ExplainOptions()
    candidates = candidates or Known(tuple(effects.catalogue(options.only, more)))
    return _Loop(predictor, options, model or Model.of(predictor.scene), candidates).run()


class _Loop:
    def __init__(self, predictor: Predictor, options: ExplainOptions, model: Model, candidates: Candidates) -> None:
        self.predictor, self.options, self.model, self.candidates = predictor, options, model, candidates
        self.starts: list[Anchored] = []
        # What may be missing beside the model that is begun with.
        self.lacking: list[Effect] = []
        self.compared = HypothesisTable(alike=candidates.alike)
        # What the model that was begun with lacks on sets that were compared with all steps.
        self.rankings: dict[Anchored, Ranking] = {}
        # Effects beside which further ones were looked for.
        self.beside: set[tuple[str, ...]] = set()

    # -- the loop
    # --------------------------------------------------------------------------------------------------------------

    def run(self) -> Explanation:
        start = time.perf_counter()
        base = self.noised(self.begun())
        self.stage(base, self.options.sets)
        while self.deeper():
            pass
        best = self.compared.best()
        check_not_stood_for(best, self.compared.refused, self.model)
        return self.explanation(best, time.perf_counter() - start)

    def begun(self) -> State:
        """The model with a likely set, on what was seen before the body buckles with it."""
        self.step("looking for the likely anchors in a few steps")
        first = first_sets(self.predictor, self.model)
        for one in leave_out(self.predictor, self.model, first[0]):
            self.say(str(one))
        if self.predictor.left_out:
            first = first_sets(self.predictor, self.model)
        self.starts = first
        base = State.of(self.predictor, self.model, first[0])
        with suppress(SolveError):
            base = settled(base)
        self.model = base.model
        return base

    def noised(self, base: State) -> State:
        """The state with the noise that its residual has where none is stated, or where that is surprisingly another."""
        found = told_noise(self.predictor.data, base.rough_values)
        data = self.predictor.data
        if found is None or (data.stated and not found.surprising):
            return base
        if not data.stated:
            # What the mesh leaves is no more known than so: of smooth data without noise nothing would ever be doubted.
            found = replace(found, sigma=max(found.sigma, base.errors.mesh_rms))
        self.predictor.believe(found)
        self.say(f"the measurement has a noise of {found.sigma * 1e3:.3g} mm")
        return State.of(self.predictor, self.model, base.anchors, base.errors.mesh, base.free, base.prediction)

    # -- hypotheses
    # --------------------------------------------------------------------------------------------------------------

    def stage(self, base: State, sets: int) -> None:
        """Weigh so many sets, and effects, beside a model, and fit the likeliest to all steps."""
        self.say(f"weighing anchor sets and effects beside {base.model.name}")
        lacking = self.candidates.beside(base, self.model, self.starts if sets > 1 else ())
        self.lacking = self.lacking or lacking
        among = self.candidates.among
        try:
            found = contest(base, self.model, lacking, self.starts, sets, self.options.fitted, among, self.candidates)
        except SolveError as error:
            self.predictor.skip(f"sets and effects beside {base.model.name}: {error}")
            found = Contest([Rival.of(Fit.at(base), self.model, among)], {})
        best = found.rivals[0]
        if best.anchors != base.anchors:
            with suppress(SolveError):
                base = State.of(self.predictor, base.model, best.anchors, None, base.free)
        self.promote(found, base)

    def promote(self, contest: Contest, base: State) -> None:
        """Fit the likeliest to all steps, and the likeliest without an effect."""
        own = tuple(term.effect.name for term in base.model.added(self.model))
        # Beside an effect that explains all a second one need not be known as well.
        chosen = _for_all_steps(contest, own, WORTH if own and contest.rivals[0].complete else UNLIKELY)
        compared, fitted = self.compared, list[Rival]()
        for number, rival in enumerate(chosen):
            self.step("hypotheses fitted to all steps", number, len(chosen))
            known = compared.like(rival)
            again = known or promoted(rival, base, self.model)
            if again is None:
                continue
            fitted.append(again)
            state = again.fitted.state
            if known is None:
                self.say(f"  {state.model.name}, anchors {self.name(again.anchors)}: {state.rms * 1e3:.3g} mm")
        rivals = [*compared.own, *fitted]
        if not any(rival.names == own for rival in rivals):
            # Whatever else cannot be followed: the model that was begun with was.
            rivals.append(Rival.of(self.allowing(self.alone(base)), self.model, self.candidates.among))
        compared.add([*rivals, *self.elsewhere(best_first(rivals), base)], self.model)
        compared.add_stage(contest)
        self.settle(base)
        self.predictor.drop([self.model, *(rival.fitted.state.model for rival in self.compared.full)])

    @staticmethod
    def alone(base: State) -> Fit:
        """The model that was begun with, with its free numbers fitted."""
        try:
            return fit(base, base.free) if base.free else Fit.at(base)
        except SolveError:
            return Fit.at(base)

    @staticmethod
    def allowing(fitted: Fit) -> Fit:
        """A fit with the curvature of what the scene may have wrong, as far as that can be computed."""
        try:
            return bent(fitted)
        except SolveError:
            return fitted

    def settle(self, base: State) -> None:
        """Fit what is believed most, and others about it, until the likeliest is the one whose tangent was asked about other sets.

        The tangent of one that has lost says little of the sets about the one that has won.
        """
        asked = set()
        while True:
            self.confirm(base)
            best, about = self.compared.best(), self.compared.about
            asked |= {(about.names, about.anchors)} if about else set()
            if (best.names, best.anchors) in asked:
                return
            self.compared.add(self.elsewhere([best, *self.compared.full], base), self.model)

    def confirm(self, base: State) -> None:
        """Fit to all steps what is believed most, until that was, and so was the same without each of its effects.

        A few steps, or a tangent, may have promised too much of the one and too little of the others.
        """
        fitted = refused = 0
        while refused < _REFUSED:
            least = _WORTH if fitted < _CONFIRMED else LIKELIER if fitted < _LIMIT else 1.0
            told = self.compared.unconfirmed(least) or self.compared.unopposed()
            if told is None and self.promised_anew():
                continue
            if told is None:
                return
            self.step("what seems likeliest fitted to all steps", fitted, _CONFIRMED)
            again = self.again(told, base)
            if again is None:
                refused += 1
                self.compared.refuse(told)
                continue
            fitted += 1
            state = again.fitted.state
            self.say(f"  {state.model.name}, anchors {self.name(again.anchors)}: {state.rms * 1e3:.3g} mm")
            self.compared.add([again], self.model)

    def promised_anew(self) -> bool:
        """Ask all steps what the likeliest model lacks, where no effect is thought to act; whether that was not asked before.

        A few steps may show nothing of what remembers, and the errors of another set may hide what an effect explains.
        """
        best = self.compared.best()
        if best.names or best.anchors in self.rankings:
            return False
        self.compared.add_effects(best, self.lacks(best).rows)
        return True

    def lacks(self, plain: Rival) -> Ranking:
        """What a model without effects lacks, as all steps show it; asked once for each set."""
        if plain.anchors not in self.rankings:
            try:
                self.rankings[plain.anchors] = rank(plain.judged, self.lacking, strict=False)
            except SolveError as error:
                self.rankings[plain.anchors] = Ranking((), {effect.name: str(error) for effect in self.lacking})
        return self.rankings[plain.anchors]

    def again(self, told: Hypothesis, base: State) -> Rival | None:
        """A hypothesis that was compared with a few steps, or not at all, with all of them; None where that fails."""
        names, effects, best = told.names, {effect.name: effect for effect in self.lacking}, self.compared.best()
        more = [name for name in best.names if name not in names]
        if told.anchors <= best.anchors and len(more) == 1 and len(names) < len(best.names):
            return promoted(best.without(more[0]), base, self.model, anchors=told.anchors)
        rough = self.compared.roughly(told)
        if rough is not None:
            return promoted(rough, base, self.model)
        like = next((r for r in self.compared.full if r.names == names), None)
        if like is not None:
            return promoted(like, base, self.model, anchors=told.anchors)
        own = tuple(term.effect.name for term in base.model.added(self.model))
        if names[:-1] != own or names[-1] not in effects:
            return None
        try:
            beside = State.of(self.predictor, base.model, told.anchors, None, base.free)
            found = added(beside, effects[names[-1]], self.model, self.candidates.among)
            if found is None or found.term.effect.sudden:
                return found
            # By the error of the mesh that the model without it has, a further effect may seem to act.
            own_errors = promoted(found, base, self.model)
            return best_first([found, own_errors] if own_errors else [found])[0]
        except (SolveError, InputError):
            return None

    def elsewhere(self, rivals: Sequence[Rival], base: State) -> list[Rival]:
        """The best of some hypotheses on other sets, fitted where its tangent in all steps shows them to be as likely."""
        found: list[Rival] = []
        if not rivals:
            return found
        best = rivals[0]
        tried = {r.anchors for r in rivals if r.names == best.names}
        shown = self.shown(best)
        for _ in range(_MOVED):
            near = [s for s in shown if s not in tried and shown[s] > shown[best.anchors] - WORTH]
            if not near:
                break
            anchors = min(near, key=lambda s: (-shown[s], len(s), sorted(s)))
            tried.add(anchors)
            self.step("other anchor sets fitted to all steps", len(found), _MOVED)
            again = promoted(best, base, self.model, anchors=anchors)
            if again is None:
                self.compared.refuse(Hypothesis(anchors, best.hypothesis.effect))
                continue
            found.append(again)
            self.say(
                f"  {again.fitted.state.model.name}, anchors {self.name(anchors)}: {again.fitted.state.rms * 1e3:.3g} mm"
            )
            if again.log > best.log:
                best, shown = again, self.shown(again)
        self.compared.about = best
        unlikely = [s for s, log in shown.items() if log < shown[best.anchors] - WORTH]
        self.compared.fewer = best.without_a_patch(unlikely, glanced(self.predictor), GLANCE, self.model)
        return found

    def shown(self, rival: Rival) -> dict[Anchored, float]:
        """Logarithms of the evidence of other sets with a hypothesis, as its tangent shows them."""
        found = sets_about(rival, self.model)
        self.compared.add_sets(rival, found)
        return {anchors: evidence.total for anchors, evidence in found.items()}

    def deeper(self) -> bool:
        """Look for a further effect beside the likeliest model; whether there was one to look beside."""
        best = self.compared.full[0]
        if not best.names or len(best.names) >= self.options.effects or best.names in self.beside:
            return False
        self.beside.add(best.names)
        self.stage(best.fitted.state, 1)
        return True

    # -- the answer
    # --------------------------------------------------------------------------------------------------------------

    def explanation(self, best: Rival, seconds: float) -> Explanation:
        plain = next(r for r in self.compared.full if not r.names)
        same = next((r for r in self.compared.full if not r.names and r.anchors == best.anchors), plain)
        rungs = [self.rung(rival) for rival in ([plain] if same is plain else [plain, same])]
        rungs[-1] = replace(rungs[-1], ranking=self.lacks(same), rivals=tuple(self.singles()))
        if len(best.names) > 1:
            first = next((r for r in self.compared.full if r.names == best.names[:1]), None)
            rungs += [self.rung(first)] if first else []
        if best.names:
            rungs.append(self.rung(best))
        odds = self.compared.odds
        nearly = bool(best.names) and explains(rungs[0].fitted, rungs[-1].fitted)
        verdict = verdict_of(best.names, odds.best.unknown, nearly, rungs[-1].adequacy.adequate)
        found = Explanation(
            verdict,
            odds,
            tuple(rungs),
            told_anchors(best_first([*self.compared.full, *self.compared.rough]), odds, best, seconds),
            tuple(self.compared.full),
            self.predictor.noise,
            dict(self.predictor.trajectories),
            seconds,
            self.compared.neglected,
            refuted=not (best.names or rungs[-1].adequacy.adequate),
        )
        self.say(
            f"{verdict}, {percent(found.probability)}; anchors {self.name(best.anchors)}, {percent(found.held_by)}"
        )
        return found

    def singles(self) -> list[Rival]:
        """The hypotheses with one effect, the likeliest first."""
        return best_first(r for r in [*self.compared.full, *self.compared.rough] if len(r.names) == 1)

    def rung(self, rival: Rival) -> Rung:
        state, adequacy = rival.fitted.state, judge(rival.fitted.state)
        verdict = f"{adequacy.word} ({p_value(adequacy.p_value)})" if adequacy.told is False else adequacy.word
        self.say(
            f"{state.model.name}, anchors {self.name(state.anchors)}: residual {state.rms * 1e3:.3g} mm, "
            f"noise {state.noise * 1e3:.3g} mm, mesh {state.errors.mesh_rms * 1e3:.2g} mm: {verdict}"
        )
        apart = rival.held_out if rival.held_out is not None else held_out(rival.fitted)
        return Rung(rival.fitted, adequacy, apart)

    def say(self, text: str) -> None:
        self.predictor.progress.say(text)

    def step(self, work: str, done: int = 0, total: int = 0) -> None:
        self.predictor.progress.step(work, done, total)

    def name(self, anchors: Anchored) -> str:
        return label(anchors, self.predictor.scene.patches)


def _for_all_steps(contest: Contest, own: tuple[str, ...], apart: float) -> list[Rival]:
    """The likeliest of what was compared on a few steps, and the likeliest with the effects of the model it was compared beside.

    Of those with which something unknown acts besides only the first: whatever they name, the verdict is the same. Other effects
    that are nearly as likely come before other sets with the same ones, which the tangent in all steps shows. What holds the body
    in the place of a patch besides: no tangent of the others shows it.
    """
    found, chosen, stood = contest.rivals, list[Rival](), list[Rival]()
    firsts = list({rival.names: rival for rival in reversed(found) if rival.log > found[0].log - WORTH}.values())[::-1]
    for rival in [*firsts, *found]:
        if any((r.names, r.anchors) == (rival.names, rival.anchors) for r in chosen):
            continue
        likely = rival.log > found[0].log - apart and (rival.complete or not chosen)
        first_alone = rival.names == own and not any(r.names == rival.names for r in chosen)
        if first_alone or (likely and len(chosen) < _PROMOTED):
            chosen.append(rival)
        elif likely and len(stood) < _STOOD_IN and (rival.names, rival.anchors) in contest.stood_in:
            stood.append(rival)
    return chosen + stood
