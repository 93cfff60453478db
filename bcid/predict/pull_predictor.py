"""What anchor sets and models predict for pulls: computed once, spread over the ranks, and kept in a store.

A prediction depends on the scene, the level, the model, the set and the motion, not on noise: trials and runs share it.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import product

import numpy as np
from numpy.typing import NDArray

from bcid.base.collective import Comm, on_root
from bcid.base.errors import SolveError
from bcid.base.progress import Progress, Silent
from bcid.base.scheduler import spread
from bcid.forms.anchor_compliance import AnchorCompliance, affordable, undeformed
from bcid.forms.forward import Forward
from bcid.forms.gripper_force import ForceScale
from bcid.forms.model import Model
from bcid.forms.probes import Sensitivities, SensitivityRequest
from bcid.forms.sensitivity import Sensitivity
from bcid.forms.solver.equilibrium import Settings
from bcid.inference.knots import knots_of, known_frames
from bcid.inference.nuisances import Nuisances
from bcid.measurement import Action
from bcid.predict import questions
from bcid.predict.forward_models import ForwardModels
from bcid.predict.pull_prediction import PullPrediction, back, predicted, there
from bcid.predict.result_formats import PullFormat
from bcid.predict.store import PredictionStore
from bcid.scene import Scene
from bcid.scene.uncertainty import Uncertainty

Array = NDArray[np.float64]
Anchored = frozenset[str]
Task = tuple[Anchored, Action]
# Motion and model of a pull, and the anchored patches.
Key = tuple[str, Anchored]
# An accuracy of 1e-5 leaves 5e-6 mm after a pull of 8 mm, seldom 3e-4 mm, far less than a camera sees. Where Newton's method
# has not come to its end by 20 iterations, it seldom does: the step is halved instead.
_SETTINGS = Settings(rtol=1e-5, halvings=3, max_iterations=20)
# Results are shared and stored at the latest after so many predictions of a rank.
_BATCH = 64


class PullPredictor:
    """Predicts actions on a level of a scene. `predict` is collective on `comm`, with the same result on every rank.

    Args:
        scene: the scene.
        level: number of its level.
        comm: an MPI communicator.
        store: keeps predictions; None to keep them in memory only.
        model: the model; by default the scene's.
        progress: told how many pulls are predicted (give it on rank 0 only).
        gripper: what force and torque of the gripper are divided by, where they are predicted beside the fiducials.
        settings: accuracy and patience of the solver.

    Attributes:
        evaluations: actions predicted by this object, on all ranks.
        asked: what it was asked for, by motion, model and set, whether it was known or not.
    """

    def __init__(
        self,
        scene: Scene,
        level: int,
        comm: Comm,
        store: PredictionStore | None = None,
        model: Model | None = None,
        progress: Progress | None = None,
        gripper: ForceScale | None = None,
        settings: Settings = _SETTINGS,
    ) -> None:
        self.scene, self.level, self.comm, self.store = scene, level, comm, store
        self.gripper = gripper
        self.model = model or Model.of(scene)
        self.progress = progress or Silent()
        self.evaluations = 0
        self.asked: set[Key] = set()
        self._known: dict[Key, PullPrediction] = {}
        self._tangents: dict[Key, PullTangent | None] = {}
        # Movements of the fiducials by unit steps of the gripper, by grasp and set.
        self._linear: dict[Key, Array] = {}
        self._models = ForwardModels(scene, comm, settings, gripper)

    def predict(
        self, tasks: Iterable[Task], detailed: bool = False, models: Sequence[Model] | None = None
    ) -> list[PullPrediction]:
        """Predictions, in order; `detailed` with force, strain and eigenvalue. Each is computed once.

        `models` are those of the tasks, where they are other than the predictor's own.
        """
        tasks = list(tasks)
        whose = [self.model] * len(tasks) if models is None else list(models)
        keys = self._keys(tasks, whose)
        self.asked.update(keys)

        def enough(known: PullPrediction) -> bool:
            return known.detailed or not detailed

        missing = {
            k: (task, model)
            for k, task, model in zip(keys, tasks, whose, strict=True)
            if k not in self._known or not enough(self._known[k])
        }
        todo = list(missing.items())
        size = _BATCH * self.comm.size
        for i in range(0, len(todo), size):
            some = todo[i : i + size]
            work = partial(self._work, [about for _, about in some], detailed, i, len(todo))
            if self.store is None:
                found = work(range(len(some)))
            else:
                asked = [f"{self._identity} {motion} {sorted(anchors)}" for (motion, anchors), _ in some]
                found = self.store.results(asked, PullFormat(), work, enough)
            self._known |= {key: one for (key, _), one in zip(some, found, strict=True)}
        return [self._known[k] for k in keys]

    @cached_property
    def _identity(self) -> str:
        """What all predictions depend on; what a robot may do, and how well the scene is known, changes none."""
        body = replace(self.scene, limits=None, uncertainty=Uncertainty()).fingerprint()
        felt = None if self.gripper is None else (self.gripper.stiffness, self.gripper.lever)
        return f"pull {body} {self.level} {self._models.settings} {felt}"

    def _keys(self, tasks: Sequence[Task], models: Sequence[Model]) -> list[Key]:
        """Texts of motion and model, with the set."""
        known: dict[tuple[int, int], str] = {}
        for (_, action), model in zip(tasks, models, strict=True):
            pair = id(action), id(model)
            if pair not in known:
                known[pair] = f"{questions.of_pull(action, timed=not model.steady)} {questions.of_model(model)}"
        return [(known[id(t[1]), id(model)], t[0]) for t, model in zip(tasks, models, strict=True)]

    def _work(
        self, some: Sequence[tuple[Task, Model]], detailed: bool, done: int, total: int, numbers: Sequence[int]
    ) -> list[PullPrediction]:
        """Predictions of those tasks that have these numbers; `done` are before them, of a `total`."""
        todo = [some[k] for k in numbers]
        for model in {model.name: model for _, model in todo}.values():
            self.forward(model)

        def one(i: int) -> PullPrediction:
            self.progress.step(f"predicting pulls on level {self.level}", done + i, total)
            (anchors, action), model = todo[i]
            return predicted(self.forward(model), anchors, action, detailed)

        self.evaluations += len(todo)
        return spread(self.comm, len(todo), one)

    def differentiate(self, tasks: Iterable[Task]) -> list[PullTangent | None]:
        """What the scene may have slightly wrong does to pulls, in order; collective.

        None where a pull cannot be followed. Each is computed once.
        """
        tasks = list(tasks)
        keys = self._keys(tasks, [self.model] * len(tasks))
        missing = {k: task for k, task in zip(keys, tasks, strict=True) if k not in self._tangents}
        todo = list(missing.items())
        differentiator = self._differentiator

        def one(i: int) -> PullTangent | None:
            self.forward()
            return differentiator.of(*todo[i][1])

        if todo:
            found = spread(self.comm, len(todo), one)
            self._tangents |= {key: tangent for (key, _), tangent in zip(todo, found, strict=True)}
        return [self._tangents[k] for k in keys]

    def small_steps(self, sets: Sequence[Anchored], grasp: str, size: float) -> list[PullPrediction]:
        """Predictions of `small_action`, in order: to first order where that costs less than to follow them; collective."""
        forward = self.forward()
        if self.gripper is not None or not undeformed(self.model, forward.scene) or not affordable(forward):
            action = small_action(grasp, size)
            return self.predict([(anchors, action) for anchors in sets])
        fresh = [a for a in dict.fromkeys(sets) if (grasp, a) not in self._linear]
        if fresh:
            # Every set needs the same factor: one rank has it.
            found = on_root(self.comm, lambda: _first_order(forward, fresh, grasp))
            self._linear |= {(grasp, a): moved for a, moved in zip(fresh, found, strict=True)}
        rest = forward.observer.rest
        return [
            PullPrediction(np.concatenate([rest[None], rest + size * self._linear[grasp, anchors]])) for anchors in sets
        ]

    @property
    def tangents(self) -> int:
        """How many pulls were differentiated, on all ranks."""
        return len(self._tangents)

    @cached_property
    def _differentiator(self) -> Differentiator:
        return Differentiator(self.forward())

    @property
    def nuisances(self) -> Nuisances:
        """What the scene may have slightly wrong; collective where it is built."""
        return self._differentiator.nuisances

    def forward(self, model: Model | None = None) -> Forward:
        """The forward model of these parts, with their values, private to the process; collective where it is built."""
        return self._models.of(model or self.model, self.level)

    def destroy(self) -> None:
        """Free the PETSc objects of this process."""
        if "_differentiator" in self.__dict__:
            self._differentiator.destroy()
        self._models.drop()


def _first_order(forward: Forward, sets: Sequence[Anchored], grasp: str) -> list[Array]:
    """Movements of the fiducials by a unit step of the gripper along each axis, shape (3, fiducials, 3) for each set."""
    compliance = AnchorCompliance(forward, grasp)
    return [compliance.moved(anchors) for anchors in sets]


def small_action(grasp: str, size: float) -> Action:
    """A step along x, then along y, then along z, each from rest: what a linear body does follows from it."""
    steps = np.arange(4)
    return Action(
        "1", steps, steps, grasp, np.vstack([np.zeros(3), size * np.eye(3)]), np.tile([1.0, 0.0, 0.0, 0.0], (4, 1))
    )


@dataclass(frozen=True)
class PullTangent:
    """Sensitivities of a set in a pull, and what was asked for; frames as in the pull."""

    found: Sensitivities
    wanted: SensitivityRequest


class Differentiator:
    """Differentiates pulls on one level. Local to the process.

    Args:
        forward: of the level, whose mesh is not shared.
    """

    def __init__(self, forward: Forward) -> None:
        self.forward, self.nuisances = (
            forward,
            Nuisances(forward.scene, forward.mesh, forward.gripper_force is not None),
        )
        self._sensitivity: Sensitivity | None = None

    def of(self, anchors: Anchored, action: Action) -> PullTangent | None:
        """Of a set in a pull; None where it cannot be followed to the end."""
        self._sensitivity = self._sensitivity or Sensitivity(self.forward)
        wanted = self.nuisances.wanted(self.forward.model, anchors)
        if not (wanted.probes or wanted.law or wanted.places):
            return PullTangent(Sensitivities([], {}), wanted)
        first, mirror = there(action, self.forward.model.steady), back(action, self.forward.model.steady)
        prediction = self.forward.predict(anchors, [first], keep=True)
        if prediction.failure or prediction.states is None:
            return None
        states = {frame: prediction.states[int(same)] for frame, same in enumerate(mirror)}
        whole = replace(prediction, positions=prediction.positions[mirror], states=states)
        numbered = replace(action, frames=np.arange(len(action)))
        way = np.arange(len(action)) < len(first)
        known = knots_of(self.forward.model, [first], np.ones(len(first), dtype=bool))
        seen = way.copy() if known is None else known_frames(known, len(action))
        # A gripper that is off is so at the end as well, where it is back at rest.
        way[-1] = seen[-1] = True
        try:
            found = self._sensitivity.of(anchors, [numbered], whole, wanted, None, seen)
        except SolveError:
            return None
        for array, one in product(found.arrays, known or ()):
            one.fill(array)
        return PullTangent(_at(found, np.where(way, np.arange(len(action)), mirror)), wanted)

    def destroy(self) -> None:
        """Free the PETSc objects."""
        if self._sensitivity is not None:
            self._sensitivity.destroy()


def _at(found: Sensitivities, frames: NDArray[np.int64]) -> Sensitivities:
    """The same with its frames chosen anew."""
    return Sensitivities(
        [{name: array[frames] for name, array in one.items()} for one in found.probes],
        {name: array[frames] for name, array in found.law.items()},
        None,
        None if found.forces is None else found.forces[frames],
        None if found.places is None else found.places[frames],
        growths=None if found.growths is None else found.growths[frames],
    )
