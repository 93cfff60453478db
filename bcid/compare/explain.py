"""The whole loop: anchors, adequacy, the missing effect, its fit, and again, until adequate or unknown."""

from __future__ import annotations

import math
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bcid.compare import anchors as anchor_search
from bcid.compare.adequacy import Adequacy, judge
from bcid.compare.buckling import leave_out
from bcid.compare.fit import Fit, fit, held_out
from bcid.compare.missing import SIGNIFICANT, Ranking, Row, rank
from bcid.compare.state import State
from bcid.compare.twin import Twin
from bcid.errors import InputError, SolveError
from bcid.forms.effects.effect import Effect
from bcid.forms.model import Dose, Model
from bcid.forms.solve import Settings
from bcid.progress import Progress, Silent
from bcid.search.farm import label
from bcid.search.identify import Identification, Options, identify

Array = NDArray[np.float64]
Anchored = frozenset[str]
# Two explanations whose chi-square differs by less (with a penalty for their numbers) cannot be told apart: odds of 20 to 1.
_TELLING = 2 * math.log(20.0)
# The coarsest level is climbed from random seeds. What that misses is found on the working level, which is climbed from
# so many of the best sets.
_SEEDS, _STARTS = 4, 2
# A candidate is not refitted when another leaves less than so many times the noise (chi-square per value) and it is
# expected to leave more than so many times.
_NEARLY, _FAR = 1.3, 4.0
# A set from which the working level is climbed, and one that competes with the best, leave at most so many times its RMS
# residual.
_NEAR, _RIVAL = 1.6, 1.3
# Candidates are refitted to this relative change of chi-square.
_ROUGH = 3e-3
# A reciprocal or a direction may need a start away from the neutral value: part of the way to the expected value.
_CAUTION = (1.0, 0.5, 0.2)


@dataclass(frozen=True)
class Plan:
    """How far the loop goes.

    Attributes:
        level: fine level (see `Twin`); by default the last with at most 40,000 unknowns.
        effects: effects that may be adopted together at most.
        fitted: candidates that are refitted at each step.
        sets: anchor sets that compete with the best one at each step.
        only: names of the effects to look at; all by default.
    """

    level: int | None = None
    effects: int = 3
    fitted: int = 3
    sets: int = 2
    only: tuple[str, ...] | None = None


@dataclass(frozen=True)
class Rival:
    """A candidate that was refitted: a set of anchors and an effect added to the model before.

    Attributes:
        effect: name of the effect.
        dose: fitted.
        anchors: the set.
        fitted: the fit.
        criterion: chi-square with a penalty for the fitted numbers (Schwarz 1978).
        held_out: RMS residual when each action is predicted from the others, m, for the best rivals.
    """

    effect: str
    dose: Dose
    anchors: Anchored
    fitted: Fit
    criterion: float
    held_out: float | None = None


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
            nothing in the catalogue makes it so.
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
    twin: Twin,
    plan: Plan | None = None,
    model: Model | None = None,
    more: Iterable[Effect] = (),
    progress: Progress | None = None,
) -> Explanation:
    """Find anchors and missing effects until the model is adequate, or say that nothing explains the data; collective.

    Args:
        twin: of the measurement.
        plan: how far to go.
        model: where to begin; by default the scene's model.
        more: effects beyond the catalogue.
        progress: told what goes on (give it on rank 0 only).

    Raises:
        InputError: the plan names an unknown effect or level.
        SolveError: the plain model cannot be followed for any anchor set.
    """
    loop = _Loop(twin, plan or Plan(), tuple(more), progress or Silent())
    return loop.run(model or Model.of(twin.scene))


