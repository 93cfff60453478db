"""The anchors once more, with effects in place and the error of the mesh taken out of the data."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from bcid.compare.data import MeshError
from bcid.compare.twin import Twin
from bcid.forms.model import Model
from bcid.forms.solve import Settings
from bcid.search.farm import Candidate
from bcid.search.identify import Identification, Options, identify

# A set with which the body would buckle again and again is given up early.
_SETTINGS = Settings(rtol=1e-7, halvings=0)


def search(
    twin: Twin, model: Model, mesh: MeshError, start: Iterable[Candidate] = (), certify: str = "auto"
) -> Identification:
    """Search the anchors on the working level of a twin; collective.

    The data are corrected by what the ladder says of the error of the mesh, for it is nearly the same for sets that are
    close to each other.

    Args:
        twin: the working level.
        model: with the values of its effects.
        mesh: error of the mesh.
        start: sets to climb from; random ones by default.
        certify: as in `bcid.search.identify.Options`.
    """
    data, measurement = twin.data, twin.measurement
    columns = [twin.scene.fiducial_names.index(name) for name in measurement.fiducial_names]
    corrected = measurement.data.copy()
    shift = np.nan_to_num(mesh.correction[:, columns])
    corrected["position"] = (("frame", "fiducial", "axis"), measurement.positions - shift)
    noise = measurement.noise_sigma if data.stated else None
    options = Options(certify=certify, coarsest=twin.level, finest=twin.level)
    seen = replace(measurement, data=corrected, noise_sigma=noise)
    found = identify(twin.scene, seen, twin.comm, options, model, _SETTINGS, start=tuple(start))
    twin.count("working", sum(found.evaluations.values()))
    return found
