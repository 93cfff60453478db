"""Which pull to make next: the one that is expected to tell most for its cost, among those that are allowed."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from bcid.exploration.hypothesis_predictions import HypothesisPredictor
from bcid.exploration.moves import Move, cost, limits_of
from bcid.exploration.posterior_summary import PosteriorSummary
from bcid.forms.gripper_force import ROWS
from bcid.forms.simulate import recorded, with_wrenches
from bcid.inference.data import LEAST_NOISE, Data
from bcid.inference.error_covariance import ErrorCovariance
from bcid.inference.hypotheses import Hypothesis, entropy
from bcid.inference.information import Expected, information, noise_free
from bcid.inference.mesh_error import MeshError
from bcid.inference.thresholds import THRESHOLDS
from bcid.measurement import Action
from bcid.predict.pull_prediction import PullPrediction
from bcid.predict.questions import of_pull
from bcid.scene import Scene
from bcid.search.settings import SETTINGS

Array = NDArray[np.float64]
# Pulls there and back promise the same by the linear response, but for round-off: so many digits tell them apart.
_ALIKE = 9
# Of the gripper's path: where the response is linear.
_SMALL = 0.01


@dataclass(frozen=True)
class Option:
    """A pull that was considered.

    Attributes:
        move: the pull.
        expected: information it is expected to give; by the linear response when `linear`.
        price: what it costs.
        linear: whether only the linear response was looked at.
        forbidden: why it is not allowed, or "".
    """

    move: Move
    expected: Expected
    price: float
    linear: bool = True
    forbidden: str = ""

    @property
    def worth(self) -> float:
        """Bits for its cost."""
        return self.expected.bits / self.price


@dataclass(frozen=True)
class Choice:
    """The pull to make, and what else was considered.

    Attributes:
        move: the pull; None when no allowed pull tells anything.
        expected: its information.
        options: all pulls, the best first.
        ahead: the second pull that was thought of, if that decided.
    """

    move: Move | None
    expected: Expected
    options: tuple[Option, ...]
    ahead: Move | None = None


@dataclass(frozen=True)
class Predictive:
    """What the hypotheses predict for a pull, in units of its errors.

    Attributes:
        means: shape (hypotheses, values).
        loose: of each, what its unknown numbers change, shape (numbers, values).
    """

    means: Array
    loose: tuple[Array, ...]

    def __add__(self, other: Predictive) -> Predictive:
        """Two pulls as one: the unknown numbers are the same in both."""
        loose = (np.concatenate(pair, axis=1) for pair in zip(self.loose, other.loose, strict=True))
        return Predictive(np.concatenate([self.means, other.means], axis=1), tuple(loose))


@dataclass(frozen=True)
class Chooser:
    """Chooses pulls; collective on the ranks of the predictor, with the same choice on all.

    Attributes:
        scene: with limits.
        predictor: predicts pulls.
        moves: what may be done.
        criterion: "information", "entropy" (as in the paper, without noise), or "random".
        look_ahead: whether pairs of pulls are looked at.
        samples: of the estimate of information.
        noise: standard deviation of a coordinate, m, in pulls to come.
        wrench_noise: of a force, N, where the predictor predicts them.
        random_state: of the estimate, and of random choice.
        barred: pulls that cannot be made, and why.
    """

    scene: Scene
    predictor: HypothesisPredictor
    moves: tuple[Move, ...]
    criterion: str
    look_ahead: bool
    samples: int
    noise: float
    random_state: int
    wrench_noise: float = 0.0
    barred: dict[Move, str] = field(default_factory=dict)
    _expected_values: dict[str, Data] = field(default_factory=dict, init=False, repr=False)

    def choose(self, view: PosteriorSummary, last: Move | None) -> Choice:
        """The next pull after `last`."""
        barred = dict(self.barred)
        while True:
            choice = self._choose(view, last, barred)
            reason = self._barred(choice.move, view) if choice.move else ""
            if not (choice.move and reason):
                return choice
            barred[choice.move] = reason

    def _choose(self, view: PosteriorSummary, last: Move | None, barred: Mapping[Move, str]) -> Choice:
        limits = limits_of(self.scene)
        sets = credible_set(view)
        options = [
            Option(move, Expected(0.0), cost(move, last, limits), forbidden=barred.get(move, "")) for move in self.moves
        ]
        if self.criterion == "random":
            return self._random(options, view, sets)
        if len(options) > SETTINGS.batch_of_pulls or len(sets) > SETTINGS.predicted_sets:
            options = sorted(self._linear(options, view), key=lambda o: -round(o.worth, _ALIKE))
        if len(sets) > SETTINGS.predicted_sets:
            return self._first_allowed(options, view, sets)
        return self._best(options, view, sets)

    def _barred(self, move: Move, view: PosteriorSummary) -> str:
        """Why a pull that the working level allows is not: a finer mesh buckles earlier. "" if it can be followed there too."""
        likely = [h for h, p in view.probabilities.items() if p > 1 - THRESHOLDS.credible]
        if self.predictor.fine is None or not likely:
            return ""
        predicted = self.predictor.predict_finely(likely, view.fitted, self._action(move), detailed=False)
        return self._forbidden(predicted, np.array([view.probabilities[h] for h in likely]))

    # -- ways to choose
    # --------------------------------------------------------------------------------------------------------------

    def _best(self, options: list[Option], view: PosteriorSummary, sets: list[Hypothesis]) -> Choice:
        """By full predictions, those that promise most first, until one of them is worth it."""
        seen: list[Option] = []
        shown: dict[Move, Predictive] = {}
        for i in range(0, len(options), SETTINGS.batch_of_pulls):
            for option in options[i : i + SETTINGS.batch_of_pulls]:
                predicted, forbidden = self._asked(option, view, sets, weights(view.probabilities, sets))
                if forbidden:
                    seen.append(replace(option, forbidden=forbidden))
                    continue
                shown[option.move] = self._in_errors(option.move, predicted, view)
                expected = self._expected(shown[option.move], weights(view.probabilities, sets))
                seen.append(replace(option, expected=expected, linear=False))
            if any(telling(o) for o in seen):
                break
        allowed = sorted((o for o in seen if telling(o)), key=lambda o: -o.worth)
        every = (*allowed, *(o for o in seen if o not in allowed), *options[len(seen) :])
        if not allowed:
            return Choice(None, Expected(max((o.expected.bits for o in seen if not o.forbidden), default=0.0)), every)
        first, ahead = self._pair(allowed, shown, weights(view.probabilities, sets), view)
        return Choice(first.move, first.expected, every, ahead)

    def _pair(
        self, allowed: list[Option], shown: dict[Move, Predictive], p: Array, view: PosteriorSummary
    ) -> tuple[Option, Move | None]:
        """The first pull of the best pair, where one pull alone cannot decide and the pair tells more than any with the best.

        Pairs are made without looking at what the first one shows: what they tell is a lower bound.
        """
        best = allowed[0]
        if not self.look_ahead or self.criterion != "information" or len(allowed) < 2:
            return best, None
        if best.expected.bits + 2 * best.expected.error > view.entropy - entropy([0.95, 0.05]):
            return best, None
        pairs = []
        for a, b in [*combinations(allowed, 2), *((o, o) for o in allowed)]:
            both = self._expected(shown[a.move] + shown[b.move], p)
            pairs.append((both.bits / (a.price + b.price), both, a, b))
        with_best = max((pair for pair in pairs if best in pair[2:]), key=lambda pair: pair[0])
        top = max(pairs, key=lambda pair: pair[0])
        margin = 2 * math.hypot(top[1].error, with_best[1].error) / (top[2].price + top[3].price)
        if top[0] <= with_best[0] + margin:
            return best, None
        first, second = sorted(top[2:], key=lambda o: -o.worth)
        return first, second.move

    def _first_allowed(self, options: list[Option], view: PosteriorSummary, sets: list[Hypothesis]) -> Choice:
        """By the linear response of many sets: the best one that a sample of them allows."""
        rng = np.random.default_rng([self.random_state, len(view.seen)])
        p = weights(view.probabilities, sets)
        drawn = [sets[k] for k in sorted(rng.choice(len(sets), SETTINGS.drawn_sets, replace=False, p=p))]
        seen: list[Option] = []
        for i, option in enumerate(options):
            if option.expected.bits < SETTINGS.helping:
                break
            even = np.full(len(drawn), 1 / len(drawn))
            forbidden = self._asked(option, view, drawn, even)[1]
            seen.append(replace(option, forbidden=forbidden))
            if not forbidden:
                return Choice(option.move, option.expected, (*reversed(seen), *options[i + 1 :]))
        return Choice(None, Expected(0.0), (*seen, *options[len(seen) :]))

    def _random(self, options: list[Option], view: PosteriorSummary, sets: list[Hypothesis]) -> Choice:
        """Any allowed pull."""
        rng = np.random.default_rng([self.random_state, len(view.seen)])
        if len(sets) > SETTINGS.drawn_sets:
            p = weights(view.probabilities, sets)
            sets = [sets[k] for k in sorted(rng.choice(len(sets), SETTINGS.drawn_sets, replace=False, p=p))]
        p = weights(view.probabilities, sets)
        for k in rng.permutation(len(options)):
            if not self._asked(options[k], view, sets, p)[1]:
                return Choice(options[k].move, Expected(math.nan), tuple(options))
        return Choice(None, Expected(0.0), tuple(options))

    # -- what a pull would show
    # --------------------------------------------------------------------------------------------------------------

    def _action(self, move: Move) -> Action:
        return move.action(limits_of(self.scene))

    def _asked(
        self, option: Option, view: PosteriorSummary, sets: Sequence[Hypothesis], p: Array
    ) -> tuple[list[PullPrediction], str]:
        """What sets with probabilities `p` predict for a pull, and why it is not allowed, or "".

        The likeliest is asked alone first: where it forbids the pull, what the others predict is of no interest. Where the
        likely ones allow it whatever the others do, force, strain and stability of those are not asked for.
        """
        if option.forbidden:
            return [], option.forbidden
        action, likely = self._action(option.move), _decisive(p)
        for count in dict.fromkeys((1, likely, len(sets))):
            predicted = self.predictor.predict(sets[:count], view.fitted, action, detailed=True)
            forbidden = self._forbidden(predicted, p[:count])
            if forbidden:
                return predicted, forbidden
            if count == likely and self._forbidden(predicted, p[:count], float(p[count:].sum())) == "":
                return predicted + self.predictor.predict(sets[count:], view.fitted, action, detailed=False), ""
        return predicted, ""

    def _forbidden(self, predicted: Sequence[PullPrediction], p: Array, more: float = 0.0) -> str:
        """Why a pull is not allowed, or ""; if `more` of the probability spoke against it as well."""
        limits = limits_of(self.scene)
        checks: list[tuple[str, Callable[[PullPrediction], bool]]] = [
            ("the body may buckle", lambda f: f.buckles),
            (
                f"the force may exceed {limits.force or 0:.3g} N",
                lambda f: limits.force is not None and f.force > limits.force,
            ),
            (
                f"the strain may exceed {limits.strain or 0:.3g}",
                lambda f: limits.strain is not None and f.strain > limits.strain,
            ),
        ]
        for reason, exceeds in checks:
            risk = more + float(sum(w for w, f in zip(p, predicted, strict=True) if exceeds(f)))
            if risk > 1 - THRESHOLDS.credible:
                least = "at least " if p.sum() < 1 - 1e-9 else ""
                return f"{reason} (probability {least}{risk:.2g})"
        return ""

    def _in_errors(self, move: Move, predicted: Sequence[PullPrediction], view: PosteriorSummary) -> Predictive:
        positions = np.array([np.nan_to_num(f.positions) for f in predicted])
        return self._scaled(positions, [f.loose for f in predicted], self._action(move), view, True)

    def _scaled(
        self,
        positions: Array,
        loose: Sequence[Sequence[Array]],
        action: Action,
        view: PosteriorSummary,
        modes: bool,
    ) -> Predictive:
        """Predictions (hypotheses, frames, rows, 3), m, and what is loose of them, in units of their errors."""
        errors = self._errors(positions, action, view, modes)
        data = errors.data
        means = errors.whiten(np.array([data.vector(p - data.rest) for p in positions]).T).T
        columns = [[errors.whiten(data.vector(np.nan_to_num(c))) for c in own] for own in loose]
        return Predictive(means, tuple(np.array(own).reshape(-1, means.shape[1]) for own in columns))

    def _errors(self, positions: Array, action: Action, view: PosteriorSummary, modes: bool) -> ErrorCovariance:
        """Errors of a pull to come, about predictions (hypotheses, frames, rows, 3), m.

        With `modes` also of what the likeliest set's scene may have slightly wrong.
        """
        expected = positions.mean(axis=0)
        data = self._with_forces(self._data(action, view), expected)
        # Along the motion, as large as the mesh has left in other pulls, whatever its shape.
        moved = np.sqrt(np.mean((positions - data.rest) ** 2, axis=0))
        mesh = replace(MeshError.unknown(data.mask.shape), left=view.error * moved, known=view.error > 0)
        sigma = np.where(data.of_position, max(self.noise, LEAST_NOISE), data.sigma)
        return ErrorCovariance(
            data, sigma, mesh, self.predictor.modes(view.best, action, data, expected) if modes else None
        )

    def _with_forces(self, data: Data, expected: Array) -> Data:
        """The same with forces of the gripper of the size that is expected, (frames, rows, 3), m, where they are measured."""
        gripper = self.predictor.working.gripper
        if gripper is None:
            return data
        wrenches = gripper.wrenches(expected[:, -ROWS:])
        # What is drawn does not matter: forces are taken for their size alone.
        felt = with_wrenches(data.measurement, wrenches, self.wrench_noise, np.random.default_rng(0))
        return Data(data.scene, felt, gripper)

    def _data(self, action: Action, view: PosteriorSummary) -> Data:
        """The positions of a pull to come, all of which are seen; about where the body is at rest."""
        scene, seen, key = self.scene, view.seen, of_pull(action)
        # The frame of the first pull is that of the others.
        if key not in self._expected_values or not seen:
            rest = np.tile(scene.rest, (len(action), 1, 1))
            measured = recorded(scene, [action], rest, 0.0, np.random.default_rng(0), action.clock)
            error = seen[0].frame_error if seen else None
            measured = replace(measured, frame_error=error)
            self._expected_values[key] = Data(scene, measured)
        return self._expected_values[key]

    def _linear(self, options: list[Option], view: PosteriorSummary) -> list[Option]:
        """The options with what the linear response of every hypothesis with a part in the belief promises."""
        sets = credible_set(view)
        p = weights(view.probabilities, sets)
        size = _SMALL * limits_of(self.scene).displacement
        responses: dict[str, list[PullPrediction]] = {}
        for grasp in dict.fromkeys(o.move.grasp for o in options):
            responses[grasp] = self.predictor.small_steps(sets, view.fitted, grasp, size)
        result = []
        for option in options:
            action = self._action(option.move)
            found = responses[option.move.grasp]
            positions = np.array([extended(f.positions, action, size) for f in found])
            loose = [[extended(c, action, size) for c in f.loose] for f in found]
            result.append(
                replace(option, expected=self._expected(self._scaled(positions, loose, action, view, False), p))
            )
        return result

    def _expected(self, shown: Predictive, p: Array) -> Expected:
        if self.criterion == "entropy":
            return noise_free(shown.means, p)
        return information(shown.means, p, self.samples, self.random_state, shown.loose)


def extended(small: Array, action: Action, size: float) -> Array:
    """What a linear body shows of an action, from what it shows at rest and after a step of `size` along each axis."""
    return np.asarray(
        np.nan_to_num(small[0] + np.einsum("fa,ajk->fjk", action.translation, small[1:] - small[0]) / size)
    )


def telling(option: Option) -> bool:
    """Whether a pull is allowed and expected to tell anything."""
    return (
        not option.forbidden
        and option.expected.bits - 2 * option.expected.error > 0
        and option.expected.bits > SETTINGS.helping
    )


def _decisive(p: Array) -> int:
    """How many of the likeliest hypotheses hold so much of the probability that the others forbid no pull by themselves."""
    return min(int(np.searchsorted(np.cumsum(p), THRESHOLDS.credible)) + 1, len(p))


def credible_set(view: PosteriorSummary) -> list[Hypothesis]:
    """The likeliest hypotheses, which hold 99.9 % of the probability, of those that count and can be predicted."""
    found: list[Hypothesis] = []
    mass = 0.0
    for hypothesis, p in view.probabilities.items():
        if found and (mass >= 1 - SETTINGS.counting or p < SETTINGS.counting):
            break
        if not hypothesis.names or hypothesis in view.fitted:
            found.append(hypothesis)
        mass += p
    return found


def weights(probabilities: Mapping[Hypothesis, float], hypotheses: Iterable[Hypothesis]) -> Array:
    """Probabilities of some hypotheses, summing to one."""
    found = np.array([probabilities[h] for h in hypotheses])
    return np.asarray(found / found.sum())
