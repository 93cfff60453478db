"""What small changes of the model do to every fiducial, from one converged run: K du = -dR/dtheta along the trajectory.

With K the tangent at a converged step, C the matrix that observes the fiducials and a change dR of the residual, the
fiducials move by -C K^-1 dR; a change du_a of prescribed displacements moves them by C_a du_a - C K^-1 K_fa du_a. The
products C K^-1 cost one factorisation and one block of triangular solves per step and serve every effect, place and
direction: a further one costs an assembly of dR, which is a form that UFL derives from the residual.

Force and torque of the gripper are sums L' R of the residual where it holds: they change by L' (dR + K du), so that C has the
rows L' K for them, and what acts where it holds is felt directly.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp
import ufl
from dolfinx import fem
from dolfinx.fem import petsc as fp
from numpy.typing import NDArray

from bcid.forms import compiled
from bcid.forms.effects.effect import STEP, Effect
from bcid.forms.forward import Forward, Prediction
from bcid.forms.model import Model, Term
from bcid.forms.parameter import Parameter
from bcid.forms.probes import Probe, Sensitivities, SensitivityRequest
from bcid.forms.responses import Responses
from bcid.forms.solver.supports import Pose
from bcid.forms.solver.trajectory import poses
from bcid.forms.weak_form import LONG
from bcid.measurement import Action

Array = NDArray[np.float64]


def _parameter(effect: Effect, name: str) -> Parameter:
    return next(p for p in effect.parameters if p.name == name)


@dataclass(frozen=True)
class Cause:
    """What moves the fiducials: a change of the residual and one of what is prescribed, by shape (unknowns,).

    `target`, shape (rows, 3), is where the movement is added; `turned`, shape (6,), m, what force and torque change by as the
    gripper itself moves, or as its springs change.
    """

    target: Array
    force: Array | float
    increment: Array | float = 0.0
    turned: Array | float = 0.0


class Sensitivity:
    """Differentiates the prediction of one `Forward`, which must not share its mesh. Local to the process.

    Args:
        forward: the level and model; its model may have effects already.
    """

    def __init__(self, forward: Forward) -> None:
        if forward.comm.size > 1:
            raise ValueError("Sensitivity: the mesh must not be shared over ranks")
        self.forward = forward
        self.equilibrium = forward.equilibrium
        self.model = forward.model
        self.responses = Responses(forward)
        self.weak_form = self.equilibrium.weak_form
        self._derivatives: dict[str, Any] = {}
        self._cells: dict[str, tuple[Any, Any]] = {}
        self._mass: dict[tuple[object, ...], Any] = {}
        self._pushed: tuple[Array, Array] | None = None

    # -- one step
    # ------------------------------------------------------------------------------------------------------------

    def _assemble(self, form: Any) -> Array:
        vector = fem.assemble_vector(form)
        return np.asarray(vector.array)

    def _by_number(self, term: Term, name: str) -> Array | float:
        """dR/dtheta at the present state and the numbers that are set."""
        key = term.full(name)
        if key not in self._derivatives:
            self._derivatives[key] = self.weak_form.derivative(term, name)
        form = self._derivatives[key]
        return 0.0 if form is None else self._assemble(form)

    def _change(self, probe: Probe, name: str, time: float) -> Array | float:
        """dR/dtheta at the present state, where the effect acts as it does at a time, s."""
        term = probe.term
        self.weak_form.term_constants(term)
        acting = term.effect.at(time, term.values)
        constants = {key: self.weak_form.constants[term.full(key)] for key in acting}
        before = {key: float(constant.value) for key, constant in constants.items()}
        for key, value in acting.items():
            if math.isfinite(value):
                constants[key].value = value
        result: Array | float = 0.0
        for key, slope in term.effect.slopes(name, time, term.values).items():
            result = result + slope * self._by_number(term, key)
        for key, value in before.items():
            constants[key].value = value
        return result

    def _change_of_law(self, name: str) -> Array | float:
        """dR/dtheta for a constant of the law."""
        if name not in self._derivatives:
            self._derivatives[name] = self.weak_form.law_derivative(name)
        form = self._derivatives[name]
        return 0.0 if form is None else self._assemble(form)

    def _yielding(self, term: Term, anchors: frozenset[str], loads: Array) -> Array:
        """Displacement of what is held rigidly per unit of compliance (m/Pa): -M^-1 times the forces that hold it.

        A spring bed of stiffness k holds with -k M u what a rigid hold would: u = -1/k M^-1 F, with M the mass of where it is,
        divided by the share of the compliance where that is not the same everywhere. Under a gripper, u is by how much more than
        the gripper itself what it holds moves.
        """
        moved = np.zeros_like(loads)
        for bed in self._beds(term, anchors):
            held, solve = self._bed(bed, term)
            moved[held] = -solve(loads[held])
        return moved

    def _beds(self, term: Term, anchors: frozenset[str]) -> list[tuple[str, str]]:
        """Where an effect would put springs: ("grip", a grasp) or ("surface", a patch)."""
        if term.effect.gives:
            grasp = self.equilibrium.supports.grasp
            return [("grip", grasp)] if grasp in self.weak_form.grips else []
        return [("surface", patch) for patch in sorted(anchors) if term.place in ("", patch)]

    def _bed(self, bed: tuple[str, str], term: Term) -> tuple[NDArray[np.int64], Any]:
        """Unknowns of a bed of springs, and what solves with its mass matrix."""
        shared = term.effect.share is not None
        key = (*bed, term.effect.name, *(term.values[p.name] for p in term.effect.shapes)) if shared else bed
        if key not in self._mass:
            from scipy.sparse.linalg import splu

            mass = fem.assemble_matrix(self._mass_form(bed, term)).to_scipy().tocsc()
            inside = np.flatnonzero(np.asarray(np.abs(mass).sum(axis=1)).ravel() > 0)
            solver = splu(mass[inside][:, inside])
            self._mass[key] = self.forward.body.displacement_dofs[inside], solver.solve
        return self._mass[key]

    def _mass_form(self, bed: tuple[str, str], term: Term) -> fem.Form:
        """Mass of a bed of springs, divided by the share of the compliance where a term has one."""
        body, weak_form = self.forward.body, self.weak_form
        u, v = ufl.TrialFunction(body.displacement_space), ufl.TestFunction(body.displacement_space)
        product, measure = ufl.inner(u, v), getattr(weak_form, bed[0])(bed[1])
        if term.effect.share is None:
            return compiled.form(product * measure)
        values = {name: fem.Constant(body.domain, float(term.values[name])) for name in term.values}
        frame = weak_form.frame(bed[1])
        share = term.effect.share(frame, frame.plane(ufl.SpatialCoordinate(body.domain)), values, ufl)
        return compiled.form(product / share * measure)

    def _by_cell(self, number: str) -> sp.csr_matrix:
        """dR/dm for a number m of every cell, shape (unknowns, cells): its relative "stiffness", or its "growth"."""
        if number not in self._cells:
            weak_form = self.weak_form
            space = fem.functionspace(self.forward.body.domain, ("DG", 0))
            weight = fem.Function(space)
            if number == "growth":
                # Of the law: what effects change of it would ask for another form for each of them.
                energy = weak_form.stored((), weight)
            else:
                stored = weak_form.stored([term for term in self.forward.model.terms if term.effect.changes_law])
                energy = ufl.Form([i.reconstruct(integrand=weight * i.integrand()) for i in stored.integrals()])
            by_number = ufl.derivative(energy, weight, ufl.TrialFunction(space))
            form = compiled.form(ufl.derivative(by_number, weak_form.u, weak_form.test))
            self._cells[number] = form, fp.create_matrix(form)
        form, matrix = self._cells[number]
        # PETSc takes the blocks of displacement and cell, which differ in size; DOLFINx's own matrix does not.
        matrix.zeroEntries()
        fp.assemble_matrix(matrix, form)
        matrix.assemble()
        rows, columns, values = matrix.getValuesCSR()
        return sp.csr_matrix((values, columns, rows), shape=matrix.getSize())

    # -- along the motion
    # -----------------------------------------------------------------------------------------------------

    def of(
        self,
        anchors: Iterable[str],
        actions: Sequence[Action],
        prediction: Prediction,
        wanted: SensitivityRequest,
        model: Model | None = None,
        seen: NDArray[np.bool_] | None = None,
    ) -> Sensitivities:
        """Sensitivities along the actions, from the states that the prediction kept.

        Args:
            anchors: the anchored patches of the prediction.
            actions: as commanded.
            prediction: with its states.
            wanted: what is asked for.
            model: the forward's model, with effects on gripper and picture besides; by default the forward's own.
            seen: in which frames they are wanted, shape (frames,); all by default.
        """
        states = prediction.states
        if states is None:
            raise ValueError("Sensitivity: the states are needed; predict with keep=True")
        count, fiducials = prediction.positions.shape[:2]
        empty = np.full((count, fiducials, 3), np.nan)
        result = Sensitivities(
            [{name: empty.copy() for name in probe.wanted} for probe in wanted.probes],
            {name: empty.copy() for name in wanted.law},
            np.full((*empty.shape, len(self.forward.mesh.cells)), np.nan, np.float32) if wanted.stiffness else None,
            None if wanted.forces is None else np.full((*empty.shape, wanted.forces.shape[1], 3), np.nan, np.float32),
            np.full((*empty.shape, 3), np.nan) if wanted.places else None,
            None if wanted.terms is None else np.full((*empty.shape, wanted.terms.count), np.nan, np.float32),
            None if wanted.terms is None else np.full((count, wanted.terms.holds, 4, 3), np.nan),
            None if wanted.growths is None else np.full((*empty.shape, wanted.growths.shape[1]), np.nan, np.float32),
            np.full((*empty.shape, self._boundary.shape[1]), np.nan) if wanted.boundary else None,
        )
        self.model = model or self.forward.model
        for commanded in actions:
            self._follow(
                frozenset(anchors), commanded, states, wanted, result, np.ones(count, bool) if seen is None else seen
            )
        return result

    def _follow(
        self,
        anchors: frozenset[str],
        commanded: Action,
        states: Mapping[int, Array],
        wanted: SensitivityRequest,
        result: Sensitivities,
        seen: NDArray[np.bool_],
    ) -> None:
        action = self.model.driven(commanded)
        moves = [self._moves(probe, name, commanded) for probe in wanted.probes for name in probe.wanted]
        for held, first, end in self.model.stages(anchors, action):
            self._follow_stage(held, action, (first, end), states, wanted, result, seen, moves)

    def _follow_stage(
        self,
        anchors: frozenset[str],
        action: Action,
        steps: tuple[int, int],
        states: Mapping[int, Array],
        wanted: SensitivityRequest,
        result: Sensitivities,
        seen: NDArray[np.bool_],
        moves: list[list[tuple[Pose, Pose]] | None],
    ) -> None:
        """Steps of an action in which the same patches are held: the first, and the one after the last."""
        equilibrium, weak_form = self.equilibrium, self.weak_form
        equilibrium.hold(anchors, action.grasp)
        for probe in wanted.probes:
            if probe.effect.memory or probe.effect.uses_past:
                weak_form.memory(probe.term)
        asked = {probe.term.label for probe in wanted.probes}
        probed = [memory for label, memory in weak_form.probed.items() if label in asked]
        for memory in probed:
            memory.reset()
        for step, (pose, frame) in enumerate(zip(poses(action)[: steps[1]], action.frames[: steps[1]], strict=True)):
            if int(frame) not in states:
                # It could not be followed any further.
                break
            equilibrium.set_state(pose, states[int(frame)])
            for memory in probed:
                memory.dt.value = max(pose.time - equilibrium.time, 1e-9) if memory.moving.value else LONG
            if seen[frame] and step >= steps[0]:
                before = states[int(action.frames[max(step - 1, 0)])]
                self._step(anchors, action, step, pose, int(frame), before, moves, wanted, result)
            equilibrium.accept(pose)
            for memory in probed:
                memory.advance()

    def _moves(self, probe: Probe, name: str, commanded: Action) -> list[tuple[Pose, Pose]] | None:
        """For an effect on the gripper: its poses for a slightly greater and smaller value, a unit step apart."""
        if not probe.effect.drive:
            return None
        step = STEP * _parameter(probe.effect, name).scale

        def driven(sign: float) -> list[Pose]:
            action = commanded
            for term, values in self._chain(probe, name, sign * step):
                action = term.effect.driven(action, values)
            return poses(action)

        return list(zip(driven(1.0), driven(-1.0), strict=True))

    def _chain(self, probe: Probe, name: str, change: float) -> list[tuple[Term, Mapping[str, float]]]:
        """The model's effects, and the probe's if it is not among them, with one of the probe's numbers changed."""
        terms = [probe.term if term.label == probe.term.label else term for term in self.model.terms]
        terms += [] if probe.term in terms else [probe.term]
        changed = {**probe.term.values, name: probe.term.values[name] + change}
        return [(term, changed if term is probe.term else term.values) for term in terms]

    def _step(
        self,
        anchors: frozenset[str],
        action: Action,
        step: int,
        pose: Pose,
        frame: int,
        before: Array,
        moves: list[list[tuple[Pose, Pose]] | None],
        wanted: SensitivityRequest,
        result: Sensitivities,
    ) -> None:
        """All sensitivities in one frame; `before` is the state of the last one."""
        equilibrium, forward = self.equilibrium, self.forward
        places = forward.observer.positions(equilibrium.displacement())
        seen = self._seen(places, action, step)
        if result.places is not None:
            result.places[frame] = 0.0
            result.places[frame, : len(places)] = forward.observer.gradients(equilibrium.displacement())
            result.places[frame] = seen(result.places[frame])
        causes: list[Cause] = []
        asked = [(p, name, out[name]) for p, out in zip(wanted.probes, result.probes, strict=True) for name in p.wanted]
        for (probe, name, out), pairs in zip(asked, moves, strict=True):
            out[frame] = 0.0
            if probe.effect.observe:
                out[frame, : len(places)] = self._pictured(probe, name, places, action, step)
            causes += self._of_probe(probe, name, anchors, pose, pairs[step] if pairs else None, out[frame])
        for name in wanted.law:
            result.law[name][frame] = 0.0
            causes.append(Cause(result.law[name][frame], self._change_of_law(name)))
        several = result.stiffness, result.forces, result.growths, result.terms, result.boundary
        fields = any(wide is not None for wide in several)
        if not causes and not fields:
            return
        count = 0 if wanted.forces is None else 3 * wanted.forces.shape[1]
        count += len(forward.mesh.cells) if wanted.stiffness else 0
        count += 0 if wanted.growths is None else wanted.growths.shape[1]
        count += wanted.terms.count if wanted.terms else 0
        count += self._boundary.shape[1] if wanted.boundary else 0
        response = self.responses.at(pose, self.model, len(causes), count, factorised=wanted.terms is not None)
        columns, increments = np.zeros((2, len(equilibrium.u.x.array), len(causes)))
        for j, cause in enumerate(causes):
            columns[:, j] = cause.force
            increments[:, j] = cause.increment
        moved = response.moved(columns, increments)
        for j, cause in enumerate(causes):
            moved[3 * len(places) :, j] += cause.turned
        for cause, change in zip(causes, moved.T, strict=True):
            cause.target[:] += seen(change.reshape(-1, 3))
        if result.stiffness is not None:
            softened = response.moved(self._by_cell("stiffness"))
            result.stiffness[frame] = self._all_seen(seen, softened)
        if result.forces is not None and wanted.forces is not None:
            pushed = self._all_seen(seen, response.moved(self._pushes(wanted.forces)))
            result.forces[frame] = pushed.reshape(forward.rows, 3, -1, 3)
        if result.growths is not None:
            result.growths[frame] = self._all_seen(seen, response.moved(self._by_cell("growth") @ wanted.growths))
        if result.boundary is not None:
            driven = response.moved(np.zeros_like(self._boundary), self._boundary)
            result.boundary[frame] = self._all_seen(seen, driven)
        if result.terms is not None and result.held is not None and wanted.terms is not None:
            result.held[frame] = wanted.terms.held(equilibrium.u.x.array, response.solved)
            works = wanted.terms.works(equilibrium.u.x.array, response.adjoint, before)
            result.terms[frame] = self._all_seen(seen, works)

    @cached_property
    def _boundary(self) -> Array:
        """What errors of driven places prescribe, shape (unknowns, modes), m."""
        supports = self.equilibrium.supports
        return supports.boundary.error_increments(supports.gripped)

    def _pushes(self, weights: Array) -> Array:
        """Changes of the residual by a unit of each force along each axis, shape (unknowns, forces * 3); the last are kept."""
        if self._pushed is None or self._pushed[0] is not weights:
            dofs = self.forward.body.displacement_dofs.reshape(-1, 3)
            found = np.zeros((len(self.equilibrium.u.x.array), weights.shape[1], 3))
            for axis in range(3):
                found[dofs[:, axis], :, axis] = -weights
            self._pushed = weights, found.reshape(len(found), -1)
        return self._pushed[1]

    def _of_probe(
        self,
        probe: Probe,
        name: str,
        anchors: frozenset[str],
        pose: Pose,
        pair: tuple[Pose, Pose] | None,
        target: Array,
    ) -> list[Cause]:
        """What a unit of a parameter changes at the present state."""
        parameter = _parameter(probe.effect, name)
        found: list[Cause] = []
        value = probe.term.values[name]
        if parameter.reciprocal and not math.isfinite(value):
            forces = self.equilibrium.unbalanced()
            found.append(Cause(target, 0.0, self._yielding(probe.term, anchors, forces)))
        elif probe.effect.mechanical:
            scale = -(value**2) if parameter.reciprocal else 1.0
            change = scale * self._change(probe, name, pose.time)
            found.append(Cause(target, change, 0.0, self._felt(change, pose) if probe.effect.gives else 0.0))
        if pair is not None:
            found.append(self._of_drive(target, pose, pair, 2 * STEP * parameter.scale))
        return found

    def _of_drive(self, target: Array, pose: Pose, pair: tuple[Pose, Pose], width: float) -> Cause:
        """What the gripper changes by moving from the second to the first of two poses that are so much of a parameter apart."""
        equilibrium, gripper = self.equilibrium, self.forward.gripper_force
        loads: Array | float = np.asarray(-self._loaded(*pair) / width) if pose.loads else 0.0
        turned = np.asarray(gripper.turned(equilibrium.gripping(), *pair) / width) if gripper else 0.0
        moved = np.asarray(self._gripped(*pair) / width)
        if not equilibrium.supports.sprung:
            return Cause(target, loads, moved, turned)
        pulled = -(equilibrium.springs.stiffness() @ moved)
        return Cause(target, loads + pulled, 0.0, turned + self._felt(pulled, pose))

    def _felt(self, change: Array | float, pose: Pose) -> Array | float:
        """What force and torque change by where the springs of the gripper change their part of the residual, shape (6,), m."""
        gripper = self.forward.gripper_force
        return np.asarray(-(gripper.levers(pose).T @ change)) if gripper and isinstance(change, np.ndarray) else 0.0

    @staticmethod
    def _all_seen(seen: Any, columns: Array) -> Array:
        shaped = columns.reshape(-1, 3, columns.shape[1])
        return np.asarray(seen(shaped))

    def _seen(self, places: Array, action: Action, step: int) -> Any:
        """How a change of the fiducials' positions appears in the picture: through the model's observation effects."""
        model = self.model
        if not any(term.effect.observe for term in model.terms):
            return lambda change: change
        frame = self.forward.frame(action, step)
        # No picture shows force and torque.
        jacobian = np.tile(np.eye(3), (self.forward.rows, 1, 1))
        for axis in range(3):
            shift = np.zeros(3)
            shift[axis] = 1e-6
            jacobian[: len(places), :, axis] = (
                model.observed(places + shift, frame) - model.observed(places - shift, frame)
            ) / 2e-6
        return lambda change: np.einsum("iab,ib...->ia...", jacobian, change)

    def _pictured(self, probe: Probe, name: str, places: Array, action: Action, step: int) -> Array:
        """Change of the picture by an observation effect."""
        frame, size = self.forward.frame(action, step), STEP * _parameter(probe.effect, name).scale

        def picture(sign: float) -> Array:
            seen = places
            for term, values in self._chain(probe, name, sign * size):
                seen = term.effect.observed(seen, values, frame, term.place)
            return seen

        return np.asarray((picture(1.0) - picture(-1.0)) / (2 * size))

    def _loaded(self, more: Pose, less: Pose) -> Array:
        """Difference of the dead loads of two poses."""
        equilibrium = self.equilibrium
        forces = np.zeros(len(equilibrium.u.x.array))
        load = equilibrium.supports.load
        forces[equilibrium.body.displacement_dofs] = load(more.loads) - load(less.loads)
        return forces

    def _gripped(self, more: Pose, less: Pose) -> Array:
        """Difference of the prescribed displacements of two poses, zero elsewhere."""
        equilibrium = self.equilibrium
        increment, moved = np.zeros(len(equilibrium.u.x.array)), np.zeros(len(equilibrium.u.x.array))
        supports = equilibrium.supports
        if supports.grasp:
            moved[equilibrium.body.displacement_dofs] = supports.moved(more) - supports.moved(less)
            increment[supports.gripped] = moved[supports.gripped]
        return increment

    def destroy(self) -> None:
        """Free the PETSc matrix."""
        for _, matrix in self._cells.values():
            matrix.destroy()