@dataclass
class _Loop:
    twin: Twin
    plan: Plan
    more: tuple[Effect, ...]
    progress: Progress

    def __post_init__(self) -> None:
        self.scene, self.measurement, self.comm = self.twin.whole, self.twin.measurement, self.twin.comm
        self.seen: list[Anchored] = []

    # -- the loop
    # --------------------------------------------------------------------------------------------------------------

    def run(self, model: Model) -> Explanation:
        start = time.perf_counter()
        first = self.first_anchors(model)
        self.seen = list(first)
        for one in leave_out(self.twin, model, first[0]):
            self.say(str(one))
        if self.twin.left_out:
            self.measurement = self.twin.measurement
            first = self.first_anchors(model)
        begun = fit(self.state(model, first[0]), free_numbers(model, self.twin))
        fitted, identification = self.settle(begun, more=first[1:])
        rungs = [self.rung(fitted)]
        while not rungs[-1].adequacy.adequate and len(rungs) <= self.plan.effects:
            ranking, rivals = self.candidates(rungs[-1].fitted, identification)
            rungs[-1] = replace(rungs[-1], ranking=ranking, rivals=tuple(rivals))
            if not rivals or rivals[0].criterion >= criterion(rungs[-1].fitted) - 2:
                break
            fitted, identification = self.settle(rivals[0].fitted)
            fitted = self.pruned(fitted)
            rungs.append(self.rung(fitted))
        if rungs[-1].ranking is None and rungs[-1].adequacy.adequate and len(rungs) == 1:
            rungs[-1] = self.second_look(rungs[-1])
        return Explanation(
            self.verdict(rungs, model),
            tuple(rungs),
            identification,
            self.ambiguous(rungs),
            dict(self.twin.trajectories),
            time.perf_counter() - start,
        )

    def first_anchors(self, model: Model) -> list[Anchored]:
        """The likely anchor sets as the plain model sees them on the coarsest level, the likeliest first."""
        options = Options(certify="no", seeds=_SEEDS, finest=0)
        # A set with which the body buckles takes long and is seldom the one.
        found = identify(self.scene, self.measurement, self.comm, options, model, Settings(rtol=1e-6, halvings=0))
        self.twin.count("coarse", sum(found.evaluations.values()))
        near = [a.anchored for a in found.alternatives if a.rms < _NEAR * a.best_rms]
        return [frozenset(names) for names in [found.anchored, *near[: _STARTS - 1]]]

    def state(self, model: Model, anchors: Anchored) -> State:
        return State.of(self.twin, model, anchors)

    def settle(self, fitted: Fit, more: Sequence[Anchored] = ()) -> tuple[Fit, Identification]:
        """Fit, error of the mesh and anchors, until none of them changes the others; `more` sets are climbed from too.

        Every set is looked at where the model is nearly adequate: where it is not, few can be stopped early.
        """
        identification = None
        for _ in range(3):
            fitted = self.corrected(fitted)
            state = fitted.state
            near = state.chi2 < _NEARLY * len(self.twin.data)
            starts, certify = ([state.anchors], "auto") if near else ([state.anchors, *more], "no")
            identification = anchor_search.search(self.twin, state.model, state.errors.mesh, starts, certify)
            found = frozenset(identification.anchored)
            if found == state.anchors:
                break
            other = fit(State.of(self.twin, state.model, found, state.errors.mesh, state.free), state.free)
            if other.state.chi2 >= state.chi2:
                break
            self.seen.append(found)
            self.say(f"with {state.model.name} the anchors are {self.name(found)}, not {self.name(state.anchors)}")
            fitted = other
        assert identification is not None
        return fitted, identification

    def corrected(self, fitted: Fit, most: int = 2) -> Fit:
        """Fit again with the error of the mesh of the fitted model, until the fitted numbers stay."""
        for _ in range(most):
            state = fitted.state
            mesh = self.twin.mesh_error(state.model, state.anchors, state.reply)
            again = fit(State.of(self.twin, state.model, state.anchors, mesh, state.free, state.reply), state.free)
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
        verdict = "adequate" if adequacy.adequate else f"not adequate (p = {adequacy.p_value:.2g})"
        self.say(
            f"{state.model.name}, anchors {self.name(state.anchors)}: residual {state.rms * 1e3:.3g} mm, "
            f"noise {state.noise * 1e3:.3g} mm, mesh {state.errors.mesh.rms * 1e3:.2g} mm: {verdict}"
        )
        return Rung(fitted, adequacy, apart)

    def second_look(self, rung: Rung) -> Rung:
        """An adequate model is asked once whether one effect alone is significant all the same."""
        ranking = rank(rung.state, self.more, self.plan.only)
        return replace(rung, ranking=ranking)

    # -- candidates
    # -----------------------------------------------------------------------------------------------------------

    def candidates(self, fitted: Fit, identification: Identification) -> tuple[Ranking, list[Rival]]:
        """Rank what is missing, for the anchors at hand and for those that come next, and refit the most promising."""
        state = fitted.state
        self.say("ranking the effects by what they would explain, and fitting the first of them")
        ranking = rank(state, self.more, self.plan.only, strict=False)
        proposals = [(row, state) for row in ranking.rows]
        for other in self.next_sets(fitted, identification):
            proposals += [(row, other) for row in rank(other, self.more, self.plan.only, strict=False).rows]
        rivals = refit_candidates(fitted, proposals, self.plan)
        for rival in rivals:
            self.progress.say(
                f"  with {rival.dose.label}, anchors {self.name(rival.anchors)}: {rival.fitted.state.rms * 1e3:.3g} mm"
            )
        self.twin.drop([fitted.state.model, *(r.fitted.state.model for r in rivals[:2])])
        return ranking, rivals

    def next_sets(self, fitted: Fit, identification: Identification) -> list[State]:
        """The sets that come next to the best one, with the present model."""
        state = fitted.state
        found: list[State] = []
        near = [frozenset(a.anchored) for a in identification.alternatives if a.rms < _RIVAL * a.best_rms]
        # Without the missing effect another set may fit better than the true one, which was met before or comes next.
        for anchors in dict.fromkeys([*near[:1], *self.seen, *near]):
            if len(found) == self.plan.sets:
                break
            if not anchors or anchors == state.anchors:
                continue
            try:
                rival = State.of(self.twin, state.model, anchors, state.errors.mesh, state.free)
                found.append(fit(rival, state.free, most=4).state if state.free else rival)
            except SolveError:
                continue
        return found

    def pruned(self, fitted: Fit) -> Fit:
        """Without effects that a later one has made needless."""
        for dose in fitted.state.model.doses:
            if (
                dose.full(next(iter(dose.values))) not in free_numbers(fitted.state.model, self.twin)
                or len(fitted.state.model.doses) < 2
            ):
                continue
            model = fitted.state.model.without(dose.label)
            state = State.of(self.twin, model, fitted.state.anchors, fitted.state.errors.mesh)
            less = fit(state, free_numbers(model, self.twin))
            if criterion(less) <= criterion(fitted):
                self.say(f"{dose.label} is not needed any more")
                return self.pruned(less)
        return fitted

    # -- the verdict
    # ----------------------------------------------------------------------------------------------------------

    def verdict(self, rungs: Sequence[Rung], model: Model) -> str:
        last = rungs[-1]
        if not last.adequacy.adequate:
            return "unknown"
        begun = {dose.label for dose in model.doses}
        added = [dose.effect.name for dose in last.state.model.doses if dose.label not in begun]
        return "+".join(dict.fromkeys(added)) or "none"

    def ambiguous(self, rungs: Sequence[Rung]) -> tuple[str, ...]:
        """Rivals of the effect adopted last that explain as much."""
        if len(rungs) < 2 or not rungs[-2].rivals:
            return ()
        best = rungs[-2].rivals[0]
        near = [r.effect for r in rungs[-2].rivals[1:] if r.criterion - best.criterion < _TELLING]
        return tuple(name for name in dict.fromkeys(near) if name != best.effect)

    def say(self, text: str) -> None:
        self.progress.say(text)

    def name(self, anchors: Anchored) -> str:
        return label(anchors, self.scene.patches)


