"""What every set of anchors would show, to first order about one set that was followed.

With K the tangent while nothing but the gripper holds the body, r the reactions of the anchors at the state u, and B the
tractions that the patches may exert, a set S that holds its patches in the mean against all its tractions moves the body by

    K du + B_S l = -r,    B_S' (u + du) = 0,    so that    du = -K^-1 r - K^-1 B_S (B_S' K^-1 B_S)^-1 B_S' (u - K^-1 r).

The products with K^-1 cost one factorisation and one block of triangular solves per step, and every set after that a small
dense system: the dual substructuring of Farhat & Roux (Int. J. Numer. Meth. Eng. 32 (1991) 1205). It is eliminated patch after
patch, so that a set costs one patch more than the set that lacks its last one. A patch that springs hold
yields to its tractions. Tractions are polynomials on each patch; what that leaves out of a reaction is the same with and
without du, and only differences to the set that was followed are told.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from itertools import takewhile

import numpy as np
import ufl
from dolfinx import fem
from numpy.typing import NDArray

from bcid.base.errors import InputError, SolveError
from bcid.forms import compiled
from bcid.forms.forward import Forward, Prediction
from bcid.forms.model import Term
from bcid.forms.solver.status import Status
from bcid.forms.solver.supports import Pose
from bcid.forms.solver.trajectory import poses
from bcid.measurement import Action

Array = NDArray[np.float64]
# Numbers of a term, and the patches of a set with those of what holds them; none where they are held rigidly.
_Values = tuple[tuple[str, float], ...]
_Chain = list[tuple[int, _Values]]
# A body that nothing holds but anchors is held by springs of this part of its own stiffness besides.
_SPRINGS = 1e-9
# Patches that exert the same tractions need no more than one of them.
_ALIKE = 1e-12


@dataclass(frozen=True)
class StepTangent:
    """One step of a trajectory.

    Attributes:
        compliance: B' K^-1 B, and that of springs, shape (tractions, tractions).
        apart: B' (u - K^-1 r), shape (tractions,).
        shown: movement of the fiducials (and change of force and torque, see `Forward`) by K^-1 B, shape (3 * rows, tractions), m.
        freed: the same by -K^-1 r, shape (3 * rows,), m.
    """

    compliance: Array
    apart: Array
    shown: Array
    freed: Array


@dataclass(frozen=True)
class _Steps:
    """Steps as one, the step as the first axis, where some patches are held; each traction in units of its own compliance.

    Attributes:
        compliance, apart, shown, freed: as of a `StepTangent`, with what is held; of the tractions from the `first` one on.
        scale: the units, shape (steps, tractions).
        first: number of the first traction that may still be added.
    """

    compliance: Array
    apart: Array
    shown: Array
    freed: Array
    scale: Array
    first: int = 0

    @classmethod
    def of(cls, steps: Sequence[StepTangent]) -> _Steps:
        """All of them, with no patch held."""
        compliance, apart, shown, freed = (
            np.array([getattr(step, f.name) for step in steps]) for f in fields(StepTangent)
        )
        scale = 1 / np.sqrt(np.maximum(np.abs(np.diagonal(compliance, axis1=1, axis2=2)), 1e-300))
        compliance = scale[:, :, None] * compliance * scale[:, None, :] + _ALIKE * np.eye(scale.shape[1])
        return cls(compliance, scale * apart, shown * scale[:, None, :], freed, scale)

    def among(self, numbers: Sequence[int]) -> _Steps:
        """Some of them."""
        some = list(numbers)
        compliance, apart, shown = self.compliance[some], self.apart[some], self.shown[some]
        return _Steps(compliance, apart, shown, self.freed[some], self.scale[some], self.first)

    def held(self, own: NDArray[np.int64], springs: Array | None) -> _Steps:
        """The same with a patch held besides, by its `own` tractions or by springs of a compliance; those after it are left."""
        inside, left = slice(own[0] - self.first, own[-1] + 1 - self.first), slice(own[-1] + 1 - self.first, None)
        block = self.compliance[:, inside, inside]
        if springs is not None:
            scale = self.scale[:, inside]
            block = block + scale[:, :, None] * springs * scale[:, None, :]
        right = np.concatenate([self.compliance[:, inside, left], self.apart[:, inside, None]], axis=2)
        found = np.linalg.solve(block, right)
        below, shown = self.compliance[:, left, inside] @ found, self.shown[:, :, inside] @ found
        return _Steps(
            self.compliance[:, left, left] - below[:, :, :-1],
            self.apart[:, left] - below[:, :, -1],
            self.shown[:, :, left] - shown[:, :, :-1],
            self.freed - shown[:, :, -1],
            self.scale[:, left],
            int(own[-1] + 1),
        )


@dataclass(frozen=True)
class SetTangent:
    """All sets of anchors about one of them.

    Attributes:
        anchors: the set that was followed.
        tractions: numbers of the tractions of each patch.
        steps: what is known in each frame that was reached and has a change.
        shape: (frames, rows, 3).
        springs: compliance of an anchored patch that an effect holds, see `SetTangents.springs`.
        held: which of some anchors are held in a frame.
    """

    anchors: frozenset[str]
    tractions: dict[str, NDArray[np.int64]]
    steps: dict[int, StepTangent]
    shape: tuple[int, ...]
    springs: Callable[[str, Term], Array]
    held: Callable[[frozenset[str], int], frozenset[str]]

    def moved(self, anchors: Iterable[str], soft: Mapping[str, Term] | None = None) -> Array:
        """By how much the fiducials are elsewhere with another set, shape (frames, fiducials, 3), m.

        `soft` has the springs that hold anchored patches instead of a rigid anchor.
        """
        return self.all_moved([frozenset(anchors)], [soft or {}])[0]

    def all_moved(self, sets: Sequence[frozenset[str]], soft: Sequence[Mapping[str, Term]]) -> list[Array]:
        """The same of many sets, each with what is soft in it."""
        result = [np.zeros(self.shape) for _ in sets]
        for one, found in zip(result, self._anchored(sets, soft), strict=True):
            one[list(self.steps)] = found - self._here
        return result

    @cached_property
    def _here(self) -> Array:
        return self._anchored([self.anchors], [{}])[0]

    @cached_property
    def _stacked(self) -> _Steps:
        return _Steps.of(list(self.steps.values()))

    def _anchored(self, sets: Sequence[frozenset[str]], soft: Sequence[Mapping[str, Term]]) -> list[Array]:
        """Movement of the fiducials with these anchors, each as long as it holds, each (steps, fiducials, 3), m.

        Sets that begin with the same patches follow each other, so that these are held once for all of them.
        """
        result = [np.zeros((len(self.steps), *self.shape[1:])) for _ in sets]
        places = list(self.tractions)
        parts: dict[tuple[int, ...], list[tuple[_Chain, int]]] = {}
        for case, (anchors, given) in enumerate(zip(sets, soft, strict=True)):
            for held, numbers in self._stages(anchors).items():
                chain = sorted((places.index(patch), _written(given.get(patch))) for patch in held)
                parts.setdefault(numbers, []).append((chain, case))
        for numbers, chains in parts.items():
            steps = self._stacked if len(numbers) == len(self.steps) else self._stacked.among(numbers)
            for case, moved in self._along(steps, sorted(chains), soft):
                result[case][list(numbers)] = moved.reshape(len(moved), *self.shape[1:])
        return result

    def _stages(self, anchors: frozenset[str]) -> dict[frozenset[str], tuple[int, ...]]:
        """Which of some anchors are held in which steps."""
        found: dict[frozenset[str], list[int]] = {}
        for number, frame in enumerate(self.steps):
            found.setdefault(self.held(anchors, frame), []).append(number)
        return {held: tuple(numbers) for held, numbers in found.items()}

    def _along(
        self, steps: _Steps, chains: Sequence[tuple[_Chain, int]], soft: Sequence[Mapping[str, Term]]
    ) -> Iterator[tuple[int, Array]]:
        """For each chain of patches, in order, with what is soft in it, its case and the movement, (steps, 3 * rows), m."""
        tractions = list(self.tractions.items())
        path: _Chain = []
        states = [steps]
        for chain, case in chains:
            same = sum(1 for _ in takewhile(lambda both: both[0] == both[1], zip(path, chain, strict=False)))
            del path[same:], states[same + 1 :]
            for number, values in chain[same:]:
                patch, own = tractions[number]
                springs = self.springs(patch, soft[case][patch]) if values else None
                path.append((number, values))
                states.append(states[-1].held(own, springs) if len(own) else states[-1])
            yield case, states[-1].freed


class SetTangents:
    """Linearises the prediction of one `Forward`, which must not share its mesh. Local to the process.

    Args:
        forward: the level and model.

    Attributes:
        tractions: numbers of the tractions of each patch.
        areas: movement that goes with unit tractions on a bed of springs of unit stiffness, shape (tractions, tractions).
    """

    def __init__(self, forward: Forward) -> None:
        if forward.comm.size > 1:
            raise ValueError("SetTangents: the mesh must not be shared over ranks")
        self.forward = forward
        self._observe = forward.observer.of_unknowns()
        parts = {name: self._of_patch(name) for name in forward.scene.patches}
        ends = np.cumsum([shapes.shape[1] for shapes, _ in parts.values()])
        self.tractions = {
            name: np.arange(end - shapes.shape[1], end)
            for (name, (shapes, _)), end in zip(parts.items(), ends, strict=True)
        }
        self._shapes, self._columns = (self._of_unknowns(columns) for columns in zip(*parts.values(), strict=True))
        self.areas = np.zeros((len(self._shapes.T),) * 2)
        for numbers in self.tractions.values():
            self.areas[np.ix_(numbers, numbers)] = self._shapes[:, numbers].T @ self._columns[:, numbers]
        self._shared: dict[tuple[str, str, _Values], Array] = {}

    def springs(self, patch: str, term: Term) -> Array:
        """Compliance of an anchored patch that an effect holds, between its tractions, shape (own tractions, own tractions)."""
        (amount,), own = term.effect.amounts, self.tractions[patch]
        shapes = tuple((p.name, term.values[p.name]) for p in term.effect.shapes)
        key = patch, term.effect.name, shapes
        if key not in self._shared:
            self._shared[key] = self._areas(patch, term, own)
        return np.asarray(self._shared[key] / term.values[amount.name])

    def _areas(self, patch: str, term: Term, own: NDArray[np.int64]) -> Array:
        """The part of `areas` that is of a patch, each place by its share of the compliance."""
        if term.effect.share is None:
            return np.asarray(self.areas[np.ix_(own, own)])
        frame, body = self.forward.equilibrium.weak_form.frame(patch), self.forward.body
        given = np.repeat(term.effect.share(frame, frame.plane(body.nodes.T), term.values, np), 3)
        dofs = body.displacement_dofs
        found = self._shapes[dofs][:, own].T @ (given[:, None] * self._columns[dofs][:, own])
        return np.asarray(found + found.T) / 2

    def _of_unknowns(self, parts: Sequence[Array]) -> Array:
        """Columns of displacement components, side by side, as columns of unknowns."""
        found = np.zeros((len(self.forward.equilibrium.u.x.array), sum(part.shape[1] for part in parts)))
        found[self.forward.body.displacement_dofs] = np.hstack(parts)
        return found

    def _of_patch(self, name: str) -> tuple[Array, Array]:
        """Shapes of tractions on a patch, and the nodal forces of unit ones, each (3 * nodes, tractions)."""
        body, weak_form = self.forward.body, self.forward.equilibrium.weak_form
        nodes = self.forward.equilibrium.supports.nodes(name)
        away = body.nodes[nodes] - body.nodes[nodes].mean(axis=0)
        plane = np.linalg.svd(away, full_matrices=False)[2][:2]
        x, y = (away @ plane.T / max(float(np.abs(away).max(initial=0.0)), 1e-300)).T
        shapes = np.column_stack([np.ones_like(x), x, y, x * x, x * y, y * y])
        # A patch of few nodes has no more shapes than nodes.
        basis, sizes, _ = np.linalg.svd(shapes, full_matrices=False)
        shapes = basis[:, sizes > 1e-6 * sizes.max(initial=0.0)]
        directions = self._directions(name, nodes)
        columns = np.zeros((len(body.nodes), 3, shapes.shape[1], directions.shape[2]))
        columns[nodes] = shapes[:, None, :, None] * directions[:, :, None, :]
        flat = columns.reshape(3 * len(body.nodes), -1)
        try:
            measure = weak_form.surface(name)
        except InputError:
            return flat, flat
        u, v = ufl.TrialFunction(body.displacement_space), ufl.TestFunction(body.displacement_space)
        return flat, np.asarray(fem.assemble_matrix(compiled.form(ufl.inner(u, v) * measure)).to_scipy() @ flat)

    def _directions(self, name: str, nodes: NDArray[np.int64]) -> Array:
        """Unit vectors along which a patch holds its nodes, shape (nodes, 3, directions)."""
        scene = self.forward.scene
        direction = scene.held_direction(name)
        if not direction:
            return np.tile(np.eye(3)[:, scene.held_along(name)], (len(nodes), 1, 1))
        normals = self.forward.equilibrium.weak_form.normal(name).x.array.reshape(-1, 3)[nodes]
        if direction == "normal":
            return np.asarray(normals[:, :, None])
        # A vector and those within the surface there are orthogonal: the last two left singular vectors of a column.
        return np.asarray(np.linalg.svd(normals[:, :, None])[0][:, :, 1:])

    def of(self, actions: Sequence[Action], prediction: Prediction, seen: NDArray[np.bool_]) -> dict[int, StepTangent]:
        """The steps of some actions, from the states that their prediction kept; by frame.

        Args:
            actions: as commanded.
            prediction: with its states.
            seen: in which frames it is wanted, shape (frames,).

        Raises:
            SolveError: a tangent could not be factorised.
        """
        states = prediction.states
        if states is None:
            raise ValueError("SetTangents: the states are needed; predict with keep=True")
        equilibrium, found = self.forward.equilibrium, {}
        for commanded in actions:
            action = self.forward.model.driven(commanded)
            equilibrium.hold((), action.grasp)
            for pose, frame in zip(poses(action), map(int, action.frames), strict=True):
                if frame not in states:
                    break
                equilibrium.set_state(pose, states[frame])
                if seen[frame] and states[frame].any():
                    found[frame] = self._step(pose)
                equilibrium.accept(pose)
        return found

    def _step(self, pose: Pose) -> StepTangent:
        equilibrium = self.forward.equilibrium
        held = equilibrium.supports.prescribed
        reactions = equilibrium.unbalanced()
        columns, gripper = self._columns.copy(), self.forward.gripper_force
        columns[held] = 0.0
        reactions[held] = 0.0
        if equilibrium.verify(_SPRINGS) is Status.LINEAR_SOLVER:
            raise SolveError("the tangent of a converged step could not be factorised")
        found = equilibrium.factor.solve_block(np.column_stack([columns, reactions]))
        by_traction, by_reactions = found[:, :-1], found[:, -1]
        observe = self._observe
        if gripper is not None:
            observe = gripper.beside(observe, gripper.levers(pose))
        return StepTangent(
            columns.T @ by_traction + self._yielding(),
            columns.T @ (equilibrium.u.x.array - by_reactions),
            np.asarray(observe @ by_traction),
            np.asarray(-(observe @ by_reactions)),
        )

    def _yielding(self) -> Array:
        """Compliance of the patches that springs hold where they are anchored, shape (tractions, tractions)."""
        equilibrium = self.forward.equilibrium
        found = np.zeros((self._columns.shape[1],) * 2)
        sprung = equilibrium.freed(self.tractions)
        if not sprung:
            return found
        free = equilibrium.tangent.times(self._shapes)
        for name in sorted(sprung):
            # One after the other: patches may share nodes.
            equilibrium.weak_form.anchored[name].value = 1.0
            equilibrium.tangent.assemble()
            equilibrium.weak_form.anchored[name].value = 0.0
            own = self.tractions[name]
            shapes = self._shapes[:, own]
            springs = shapes.T @ (equilibrium.tangent.times(shapes) - free[:, own])
            area = self.areas[np.ix_(own, own)]
            found[np.ix_(own, own)] = area @ np.linalg.pinv(springs, hermitian=True) @ area
        return found


def _written(term: Term | None) -> _Values:
    """Numbers of what holds a patch by springs; none of a rigid anchor."""
    return tuple(term.values.items()) if term else ()
