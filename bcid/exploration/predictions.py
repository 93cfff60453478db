"""What each anchor set predicts for each pull: computed once, spread over the ranks, and kept on disk for whoever asks again.

A prediction depends on the scene, the level, the model, the set and the motion, not on noise: trials and runs share it.
"""

from __future__ import annotations

import json
import os
import socket
from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import cached_property, partial
from io import BytesIO
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from bcid.base.collective import Comm, on_root
from bcid.base.errors import InputError
from bcid.base.fingerprint import fingerprint
from bcid.base.inside_folder import read_inside
from bcid.base.progress import Progress, Silent
from bcid.base.run_folder import writing
from bcid.base.text_file import parse_json
from bcid.base.unpacked import stored_arrays
from bcid.exploration.pull_prediction import PullPrediction, predicted
from bcid.exploration.pull_tangent import Differentiator, PullTangent
from bcid.forms.anchor_compliance import AnchorCompliance, affordable, undeformed
from bcid.forms.forward import Forward
from bcid.forms.gripper_force import ForceScale
from bcid.forms.model import Model
from bcid.forms.solver.equilibrium import Settings
from bcid.inference.nuisances import Nuisances
from bcid.measurement import Action
from bcid.predict.forward_models import ForwardModels
from bcid.scene import Scene
from bcid.scene.uncertainty import Uncertainty
from bcid.search.scheduler import spread

T = TypeVar("T")
Array = NDArray[np.float64]
Anchored = frozenset[str]
Task = tuple[Anchored, Action]
# Out-of-balance forces against reactions: after a pull of 8 mm this leaves 5e-6 mm, seldom 3e-4 mm, far less than a camera sees.
_ACCURACY = 1e-5
# Where Newton's method has not come to its end by then, it seldom does: the step is halved instead.
_ITERATIONS = 20
# What a stored prediction holds; part of its fingerprint.
_FORMAT = "bcid-predictions/1"
# Results are shared and stored at the latest after so many predictions of a rank.
_BATCH = 64


