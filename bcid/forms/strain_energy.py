"""Strain energy density of the present state at the nodes of the mesh, for pictures."""

from __future__ import annotations

import numpy as np
import ufl
from dolfinx import fem, la
from numpy.typing import NDArray

from bcid.forms import compiled
from bcid.forms.solver.equilibrium import Equilibrium

Array = NDArray[np.float64]


class StrainEnergy:
    """Averages of the law's energy, as effects change it, around each node: the lumped projection on linear elements.

    Args:
        equilibrium: whose state it is of.
    """

    def __init__(self, equilibrium: Equilibrium) -> None:
        self.body, weak_form = equilibrium.body, equilibrium.weak_form
        space = fem.functionspace(self.body.domain, ("Lagrange", 1))
        around = ufl.TestFunction(space)
        density, degree = weak_form.density(weak_form.model.terms)
        self._form = compiled.form(density * around * weak_form.measure(degree))
        self._space = space
        self._volume = self._at_nodes(compiled.form(around * weak_form.measure(1)))

    def at_mesh_nodes(self) -> Array:
        """J/m^3 at the nodes of the mesh, shape (nodes,), the same on every rank; collective on those that share the mesh."""
        return self._at_nodes(self._form) / self._volume

    def _at_nodes(self, form: fem.Form) -> Array:
        """An assembled vector by node of the mesh."""
        vector = fem.assemble_vector(form)
        vector.scatter_reverse(la.InsertMode.add)
        return self.body.at_mesh_nodes(vector.array, self._space)
