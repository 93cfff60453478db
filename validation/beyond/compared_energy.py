"""How far a proposed energy is from the true one, over the strains that occurred."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from numpy.typing import NDArray

from bcid.forms import compiled
from bcid.forms.model import Model
from bcid.forms.weak_form import WeakForm
from bcid.predict.predictor import Predictor
from bcid.scene import Material
from bcid.search.answer.law_form import LawForm
from bcid.search.fitting.fit import Fit

Array = NDArray[np.float64]
# Part of the cells and frames that are compared, the least strained.
_MOST = 0.95


def energy_apart(predictor: Predictor, fitted: Fit, law: Mapping[str, Any]) -> float:
    """RMS difference of the energies per volume of cells in all frames, relative to the RMS of the true one.

    The energy of a model is that of its law and its terms, with the form of the law that is told beside them.
    Without measured forces a scale common to all energies cannot be known: the best is taken. The most strained cells are left out:
    there an exponential is larger than all else, and the mesh decides how large.
    """
    state, form = fitted.state, LawForm.of(fitted)
    forward = predictor.forward(state.model)
    scene = replace(predictor.scene, material=Material(law["name"], dict(law["values"])))
    equilibrium = forward.equilibrium
    true = _density(WeakForm(forward.body, Model.of(scene), scene, equilibrium.u))
    told = form.beside(state.model) if form and form.seen else state.model
    found = _density(WeakForm(forward.body, told, predictor.scene, equilibrium.u))
    pairs = []
    for part in state.prediction.parts.values():
        for unknowns in (part.states or {}).values():
            equilibrium.u.x.array[:] = unknowns
            pairs.append((true(), found()))
    expected, proposed = (np.concatenate(values) for values in zip(*pairs, strict=True))
    usual = np.isfinite(expected) & np.isfinite(proposed)
    usual &= expected <= np.quantile(expected[usual], _MOST)
    expected, proposed = expected[usual], proposed[usual]
    scaled = proposed * float(expected @ proposed) / max(float(proposed @ proposed), 1e-300)
    return float(np.linalg.norm(scaled - expected) / np.linalg.norm(expected))


def _density(weak_form: WeakForm) -> Any:
    """A function that gives the energy of law and terms per volume, J/m^3, in every cell at the present state."""
    space = fem.functionspace(weak_form.body.domain, ("DG", 0))
    weight = ufl.TestFunction(space)
    energies = []
    for energy in weak_form.energies:
        volume = [i for i in energy.integrals() if i.integral_type() == "cell"]
        energies += [ufl.Form([i.reconstruct(integrand=i.integrand() * weight)]) for i in volume]
    form = compiled.form(sum(energies[1:], start=energies[0]))
    volumes = fem.assemble_vector(compiled.form(weight * weak_form.measure(1))).array
    return lambda: np.array(fem.assemble_vector(form).array) / volumes
