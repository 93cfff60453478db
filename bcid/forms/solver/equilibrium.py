"""Equilibrium of one body under one model: PETSc SNES behind a thin wrapper, and a check of every answer it accepts."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import count
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from dolfinx.fem import petsc as fp
from numpy.typing import NDArray
from petsc4py import PETSc
from ufl.algorithms import expand_derivatives

from bcid.base import compat
from bcid.base.errors import InputError
from bcid.forms import compiled
from bcid.forms.mesh.body import Body
from bcid.forms.model import Model
from bcid.forms.solver.factor import OUT_OF_MEMORY, Factor, FactorShell
from bcid.forms.solver.grip_springs import GripSprings
from bcid.forms.solver.lbfgs import LbfgsUpdate
from bcid.forms.solver.status import REASONS, Status
from bcid.forms.solver.supports import Pose, Supports
from bcid.forms.solver.tangent import LargeTangent, SharedTangent, Tangent
from bcid.forms.weak_form import LONG, WeakForm
from bcid.scene import Region, Scene

Array = NDArray[np.float64]
_prefixes = count()
# An old tangent serves until an iteration leaves more than this part of the residual, or for so many iterations.
_SLOW = 0.8
_PATIENCE = 20
_HOPELESS = 1e3
# Newton's method is given up after so many iterates in a row in which an element is inside out: what it may still come to is
# another such state, as a body that is pulled there step by step never is.
_INVERTED = 3
# Prescribed changes smaller than this part of the body's size need not be spread by a solve of their own.
_FAR = 1e-4


@dataclass(frozen=True)
class Settings:
    """Accuracy and patience of a solve.

    Attributes:
        rtol: norm of the out-of-balance force against that of the reactions and loads.
        max_iterations: Newton iterations per step.
        halvings: how often a step may be halved before it counts as failed.
        linear: "direct", "gamg" (conjugate gradients with algebraic multigrid), or "auto": direct up to `direct_up_to`
            unknowns.
        direct_up_to: see `linear`.
        pivots: whether the tangent's pivots are looked at every few steps and at the end of an action, to know that it is stable.
    """

    rtol: float = 1e-8
    max_iterations: int = 50
    halvings: int = 5
    linear: str = "auto"
    direct_up_to: int = 200_000
    pivots: bool = True


class Equilibrium:
    """Finds where the body rests, given what is held and how it is loaded.

    Built once per process and level: forms, sparsity, solver and boundary conditions are shared by all candidates;
    `hold` toggles patches without recompiling anything. All methods are collective on the body's communicator.

    Args:
        body: the meshed body.
        model: law, effects and loads; its anchors and grasp are held at the start.
        scene: where patches, grasps and places are.
        settings: accuracy and patience.

    Attributes:
        u: the unknown, a DOLFINx Function (displacement, or displacement and pressure).
        iterations, factor.count: work done since it was built.
        age: steps taken since the tangent was last factorised.
        rtol: accuracy asked for, at first that of the settings.
        careful: whether every iteration gets a tangent of its own.
        least_energy: below it an energy cannot be told from round-off, J.
        supports: what is prescribed.
        springs: those that hold what the gripper moves, if an effect has put them there.
    """

    def __init__(self, body: Body, model: Model, scene: Scene, settings: Settings | None = None) -> None:
        self.body, self.model, self.scene = body, model, scene
        self.settings = settings or Settings()
        self.rtol = self.settings.rtol
        self.iterations = 0
        self.u = fem.Function(body.space)
        self._compile()
        self._prepare_solver()
        self.supports = Supports(body, scene, self.places, model.rollers, self._owned, self.weak_form.gripper)
        self._lagging = self._stale = self._verified = self._chord = False
        self._iteration = self._slow = self._inverted = 0
        self._held: tuple[frozenset[str], frozenset[str], str] | None = None
        self.hold(model.anchors, model.grasp)

    # -- forms
    # ---------------------------------------------------------------------------------------------------------------

    def _compile(self) -> None:
        body = self.body
        self.weak_form = WeakForm(body, self.model, self.scene, self.u)
        self._constants = self.weak_form.constants
        first, *others = self.weak_form.residuals
        tangents = [expand_derivatives(ufl.derivative(other, self.u)) for other in others]
        with compat.compiling():
            self.energy_forms = [compiled.form(energy) for energy in self.weak_form.energies]
            self.residual_forms = [compiled.form(residual) for residual in (first, *others)]
            # A dead load has none.
            found = [ufl.derivative(first, self.u), *(tangent for tangent in tangents if not tangent.empty())]
            self.tangent_forms = [compiled.form(tangent) for tangent in found]
            self._jacobian = compiled.expression(self.weak_form.kin.J, _sample_points(body.degree))

    @property
    def places(self) -> dict[str, Region]:
        """Every named region of the scene."""
        return self.weak_form.places

    def set_constants(self, values: Mapping[str, float]) -> None:
        """Change numbers of the model by full name ("young", "gravity.weight"); nothing is recompiled."""
        self._verified = False
        for name, value in values.items():
            self._constants[name].value = value

    # -- what is held
    # --------------------------------------------------------------------------------------------------------

    def freed(self, anchors: Iterable[str]) -> frozenset[str]:
        """The anchored patches that springs hold, of an effect or along a direction of their surface."""
        return self.model.freed(anchors) | frozenset(self.weak_form.sprung).intersection(anchors)

    def hold(self, anchors: Iterable[str], grasp: str = "") -> None:
        """Fix these patches, let the gripper hold `grasp`, and go back to the undeformed state.

        Patches and grasps that an effect holds instead of a rigid anchor or gripper stay free.

        Raises:
            InputError: an effect is to hold a grasp that is not a surface.
        """
        anchors = frozenset(anchors)
        freed, gives = self.freed(anchors), self.model.gives
        if gives and grasp and grasp not in self.weak_form.grips:
            raise InputError(f"grasp '{grasp}' is not a surface: no springs can be spread over it")
        for name, constant in self.weak_form.anchored.items():
            constant.value = float(name in freed)
        for name, constant in self.weak_form.grasped.items():
            constant.value = float(gives and name == grasp)
        self.supports.hold(set(anchors - freed), grasp, gives)
        self.weak_form.lead(self.supports.led, grasp)
        self.tangent.hold(self.supports.prescribed, self.supports.conditions)
        held = anchors, frozenset(freed), grasp
        if held != self._held:
            self._held = held
            self.factor.constrain()
        self.reset()

    def reset(self) -> None:
        """Back to the undeformed state; the factor is no longer trusted."""
        self.start_over(None)
        self.careful = not self._keeps
        self.time = 0.0
        for memory in self.weak_form.memories.values():
            memory.reset()

    def accept(self, pose: Pose) -> None:
        """The present state is the equilibrium at `pose`: effects with memory take it for their last one."""
        self.time = pose.time
        self._verified &= not self.weak_form.memories
        for memory in self.weak_form.memories.values():
            memory.advance()

    def start_over(self, state: Array | None) -> None:
        """Back to `state` (this rank's unknowns; None: undeformed), and from there with a tangent for every iteration."""
        self.u.x.array[:] = 0.0 if state is None else state
        self._verified = False
        self.factor.reset()
        self.secant.clear()
        self.supports.unload()
        self.age = 0
        self.careful = True

    def set_state(self, pose: Pose, state: Array) -> None:
        """Take `state` (this rank's unknowns) for the equilibrium at `pose`, without solving."""
        self.start_over(state)
        self._prescribe(pose)

    def _prescribe(self, pose: Pose) -> None:
        """Gripper, dead loads and the fraction of the effects of a pose."""
        self.supports.put(pose)
        self.springs.stretch()
        self.set_constants(self.model.acting(pose.load_factor, pose.time))
        for memory in self.weak_form.memories.values():
            memory.dt.value = max(pose.time - self.time, 1e-9) if memory.moving.value else LONG

    # -- solver
    # --------------------------------------------------------------------------------------------------------------

    def _prepare_solver(self) -> None:
        comm = self.body.comm
        self.vector = compat.create_vector(self.residual_forms[0])
        self.iterate = self.vector.duplicate()
        self.correction = self.vector.duplicate()
        self._owned = self.vector.getLocalSize()
        self.internal = np.zeros(self._owned)
        with compat.compiling():
            giving = [self.weak_form.residuals[number] for number in self.weak_form.giving]
            self.springs = GripSprings(giving, self.u, self.vector)
        nodes = self._nodes_of_multigrid()
        kind = SharedTangent if comm.size > 1 else Tangent if nodes is None else LargeTangent
        self.tangent = kind(self.tangent_forms, self.model.symmetric)
        self.factor = Factor(self.tangent.matrix, self.model.symmetric, self.body.pressures, nodes)
        # What is kept must be positive definite, and solved with directly.
        self._keeps = self.model.definite and nodes is None
        self.secant = LbfgsUpdate(self.factor, comm, self._keeps)
        snes = PETSc.SNES().create(comm)
        snes.setOptionsPrefix(prefix := f"bcid_snes_{next(_prefixes)}_")
        snes.setType("newtonls")
        snes.setFunction(self._residual, self.vector)
        snes.setJacobian(self._renew, self.tangent.matrix)
        snes.setTolerances(max_it=self.settings.max_iterations)
        PETSc.Options()[f"{prefix}snes_linesearch_type"] = self._line_search = "bt"
        snes.setConvergenceTest(self._converged)
        ksp = snes.getKSP()
        ksp.setType("preonly")
        ksp.getPC().setType("python")
        ksp.getPC().setPythonContext(FactorShell(self.factor, self.secant.correct))
        snes.setFromOptions()
        self.snes = snes
        shear = float(self.model.law.shear(self.model.law.complete(self.model.values)))
        # Below this force nothing can be told from round-off: a body that only moves rigidly has no reactions to
        # compare with.
        self._floor = 1e-13 * shear * self.body.mesh.size**2
        self.least_energy = 1e-12 * shear * self.body.mesh.size**3

    def _nodes_of_multigrid(self) -> Array | None:
        """Places of this rank's own nodes, when the mesh is to be solved iteratively."""
        settings = self.settings
        if settings.linear not in ("auto", "direct", "gamg"):
            raise InputError(f"linear solver '{settings.linear}': allowed are auto, direct, gamg")
        possible = self.model.symmetric and not self.body.mixed
        if settings.linear == "gamg" and not possible:
            raise InputError(
                "linear solver 'gamg' needs the displacement formulation and loads with a potential: use 'direct'"
            )
        wanted = settings.linear == "gamg" or (settings.linear == "auto" and self.body.unknowns > settings.direct_up_to)
        if not (wanted and possible):
            return None
        return self.body.nodes[: self._owned // 3]

    def _choose_line_search(self, full_steps: bool) -> None:
        kind = "basic" if full_steps else "bt"
        if kind != self._line_search:
            PETSc.Options()[f"{self.snes.getOptionsPrefix()}snes_linesearch_type"] = self._line_search = kind
            self.snes.setFromOptions()

    def _residual(self, _snes: PETSc.SNES, x: PETSc.Vec, F: PETSc.Vec) -> None:
        self._copy_in(x)
        self._assemble_forces(F)
        F.array[self.supports.reacting] = 0.0

    def _copy_in(self, x: PETSc.Vec) -> None:
        self.u.x.array[: self._owned] = x.array_r
        self.u.x.scatter_forward()

    def _assemble_forces(self, F: PETSc.Vec) -> None:
        """Internal minus external nodal forces into F; the force and reaction norms are kept for the convergence test."""
        with F.localForm() as local:
            local.set(0.0)
        for form in self.residual_forms:
            fp.assemble_vector(F, form)
        F.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
        if self.supports.loaded:
            F.array[:] -= self.supports.dead()
        self.internal[:] = F.array
        self.springs.update()

    def _scale(self) -> float:
        """Norm of reactions and loads: what the out-of-balance force is measured against."""
        parts = self.internal[self.supports.reacting], self.supports.dead(), self.springs.forces
        return float(np.sqrt(self.total(sum(float(part @ part) for part in parts))))

    def applied(self) -> tuple[Array, Array]:
        """What was put into the body and its springs at the last solve: forces on this rank's own unknowns, and how far
        what they act on has moved, N and m, shape (n,) each.

        Anchors, dead loads and a rigid gripper act on the body, a gripper that holds by springs on their other end.
        """
        moved, other = self.u.x.array[: self._owned].copy(), np.zeros(self._owned)
        dofs, driven = self.supports.driven
        other[dofs] = driven
        forces = self.supports.applied(self.internal), self.springs.forces
        return np.concatenate(forces), np.concatenate([moved, other])

    def _renew(self, _snes: PETSc.SNES, _x: PETSc.Vec, _J: PETSc.Mat, _P: PETSc.Mat) -> None:
        """What SNES calls for a Jacobian: the old one stays while the iteration converges well with it."""
        keep = (self._lagging and not self._stale) or self._chord
        if not (keep and self.factor.usable):
            self._assemble_tangent()
            self._renewed, self._stale = self._iteration, False

    def _assemble_tangent(self) -> None:
        """The tangent at the present state; what was known of earlier ones is dropped."""
        # Alike at rest only without memory: what is kept of the last step is not among the numbers.
        alike = self.body.comm.size == 1 and not self.model.remembers
        rest = alike and not self.u.x.array.any()
        self.tangent.assemble(self._numbers() if rest else None)
        self.age = 0
        self.factor.usable = self._verified = False
        self.secant.clear()

    def _numbers(self) -> tuple[float, ...]:
        """Every number that the tangent depends on."""
        own = [self._constants[name] for name in self.model.numbers()]
        return (*(float(constant.value) for constant in own), *self.weak_form.switches())

    def _converged(self, _snes: PETSc.SNES, iteration: int, norms: tuple[float, float, float]) -> Any:
        residual = norms[2]
        if not np.isfinite(residual):
            return compat.snes_not_finite()
        allowed = max(self.rtol * self._scale(), self._floor, self.springs.round_off)
        if residual <= allowed:
            return PETSc.SNES.ConvergedReason.CONVERGED_FNORM_RELATIVE
        self._chord = self.factor.aim(allowed / residual, iteration)
        return self._judge(iteration, residual) if self._lagging else self._look(iteration)

    def _look(self, iteration: int) -> Any:
        """Whether Newton's method with a tangent of its own for every iteration goes on, see `_INVERTED`."""
        inverted = iteration > 0 and self.smallest_jacobian() <= 0
        self._inverted = self._inverted + 1 if inverted else 0
        if self._inverted < _INVERTED:
            return PETSc.SNES.ConvergedReason.CONVERGED_ITERATING
        return PETSc.SNES.ConvergedReason.DIVERGED_LINE_SEARCH

    def _judge(self, iteration: int, residual: float) -> Any:
        """Whether an iteration with an old tangent goes on with it, asks for a fresh one, or is given up."""
        if iteration == 0:
            self._first, self._previous, self._renewed, self._slow = residual, np.inf, 0, 0
        # Where the energy has no minimum ahead, an old tangent leads to whichever state it happens to meet.
        lost = self.secant.negative or (self.factor.usable and self.factor.negative)
        if lost or residual > _HOPELESS * self._first:
            return PETSc.SNES.ConvergedReason.DIVERGED_LINE_SEARCH
        # One bad iteration is forgiven: it shows the secant update where the tangent has changed.
        self._slow = self._slow + 1 if residual > _SLOW * self._previous else 0
        self._stale = self._slow > 1 or iteration - self._renewed >= _PATIENCE
        self._iteration, self._previous = iteration, residual
        return PETSc.SNES.ConvergedReason.CONVERGED_ITERATING

    def solve(self, pose: Pose, start: Array | None = None) -> Status:
        """Equilibrium for one pose, starting from the present state or from `start` (this rank's unknowns).

        First with the tangent that is at hand, renewed when that converges slowly; if it fails, once more by Newton's
        method with a tangent of its own for every iteration. The state is changed only when the result is
        `Status.CONVERGED`.
        """
        before = self.u.x.array.copy()
        self._verified = False
        self._prescribe(pose)
        status = Status.DIVERGED
        for lagging in (False,) if self.careful else (True, False):
            self.u.x.array[:] = before if start is None else start
            self._lagging = lagging
            # Full steps under loads: in bending they raise the residual on their way, and backtracking would hold them up for good.
            # A sheet that wrinkles hardly resists where it is slack: full steps there go much too far.
            loaded = bool(self.model.terms or pose.loads) and not self.model.wrinkles
            self._choose_line_search(lagging or loaded)
            status = self._lift()
            if status is Status.CONVERGED:
                status = self._newton()
            if status is Status.CONVERGED:
                self.age += 1
                return status
            self.factor.usable = False
        self.u.x.array[:] = before
        return status

    def _lift(self) -> Status:
        """Bring the held nodes to their prescribed places, the others following by the tangent where it is far."""
        state = self.u.x.array
        wanted = self.supports.met(state)
        increment = wanted - state
        if self._largest(np.abs(increment).max(initial=0.0)) > _FAR * self.body.mesh.size:
            if not self.factor.usable:
                self._assemble_tangent()
                if not self.factor.refresh():
                    return self._unfactored()
            self.tangent.lifting(increment, self.vector, self.u.x.petsc_vec)
            self.vector.array[self.supports.reacting] = increment[self.supports.reacting]
            self.factor.aim()
            try:
                self.factor.solve(self.vector, self.correction)
            except PETSc.Error as error:
                return self._refused(error)
            state[: self._owned] += self.correction.array_r
            self.u.x.scatter_forward()
        prescribed = self.supports.prescribed
        state[prescribed] = wanted[prescribed]
        return Status.CONVERGED

    def _newton(self) -> Status:
        self.iterate.array[:] = self.u.x.array[: self._owned]
        factored, self._inverted = self.factor.count, 0
        self.secant.pause()
        try:
            self.snes.solve(None, self.iterate)
        except PETSc.Error as error:
            # An exception of a callback is not PETSc's: it must not pass for a failed solve.
            cause = error.__cause__ or error
            if not isinstance(cause, PETSc.Error):
                raise cause from None
            # The error has left the vector locked.
            self.iterate.destroy()
            self.iterate = self.vector.duplicate()
            return self._refused(cause)
        self.iterations += self.snes.getIterationNumber()
        reason = self.snes.getConvergedReason()
        if self.factor.starved or (self.factor.count > factored and not self.factor.usable):
            return self._unfactored()
        if self._inverted == _INVERTED:
            return Status.INVERTED
        if reason <= 0:
            return REASONS.get(reason, Status.DIVERGED)
        self._copy_in(self.iterate)
        if self._lagging:
            self.secant.observe(self.vector.array_r)
        if self.factor.count > factored and self.factor.negative:
            return Status.UNSTABLE
        return Status.CONVERGED if self.smallest_jacobian() > 0 else Status.INVERTED

    def _refused(self, error: PETSc.Error) -> Status:
        return Status.OUT_OF_MEMORY if error.ierr == OUT_OF_MEMORY else self._unfactored()

    def _unfactored(self) -> Status:
        return Status.OUT_OF_MEMORY if self.factor.starved else Status.LINEAR_SOLVER

    def verify(self, springs: float = 0.0) -> Status:
        """Factorise the tangent of the present state and look at its pivots: `CONVERGED` or `UNSTABLE`.

        With `springs`, every node is held besides by one of this part of the tangent's own stiffness.
        """
        if springs or not self.verified:
            self._assemble_tangent()
            if springs:
                self.tangent.stiffen(springs)
            if not self.factor.refresh():
                return self._unfactored()
            self._verified = not springs
        return Status.UNSTABLE if self.factor.negative else Status.CONVERGED

    @property
    def verified(self) -> bool:
        """Whether the factor at hand is of the tangent of the present state."""
        return self._verified and self.factor.usable

    def confirm(self) -> Status:
        """`verify`, or with multigrid, which knows no pivots, what the iterations that led to the present state have met."""
        if self.factor.multigrid is None:
            return self.verify()
        return Status.UNSTABLE if self.factor.negative else Status.CONVERGED

    def smallest_jacobian(self) -> float:
        """Smallest det F over all elements, at their corners, edge nodes and middles (at degree 1 it is one number per element)."""
        cells = np.arange(self.body.domain.topology.index_map(3).size_local, dtype=np.int32)
        values = self._jacobian.eval(self.body.domain, cells)
        return -self._largest(-float(values.min(initial=np.inf)))

    def total(self, value: float) -> float:
        """Sum over the ranks."""
        return float(self.body.comm.allreduce(value)) if self.body.comm.size > 1 else value

    def _largest(self, value: float) -> float:
        if self.body.comm.size == 1:
            return float(value)
        from mpi4py import MPI

        return float(self.body.comm.allreduce(value, op=MPI.MAX))

    def forces(self) -> Array:
        """Internal minus external nodal forces of the model, this rank's contributions, in the order of the unknowns.

        Known dead loads of the actions are not among them.
        """
        return np.asarray(sum(fem.assemble_vector(form).array for form in self.residual_forms))

    def unbalanced(self) -> Array:
        """Internal minus all external nodal forces, known dead loads included, as `forces`."""
        found = self.forces()
        found[self.body.displacement_dofs] -= self.supports.external
        return found

    def gripping(self) -> Array:
        """Forces of the gripper on the unknowns that it holds, among others; one rank only."""
        if not self.supports.sprung:
            return self.unbalanced()
        self.springs.update()
        return self.springs.forces

    def energy(self) -> float:
        """Energy of the present state (strain energy and potential of the effects that have one), J."""
        return self.total(float(sum(fem.assemble_scalar(form) for form in self.energy_forms)))

    def displacement(self) -> Array:
        """Displacement of this rank's nodes, ghosts included, shape (nodes, 3), m."""
        return self.u.x.array[self.body.displacement_dofs].reshape(-1, 3)

    def wrench(self, pose: Pose) -> Array:
        """Force (N) and torque (N m) of the gripper on the body, about the moved centre of the grasp, shape (6,)."""
        result = np.zeros(6)
        if self.supports.grasp:
            self._assemble_forces(self.vector)
            dofs = self.body.displacement_dofs
            mine = np.isin(dofs, self.supports.gripped) & (dofs < self._owned)
            components = np.zeros(len(dofs))
            components[mine] = (self.springs.forces if self.supports.sprung else self.internal)[dofs[mine]]
            forces = components.reshape(-1, 3)
            result = np.concatenate([forces.sum(axis=0), np.cross(self.supports.arms(pose), forces).sum(axis=0)])
            if self.supports.scene.thickness:
                # The half of a sheet below its middle plane pulls the other way across it.
                result[2:5] = 0.0
        return np.asarray(self.body.comm.allreduce(result)) if self.body.comm.size > 1 else result

    def destroy(self) -> None:
        """Free the PETSc objects; collective."""
        self.factor.destroy()
        self.secant.destroy()
        self.tangent.destroy()
        self.springs.destroy()
        for item in (self.snes, self.vector, self.iterate, self.correction):
            item.destroy()


def _sample_points(degree: int) -> Array:
    """Reference points at which det F is looked at."""
    if degree == 1:
        return np.full((1, 3), 0.25)
    corners = np.vstack([np.zeros(3), np.eye(3)])
    inner = np.arange(1, degree)[:, None] / degree
    edges = [(1 - inner) * corners[i] + inner * corners[j] for i in range(4) for j in range(i)]
    return np.vstack([corners, *edges, np.full(3, 0.25)])
