"""Files that come with bcid: scenes, geometries, measurements and scripts; in a checkout also what its validation reads."""

from __future__ import annotations

import shutil
from pathlib import Path

from bcid.base.errors import InputError, MachineError, unwritable

_PACKAGE = Path(__file__).resolve().parents[1]
# Below the package when it was installed from a wheel; in a checkout the package lies beside them.
_PLACES = (_PACKAGE / "shipped", _PACKAGE.parent)
# Scenes name their geometries by paths that go from one of these folders to the other.
_EXAMPLES = ("examples", "meshes")
# What is on the path of a Python that can import bcid.
IMPORT_ROOT = _PACKAGE.parent


def copy_examples(target: Path) -> list[str]:
    """Copy what the examples of the documentation need into a folder, under the names of the checkout; returns these names.

    Raises:
        InputError: the folder exists and holds something.
        MachineError: it cannot be written, or the files did not come with this installation.
    """
    if target.exists() and (not target.is_dir() or any(target.iterdir())):
        raise InputError(f"{target}: exists and is not empty; name another folder")
    # A folder that is there may be the one that the user works in, and must stay the same.
    partial = target / ".partial" if target.exists() else target.with_name(f".{target.name}.partial")
    try:
        shutil.rmtree(partial, ignore_errors=True)
        for name in _EXAMPLES:
            shutil.copytree(shipped(name), partial / name, ignore=shutil.ignore_patterns("__pycache__"))
        if target.exists():
            for name in _EXAMPLES:
                (target / name).parent.mkdir(parents=True, exist_ok=True)
                (partial / name).replace(target / name)
            shutil.rmtree(partial)
        else:
            partial.replace(target)
    except OSError as error:
        shutil.rmtree(partial, ignore_errors=True)
        raise unwritable(target, error) from None
    return list(_EXAMPLES)


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
