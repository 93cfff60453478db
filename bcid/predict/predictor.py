"""The predictor of a measurement: predictions and sensitivities of any model and anchor set, spread over the ranks."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from copy import copy
from dataclasses import replace
from functools import partial
from itertools import product
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from bcid.base.collective import Comm, agree, overlaid
from bcid.base.errors import EvaluationError, SolveError, evaluating
from bcid.base.options import check_level
from bcid.base.progress import Progress, Silent
from bcid.forms.force_bumps import BUMPS, SPOTS, bumps, force_unit, growth_bumps
from bcid.forms.forward import Forward, Look, Prediction
from bcid.forms.gripper_force import ForceScale
from bcid.forms.model import Model, Term
from bcid.forms.probes import Sensitivities, SensitivityRequest
from bcid.forms.set_tangent import SetTangent, SetTangents, StepTangent
from bcid.forms.solver.equilibrium import Settings
from bcid.forms.solver.supports import Pose
from bcid.inference.data import Data, Noise, frame_times
from bcid.inference.discrepancy import SmoothDiscrepancy
from bcid.inference.knots import Knots, knots_of, known_frames
from bcid.inference.nuisances import NuisanceModes, Nuisances
from bcid.measurement import Action, Measurement
from bcid.measurement.compared import spread
from bcid.measurement.measurement import scaled
from bcid.predict import questions
from bcid.predict.acting import by_the_clock, steady
from bcid.predict.forward_models import ForwardModels
from bcid.predict.kept_predictions import KeptActions, KeptPredictions, MeasurementPrediction, PredictionKey
from bcid.predict.levels import affordable, pair
from bcid.predict.result_formats import PredictionFormat, SensitivitiesFormat, TangentsFormat
from bcid.predict.store import PredictionStore, ResultFormat
from bcid.scene import Scene

Array = NDArray[np.float64]
T = TypeVar("T")


class Predictor:
    """Predicts what a measurement should have shown. All methods are collective on `comm`; actions are spread over ranks.

    It works on a mesh with larger elements than those of a level of the scene's ladder; one with elements of one degree more says
    how large the error of the working one is (`bcid.predict.levels`).

    Args:
        scene: the scene.
        measurement: its motions are repeated.
        comm: an MPI communicator.
        level: of the ladder; by default the last with at most 40,000 unknowns.
        settings: accuracy and patience of the solver.
        progress: told what goes on (give it on rank 0 only).
        store: keeps what the expensive steps gave, and knows what they have given in a run that was interrupted.

    Attributes:
        scene: the scene with the working level and, if there is one, the fine level, for a ladder.
        whole: the scene as it was given.
        fine_level: number of that level of its ladder.
        data: the measured values.
        noise: that is believed instead of the stated one; None as long as that is.
        numbers: of its frames in the whole measurement, shape (frames,).
        left_out: what of the measurement is not compared, and why, in words.
        thin: whether only some steps of each action are followed.
        trajectories: forward trajectories by level ("working", "fine"), in whole-trajectory equivalents.
        repeated: what single actions gave, where measurements share them; shared with all that `repeating` makes.
        skipped: evaluations that failed otherwise than by a solve, each once, in words.
    """

    level = 0

    def __init__(
        self,
        scene: Scene,
        measurement: Measurement,
        comm: Comm,
        level: int | None = None,
        settings: Settings | None = None,
        progress: Progress | None = None,
        store: PredictionStore | None = None,
    ) -> None:
        check_level(level, scene)
        self.fine_level = affordable(scene, comm) if level is None else level
        self.whole, self.measurement, self.comm = scene, measurement, comm
        self.scene = replace(scene, levels=pair(scene, self.fine_level, comm))
        # Where a step must be halved more often the body buckles, and following it proves nothing.
        self.settings = settings or Settings(rtol=1e-6, halvings=3)
        self.progress, self.store = progress or Silent(), store
        self.thin = False
        self.noise: Noise | None = None
        self.forces = ForceScale.of(scene, measurement)
        self.data = Data(scene, measurement, self.forces)
        self.left_out: tuple[str, ...] = ()
        self.actions = measurement.actions
        self.numbers: NDArray[np.int64] = np.arange(len(self.data.mask))
        self.trajectories: dict[str, float] = {}
        self.repeated: KeptActions | None = None
        self.skipped: list[str] = []
        self._lengths = {action.name: len(action) for action in self.actions}
        self._kept = KeptPredictions(self.thin)
        self._models = ForwardModels(self.scene, comm, self.settings, self.forces)
        self._thinned: dict[tuple[bytes, Settings], Predictor] = {}
        self._about: tuple[Model, SetTangent] | None = None
        self._nuisances: Nuisances | None = None
        self._weights: Array | None = None
        self._growths: Array | None = None
        self._whole_scene: str | None = None

    def look_at(self, measurement: Measurement, left_out: tuple[str, ...] = ()) -> None:
        """Compare with what else was seen of the same motions."""
        self.measurement, self.left_out = measurement, left_out
        self.data = self._seen(measurement)

    def believe(self, noise: Noise) -> None:
        """Take another noise than the stated one from now on, or one where none is stated."""
        self.noise = noise
        self.data = self._seen(self.measurement)

    def _seen(self, measurement: Measurement) -> Data:
        data = Data(self.whole, measurement, self.forces)
        return data if self.noise is None else data.with_noise(self.noise)

    def repeating(self, measurement: Measurement) -> Predictor:
        """A predictor of another measurement of the same body; meshes and forward models are shared."""
        other = copy(self)
        other.look_at(measurement)
        other.actions = measurement.actions
        other.numbers = np.arange(len(other.data.mask))
        other._lengths = {action.name: len(action) for action in other.actions}
        other._kept, other._thinned, other._about = KeptPredictions(other.thin), {}, None
        return other

    def thinned(self, steps: int, settings: Settings) -> tuple[Predictor, NDArray[np.int64]]:
        """A predictor that follows so many evenly spread steps of each action, and looks at rest once; and which frames these are.

        Each action is followed up to where it is last seen. It shares the forward models with this one, but solves with its own
        settings. It is made once and kept.
        """
        return self.in_steps([spread(last + 1, steps) for last in self.last_seen()], settings)

    def in_steps(self, steps: Sequence[NDArray[np.int64]], settings: Settings) -> tuple[Predictor, NDArray[np.int64]]:
        """The same in some steps of each action."""
        chosen = [action.frames[some] for action, some in zip(self.actions, steps, strict=True)]
        frames = np.sort(np.concatenate(chosen))
        key = frames.tobytes(), settings
        data = self.measurement.data.isel(frame=frames).copy(deep=True)
        rests = [int(kept[0]) for kept in chosen[1:] if len(kept) > 1]
        for name in {"position", "wrench"} & set(data):
            data[name][{"frame": np.searchsorted(frames, rests)}] = np.nan
        if key not in self._thinned:
            other = copy(self)
            other.thin, other.settings = True, settings
            other._kept, other._thinned, other._about = KeptPredictions(thin=True), {}, None
            self._thinned[key] = other
        other = self._thinned[key]
        other.noise = self.noise
        other.look_at(replace(self.measurement, data=data), self.left_out)
        other.numbers = self.numbers[frames]
        other.actions = [replace(a, numbers=other.numbers[a.frames]) for a in other.measurement.actions]
        return other, frames

    def last_seen(self) -> list[int]:
        """The last step of each action that is seen."""
        seen = np.asarray(self.data.mask.any(axis=(1, 2)))
        return [int(np.flatnonzero(seen[action.frames]).max(initial=0)) for action in self.actions]

    @property
    def finer(self) -> int | None:
        """The level that the working level is compared with, if there is one."""
        return 1 if len(self.scene.levels) > 1 else None

    def forward(self, model: Model, level: int | None = None) -> Forward:
        """The forward model of these parts that move the body, with their values, private to the process."""
        return self._models.of(mechanical(model), self.level if level is None else level)

    def drop(self, keep: Iterable[Model] = ()) -> None:
        """Free what was built for models other than these."""
        self._models.drop(mechanical(model).name for model in keep)

    def skip(self, text: str) -> None:
        """Note an evaluation that failed otherwise than by a solve."""
        if text not in self.skipped:
            self.skipped.append(text)
            self.progress.say(f"skipped: {text}")

    def mine(self, actions: Iterable[Action]) -> list[Action]:
        """Those of some actions that this rank computes, which are the same whatever else is asked for: it has their states.

        Of all actions the longest come first, each to the rank with the least to do. A few steps of an action are computed where
        all of them are, for they may start from their states.
        """
        lengths = {action.name: self._lengths.get(action.name, len(action)) for action in self.actions}
        loads, owner = [0] * self.comm.size, dict[str, int]()
        for name in sorted(lengths, key=lambda name: (-lengths[name], name)):
            owner[name] = loads.index(min(loads))
            loads[owner[name]] += lengths[name]
        return sorted((a for a in actions if owner[a.name] == self.comm.rank), key=lambda a: int(a.frames[0]))

    def predict(
        self,
        model: Model,
        anchors: Iterable[str],
        level: int | None = None,
        actions: Iterable[Action] | None = None,
        keep: bool = False,
        near: Mapping[int, Array] | None = None,
    ) -> MeasurementPrediction:
        """What the model shows with these patches anchored.

        Args:
            model: law, effects and their values.
            anchors: the anchored patches.
            level: mesh level; the working level by default.
            actions: only these; all by default.
            keep: keep the states, for `sensitivities`.
            near: states of the working level by frame, to start from; on another level see `Forward.nearly`.
        """
        actions = self.actions if actions is None else list(actions)
        level = self.level if level is None else level
        key = PredictionKey(level, mechanical(model), frozenset(anchors), tuple(action.name for action in actions))
        known = self._kept.of(key, keep)
        if known is None:
            known = self._recalled(
                lambda: f"{key.level} {questions.of_model(key.model)} {sorted(key.anchors)} {key.actions} {keep}",
                PredictionFormat(self.mine(actions), self.comm),
                lambda: self._attempted(key, actions, keep, near or {}),
            )
            share = sum(len(a) for a in actions) / sum(self._lengths.values())
            self.count("fine" if key.level else "working", share)
            self._kept.add(key, keep, known)
        try:
            with evaluating(_hypothesis(model, anchors), self.skip):
                return replace(known, positions=self._pictured(model, known.positions, level))
        except SolveError as error:
            return replace(known, positions=np.full_like(known.positions, np.nan), failure=str(error))

    def _attempted(
        self, key: PredictionKey, actions: list[Action], keep: bool, states: Mapping[int, Array]
    ) -> MeasurementPrediction:
        """Prediction before effects on the picture; one of no frame where the evaluation fails otherwise than by a solve."""
        try:
            with evaluating(_hypothesis(key.model, key.anchors), self.skip):
                return self._followed(key, actions, keep, states)
        except SolveError as error:
            return MeasurementPrediction(np.full(self.data.mask.shape, np.nan), {}, str(error))

    def _followed(
        self, key: PredictionKey, actions: list[Action], keep: bool, states: Mapping[int, Array]
    ) -> MeasurementPrediction:
        """Prediction before effects on the picture."""
        forward = self.forward(key.model, key.level)
        forward.equilibrium.settings = self.settings
        near = self._kept.near(key)
        begun: Mapping[int, Array] | None = states or None
        if states and key.level != self.level:
            begun = forward.nearly(self.forward(key.model), states)
        look = self._looking(forward) if keep and key.level == self.level else None
        positions = np.full(self.data.mask.shape, np.nan)
        parts, failure, error = {}, "", None
        for action in self.mine(actions):
            try:
                work = partial(
                    forward.predict, key.anchors, [action], keep=keep, known=near.get(action.name, begun), look=look
                )
                part = self._of_action(action, [key.level, key.model, key.anchors, keep], work)
            except Exception as caught:
                error = caught
                break
            positions[action.frames] = part.positions[action.frames]
            parts[action.name] = part
            failure = failure or (part.failure.reason if part.failure else "")
        agree(self.comm, error)
        gathered = self.comm.allgather((positions, failure))
        return MeasurementPrediction(
            overlaid([found for found, _ in gathered]), parts, next((why for _, why in gathered if why), "")
        )

    def _recalled(self, question: Callable[[], str], form: ResultFormat[T], work: Callable[[], T]) -> T:
        """What `work` gives, as it is known from an interrupted run or else computed; collective."""
        if self.store is None:
            return work()
        return self.store.result(lambda: f"{self._identity} {question()}", form, work)

    def _of_action(self, action: Action, about: Sequence[object], work: Callable[[], T]) -> T:
        """What `work` gives of an action on this rank, as it is known from a measurement with the same one or else computed."""
        if self.repeated is None:
            return work()
        return self.repeated.result(f"{self.settings} {questions.of_action(action)} {questions.of_all(about)}", work)

    @property
    def _identity(self) -> str:
        """What all results depend on: body, motions, levels and solver."""
        if self._whole_scene is None:
            self._whole_scene = self.whole.fingerprint()
        motions = questions.of_measurement(self.measurement)
        return f"{self._whole_scene} {self.fine_level} {self.settings} {self.thin} {self.numbers.tolist()} {motions}"

    def _looking(self, forward: Forward) -> Look | None:
        """Makes the responses of the states that will be asked about, where they can be kept."""
        asked, responses = self._frames(self._known(forward.model)), self._models.sensitivity(forward).responses
        if not responses.worth(4 * BUMPS, int(asked.sum())):
            return None

        def look(frame: int, pose: Pose) -> None:
            if asked[frame]:
                responses.make(pose, forward.model)

        return look

    def _pictured(self, model: Model, positions: Array, level: int) -> Array:
        """Positions as the camera shows them."""
        if not any(term.effect.observe for term in model.terms):
            return positions
        forward = self.forward(model, level)
        seen = positions.copy()
        count = len(self.scene.fiducials)
        for action in self.actions:
            for step, frame in enumerate(action.frames):
                seen[frame, :count] = model.observed(positions[frame, :count], forward.frame(action, step))
        return seen

    def sensitivities(
        self, model: Model, anchors: Iterable[str], prediction: MeasurementPrediction, wanted: SensitivityRequest
    ) -> Sensitivities:
        """Sensitivities along all actions of a prediction that kept its states, the same on every rank.

        What changes along an action as smoothly as the motion does is computed in a few steps, and interpolated between them.
        """
        # Friction is among the terms.
        known = self._known(model, directed=wanted.terms is not None)
        if known is None:
            return self._sensitivities_in(model, anchors, prediction, wanted, None)
        times = self.times
        steadily = [steady(probe, model, times) for probe in wanted.probes]
        asked = [other or probe for probe, other in zip(wanted.probes, steadily, strict=True)]
        few = replace(wanted, probes=tuple(probe for probe in asked if probe.effect.smooth))
        found = self._sensitivities_in(model, anchors, prediction, few, known)
        for array, one in product(found.arrays, known):
            one.fill(array)
        smooth, rest = (
            iter(found.probes),
            SensitivityRequest(tuple(probe for probe in asked if not probe.effect.smooth)),
        )
        others = iter(self._sensitivities_in(model, anchors, prediction, rest, None).probes if rest.probes else ())
        probes = [next(smooth) if probe.effect.smooth else next(others) for probe in asked]
        told = zip(wanted.probes, steadily, probes, strict=True)
        return replace(found, probes=[by_the_clock(p, one, times) if other else one for p, other, one in told])

    @property
    def times(self) -> Array:
        """When each frame was seen, by the clock of its action, shape (frames,), s."""
        return frame_times(self.actions, len(self.data.mask))

    def _sensitivities_in(
        self,
        model: Model,
        anchors: Iterable[str],
        prediction: MeasurementPrediction,
        wanted: SensitivityRequest,
        known: Sequence[Knots] | None,
    ) -> Sensitivities:
        """Sensitivities at rest and in those steps of each action that are `known`, or in all that were seen."""
        where = None if known is None else [one.steps.tolist() for one in known]
        with evaluating(f"sensitivities of {_hypothesis(model, anchors)}", self.skip):
            return self._recalled(
                lambda: f"to {questions.of_wanted(wanted)} {where} {questions.of_model(model)} {sorted(anchors)}",
                SensitivitiesFormat(len(wanted.probes)),
                lambda: self._sensitivities_about(model, anchors, prediction, wanted, known),
            )

    def _sensitivities_about(
        self,
        model: Model,
        anchors: Iterable[str],
        prediction: MeasurementPrediction,
        wanted: SensitivityRequest,
        known: Sequence[Knots] | None,
    ) -> Sensitivities:
        """The same, computed."""
        forward = self.forward(model)
        sensitivity, seen = self._models.sensitivity(forward), self._frames(known)
        error, parts, mine = None, [], self.mine(self.actions)
        for number, action in enumerate(mine):
            if not self.thin and len(wanted.probes) > 1:
                self.progress.step("sensitivities to effects, by action", number, len(mine))
            whole = self._whole(prediction.parts[action.name])
            try:
                work = partial(sensitivity.of, anchors, [action], whole, wanted, model, seen)
                about = [model, frozenset(anchors), wanted, seen[action.frames].tolist()]
                parts.append(self._of_action(action, about, work).padded(len(seen)))
            except Exception as caught:
                error = caught
                break
        agree(self.comm, error)
        return Sensitivities.merged([part for parts in self.comm.allgather(parts) for part in parts])

    def disturbances(
        self,
        model: Model,
        anchors: Iterable[str],
        prediction: MeasurementPrediction,
        nuisances: NuisanceModes | None = None,
    ) -> tuple[NuisanceModes, SmoothDiscrepancy, Array]:
        """What nuisances do to the measured values, what is unknown and smooth, and what a force at each of many spots does.

        The latter per unit of force, shape (n, spots, 3), m. The prediction must have kept its states. All
        are known in a few steps of each action, and interpolated between them. Where `nuisances` are given these are taken.
        """
        forward = self.forward(model)
        if self._nuisances is None:
            self._nuisances, self._weights, self._growths = (
                Nuisances(scaled(self.scene, self.data.measurement), forward.mesh, self.data.tells_stiffness),
                np.hstack([bumps(forward, count)[1] for count in (BUMPS, SPOTS)]),
                growth_bumps(forward),
            )
        wanted = self._nuisances.wanted(model, anchors) if nuisances is None else SensitivityRequest()
        wanted = replace(wanted, forces=self._weights, growths=self._growths)
        try:
            found = self.sensitivities(model, anchors, prediction, wanted)
        except EvaluationError:
            # Without sensitivities neither input uncertainties nor a discrepancy may explain anything for this hypothesis.
            count = len(self.data)
            return nuisances or NuisanceModes.none(count), SmoothDiscrepancy.nothing(count), np.zeros((count, SPOTS, 3))
        assert found.forces is not None
        modes = nuisances or self._nuisances.modes(self.data, found, wanted, model, prediction.positions)
        smooth, spots = found.forces[:, :, :, :BUMPS], self.data.vector(found.forces[:, :, :, BUMPS:]).astype(float)
        unknown = SmoothDiscrepancy.of(self.data, smooth, found.growths, force_unit(forward))
        return modes, unknown, np.nan_to_num(spots)

    def set_tangent(self, model: Model, anchors: Iterable[str], prediction: MeasurementPrediction) -> SetTangent:
        """What every set shows to first order about one whose prediction kept its states, the same on every rank; collective.

        In all frames that are seen, or where everything is smooth in a few steps of each action. The last is kept.
        """
        known, model = self._about, mechanical(model)
        if known is None or known[0] != model or known[1].anchors != frozenset(anchors):
            known = self._about = model, self._set_tangent(model, anchors, prediction)
        return known[1]

    def _set_tangent(self, model: Model, anchors: Iterable[str], prediction: MeasurementPrediction) -> SetTangent:
        with evaluating(f"other anchor sets about {_hypothesis(model, anchors)}", self.skip):
            tangents = self._models.tangents(self.forward(model))
            steps = self._recalled(
                lambda: f"of sets {questions.of_model(model)} {sorted(anchors)}",
                TangentsFormat(),
                lambda: self._step_tangents(tangents, model, prediction),
            )
        shape, numbers = self.data.mask.shape, self.numbers

        def held(some: frozenset[str], frame: int) -> frozenset[str]:
            return model.held(some, int(numbers[frame]))

        return SetTangent(frozenset(anchors), tangents.tractions, steps, shape, tangents.springs, held)

    def _step_tangents(
        self, tangents: SetTangents, model: Model, prediction: MeasurementPrediction
    ) -> dict[int, StepTangent]:
        """Of all actions, the same on every rank."""
        error, seen = None, self._frames(self._known(model))
        mine: dict[int, StepTangent] = {}
        for action in self.mine(self.actions):
            if action.name not in prediction.parts:
                continue
            try:
                mine |= tangents.of([action], prediction.parts[action.name], seen)
            except Exception as caught:
                error = caught
                break
        agree(self.comm, error)
        steps: dict[int, StepTangent] = {}
        for found in self.comm.allgather(mine):
            steps |= found
        return steps

    def moves(
        self,
        model: Model,
        anchors: Iterable[str],
        prediction: MeasurementPrediction,
        sets: Sequence[frozenset[str]],
        soft: Sequence[Mapping[str, Term]] = (),
    ) -> list[Array]:
        """By how much the fiducials are elsewhere with other sets, to first order, each (frames, fiducials, 3), m; collective.

        `soft` has for each set the springs that hold patches instead of a rigid anchor.
        """
        if not self.scene.patches:
            return [np.zeros(self.data.mask.shape) for _ in sets]
        tangent = self.set_tangent(model, anchors, prediction)
        with evaluating(f"other anchor sets about {_hypothesis(model, anchors)}", self.skip):
            moved = tangent.all_moved(sets, soft or [{}] * len(sets))
        for one, known in product(moved, self._known(model) or ()):
            known.fill(one)
        return moved

    def _known(self, model: Model, directed: bool = False) -> list[Knots] | None:
        """The steps of each action in which what changes with the motion need be known; None where in all."""
        followed = np.ones(len(self.data.mask), dtype=bool)
        return None if self.thin else knots_of(model, self.actions, followed, directed)

    def _frames(self, known: Sequence[Knots] | None) -> NDArray[np.bool_]:
        """Rest and the frames of known steps; all that are seen where none are given."""
        if known is not None:
            return known_frames(known, len(self.data.mask))
        return np.asarray(self.data.mask.any(axis=(1, 2)))

    def _whole(self, part: Prediction) -> Prediction:
        """A part's positions in the frames of the whole measurement."""
        positions = np.full(self.data.mask.shape, np.nan)
        positions[: len(part.positions)] = part.positions
        return replace(part, positions=positions)

    def count(self, what: str, trajectories: float) -> None:
        """Note forward trajectories."""
        self.trajectories[what] = self.trajectories.get(what, 0.0) + trajectories

    def unknowns(self, level: int) -> int:
        """Of a level; collective."""
        return self._models.unknowns(level)

    def destroy(self) -> None:
        """Free the PETSc objects."""
        self.drop()


def _hypothesis(model: Model, anchors: Iterable[str]) -> str:
    return f"{model.name} with anchors {{{' '.join(sorted(anchors))}}}"


def mechanical(model: Model) -> Model:
    """The model without effects that only change the picture."""
    return replace(model, terms=tuple(d for d in model.terms if d.effect.moves))
