"""What the truth itself reaches on the mesh that a term is looked for on: no proposal can be asked for more."""

from __future__ import annotations

from dataclasses import dataclass, replace

from mpi4py import MPI

from bcid.base.errors import SolveError
from bcid.base.units import p_value
from bcid.forms.model import Model, Term
from bcid.inference.error_covariance import ErrorCovariance
from bcid.inference.thresholds import THRESHOLDS
from bcid.measurement import Measurement
from bcid.predict.predictor import Predictor
from bcid.scene import Scene
from bcid.search.answer.adequacy import judge
from bcid.search.fitting.fit import Fit
from bcid.search.fitting.held_out import held_out
from bcid.search.fitting.state import State


class BeyondMesh(SolveError):
    """The working mesh shows something else than what is true."""


@dataclass(frozen=True)
class MeshFloor:
    """What the true model with the true anchors leaves on the working mesh.

    Attributes:
        rms: of its residual, m.
        held_out: RMS residual where each action is predicted from the others, m.
    """

    rms: float
    held_out: float | None

    @classmethod
    def of(cls, scene: Scene, measurement: Measurement, anchors: frozenset[str], term: Term | None) -> MeshFloor:
        """Of a case whose scene has nothing wrong but what is hidden, here with the truth in its place.

        Raises:
            BeyondMesh: it cannot be followed, or noise and what the mesh ladder tells do not explain what it leaves.
        """
        predictor = Predictor(scene, measurement, MPI.COMM_SELF)
        try:
            plain = Model.of(scene)
            state = State.of(predictor, plain if term is None else plain + term, anchors)
            if (p := _by_mesh_alone(state)) < THRESHOLDS.surprise:
                raise BeyondMesh(f"the truth leaves {state.rms * 1e3:.3g} mm on the working mesh ({p_value(p)})")
            return cls(state.rms, held_out(Fit.at(state)))
        except BeyondMesh:
            raise
        except SolveError as error:
            raise BeyondMesh(str(error)) from error
        finally:
            predictor.destroy()


def _by_mesh_alone(state: State) -> float:
    """How surprising the residual is if only noise and the error of the mesh act: what the scene says is right."""
    return judge(
        replace(state, errors=ErrorCovariance(state.predictor.data, state.errors.sigma, state.errors.mesh))
    ).p_value
