"""How stiff the body is, as the gripper's force tells."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bcid.base.units import uncertain
from bcid.forms.model import Model
from bcid.inference.likelihood import Errors
from bcid.inference.nuisances import STIFFNESS
from bcid.scene import Scene

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Stiffness:
    """Of the law's constants that are stiffnesses, all together.

    Attributes:
        factor: what those of the model are to be multiplied by.
        stderr: its standard error.
        constants: those of the model, Pa.
        stated: those of the scene, Pa.
    """

    factor: float
    stderr: float
    constants: Mapping[str, float]
    stated: Mapping[str, float]

    @classmethod
    def of(
        cls, errors: Errors, residual: Array, model: Model, scene: Scene, fitted: Array | None = None
    ) -> Stiffness | None:
        """From a residual (n,), m; None where no force is measured, or the scene takes its stiffness for exact.

        Args:
            errors: of the residual, with the stiffness among its nuisances.
            model: that it was predicted with.
            scene: where that began.
            fitted: columns (n, p), m, by which numbers that were fitted to the same data change what is predicted.
        """
        told = errors.estimate(residual, STIFFNESS, fitted)
        if told is None:
            return None
        return cls(1 + told[0], told[1], model.stiffnesses, Model.of(scene).stiffnesses)

    @property
    def values(self) -> dict[str, float]:
        """The constants as they were found, Pa; a factor that is no stiffness is not believed."""
        factor = self.factor if self.factor > self.stderr else 1.0
        return {name: factor * value for name, value in self.constants.items()}

    @property
    def text(self) -> str:
        """As summaries tell it: "young = 15210 ± 320 Pa (the scene has 15000)"."""
        parts = [
            f"{name} = {uncertain(self.factor * value, self.stderr * value, 'Pa')} (the scene has {self.stated[name]:.6g})"
            for name, value in self.constants.items()
        ]
        return ", ".join(parts)

    def to_json(self) -> dict[str, Any]:
        """As results hold it: constants in Pa."""
        return {
            "constants": {
                name: {
                    "value": self.factor * value,
                    "stderr": self.stderr * value,
                    "scene": self.stated[name],
                    "unit": "Pa",
                }
                for name, value in self.constants.items()
            },
        }
