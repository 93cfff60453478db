"""The whole loop: anchors, adequacy, the missing effect, its fit, and again, until adequate or unknown."""

from __future__ import annotations

import math
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from bcid.base.errors import SolveError
from bcid.base.progress import Steps
from bcid.base.units import p_value
from bcid.comparison import anchors as anchor_search
from bcid.comparison.adequacy import Adequacy, judge
from bcid.comparison.buckled_frames import leave_out
from bcid.comparison.fit import Fit, fit, held_out
from bcid.comparison.joint import NEARLY, propose
from bcid.comparison.predictor import Predictor
from bcid.comparison.ranking import SIGNIFICANT, Ranking, rank
from bcid.comparison.rivals import STEPS, Rival, at_a_glance, contest, explained, explains
from bcid.comparison.state import State
from bcid.forms import effects
from bcid.forms.effects.effect import Effect
from bcid.forms.model import Model
from bcid.forms.solver.equilibrium import Settings
from bcid.inference.followed import NotFollowed
from bcid.inference.mesh_error import MeshError
from bcid.inference.outcome import label
from bcid.search.identification import Identification
from bcid.search.identify import IdentifyOptions, identify

Array = NDArray[np.float64]
Anchored = frozenset[str]
# Two explanations whose chi-square differs by less (with a penalty for their numbers) cannot be told apart: odds of 20 to 1.
_ODDS = 20.0
_TELLING = 2 * math.log(_ODDS)
# The coarsest level is climbed from random seeds. What that misses is found when sets and effects are looked at together,
# which begins with so many of the best sets.
_SEEDS, _STARTS = 2, 2
# Such a set leaves at most so many times the RMS residual of the best one.
_NEAR = 1.6
# An effect is adopted when it explains at least this part of what noise and mesh leave open.
_LEAST_SHARE = 0.5


@dataclass(frozen=True)
class ExplainOptions:
    """How far the loop goes.

    Attributes:
        level: fine level (see `Predictor`); by default the last with at most 40,000 unknowns.
        effects: effects that may be adopted together at most.
        fitted: candidates that are refitted at each step, on a few steps of each action.
        sets: anchor sets that are looked at together with the effects, at each step.
        only: names of the effects to look at; all by default.
    """

    level: int | None = None
    effects: int = 2
    fitted: int = 5
    sets: int = 28
    only: tuple[str, ...] | None = None


@dataclass(frozen=True)
class Rung:
    """One model of the ladder.

    Attributes:
        fitted: the model, fitted and compared.
        adequacy: the verdict on it.
        held_out: RMS residual when each action is predicted from the others, m, or None.
        ranking: what it lacks, if it was asked.
        rivals: refitted candidates for the next rung, best first.
    """

    fitted: Fit
    adequacy: Adequacy
    held_out: float | None
    ranking: Ranking | None = None
    rivals: tuple[Rival, ...] = ()

    @property
    def state(self) -> State:
        """The model compared with the data."""
        return self.fitted.state


@dataclass(frozen=True)
class Explanation:
    """What the loop found.

    Attributes:
        verdict: name of the effect adopted, several joined by "+"; "none" if the plain model is adequate, "unknown" if
            nothing in the catalogue makes it so, or nearly.
        rungs: the ladder of models.
        identification: anchors with the last model on the working level.
        ambiguous: names of effects that explain as much as the one adopted last.
        trajectories: forward trajectories on the coarse, working and fine levels.
        seconds: time spent.
    """

    verdict: str
    rungs: tuple[Rung, ...]
    identification: Identification
    ambiguous: tuple[str, ...]
    trajectories: dict[str, float]
    seconds: float

    @property
    def last(self) -> Rung:
        """The model the loop ended with."""
        return self.rungs[-1]


def explain(
    predictor: Predictor,
    options: ExplainOptions | None = None,
    model: Model | None = None,
    more: Iterable[Effect] = (),
) -> Explanation:
    """Find anchors and missing effects until the model is adequate, or say that nothing explains the data; collective.

    Args:
        predictor: of the measurement; its progress is told what goes on.
        options: how far to go.
        model: where to begin; by default the scene's model.
        more: effects beyond the catalogue.

    Raises:
        InputError: the options name an unknown effect or level.
        SolveError: the plain model cannot be followed for any anchor set.
    """
    options = options or ExplainOptions()
    known = effects.catalogue(options.only, more)
    return _Loop(predictor, options, model or Model.of(predictor.scene), known).run()


def simplest(found: Identification) -> Anchored:
    """The smallest of the sets that cannot be told apart: what need not be held is not said to be."""
    likely = [
        other for other in found.alternatives if _ODDS * other.probability > found.probability and not other.failure
    ]
    alike = [found.anchored, *found.classes[0], *(other.anchored for other in likely)]
    return min(map(frozenset, alike), key=len)


