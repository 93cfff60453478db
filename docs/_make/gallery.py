"""The scripts of the gallery of examples, and what they find when it runs them."""

import builtins
import shutil
from pathlib import Path
from typing import Any

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"


def name_the_file(_conf: dict[str, Any], file: str, when: str) -> None:
    """Tell an example its own name, which the gallery leaves undefined."""
    builtins.__file__ = str(EXAMPLES / Path(file).name)  # type: ignore[attr-defined]


def collect(target: Path) -> None:
    """Copy the numbered scripts, and nothing else that lies beside them."""
    target.mkdir(parents=True, exist_ok=True)
    for file in (Path(__file__).with_name("GALLERY_HEADER.rst"), *sorted(EXAMPLES.glob("[0-9]*.py"))):
        copy = target / file.name
        if not copy.is_file() or copy.read_bytes() != file.read_bytes():
            shutil.copyfile(file, copy)
