"""Inputs of cases: made once, and kept in the repository as one file each."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

TRUTH = "truth.json"


def prepared(folder: Path, stored: Path, make: Callable[[], None]) -> dict[str, Any]:
    """The truth of a case, whose input is in `folder`: from the `stored` copy where there is one, else by `make`."""
    if not (folder / TRUTH).is_file():
        folder.mkdir(parents=True, exist_ok=True)
        if stored.is_file():
            with zipfile.ZipFile(stored) as archive:
                archive.extractall(folder)
        else:
            make()
    truth: dict[str, Any] = json.loads((folder / TRUTH).read_text(encoding="utf-8"))
    return truth


def store(stored: Path, folder: Path, files: Iterable[Path]) -> None:
    """Keep some files of a folder."""
    stored.parent.mkdir(exist_ok=True)
    with zipfile.ZipFile(stored, "w", zipfile.ZIP_DEFLATED) as archive:
        for file in files:
            # A fixed date: the same input makes the same file.
            inside = zipfile.ZipInfo(str(file.relative_to(folder)))
            archive.writestr(inside, file.read_bytes(), zipfile.ZIP_DEFLATED, 9)
