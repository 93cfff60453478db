"""Files that come with bcid: scenes, geometries, measurements, study files, and what its benchmark compares with."""

from __future__ import annotations

from pathlib import Path

from bcid.base.errors import MachineError

_PACKAGE = Path(__file__).resolve().parents[1]
# Below the package when it was installed from a wheel; in a checkout the package lies beside them.
_PLACES = (_PACKAGE / "shipped", _PACKAGE.parent)
# What is on the path of a Python that can import bcid.
IMPORT_ROOT = _PACKAGE.parent


def shipped(name: str) -> Path:
    """Path of a file or folder, as "examples/scenes/slab.toml": names are those of the checkout.

    Raises:
        MachineError: it did not come with this installation.
    """
    for place in _PLACES:
        if (place / name).exists():
            return place / name
    raise MachineError(
        f"{name}: did not come with this bcid ({_PACKAGE}); install its wheel, or use the whole checkout"
    )
