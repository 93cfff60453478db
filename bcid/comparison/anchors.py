"""The anchors once more, with effects in place and the error of the mesh taken out of the data."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from bcid.base.progress import Steps
from bcid.forms.model import Model
from bcid.forms.solver.equilibrium import Settings
from bcid.inference.mesh_error import MeshError
from bcid.inference.outcome import Candidate
from bcid.predict.predictor import Predictor
from bcid.search.identification import Identification
from bcid.search.identify import identify
from bcid.search.identify_options import IdentifyOptions

# A set with which the body would buckle again and again is given up early.
_SETTINGS = Settings(rtol=1e-7, halvings=0)


def search(
    predictor: Predictor, model: Model, mesh: MeshError, start: Iterable[Candidate] = (), certify: str = "auto"
) -> Identification:
    """Search the anchors on the working level of a predictor; collective.

    The data are corrected by what the ladder says of the error of the mesh, for it is nearly the same for sets that are
    close to each other.

    Args:
        predictor: the working level.
        model: with the values of its effects.
        mesh: error of the mesh.
        start: sets to climb from; random ones by default.
        certify: as in `bcid.search.identify_options.IdentifyOptions`.
    """
    data, measurement = predictor.data, predictor.measurement
    columns = [predictor.scene.fiducial_names.index(name) for name in measurement.fiducial_names]
    corrected = measurement.data.copy()
    shift = np.nan_to_num(mesh.correction[:, columns])
    corrected["position"] = (("frame", "fiducial", "axis"), measurement.positions - shift)
    noise = measurement.noise_sigma if data.stated else None
    options = IdentifyOptions(certify=certify, coarsest=predictor.level, finest=predictor.level)
    seen = replace(measurement, data=corrected, noise_sigma=noise)
    found = identify(
        predictor.scene,
        seen,
        predictor.comm,
        options,
        model,
        _SETTINGS,
        Steps(predictor.progress),
        start=tuple(start),
        mesh=replace(mesh, correction=np.zeros_like(mesh.correction)) if mesh.known else None,
    )
    predictor.count("working", sum(found.evaluations.values()))
    return found
