"""Fields painted on the surface of a body: values at the corners of triangles, carried over to the facets of every mesh of it.

A facet is looked up at its middle, on the closest triangle of the file's own surface: what is selected is so the same part of the
surface on every level. A field of nodes is linear between them; what is counted is the part of the surface that has a value.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bcid.base.errors import InputError, nearest
from bcid.forms.mesh.closest import closest_triangles
from bcid.scene import Painted

Array = NDArray[np.float64]

# A number is a value when it differs by less than this part of it, a colour when no channel differs by more, of 255.
_SAME, _SAME_COLOUR = 1e-6, 16.0
# A facet is painted when at its middle at least so much is; the half itself counts, whatever the round-off.
_HALF = 0.5 - 1e-9


@dataclass(frozen=True)
class Paint:
    """What fields are at the middles of the facets of a mesh.

    Attributes:
        weights: of the corners of the triangle that is closest to a facet's middle, shape (facets, 3).
        values: of the fields at these corners by name, shape (facets, 3, components).
    """

    weights: Array
    values: dict[str, Array]

    def chosen(self, painted: Painted, what: str) -> NDArray[np.bool_]:
        """Which facets are painted with a value, shape (facets,).

        Raises:
            InputError: no such field, or it has another number of components than the value.
        """
        if painted.field not in self.values:
            raise InputError(
                f"{what}: the geometry has no painted field '{painted.field}'; {_known(painted, self.values)}"
            )
        found, wanted = self.values[painted.field], np.array(painted.value)
        if found.shape[2] != len(wanted):
            is_colour = f"has {found.shape[2]} components: write value = [255, 0, 0]"
            hint = (
                is_colour if found.shape[2] == 3 else f"has {found.shape[2]} component(s): write a number, as value = 1"
            )
            raise InputError(f"{what}: field '{painted.field}' {hint}")
        limit = _SAME_COLOUR if len(wanted) == 3 else _SAME * max(1.0, float(np.abs(wanted).max()))
        same = (np.abs(found - wanted) <= limit).all(axis=2)
        if not same.any():
            some = (
                ", ".join(f"{value:g}" for value in np.unique(found[np.isfinite(found)])[:10])
                if len(wanted) == 1
                else ""
            )
            hint = f"; it has the values {some}" if some else ""
            raise InputError(f"{what}: nothing is painted with {_shown(wanted)} in field '{painted.field}'{hint}")
        return np.asarray((same * self.weights).sum(axis=1) >= _HALF)


def _known(painted: Painted, values: Mapping[str, Any]) -> str:
    if values:
        return nearest(painted.field, values)
    return "it has none at all: paint vertices in a PLY or OBJ file, or point data of a mesh that meshio reads"


def _shown(value: Array) -> str:
    return f"{value[0]:g}" if len(value) == 1 else str([float(f"{v:g}") for v in value])


def paint(corners: Array, fields: Mapping[str, Array], middles: Array) -> Paint:
    """Fields (k, 3, components) of a surface (k, 3, 3) as they are at middles of facets (n, 3), both in m."""
    number, weights = closest_triangles(corners, middles)
    return Paint(weights, {name: values[number] for name, values in fields.items()})


def of_nodes(values: Any, triangles: NDArray[np.int64]) -> Any:
    """A field of nodes (nodes,) or (nodes, components) at the corners of triangles (k, 3)."""
    return np.asarray(values)[triangles]


def of_triangles(values: Any) -> Any:
    """A field of triangles (k,) or (k, components) at their corners."""
    return np.repeat(np.asarray(values)[:, None], 3, axis=1)


def field_arrays(corners: Array, fields: Mapping[str, Any]) -> dict[str, Any]:
    """What a child says of a painted surface: corners (k, 3, 3), and the fields of numbers that have one or three components."""
    numbers = {name: values for name, values in fields.items() if np.issubdtype(np.asarray(values).dtype, np.number)}
    kept = {name: values.reshape(len(corners), 3, -1) for name, values in numbers.items() if len(corners)}
    kept = {name: values.astype(float) for name, values in kept.items() if values.shape[2] in (1, 3)}
    return {"surface": corners} | {f"field:{name}": values for name, values in kept.items()} if kept else {}
