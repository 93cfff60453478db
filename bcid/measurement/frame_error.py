"""What is not known of the frame in which positions were measured: an error that all points and steps have in common."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bcid.base.errors import Problems
from bcid.base.text_file import read_toml
from bcid.base.units import MOST

Array = NDArray[np.float64]

FORMAT = "bcid-frame/1"
_KEYS = ("format", "centre", "covariance")
# A covariance may miss symmetry, and being positive, by this part of its largest element.
_ROUNDING = 1e-9
# Parts of the error that are this small beside its largest are none.
_LEAST = 1e-9


@dataclass(frozen=True)
class FrameError:
    """A small unknown rotation, shift and change of scale of the measured frame, with mean zero.

    Attributes:
        centre: about which it turns and grows, shape (3,), m.
        covariance: of rotation vector (rad), shift (m) and logarithm of the scale, shape (7, 7).
    """

    centre: Array
    covariance: Array

    @classmethod
    def read(cls, path: Path, length: float) -> FrameError:
        """Read a frame.toml in which lengths are in units of `length` m.

        Raises:
            InputError: with every problem of the file.
        """
        problems = Problems(f"error of the frame {path}")
        table = read_toml(path)
        problems.add_unknown(path, table, _KEYS)
        if table.get("format") != FORMAT:
            problems.add(path, f'format: expected "{FORMAT}", found {table.get("format")!r}')
        found = cls.checked(table.get("centre"), table.get("covariance"), path, problems)
        problems.raise_if_any()
        scales = _scales(length)
        return cls(found.centre * length, found.covariance * np.outer(scales, scales))

    @classmethod
    def checked(cls, centre: Any, covariance: Any, path: Path, problems: Problems) -> FrameError:
        """From numbers of any origin; what is wrong with them is noted."""
        found = []
        for name, value, shape in (("centre", centre, (3,)), ("covariance", covariance, (7, 7))):
            try:
                array = plain_numbers(value).reshape(shape)
            except (TypeError, ValueError, OverflowError):
                array = np.full(shape, np.nan)
            if not (np.abs(array) <= MOST).all():
                wanted = " x ".join(map(str, shape))
                problems.add(
                    path, f"{name}: expected {wanted} finite numbers up to {MOST:g}, found {str(value)[:60]!r}"
                )
                array = np.zeros(shape)
            found.append(array)
        most = _ROUNDING * np.abs(found[1]).max()
        if np.abs(found[1] - found[1].T).max() > most or np.linalg.eigvalsh(found[1]).min() < -most:
            problems.add(path, "covariance: expected a symmetric matrix without negative eigenvalues")
        return cls(found[0], found[1])

    def lines(self, length: float) -> list[str]:
        """Lines of a frame.toml in which lengths are in units of `length` m."""
        scales = _scales(length)
        rows = [f"  [{', '.join(f'{v:.17g}' for v in row)}]," for row in self.covariance / np.outer(scales, scales)]
        centre = ", ".join(f"{v:.17g}" for v in self.centre / length)
        what = "# Of rotation vector (rad), shift (length_unit) and logarithm of the scale, about the centre."
        return [f'format = "{FORMAT}"', f"centre = [{centre}]", what, "covariance = [", *rows, "]"]

    def modes(self, points: Array) -> Array:
        """Displacements (..., 3, k), m, of points (..., 3): independent, each as large as one standard deviation of its part."""
        # Lengths are brought to the size of the body, so that angles and shifts can be compared.
        away = points - self.centre
        reach = float(np.sqrt(np.nanmean(away**2))) or 1.0
        scales = np.array([reach] * 3 + [1.0] * 3 + [reach])
        sizes, axes = np.linalg.eigh(self.covariance * np.outer(scales, scales))
        kept = sizes > _LEAST * max(sizes.max(), 1e-30)
        parts = axes[:, kept] * np.sqrt(sizes[kept]) / scales[:, None]
        return np.asarray(slopes(away) @ parts)

    def rms(self, points: Array) -> float:
        """RMS displacement per coordinate of points (..., 3), m."""
        return float(np.sqrt(np.nanmean(np.sum(self.modes(points) ** 2, axis=-1))))


def plain_numbers(value: Any) -> Array:
    """Numbers of nested lists or of an array; `TypeError` or `ValueError` for anything else, as text and truth values."""
    items = [value]
    while items:
        item = items.pop()
        if isinstance(item, list | tuple):
            items += item
        elif not isinstance(item, int | float | np.ndarray | np.number) or isinstance(item, bool):
            raise TypeError(f"{item!r} is not a number")
    return np.asarray(value, dtype=float)


def _scales(length: float) -> Array:
    """SI units of rotation vector, shift and logarithm of the scale, for lengths in units of `length` m."""
    return np.array([1.0] * 3 + [length] * 3 + [1.0])


def slopes(away: Array) -> Array:
    """Derivatives (..., 3, 7) of points at `away` (..., 3), m, from the centre by the seven parts of a `FrameError`."""
    x, y, z = np.moveaxis(away, -1, 0)
    slope = np.zeros((*away.shape, 7))
    slope[..., 0, 1], slope[..., 0, 2] = z, -y
    slope[..., 1, 0], slope[..., 1, 2] = -z, x
    slope[..., 2, 0], slope[..., 2, 1] = y, -x
    slope[..., :, 3:6] = np.eye(3)
    slope[..., :, 6] = away
    return slope
