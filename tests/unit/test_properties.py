"""Properties that hold for whatever units, covariances, records and measurements there are."""

from __future__ import annotations

import json
import math
import types
from dataclasses import MISSING, fields, replace
from pathlib import Path
from typing import Any, Union, get_args, get_origin, get_type_hints

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from bcid import Measurement
from bcid.base.units import parse_unit, percent, quantity, show, uncertain
from bcid.forms import effect_trial as trial
from bcid.forms.simulate import recorded
from bcid.inference.data import Data
from bcid.inference.error_covariance import ErrorCovariance
from bcid.inference.mesh_error import MeshError
from bcid.inference.nuisances import NuisanceModes
from bcid.measurement import Action
from bcid.results.record import FileRecord, Record
from bcid.results.run_documents import RECORDS

COMMON = settings(
    deadline=None, derandomize=True, max_examples=15, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
UNITS = ("m", "mm", "cm", "Pa", "kPa", "N/mm^2", "N", "mN", "s", "min", "deg", "rad", "N/m^3", "Pa/m", "%", "kg", "g")
SIZES = st.floats(1e-6, 1e6)


# -- units


@COMMON
@given(SIZES, st.sampled_from(UNITS))
def test_quantity_of_a_shown_value_is_the_value(value: float, unit: str) -> None:
    factor = parse_unit(unit)[0]
    like = next(name for name in ("m", "Pa", "N", "s", "deg", "N/m^3", "Pa/m", "1", "kg") if _alike(name, unit))
    assert quantity(show(value * factor, unit, 15), like) == pytest.approx(
        value * quantity(f"1 {unit}", like), rel=1e-9
    )


def _alike(name: str, unit: str) -> bool:
    return parse_unit(name)[1] == parse_unit(unit)[1]


@COMMON
@given(st.floats(0, 1))
def test_percent_is_certain_only_in_words(p: float) -> None:
    text = percent(p)
    assert not text.startswith(("100", "0 %"))
    shown = float(text.strip("<> %"))
    assert abs(shown / 100 - p) <= 0.005 + 1e-9


@COMMON
@given(st.floats(-1e6, 1e6), st.floats(1e-6, 1e3))
def test_uncertain_rounds_by_less_than_the_error(value: float, error: float) -> None:
    shown, beside = (float(part.replace("−", "-")) for part in uncertain(value, error).split(" ± "))
    assert abs(shown - value) <= max(0.06 * error, 1e-3 * abs(value) if error < 1e-5 else 0.0)
    assert beside == pytest.approx(error, rel=0.06)


# -- covariance of a residual


def measured_at_rest() -> Measurement:
    """Two pulls of four steps in which no marker moves."""
    number, turns = np.arange(4), np.tile([1.0, 0.0, 0.0, 0.0], (4, 1))
    ways = np.eye(3)[:2] * 1e-3
    made = [Action(str(i), i * 4 + number, number, "gripper", number[:, None] * ways[i], turns) for i in (0, 1)]
    still = np.tile(trial.scene().rest, (8, 1, 1))
    return recorded(trial.scene(), made, still, 0.0, np.random.default_rng(0))


def covariance(seed: int, columns: int, noise: float) -> ErrorCovariance:
    rng = np.random.default_rng(seed)
    measured = measured_at_rest()
    data = Data(trial.scene(), replace(measured, noise_sigma=noise))
    left = np.concatenate([np.linspace(0, 1, 4)[:, None, None] * rng.normal(size=(1, 4, 3)) for _ in range(2)])
    mesh = MeshError(np.zeros_like(left), noise * left, True)
    common = noise * rng.normal(size=(len(data), columns))
    modes = NuisanceModes(np.zeros((len(data), 0)), common, ("grip",) * columns, {"grip": noise} if columns else {})
    return ErrorCovariance(data, noise * rng.uniform(0.5, 2.0, len(data)), mesh, modes)


@COMMON
@given(st.integers(0, 50), st.integers(0, 4), st.floats(1e-5, 1e-2))
def test_covariance_of_whitened_values_is_one(seed: int, columns: int, noise: float) -> None:
    errors = covariance(seed, columns, noise)
    root = np.column_stack([errors.unwhiten(one) for one in np.eye(len(errors.data))])
    assert errors.whiten(root) == pytest.approx(np.eye(len(errors.data)), abs=1e-6)
    assert errors.log_volume == pytest.approx(np.linalg.slogdet(root)[1], rel=1e-6)
    assert (np.linalg.eigvalsh(root @ root.T) > 0).all()


@COMMON
@given(st.integers(0, 50), st.integers(1, 4), st.floats(1e-5, 1e-2))
def test_covariance_with_another_nuisance_explains_more_and_is_larger(seed: int, columns: int, noise: float) -> None:
    errors = covariance(seed, columns, noise)
    fewer = errors.without(["grip"])
    residual = np.random.default_rng(seed).normal(0, 3 * noise, len(errors.data))
    assert np.sum(errors.whiten(residual) ** 2) <= np.sum(fewer.whiten(residual) ** 2) * (1 + 1e-9)
    assert errors.log_volume >= fewer.log_volume - 1e-9


@COMMON
@given(st.integers(0, 50), st.floats(0.1, 10.0))
def test_covariance_scaled_with_the_residual_leaves_chi_square(seed: int, factor: float) -> None:
    one, other = covariance(seed, 2, 1e-4), covariance(seed, 2, 1e-4 * factor)
    residual = np.random.default_rng(seed).normal(0, 1e-4, len(one.data))
    assert other.whiten(factor * residual) == pytest.approx(one.whiten(residual), rel=1e-6, abs=1e-9)
    assert other.log_volume - one.log_volume == pytest.approx(len(one.data) * math.log(factor), abs=1e-6)


# -- records of results


def records(kind: type[Record]) -> st.SearchStrategy[Record]:
    """Records of a class with whatever its types allow."""
    hints = get_type_hints(kind)
    parts = {f.name: values(hints[f.name]) for f in fields(kind) if f.name != "length_unit"}
    given_or_not = {f.name for f in fields(kind) if f.default is not MISSING or f.default_factory is not MISSING}
    needed = {name: part for name, part in parts.items() if name not in given_or_not}
    optional = {name: part for name, part in parts.items() if name in given_or_not}
    units = {"length_unit": st.sampled_from(["m", "mm", "cm"])} if issubclass(kind, FileRecord) else {}
    return st.fixed_dictionaries(needed | units, optional=optional).map(lambda found: kind(**found))


def values(kind: Any) -> st.SearchStrategy[Any]:
    origin, inner = get_origin(kind), get_args(kind)
    if origin in (Union, types.UnionType):
        return st.none() | values(inner[0])
    if origin is tuple:
        return st.lists(values(inner[0]), max_size=2).map(tuple)
    if origin is dict:
        keys = st.integers(0, 9) if inner[0] is int else st.text(max_size=4)
        return st.dictionaries(keys, values(inner[1]), max_size=2)
    if issubclass(kind, Record):
        return records(kind)
    numbers = st.floats(-1e6, 1e6, allow_nan=False)
    return {float: numbers, int: st.integers(-9, 9), str: st.text(max_size=5), bool: st.booleans()}[kind]


@pytest.mark.parametrize("kind", RECORDS, ids=lambda kind: kind.__name__)
def test_record_of_any_content_is_read_as_written(kind: type[FileRecord]) -> None:
    @COMMON
    @given(records(kind))
    def holds(record: Record) -> None:
        assert isinstance(record, FileRecord)
        assert kind.from_json(json.loads(json.dumps(record.to_json(), allow_nan=False))) == record
        there = record.converted("mm").converted(record.length_unit)
        assert _rounded(there.to_json()) == _rounded(record.to_json())

    holds()


def _rounded(content: Any) -> Any:
    return json.loads(json.dumps(content), parse_float=lambda text: f"{float(text):.9g}")


# -- measurements


@COMMON
@given(st.integers(0, 10**6), st.sampled_from(["m", "mm", "cm", "in"]), st.floats(0, 0.4))
def test_measurement_written_and_read_is_the_same(tmp_path: Path, seed: int, unit: str, unseen: float) -> None:
    rng = np.random.default_rng(seed)
    measured = measured_at_rest()
    data = measured.data.copy(deep=True)
    data["position"] += rng.normal(0, 1e-3, data["position"].shape)
    data["position"][{"frame": slice(1, None)}] = data["position"][{"frame": slice(1, None)}].where(
        rng.random(data["position"][{"frame": slice(1, None)}].shape[:2])[..., None] >= unseen
    )
    units = replace(measured.units, length=unit)
    folder = tmp_path / f"{seed}-{unit}-{unseen}"
    replace(measured, data=data, units=units).write(folder)
    again = Measurement.read(folder)
    assert again.units.length == unit
    np.testing.assert_allclose(again.positions, data["position"].values, rtol=1e-6, atol=1e-9)
    assert again.action_names == measured.action_names
