"""An identification with the prediction of its set."""

from __future__ import annotations

from dataclasses import dataclass

from bcid.forms.forward import Prediction
from bcid.inference.thresholds import THRESHOLDS
from bcid.results.identification_record import AnchorSet, IdentificationRecord
from bcid.results.record import inside


@dataclass(frozen=True, kw_only=True)
class Identification(IdentificationRecord):
    """What an identification found, lengths in m.

    Attributes:
        prediction: of the reported set on the working mesh, discretisation error taken out of the positions.
        seconds: time spent.
    """

    prediction: Prediction = inside()
    seconds: float = inside(default=0.0)


def not_converged(alternatives: tuple[AnchorSet, ...]) -> tuple[tuple[str, ...], ...]:
    """The sets that did not converge to the end and may be the one all the same."""
    return tuple(one.anchored for one in alternatives if one.failure and one.probability > THRESHOLDS.surprise)


def adequate(rms: float, noise: float | None, discrepancy: float | None) -> bool:
    """Whether a set may be all there is: no unmodelled discrepancy is certain.

    Args:
        rms, noise: RMS residual and stated noise, m.
        discrepancy: posterior probability of an unmodelled discrepancy; None where it was not computed.
    """
    if discrepancy is not None:
        return discrepancy < THRESHOLDS.credible
    return noise is None or rms <= THRESHOLDS.residual * noise
