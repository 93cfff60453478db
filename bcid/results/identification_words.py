"""What must stand above an identification, in sentences, lengths in mm."""

from __future__ import annotations

from bcid.base.units import percent
from bcid.results.common_rows import set_label
from bcid.results.identification_record import IdentificationRecord
from bcid.results.words import exceeding

# What names of surface marks begin with.
SURFACE_MARK = "surface"


def warnings(r: IdentificationRecord) -> list[str]:
    """That markers were left out, that another set may be the one, or that the model does not explain the data."""
    return [
        *_outliers(r),
        *_not_converged(r),
        *_unexplained(r),
        *(f"{text}." for text in exceeding(r.input_uncertainties)),
    ]


def _outliers(r: IdentificationRecord) -> list[str]:
    if not r.outliers:
        return []
    kind = "surface mark(s)" if all(name.startswith(SURFACE_MARK) for name in r.outliers) else "fiducial(s)"
    return [
        f"{kind} {', '.join(r.outliers)} do not go with the body, whatever set holds it and whatever smooth force acts: swapped, "
        "or misplaced? They are left out."
    ]


def _not_converged(r: IdentificationRecord) -> list[str]:
    rivals = [one for one in r.alternatives if one.anchored in r.not_converged]
    if not rivals:
        return []
    first, more = rivals[0], len(rivals) - 1
    others = f" and {more} other set(s)" if more else ""
    return [
        f"{set_label(first.anchored)}{others} could not be followed to the end ({first.failure}). On the frames before it has "
        f"probability {percent(first.probability)}: the answer below is the best of the sets that could be followed, and it may be "
        "wrong."
    ]


def _unexplained(r: IdentificationRecord) -> list[str]:
    if r.noise_rms is None:
        return [
            "no noise is known: whether a set explains this measurement cannot be told; the best misses it by "
            f"{r.rms:.3g} mm. State noise_sigma."
        ]
    if r.adequate:
        return []
    which, best = ("no set explains", "the best") if r.patches else ("the model does not explain", "it")
    beside = ", with an unknown smooth force in place of what is missing" if r.discrepancy_probability else ""
    compared = f" Probabilities compare the sets with each other only{beside}." if r.patches else ""
    return [
        f"{which} this measurement: {best} misses it by {r.rms / r.noise_rms:.1f} times the noise.\n"
        "The mesh is too coarse, a physical effect is missing (bcid explain), or units, frames, grasp or material are not what\n"
        f"the scene says.{compared}"
    ]
