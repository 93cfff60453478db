"""A file that holds two calibrated cameras, whoever wrote it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from bcid.base.errors import InputError, Problems
from bcid.base.text_file import parse_json, parse_toml, read_text
from bcid.vision.calibrations.matlab_stereo import (
    bouguet,
    is_bouguet,
    is_stereo_parameters,
    matlab_values,
    stereo_parameters,
    unknown,
)
from bcid.vision.calibrations.named_matrices import named, own, stated_size
from bcid.vision.calibrations.number_table import read_array, read_table
from bcid.vision.calibrations.opencv_storage import opencv_values
from bcid.vision.calibrations.projections import find_projections, from_projections, split_pair
from bcid.vision.calibrations.stored import Counting, Stored

FORMAT = "bcid-cameras/1"
_TABLES = (".csv", ".txt", ".dat", ".tsv")
# How OpenCV's storage begins, whatever it is called.
_STORAGE = ("%YAML", "<?xml")


def read_stored(path: Path, counting: Counting, problems: Problems) -> Stored | None:
    """The cameras of a file, in OpenCV's conventions; None with what is wrong noted.

    Args:
        path: the file.
        counting: what is known of its pixels beside what it states itself.

    Raises:
        InputError: it is of no kind that is read, or damaged.
    """
    suffix = path.suffix.lower()
    if suffix == ".mat":
        return _matlab(path, counting, problems)
    if suffix == ".npy" or (suffix in _TABLES and not _is_storage(path)):
        table = read_array(path) if suffix == ".npy" else read_table(path)
        return from_projections(split_pair(table), None, counting, path, problems)
    values = _values(path)
    if values.get("format") == FORMAT:
        _refuse_counting("bcid", counting, path, problems)
        return own(values, path, problems)
    return _by_name(values, counting, path, problems)


def _by_name(values: dict[str, Any], counting: Counting, path: Path, problems: Problems) -> Stored | None:
    """Projections where there are some, else matrices under usual names."""
    size = stated_size(values)
    size = None if size is None else np.ravel(size).tolist()
    told = Counting(values.get("first_pixel"), values.get("origin"), size).joined(counting, path, problems)
    pair = find_projections(values)
    if pair is None:
        return named(values, told, path, problems)
    return from_projections(pair, values.get("length_unit"), told, path, problems)


def _matlab(path: Path, counting: Counting, problems: Problems) -> Stored | None:
    values = matlab_values(path)
    if is_stereo_parameters(values):
        _refuse_counting("MATLAB's stereoParameters", counting, path, problems)
        return stereo_parameters(values, path, problems)
    if is_bouguet(values):
        _refuse_counting("Bouguet's toolbox", counting, path, problems)
        return bouguet(values, path, problems)
    # Scalars and vectors are matrices there.
    plain = {name: value for name, value in values.items() if "/" not in name}
    if find_projections(plain) is None and not {"R", "rotation"} & plain.keys():
        raise unknown(path, values)
    return _by_name(plain, counting, path, problems)


def _is_storage(path: Path) -> bool:
    return read_text(path).lstrip().startswith(_STORAGE)


def _refuse_counting(kind: str, counting: Counting, path: Path, problems: Problems) -> None:
    if counting.first is not None or counting.origin is not None:
        problems.add(path, f"how {kind} counts pixels is known; leave first_pixel and origin away")


def _values(path: Path) -> dict[str, Any]:
    """What a calibration file of text holds, by name."""
    text = read_text(path)
    values: Any = None
    try:
        if path.suffix == ".toml":
            values = parse_toml(text, path)
        elif path.suffix == ".json" and "opencv-matrix" not in text:
            values = parse_json(text, path)
        else:
            values = opencv_values(path)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: not a calibration file: {error}") from None
    if not isinstance(values, dict):
        raise InputError(f"{path}: not a calibration file: expected names with matrices")
    return values