class PullPredictor:
    """Predicts actions on a level of a scene. `predict` is collective on `comm`, with the same result on every rank.

    Args:
        scene: the scene.
        level: number of its level.
        comm: an MPI communicator.
        store: folder in which predictions are kept; None to keep them in memory only.
        model: the model; by default the scene's.
        progress: told how many pulls are predicted (give it on rank 0 only).
        gripper: what force and torque of the gripper are divided by, where they are predicted beside the fiducials.

    Attributes:
        evaluations: actions predicted by this object, on all ranks.
        asked: what it was asked for, by motion, model and set, whether it was known or not.
    """

    def __init__(
        self,
        scene: Scene,
        level: int,
        comm: Comm,
        store: Path | None = None,
        model: Model | None = None,
        progress: Progress | None = None,
        gripper: ForceScale | None = None,
    ) -> None:
        self.scene, self.level, self.comm, self.store = scene, level, comm, store
        self.gripper = gripper
        self.model = model or Model.of(scene)
        self.progress = progress or Silent()
        self.evaluations = 0
        self.asked: set[tuple[str, Anchored]] = set()
        self._known: dict[tuple[str, Anchored], PullPrediction] = {}
        self._tangents: dict[tuple[str, Anchored], PullTangent | None] = {}
        # Movements of the fiducials by unit steps of the gripper, by grasp and set.
        self._linear: dict[tuple[str, Anchored], Array] = {}
        settings = Settings(rtol=_ACCURACY, halvings=3, max_iterations=_ITERATIONS)
        self._models = ForwardModels(scene, comm, settings, gripper)
        self._read: set[str] = set()
        # What a robot may do, and how well the scene is known, changes no prediction.
        about = {
            "format": _FORMAT,
            "scene": replace(scene, limits=None, uncertainty=Uncertainty()).fingerprint(),
            "level": level,
            "model": self.model.name,
        }
        about |= {"values": {term.label: dict(term.values) for term in self.model.terms}}
        about |= {} if gripper is None else {"gripper": [gripper.stiffness, gripper.lever]}
        self._folder = None if store is None else store / fingerprint(about)

    def predict(
        self, tasks: Iterable[Task], detailed: bool = False, models: Sequence[Model] | None = None
    ) -> list[PullPrediction]:
        """Predictions, in order; `detailed` with force, strain and eigenvalue. Each is computed once.

        `models` are those of the tasks, where they are other than the predictor's own; what they predict is not kept on disk.
        """
        tasks = list(tasks)
        whose = [self.model] * len(tasks) if models is None else list(models)
        keys = self._keys(tasks, whose)
        self.asked.update(keys)
        for key in dict.fromkeys(k for (k, _), model in zip(keys, whose, strict=True) if model is self.model):
            self._load(key)
        missing = {
            k: (task, model) for k, task, model in zip(keys, tasks, whose, strict=True) if not self._enough(k, detailed)
        }
        todo = list(missing.items())
        size = _BATCH * self.comm.size
        for i in range(0, len(todo), size):
            fresh = self._work(todo[i : i + size], detailed, i, len(todo))
            on_root(self.comm, partial(self._keep, {k: f for k, f in fresh.items() if missing[k][1] is self.model}))
        return [self._known[k] for k in keys]

    def _keys(self, tasks: Sequence[Task], models: Sequence[Model]) -> list[tuple[str, Anchored]]:
        """Fingerprints of motion and model, with the set; the own model goes without one."""
        known: dict[tuple[int, int], str] = {}
        for (_, action), model in zip(tasks, models, strict=True):
            pair = id(action), id(model)
            if pair not in known:
                about = "" if model is self.model else "-" + fingerprint({"name": model.name} | model.constants())
                known[pair] = key_of(action, timed=not model.steady) + about
        return [(known[id(t[1]), id(model)], t[0]) for t, model in zip(tasks, models, strict=True)]

    def _enough(self, key: tuple[str, Anchored], detailed: bool) -> bool:
        known = self._known.get(key)
        return known is not None and (known.detailed or not detailed)

    def _work(
        self, todo: Sequence[tuple[tuple[str, Anchored], tuple[Task, Model]]], detailed: bool, done: int, total: int
    ) -> dict[tuple[str, Anchored], PullPrediction]:
        for model in {model.name: model for _, (_, model) in todo}.values():
            self.forward(model)

        def one(i: int) -> PullPrediction:
            self.progress.step(f"predicting pulls on level {self.level}", done + i, total)
            (anchors, action), model = todo[i][1]
            return predicted(self.forward(model), anchors, action, detailed)

        fresh = {key: found for (key, _), found in zip(todo, spread(self.comm, len(todo), one), strict=True)}
        self._known |= fresh
        self.evaluations += len(fresh)
        return fresh

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
        if self.gripper is not None or not undeformed(self.model) or not affordable(forward):
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

    # -- on disk
    # --------------------------------------------------------------------------------------------------------------

    def _keep(self, fresh: dict[tuple[str, Anchored], PullPrediction]) -> None:
        """Write a batch, whole, into one file for each action."""
        if self._folder is None:
            return
        for key in dict.fromkeys(key for key, _ in fresh):
            group = {anchors: f for (k, anchors), f in fresh.items() if k == key}
            folder = self._folder / key
            with writing(folder):
                folder.mkdir(parents=True, exist_ok=True)
                count = len(list(folder.glob("*.npz")))
                name = f"{count:06d}-{socket.gethostname()}-{os.getpid()}"
                begun = folder / f".{name}.partial"
                with begun.open("wb") as stream:
                    np.savez(
                        stream,
                        sets=np.array([json.dumps(sorted(anchors)) for anchors in group]),
                        positions=np.array([f.positions for f in group.values()]),
                        numbers=np.array([[f.force, f.strain, f.eigenvalue] for f in group.values()]),
                    )
                begun.replace(folder / f"{name}.npz")

    def _load(self, key: str) -> None:
        """Read what is stored of an action, on rank 0 for all; collective."""
        if self._folder is None or key in self._read:
            return
        self._read.add(key)
        folder = self._folder / key
        stored = on_root(
            self.comm, lambda: [entry for file in sorted(folder.glob("*.npz")) for entry in _entries(file)]
        )
        for anchors, entry in stored:
            known = self._known.get((key, anchors))
            if known is None or not known.detailed:
                self._known[key, anchors] = entry

    def destroy(self) -> None:
        """Free the PETSc objects of this process."""
        if "_differentiator" in self.__dict__:
            self._differentiator.destroy()
        self._models.drop()


def _entries(file: Path) -> list[tuple[Anchored, PullPrediction]]:
    """What a stored file holds; it must be removed when it is damaged."""
    try:
        content = stored_arrays(BytesIO(read_inside(file.parent, file.name)))
        sets = [frozenset(parse_json(str(text), file)) for text in content["sets"]]
        positions, numbers = content["positions"], content["numbers"]
        if not (len(sets) == len(positions) == len(numbers) and numbers.shape[1:] == (3,) and positions.ndim == 4):
            raise ValueError(f"{len(sets)} sets, positions {positions.shape}, numbers {numbers.shape}")
        rows = zip(sets, positions, numbers, strict=True)
        return [(a, PullPrediction(np.asarray(p, float), float(n[0]), float(n[1]), float(n[2]))) for a, p, n in rows]
    except Exception as error:
        raise InputError(f"{file}: is damaged and cannot be read ({error}); remove it, it is computed again") from None


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


def key_of(action: Action, timed: bool = False) -> str:
    """Fingerprint of a motion: grasp, poses to the nanometre, loads, and if it is `timed` its clock; not its name."""
    loads = {place: np.round(load, 9) for place, load in action.loads.items()}
    # Adding zero makes one of the two zeros of the other.
    content = {"translation": np.round(action.translation, 9) + 0.0, "rotation": np.round(action.rotation, 9) + 0.0}
    clock = np.round(action.clock, 9) if timed else None
    return fingerprint(content | {"grasp": action.grasp, "loads": loads, "clock": clock})