def criterion(fitted: Fit) -> float:
    """Chi-square, with the logarithm of the number of values for each fitted number (Schwarz 1978)."""
    return fitted.state.chi2 + len(fitted.coordinates) * math.log(len(fitted.state.twin.data))


def free_numbers(model: Model, twin: Twin) -> tuple[str, ...]:
    """Numbers that are fitted: all of the effects that the scene does not have.

    A first frame is no smooth number, and a period of 0, which stands for what is steady, has nothing to do with a short one.
    """
    known = set(Model.of(twin.scene).constants())
    return tuple(
        name
        for name, value in model.constants().items()
        if name not in known and not name.endswith(".onset") and not (name.endswith(".period") and value == 0)
    )


def refit_candidates(fitted: Fit, proposals: Iterable[tuple[Row, State]], plan: Plan) -> list[Rival]:
    """Refit the most promising of ranked effects, each with the anchor set of its state; best first; collective."""
    size = math.log(len(fitted.state.twin.data))
    waiting = [(row, state) for row, state in proposals if row.p_value < SIGNIFICANT]
    waiting.sort(key=lambda pair: pair[1].chi2 - pair[0].score + size * pair[0].freedom)
    rivals: list[Rival] = []
    tried: dict[str, int] = {}
    for row, base in waiting:
        if len(rivals) >= plan.fitted:
            break
        # An effect may compete with two anchor sets, but must not crowd out the others.
        if tried.get(row.effect, 0) >= 2 or _hopeless(row, base, rivals):
            continue
        tried[row.effect] = tried.get(row.effect, 0) + 1
        rival = _refit(fitted, row, base)
        if rival is not None:
            rivals.append(rival)
    rivals.sort(key=lambda rival: rival.criterion)
    return [replace(r, held_out=held_out(r.fitted)) if i < 2 else r for i, r in enumerate(rivals)]


def _hopeless(row: Row, base: State, rivals: Sequence[Rival]) -> bool:
    """Whether a rival explains nearly all already, and this effect is not expected to come near that."""
    values = len(base.twin.data)
    best = min((rival.fitted.state.chi2 for rival in rivals), default=math.inf)
    return best < _NEARLY * values and base.chi2 - row.score > _FAR * values


def _refit(fitted: Fit, row: Row, base: State) -> Rival | None:
    """Add an effect, begin at what is expected of it, and fit everything together."""
    for part in _CAUTION:
        try:
            model = base.model + _careful(row, base.model, part)
            names = tuple(dict.fromkeys([*fitted.state.free, *free_numbers(model, base.twin)]))
            begun = set(base.model.constants())
            names = tuple(n for n in names if n in fitted.state.free or n not in begun)
            state = State.of(base.twin, model, base.anchors, base.errors.mesh)
            again = fit(state, names, most=8, ftol=_ROUGH)
        except (SolveError, InputError):
            continue
        return Rival(row.effect, again.state.model.doses[-1], base.anchors, again, criterion(again))
    return None


def _careful(row: Row, model: Model, part: float) -> Dose:
    """The expected dose, or a part of it, within its bounds."""
    values = {}
    for p in row.dose.effect.parameters:
        value, neutral = row.dose.values[p.name], model.neutral(p)
        if p.reciprocal:
            value = p.typical if not math.isfinite(value) else value / part
            value = min(value, 1e4 * p.typical)
        elif neutral is not None:
            value = neutral + part * (value - neutral)
        values[p.name] = float(np.clip(value, p.lower, p.upper))
    return Dose(row.dose.effect, values, place=row.dose.place)
