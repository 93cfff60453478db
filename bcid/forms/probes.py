"""What a sensitivity is asked for, and its answer."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from bcid.base.collective import overlaid
from bcid.forms.effects.effect import Effect
from bcid.forms.model import Term

Array = NDArray[np.float64]
# Those of `Sensitivities` that are one array each.
_FIELDS = "stiffness", "forces", "growths", "places", "terms", "held", "boundary"


@dataclass(frozen=True)
class Probe:
    """An effect at a place with its numbers, and those of them whose influence is asked for.

    Attributes:
        term: the effect; amounts at which it is to be differentiated (neutral, for one that is not in the model).
        wanted: names of its parameters.
    """

    term: Term
    wanted: tuple[str, ...]

    @property
    def effect(self) -> Effect:
        """The effect."""
        return self.term.effect


class Works(Protocol):
    """Terms whose changes of the residual are not assembled: only their virtual work on given movements is asked for."""

    @property
    def count(self) -> int:
        """Of terms."""
        ...

    def works(self, unknowns: Array, fields: Array, before: Array) -> Array:
        """Work of a unit of each at a state (unknowns,) on fields (unknowns, fields), shape (fields, count).

        `before` is the state of the last step; at rest the same.
        """
        ...

    @property
    def holds(self) -> int:
        """Number of places that springs of any stiffness may hold."""
        ...

    def held(self, unknowns: Array, solve: Callable[[Array], Array]) -> Array:
        """Of each place its compliance (m/N) to a force, (3, 3), and its movement (m), (3,): shape (holds, 4, 3).

        `solve` gives K^-1 times columns (unknowns, n).
        """
        ...


@dataclass(frozen=True)
class SensitivityRequest:
    """What a `Sensitivity` is asked for.

    Attributes:
        probes: effects and their parameters.
        law: constants of the law, by name.
        stiffness: whether the influence of every cell's stiffness is wanted.
        forces: nodal weights of body forces, shape (nodes, forces), m^3; none by default.
        growths: growths of all lengths in every cell, in DOLFINx's order, as the law sees them, shape (cells, growths); none
            by default.
        places: whether the influence of where each fiducial sits on the body is wanted.
        terms: many terms at once, known by the virtual work they do; none by default.
        boundary: whether the influence of errors of what measured points drive is wanted.
    """

    probes: tuple[Probe, ...] = ()
    law: tuple[str, ...] = ()
    stiffness: bool = False
    forces: Array | None = None
    growths: Array | None = None
    places: bool = False
    terms: Works | None = None
    boundary: bool = False


@dataclass(frozen=True)
class Sensitivities:
    """Change of every fiducial's position per unit of a parameter, m; NaN in frames that were not asked for.

    Force and torque of the gripper are two fiducials more where they are predicted.

    Attributes:
        probes: by probe and parameter, shape (frames, fiducials, 3). For a parameter whose neutral value is infinite it is
            per unit of its reciprocal.
        law: by constant of the law.
        stiffness: per relative change of each cell's stiffness, shape (frames, fiducials, 3, cells), or None.
        forces: per N/m^3 of each force along each axis, shape (frames, fiducials, 3, forces, 3), or None.
        growths: per growth of one, shape (frames, fiducials, 3, growths), or None.
        places: per m of the fiducial's own rest position along each axis, shape (frames, fiducials, 3, 3), or None.
        terms: per unit of each of many terms, shape (frames, fiducials, 3, count), or None.
        held: what `Works.held` gives, shape (frames, holds, 4, 3), or None.
        boundary: per unit of each mode of `DrivenBoundary.error_increments`, shape (frames, fiducials, 3, modes), or None.
    """

    probes: list[dict[str, Array]]
    law: dict[str, Array]
    stiffness: NDArray[np.float32] | None = None
    forces: NDArray[np.float32] | None = None
    places: Array | None = None
    terms: NDArray[np.float32] | None = None
    held: Array | None = None
    growths: NDArray[np.float32] | None = None
    boundary: Array | None = None

    @classmethod
    def merged(cls, parts: Sequence[Sensitivities]) -> Sensitivities:
        """Those of different actions as one."""
        first = parts[0]
        probes = [
            {name: overlaid([part.probes[i][name] for part in parts]) for name in one}
            for i, one in enumerate(first.probes)
        ]
        law = {name: overlaid([part.law[name] for part in parts]) for name in first.law}
        fields = {
            name: None if getattr(first, name) is None else overlaid([getattr(part, name) for part in parts])
            for name in _FIELDS
        }
        return cls(probes, law, **fields)

    def padded(self, count: int) -> Sensitivities:
        """The same in a measurement of so many frames, of which these are the first."""
        named = self.named
        if all(len(array) == count for array in named.values()):
            return self
        more = {
            name: np.concatenate([array, np.full((count - len(array), *array.shape[1:]), np.nan, array.dtype)])
            for name, array in named.items()
        }
        return Sensitivities.of_named(more, len(self.probes))

    @property
    def arrays(self) -> list[Any]:
        """All of them, each (frames, ...)."""
        return list(self.named.values())

    @property
    def named(self) -> dict[str, Any]:
        """All of them by a name each, as "probe 0 weight", "law young" or "forces"."""
        own = {f"probe {i} {name}": array for i, one in enumerate(self.probes) for name, array in one.items()}
        own |= {f"law {name}": array for name, array in self.law.items()}
        return own | {name: found for name in _FIELDS if (found := getattr(self, name)) is not None}

    @classmethod
    def of_named(cls, arrays: Mapping[str, Any], count: int) -> Sensitivities:
        """From arrays by name, as `named` has them, and the number of probes."""
        probes: list[dict[str, Array]] = [{} for _ in range(count)]
        law = {}
        for key, array in arrays.items():
            kind, *rest = key.split(" ", 2)
            if kind == "probe":
                probes[int(rest[0])][rest[1]] = array
            elif kind == "law":
                law[" ".join(rest)] = array
        return cls(probes, law, **{name: arrays[name] for name in _FIELDS if name in arrays})
