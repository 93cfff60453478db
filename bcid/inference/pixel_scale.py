"""What the measured values change by where all lengths from pictures are larger by one factor: a pixel is longer than is said.

Where body, fiducials and grasps are larger by 1 + e and so is what was measured, displacements u in lengths of the pictures are
those of the body as the scene has it whose gripper goes 1 / (1 + e) of its path d, for stresses know no length:

    u(e) = u(d / (1 + e)),   f(e) = (1 + e)^2 f(d / (1 + e)),   m(e) = (1 + e)^3 m(d / (1 + e)),

with force f and torque m of the gripper. Turns stay. Dead loads are smaller by (1 + e)^2 in these lengths, and what effects of
the model have of a length in its unit changes likewise: weight per volume and stiffness per length become 1 + e times as large.
A path from the same pictures stays: then only forces, and what has a length in its unit, show the factor.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from bcid.base.units import parse_unit
from bcid.forms.model import Model, Term
from bcid.forms.parameter import Parameter
from bcid.forms.probes import Probe, Sensitivities, SensitivityRequest
from bcid.forms.scene_errors import pixel, pixel_term
from bcid.inference.data import Data

Array = NDArray[np.float64]
# Power of 1 + e by which a position, force or torque grows.
_OF_KIND = np.array([0.0, 2.0, 3.0])


def pixel_probes(model: Model, path_known: bool) -> list[Probe]:
    """The sensitivities that are needed; `path_known`: whether the gripper's path is known without the pictures."""
    found = [Probe(pixel_term(path_known), ("part",))]
    for term in model.terms:
        names = tuple(
            p.name
            for p in term.effect.parameters
            if term.effect.mechanical and p.neutral == 0 and _power(p) and _finite(term, p.name)
        )
        found += [Probe(term, names)] if names else []
    return found


def pixel_column(
    data: Data, found: Sensitivities, wanted: SensitivityRequest, model: Model | None, predicted: Array | None
) -> Array:
    """Change of the measured values per unit of e, shape (n,), m.

    Args:
        data: the values.
        found: sensitivities to what was `wanted`, among them those of `pixel_probes`.
        model: that they are of.
        predicted: what it predicts, (frames, rows, 3), m; needed where forces are measured.
    """
    own = {term.label: term for term in model.terms} if model is not None else {}
    column = np.zeros(len(data))
    for probe, arrays in zip(wanted.probes, found.probes, strict=True):
        for name, array in arrays.items():
            weight = 1.0 if probe.effect is pixel else _weight(own.get(probe.term.label), name)
            column += weight * np.nan_to_num(data.vector(array)) if weight else 0.0
    if predicted is not None:
        column += _OF_KIND[data.kind] * np.nan_to_num(data.vector(predicted))
    return column


def _finite(term: Term, name: str) -> bool:
    return math.isfinite(term.values[name]) and term.values[name] != 0


def _weight(term: Term | None, name: str) -> float:
    """Change of a parameter of an effect of the model per unit of e."""
    if term is None:
        return 0.0
    return next(_power(p) for p in term.effect.parameters if p.name == name) * float(term.values[name])


def _power(parameter: Parameter) -> int:
    """Power of 1 + e by which an amount grows in lengths of the pictures: of stress times length^k, -k; of a length none."""
    metre, kilogram, _second, _degree = parse_unit(parameter.unit)[1]
    return -(metre + kilogram) if kilogram else 0