@dataclass
class _Loop:
    predictor: Predictor
    options: ExplainOptions
    model: Model
    known: list[Effect]
    seen: list[Anchored] = field(default_factory=list)

    # -- the loop
    # --------------------------------------------------------------------------------------------------------------

    def run(self) -> Explanation:
        start = time.perf_counter()
        fitted, identification = self.settle(self.begun())
        rungs = [self.rung(fitted)]
        while len(rungs) <= self.options.effects and not self.settled(rungs):
            ranking, rivals, moved = self.candidates(rungs[-1].fitted)
            if moved is not None:
                fitted, identification = self.settle(moved)
                rungs[-1] = self.rung(fitted)
                continue
            rungs[-1] = replace(rungs[-1], ranking=ranking, rivals=tuple(rivals))
            if not rivals or not self.worthwhile(rivals[0], rungs[-1]):
                break
            fitted, identification = self.settle(rivals[0].fitted)
            fitted = self.pruned(fitted)
            rungs.append(self.rung(fitted))
        return Explanation(
            self.verdict(rungs),
            tuple(rungs),
            identification or self.around(rungs[-1].state),
            self.ambiguous(rungs),
            dict(self.predictor.trajectories),
            time.perf_counter() - start,
        )

    def settled(self, rungs: list[Rung]) -> bool:
        """Whether nothing is missing: the model is adequate, and of the plain one no effect is significant all the same."""
        if not rungs[-1].adequacy.adequate or len(rungs) > 1:
            return rungs[-1].adequacy.adequate
        if rungs[-1].ranking is None:
            rungs[-1] = replace(rungs[-1], ranking=rank(rungs[-1].state, self.known))
        ranking = rungs[-1].ranking
        assert ranking is not None
        return all(row.p_value >= SIGNIFICANT for row in ranking.rows)

    def begun(self) -> Fit:
        """The model with the likely anchors, on what was seen before the body buckles with them."""
        self.step("looking for the likely anchors on a coarse mesh")
        first = self.followed(self.first_anchors())
        for one in leave_out(self.predictor, self.model, first[0]):
            self.say(str(one))
        if self.predictor.left_out:
            first = self.followed(self.first_anchors())
        self.seen = first[1:]
        self.step(f"fitting {self.model.name}")
        return fit(State.of(self.predictor, self.model, first[0]), ())

    def followed(self, sets: list[Anchored]) -> list[Anchored]:
        """Those with which the working level can be followed; where there is none, the best of the sets around them."""
        found = [s for s in sets if not self.predictor.predict(self.model, s, keep=True).failure]
        if found:
            return found
        nothing = MeshError.unknown(self.predictor.data.mask.shape)
        return [frozenset(anchor_search.search(self.predictor, self.model, nothing, sets, "no").anchored)]

    def first_anchors(self) -> list[Anchored]:
        """The likely anchor sets as the plain model sees them on the coarsest level, the likeliest first."""
        options = IdentifyOptions(certify="no", seeds=_SEEDS, finest=0)
        # A set with which the body buckles takes long and is seldom the one: no step is halved for it.
        predictor, frames = self.predictor.thinned(STEPS, Settings(rtol=1e-6, halvings=0))
        try:
            found = identify(
                predictor.whole,
                predictor.measurement,
                predictor.comm,
                options,
                self.model,
                predictor.settings,
                Steps(predictor.progress),
            )
        except NotFollowed as error:
            raise NotFollowed(str(error), error.remark, self.came_to(frames[error.frames])) from None
        self.predictor.count("coarse", sum(found.evaluations.values()))
        near = [a.anchored for a in found.alternatives if a.rms < _NEAR * a.best_rms]
        return [frozenset(names) for names in [found.anchored, *near[: _STARTS - 1]]]

    def came_to(self, frames: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Which of all frames were come to, where these were."""
        found = np.zeros(len(self.predictor.data.mask), dtype=bool)
        for action in self.predictor.actions:
            found[action.frames] = action.frames <= max(np.intersect1d(action.frames, frames), default=-1)
        return found

    def settle(self, fitted: Fit) -> tuple[Fit, Identification | None]:
        """Fit, error of the mesh and anchors, until none of them changes the others.

        Every set of anchors is looked at once where the model is nearly adequate. Where it is not, its best set says little:
        the sets are then looked at together with the effects.
        """
        identification = None
        # A trajectory of a model that remembers costs several times as much.
        certify = "no" if fitted.state.model.remembers else "auto"
        for _ in range(3):
            if fitted.state.errors.mesh.about != (fitted.state.model.name, fitted.state.anchors):
                fitted = self.corrected(fitted)
            state = fitted.state
            if state.chi2 > NEARLY * len(self.predictor.data):
                break
            identification = anchor_search.search(
                self.predictor, state.model, state.errors.mesh, [state.anchors], certify
            )
            found = simplest(identification)
            if found == state.anchors:
                break
            other = fit(State.of(self.predictor, state.model, found, state.errors.mesh, state.free), state.free)
            if other.state.deviance >= state.deviance + _TELLING:
                break
            self.seen.append(state.anchors)
            self.say(f"with {state.model.name} the anchors are {self.name(found)}, not {self.name(state.anchors)}")
            fitted, certify = other, "no"
        return fitted, identification

    def around(self, state: State) -> Identification:
        """The anchors around those of a model that is not adequate."""
        return anchor_search.search(self.predictor, state.model, state.errors.mesh, [state.anchors], "no")

    def corrected(self, fitted: Fit) -> Fit:
        """Fit again with the error of the mesh of the fitted model, until the fitted numbers stay."""
        for _ in range(2):
            state = fitted.state
            self.step(f"the error of the mesh with {state.model.name}")
            mesh = self.predictor.mesh_error(state.model, state.anchors, state.prediction)
            again = fit(
                State.of(self.predictor, state.model, state.anchors, mesh, state.free, state.prediction), state.free
            )
            before, after = (np.array([c.of(f.values[c.name]) for c in f.coordinates]) for f in (fitted, again))
            errors = np.sqrt(np.diag(again.covariance)) if len(after) else np.zeros(0)
            fitted = again
            if not np.any(np.abs(after - before) > 0.5 * np.maximum(errors, 1e-12)):
                break
        return fitted

    def rung(self, fitted: Fit) -> Rung:
        adequacy = judge(fitted.state)
        apart = held_out(fitted)
        state = fitted.state
        verdict = "adequate" if adequacy.adequate else f"not adequate ({p_value(adequacy.p_value)})"
        self.say(
            f"{state.model.name}, anchors {self.name(state.anchors)}: residual {state.rms * 1e3:.3g} mm, "
            f"noise {state.noise * 1e3:.3g} mm, mesh {state.errors.mesh.rms * 1e3:.2g} mm: {verdict}"
        )
        return Rung(fitted, adequacy, apart)

    # -- candidates
    # -----------------------------------------------------------------------------------------------------------

    def candidates(self, fitted: Fit) -> tuple[Ranking, list[Rival], Fit | None]:
        """Rank what is missing, for the anchors at hand and for others, and refit the most promising.

        Where other anchors alone explain more than any effect does, the model with them comes last.
        """
        state = fitted.state
        self.say("ranking the effects by what they would explain, with these anchors and with others")
        ranking = rank(state, self.known, strict=False)
        proposals = at_a_glance(state, 0, lambda thin: propose(thin, self.seen, self.options.sets, self.known))
        here = min((p.left for p in proposals if p.anchors == state.anchors and p.effect is None), default=math.inf)
        best = proposals[0]
        if best.effect is None and best.left < here - _TELLING and best.anchors not in self.seen:
            self.seen.append(best.anchors)
            try:
                moved = fit(State.of(self.predictor, state.model, best.anchors, None, state.free), state.free)
                self.say(f"other anchors explain more than any effect: {self.name(best.anchors)}")
                return ranking, [], moved
            except SolveError:
                pass
        rivals = contest(state, proposals, self.options.fitted)
        for rival in rivals:
            self.say(
                f"  with {rival.term.label}, anchors {self.name(rival.anchors)}: {rival.fitted.state.rms * 1e3:.3g} mm"
            )
        self.predictor.drop([fitted.state.model, *(r.fitted.state.model for r in rivals)])
        return ranking, rivals, None

    def worthwhile(self, rival: Rival, before: Rung) -> bool:
        """Whether a rival explains enough to be believed: what is missing besides may be large, but not much larger.

        Of an adequate model nothing needs to be explained: there a scan must pay for all that it tried.
        """
        least = 2.0
        if before.adequacy.adequate and before.ranking is not None:
            least = 2 * math.log(before.ranking.tried / SIGNIFICANT)
        return explained(before.fitted, rival.fitted) > _LEAST_SHARE and rival.bic < before.fitted.bic - least

    def pruned(self, fitted: Fit) -> Fit:
        """Without effects that a later one has made needless."""
        state = fitted.state
        added = state.model.added(self.model)
        for term in added if len(added) > 1 else ():
            model = state.model.without(term.label)
            names = [name for name in state.free if name not in term.free]
            less = fit(State.of(self.predictor, model, state.anchors, state.errors.mesh), names)
            if less.bic <= fitted.bic:
                self.say(f"{term.label} is not needed any more")
                return self.pruned(less)
        return fitted

    # -- the verdict
    # ----------------------------------------------------------------------------------------------------------

    def verdict(self, rungs: Sequence[Rung]) -> str:
        last = rungs[-1]
        added = [term.effect.name for term in last.state.model.added(self.model)]
        if not explains(rungs[0].fitted, last.fitted, last.adequacy.adequate):
            return "unknown"
        return "+".join(dict.fromkeys(added)) or "none"

    def ambiguous(self, rungs: Sequence[Rung]) -> tuple[str, ...]:
        """Rivals of the effect adopted last that explain as much."""
        if len(rungs) < 2 or not rungs[-2].rivals:
            return ()
        best = rungs[-2].rivals[0]
        near = [r.effect for r in rungs[-2].rivals[1:] if r.bic - best.bic < _TELLING]
        return tuple(name for name in dict.fromkeys(near) if name != best.effect)

    def say(self, text: str) -> None:
        self.predictor.progress.say(text)

    def step(self, work: str) -> None:
        self.predictor.progress.step(work)

    def name(self, anchors: Anchored) -> str:
        return label(anchors, self.predictor.scene.patches)
