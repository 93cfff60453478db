"""Candidates for what is missing: effects fitted to a model, each with its set of anchors, and their evidence."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bcid.base.errors import InputError, SolveError
from bcid.forms.effects.effect import Effect
from bcid.forms.model import Model, Term
from bcid.forms.solver.equilibrium import Settings
from bcid.inference.discrepancy import Evidence
from bcid.inference.error_covariance import ErrorCovariance
from bcid.inference.evidence import LinearParameters
from bcid.inference.hypotheses import Hypothesis, log_prior
from bcid.search.candidates import StandIn
from bcid.search.fitting.curvature import bent
from bcid.search.fitting.fit import FTOL, Fit, columns, coordinates, fit
from bcid.search.fitting.held_out import held_out
from bcid.search.fitting.loosened import loosens
from bcid.search.fitting.parameter_priors import of_state
from bcid.search.fitting.ranking import Row, rank
from bcid.search.fitting.state import State, in_few_steps
from bcid.search.settings import SETTINGS

Array = NDArray[np.float64]
Anchored = frozenset[str]
# Candidates are refitted to this relative change of chi-square.
ROUGH = 3e-3
# A reciprocal or a direction may need a start away from the neutral value: part of the way to the expected value.
_CAUTION = (1.0, 0.5, 0.2)
# The error of the mesh is that of numbers that are no more than this part of a notable change off; it is asked for so often anew.
_FAR_OFF, _REMESHED = 0.2, 2
# Numbers that say about which place an effect acts.
_PLACE = {"cx", "cy", "cz"}
_NOTHING = Evidence(-math.inf, -math.inf, 0.0)


@dataclass(frozen=True)
class FittedHypothesis:
    """A hypothesis that was fitted: a set of anchors, and the effects added to the model that was begun with.

    Attributes:
        names: of the effects, one after the other; none for the model as it was.
        fitted: the fit.
        evidence: of it, with and without an unknown force besides.
        known: how many effects may act.
        held_out: RMS residual when each action is predicted from the others, m, where that was asked.
        allowed: the fitted model with the errors by which the evidence was weighed, where these are not its own.
    """

    names: tuple[str, ...]
    fitted: Fit
    evidence: Evidence
    known: int
    held_out: float | None = None
    allowed: State | None = None

    @property
    def anchors(self) -> Anchored:
        """The set."""
        return self.fitted.state.anchors

    @property
    def hypothesis(self) -> Hypothesis:
        """Its set and effects, whatever acts besides."""
        return Hypothesis(self.anchors, "+".join(self.names))

    @property
    def term(self) -> Term:
        """The effect that was added last."""
        return self.fitted.state.model.terms[-1]

    @property
    def effect(self) -> str:
        """Its name."""
        return self.names[-1]

    @property
    def logs(self) -> dict[Hypothesis, float]:
        """Logarithms of evidence and prior, without and with an unknown force besides."""
        return {hypothesis: evidence + prior for hypothesis, (evidence, prior) in self.weights.items()}

    @property
    def weights(self) -> dict[Hypothesis, tuple[float, float]]:
        """The same one by one."""
        name, count = "+".join(self.names), len(self.names)
        return {
            Hypothesis(self.anchors, name): (self.evidence.plain, log_prior(count, False, self.known)),
            Hypothesis(self.anchors, name, True): (self.evidence.forced, log_prior(count, True, self.known)),
        }

    def acts_on(self, anchors: Anchored) -> bool:
        """Whether the patches that its effects hold by springs, or let go, are among some."""
        return {t.place for t in self.fitted.state.model.terms if t.place and loosens(t.effect)} <= anchors

    def without(self, name: str) -> FittedHypothesis:
        """Where to begin with the same without one of its effects: nothing was computed with that yet."""
        state = self.fitted.state
        term = next(term for term in state.model.terms[::-1] if term.effect.name == name)
        free = tuple(number for number in state.free if number not in {term.full(p) for p in term.values})
        names = tuple(other for other in self.names if other != name)
        return replace(
            self, names=names, fitted=Fit.at(replace(state, model=state.model.without(term.label), free=free))
        )

    def allowing(self, left: Array, begun: Model) -> FittedHypothesis:
        """The same with what may be left of the error of the mesh as it is with another hypothesis, (frames, fiducials, 3), m."""
        old = self.fitted.state
        if old.errors.mesh.left is left:
            return self
        state = old.with_errors(replace(old.errors.mesh, left=left))
        return replace(self, evidence=weighed(state, begun, self.jacobian(state.errors)), allowed=state)

    def jacobian(self, errors: ErrorCovariance) -> Array:
        """Change of the residual with each fitted number in units of other errors than its own, shape (n, p)."""
        state = self.fitted.state
        moved = [errors.whiten(state.errors.unwhiten(column)) for column in self.fitted.jacobian.T]
        return np.column_stack([*moved, np.zeros((len(state.predictor.data), 0))])

    def without_a_patch(self, sets: Iterable[Anchored], steps: int, settings: Settings, begun: Model) -> list[Anchored]:
        """Those of some sets that lack one of its patches and are as likely, as a few steps with its numbers show; collective.

        A patch may hold back what would make the body unstable without it, which then moves otherwise than any tangent shows.
        """
        state, count = self.fitted.state, len(self.anchors) - 1
        thin, frames = state.predictor.thinned(steps, settings)
        seen = np.zeros(len(state.predictor.data.mask), dtype=bool)
        fewer = sorted((s for s in sets if s < self.anchors and len(s) == count), key=sorted)
        moves = {anchors: np.zeros_like(state.predicted) for anchors in fewer}
        for number, action in enumerate(thin.actions, 1):
            here = frames[action.frames]
            seen[here] = True
            for anchors, moved in moves.items():
                found = thin.predict(state.model, anchors, actions=[action])
                # What cannot be followed in a few steps says nothing: it may be in all.
                if not found.failure:
                    moved[here] = found.positions[action.frames] - state.prediction.positions[here]
            # What has lost in one action is not followed in the others.
            least = SETTINGS.unlikely if number == len(thin.actions) else SETTINGS.hopeless
            moves = {s: moves[s] for s, log in self._shown(moves, seen, begun).items() if log > -least}
        return list(moves)

    def _shown(self, moves: Mapping[Anchored, Array], seen: NDArray[np.bool_], begun: Model) -> dict[Anchored, float]:
        """Logarithms of the odds of sets against this one that move the fiducials elsewhere, by the frames that are seen alone."""
        state = self.fitted.state
        errors = state.errors.masked(~seen[state.predictor.data.frame])
        only = replace(state, errors=errors)
        numbers = of_state(only, begun, self.jacobian(errors)) or LinearParameters.none(len(state.predictor.data))
        shifts = [state.predictor.data.vector(moved) for moved in (np.zeros_like(state.predicted), *moves.values())]
        here, *logs = (Evidence.of(errors, only.residual - shift, only.forces, numbers).total for shift in shifts)
        return {anchors: log - here for anchors, log in zip(moves, logs, strict=True)}

    @property
    def judged(self) -> State:
        """The fitted model with the errors by which it was weighed: what it promises beside other hypotheses is judged by them."""
        return self.allowed or self.fitted.state

    @property
    def complete(self) -> bool:
        """Whether it is likelier that nothing else acts: no other hypothesis can do much better then."""
        plain, forced = self.logs.values()
        return plain > forced

    @property
    def log(self) -> float:
        """Of both together."""
        plain, forced = self.logs.values()
        return float(np.logaddexp(plain, forced))

    @property
    def log_evidence(self) -> float:
        """Logarithm of the evidence with or without a discrepancy, all effects being as likely."""
        return self.log - log_prior(len(self.names), False, self.known)

    @classmethod
    def of(cls, fitted: Fit, begun: Model, known: int) -> FittedHypothesis:
        """Of a fit of a model that was begun from another."""
        names = tuple(term.effect.name for term in fitted.state.model.added(begun))
        return cls(names, fitted, weighed(fitted.state, begun, fitted.jacobian), known)

    @classmethod
    def unfitted(cls, state: State, begun: Model, known: int) -> FittedHypothesis:
        """A model with numbers that were fitted elsewhere, or none: what they would do here its tangent shows; collective."""
        names = tuple(term.effect.name for term in state.model.added(begun))
        chosen = coordinates(state.model, state.free)
        jacobian = -state.errors.whiten(columns(state.predictor, state.model, state.anchors, state.prediction, chosen))
        fitted = replace(Fit.at(state), jacobian=jacobian)
        return cls(names, fitted, weighed(state, begun, jacobian), known)


def weighed(state: State, begun: Model, jacobian: Array | None = None) -> Evidence:
    """Evidence of a model whose free numbers were unknown, beside the model that it was begun from; collective.

    Where their `jacobian` is not known (see `Fit`), it is computed.
    """
    numbers = of_state(state, begun, jacobian)
    return _NOTHING if numbers is None else state.evidence(numbers)


def best_first(rivals: Iterable[FittedHypothesis]) -> list[FittedHypothesis]:
    """The likeliest first."""
    return sorted(rivals, key=lambda r: (-r.log, len(r.names), len(r.anchors), sorted(r.anchors), r.names))


def promoted(
    rival: FittedHypothesis,
    full: State,
    begun: Model,
    anchors: Anchored | None = None,
) -> FittedHypothesis | None:
    """A rival that was fitted to a part of the steps, with all of them and the error of the mesh of its own; None if it fails.

    An effect may stand for what the mesh has wrong with another model: its own tells. With `anchors`, on another set.
    """
    model, free = rival.fitted.state.model, rival.fitted.state.free
    anchors = rival.anchors if anchors is None else anchors
    alike = (full.model.name, full.anchors) == (model.name, anchors)
    mesh = full.errors.mesh if alike else None
    try:
        if rival.names and (rival.term.effect.sudden or any(p.off is not None for p in rival.term.effect.parameters)):
            # In which frame it begins, and whether it comes and goes, is only known once all are looked at.
            own = full.errors.mesh if anchors == full.anchors else None
            others = tuple(name for name in free if name not in rival.term.free)
            base = State.of(full.predictor, model.without(rival.term.label), anchors, own, others)
            return added(base, rival.term.effect, begun, rival.known)
        if anchors != rival.anchors:
            # Its numbers will be others, and the error of the mesh with them.
            mesh = rival.fitted.state.errors.mesh
        found = fit(State.of(full.predictor, model, anchors, mesh), free, most=8)
        if anchors != rival.anchors:
            there = FittedHypothesis.of(found, begun, rival.known)
            if there.log < rival.log - SETTINGS.hopeless:
                # It has lost whatever the error of the mesh is with it.
                return there
        found = _remeshed(found, model if anchors == rival.anchors else None)
        if not found.settled:
            # Standard errors are those at the end of a fit, and say nothing of how far that still is.
            found = fit(found.state, free, most=SETTINGS.settling, like=found)
        found = bent(found)
    except (SolveError, InputError):
        return None
    return FittedHypothesis.of(found, begun, rival.known)


def _remeshed(found: Fit, model: Model | None, ftol: float = FTOL) -> Fit:
    """A fit with the error of the mesh at its own numbers, where its own is that of a model with others; None is without them."""
    for _ in range(_REMESHED):
        if model is not None and not _elsewhere(found, model):
            break
        model = found.state.model
        found = fit(found.state.with_own_errors(anew=True), found.state.free, most=4, ftol=ftol, like=found)
    return found


def _elsewhere(found: Fit, model: Model) -> bool:
    """Whether fitted numbers are so far from those of a model that the error of the mesh may be another."""
    before, after = model.constants(), found.state.model.constants()
    return any(abs(c.of(after[c.name]) - c.of(before[c.name])) > _FAR_OFF * c.scale for c in found.coordinates)


def added(base: State, effect: Effect, begun: Model, known: int) -> FittedHypothesis | None:
    """An effect beside a model that was compared with all steps, where they show that it promises most; None if it fails."""
    rows = rank(base, [effect], strict=False).rows
    found = refit(base, rows[0], begun, known) if rows else []
    if not found:
        return None
    fitted = found[0].fitted
    if effect.sudden and effect.moves:
        # From a frame on the body moves otherwise, and so the error of the mesh is another.
        fitted = fit(fitted.state.with_own_errors(anew=True), fitted.state.free, most=4)
    return FittedHypothesis.of(bent(fitted), begun, known)


def refit(state: State, row: Row, begun: Model, known: int) -> list[FittedHypothesis]:
    """Add an effect, begin at what is expected of it, and fit everything together; nothing if that cannot be followed."""
    return refit_term(state, row.term, row.gain, begun, known)


def refit_term(state: State, term: Term, gain: float, begun: Model, known: int) -> list[FittedHypothesis]:
    """The same of a term with the values that it is begun with, which is expected to gain so much.

    One whose shape is fitted too may end in a minimum that is not the least: where it explains less than was expected, it is begun
    elsewhere as well.
    """
    found: list[FittedHypothesis] = []
    for part in _CAUTION:
        try:
            again = _begun_with(state, state.anchors, _careful(term, state.model, part))
        except (SolveError, InputError):
            continue
        found.append(FittedHypothesis.of(again, begun, known))
        if (
            not term.effect.shapes
            or found[-1].evidence.plain > weighed(state, begun).plain + gain - SETTINGS.comparable
        ):
            break
    return best_first(found)[:1]


def fitted_beside(state: State, known: Sequence[Effect], most: int) -> list[FittedHypothesis]:
    """The most promising effects beside a model with its set, `most` of them, fitted to all steps; collective."""
    thin = in_few_steps(state)
    try:
        rows = [row for row in rank(thin, known, strict=False).rows if math.isfinite(row.gain)][:most]
    except SolveError:
        return []
    few = [rival for row in rows for rival in refit(thin, row, state.model, len(known))]
    fitted = [rival for rival in (promoted(one, state, state.model) for one in few) if rival]
    return best_first(replace(rival, held_out=held_out(rival.fitted)) for rival in fitted)


def stood_in(state: State, stand_in: StandIn, begun: Model, known: int) -> list[FittedHypothesis]:
    """What may hold the body in the place of a patch of a set, fitted with all else; nothing if that cannot be followed."""
    try:
        return [FittedHypothesis.of(_begun_with(state, stand_in.anchors, stand_in.term), begun, known)]
    except (SolveError, InputError):
        return []


def _begun_with(state: State, anchors: Anchored, term: Term) -> Fit:
    """A term beside a model, fitted with it from where it begins, with some anchors."""
    start = state.of_set(anchors, state.model + term)
    if loosens(term.effect):
        # Where anchors give, what is slightly wrong moves the body otherwise than where they hold.
        start = start.with_own_errors(anew=True)
    again = fit(start, (*state.free, *term.free), most=8, ftol=ROUGH)
    if not again.settled and {p.name for p in term.effect.shapes} >= _PLACE:
        # What still looks for its place is not as unlikely as it seems.
        again = fit(again.state, again.state.free, most=SETTINGS.settling, ftol=ROUGH, like=again)
    return again


def _careful(term: Term, model: Model, part: float) -> Term:
    """The expected term, or a part of it, within its bounds."""
    values = {}
    for p in term.effect.parameters:
        value, neutral = term.values[p.name], model.neutral(p)
        if p.reciprocal:
            value = p.scale if not math.isfinite(value) else value / part
            value = min(value, 1e4 * p.scale)
        elif p.switch and neutral is not None:
            value = neutral + p.scale
        elif neutral is not None:
            value = neutral + part * (value - neutral)
        values[p.name] = float(np.clip(value, p.lower, p.upper))
    return Term(term.effect, values, place=term.place)
