"""Run folders of all kinds made by hand, for the tests of reports: no solver is needed."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import xarray as xr

from bcid.base.run_folder import RunFolder, sealed

AXES = ["x", "y", "z"]
STEPS = 4


def slab(count: int = 4) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points (m), tetrahedra and boundary triangles of a slab of cubes, each of six tetrahedra."""
    shape = (count, 1, count)
    number = np.arange(np.prod([n + 1 for n in shape])).reshape([n + 1 for n in shape])
    points = 0.02 * np.argwhere(number >= 0).astype(float)
    cells = []
    for i, j, k in np.ndindex(*shape):
        box = number[i : i + 2, j : j + 2, k : k + 2]
        for order in ([0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]):
            at, corners = np.zeros(3, dtype=int), [box[0, 0, 0]]
            for axis in order:
                at[axis] = 1
                corners.append(box[tuple(at)])
            cells.append(corners)
    tetrahedra = np.array(cells, dtype=np.int32)
    faces = np.vstack([np.delete(tetrahedra, k, axis=1) for k in range(4)])
    _, first, seen = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
    return points, tetrahedra, faces[first[seen == 1]]


def body(names: tuple[str, ...] = ("", "patch left", "patch right", "grasp I"), scene: str = "slab") -> xr.Dataset:
    """A slab held on the left, pulled in two actions."""
    points, cells, triangles = slab()
    middle = points[triangles].mean(axis=1)
    place = np.select([middle[:, 0] < 1e-9, middle[:, 0] > 0.08 - 1e-9, middle[:, 2] > 0.08 - 1e-9], [1, 2, 3], 0)
    way = np.r_[np.linspace(0, 1, STEPS), np.linspace(0, -1, STEPS)]
    move = np.stack([0 * points[:, 0], 0.02 * points[:, 0] / 0.08, 0 * points[:, 0]], axis=1)
    return xr.Dataset(
        {
            "points": (("node", "axis"), points),
            "cells": (("cell", "corner"), cells),
            "triangles": (("triangle", "vertex"), triangles),
            "place": ("triangle", place.astype(np.int32)),
            "place_name": ("place_number", list(names)),
            "displacement": (("frame", "node", "axis"), way[:, None, None] * move),
            "energy": (("frame", "node"), (40.0 * (way[:, None] * points[None, :, 0] / 0.08) ** 2).astype(np.float32)),
        },
        {"axis": AXES},
        {"scene": scene, "up": "0 1 0"},
    )


def positions(
    grasp: str = "I", actions: tuple[str, str] = ("1", "2"), fiducials: tuple[str, ...] = ("a", "b", "c")
) -> xr.Dataset:
    """Measured and predicted positions: the first model misses more than the last; one fiducial is unseen once."""
    rng = np.random.default_rng(1)
    frames, count = 2 * STEPS, len(fiducials)
    rest = np.column_stack([np.linspace(0.02, 0.06, count), np.full(count, 0.02), np.full(count, 0.04)])
    way = np.r_[np.linspace(0, 1, STEPS), np.linspace(0, -1, STEPS)]
    last = rest + way[:, None, None] * np.array([0, 0.01, 0])
    measured = last + 2e-4 * rng.standard_normal((frames, count, 3))
    measured[2, 1] = np.nan
    first = last + (1 + np.arange(frames))[:, None, None] * np.array([0, 5e-4, 0])
    dims = ("frame", "fiducial", "axis")
    coords = {
        "fiducial": list(fiducials),
        "axis": AXES,
        "action": ("frame", [actions[0]] * STEPS + [actions[1]] * STEPS),
        "step": ("frame", [*range(STEPS)] * 2),
    }
    data = {"measured": (dims, measured), "predicted_first": (dims, first), "predicted": (dims, last)}
    more = {"rest": (dims[1:], rest), "grasp": ("frame", [grasp] * frames)}
    return xr.Dataset(data | more, coords, {"model_first": "neo_hooke", "model": "neo_hooke + gravity"})


def rung(model: str, rms: float, adequate: bool) -> dict[str, Any]:
    numbers = {"rms": rms, "normalised_rms": 5 * rms, "held_out_rms": 1.01 * rms, "p_value": 0.5 if adequate else 0.0}
    return {"model": model, "anchored": ["left"], "adequate": adequate, **numbers}


def ranked(effect: str, expected: float, fitted: float | None = None) -> dict[str, Any]:
    return {
        "effect": effect,
        "place": "",
        "anchored": None,
        "parameters": {"weight": {"value": 1257.6, "stderr": 9.4, "unit": "N/m^3"}},
        "score": 812.0,
        "p_value": 0.0 if fitted else 0.2,
        "expected_rms": expected,
        "fitted_rms": fitted,
        "held_out_rms": fitted,
        "power": 1.0,
        "confounded_with": [],
        "identifiable": True,
        "tried": 1,
    }


def diagnosis() -> dict[str, Any]:
    return {
        "adequate": True,
        "p_value": 0.5,
        "false_alarm_rate": 0.01,
        "rms": 0.21,
        "noise_rms": 0.2,
        "noise_stated": True,
        "noise_like_rms": 0.2,
        "held_out_rms": 0.212,
        "anchored": ["left"],
        "verdict": "gravity",
        "model": "neo_hooke + gravity",
        "input_uncertainties": [],
        "selected_effects": [{"effect": "gravity", "place": "", "parameters": ranked("", 1)["parameters"]}],
        "tests": [{"name": "size", "p_value": 0.9, "decides": True, "text": "it is 0.98 times what noise explains"}],
        "residual_by": {},
        "ranking": [ranked("gravity", 0.24, 0.21), ranked("soft_anchor", 1.3)],
        "scene_sensitivity": [answer_at(-2.0, ["left"]), answer_at(2.0, [])],
        "entropy": 0.8,
        "next_steps": [{"kind": "number", "text": "measure: Poisson's ratio", "expected_bits": 0.42, "positions": []}],
        "model_sequence": [rung("neo_hooke", 1.42, False), rung("neo_hooke + gravity", 0.21, True)],
        "length_unit": "mm",
    }


def answer_at(offset: float, anchored: list[str]) -> dict[str, Any]:
    """The answer where Poisson's ratio is off; it depends on it where no patch is held then."""
    found = {
        "input": "poisson",
        "label": "Poisson's ratio",
        "stddev": 0.03,
        "offset": offset,
        "shift": f"{offset:+.0f}",
    }
    answer = {"verdict": "gravity", "verdict_probability": 0.97, "anchored": anchored, "anchors_probability": 0.96}
    return found | answer | {"depends": not anchored}


def identification() -> dict[str, Any]:
    other = {"anchored": ["left", "right"], "probability": 0.02, "rms": 0.3, "reported_rms": 0.21, "frames": 8}
    return {
        "anchored": ["left"],
        "probability": 0.98,
        "patches": {"left": 0.99, "right": 0.03},
        "rms": 0.21,
        "noise_rms": 0.2,
        "certified": True,
        "evaluations": {"1": 4.0},
        "evaluated": {"in full": 2, "stopped": 0, "failed": 0, "not": 2},
        "adequate": True,
        "alternatives": [other | {"level": 1, "stopped": True, "failure": ""}],
        "classes": [],
        "levels": [1],
        "stages": [],
        "failures": {},
        "not_converged": [],
        "remarks": [],
        "outliers": [],
        "input_uncertainties": [],
        "length_unit": "mm",
    }


def exploration() -> dict[str, Any]:
    def step(number: int, p: float) -> dict[str, Any]:
        posterior = [{"anchored": ["left"], "effect": "", "probability": p}]
        posterior.append({"anchored": ["left", "right"], "effect": "", "probability": 1 - p})
        return {
            "number": number,
            "grasp": "I",
            "direction": "+x",
            "amplitude": 8.0,
            "expected_bits": 0.5,
            "expected_stderr": 0.01,
            "gained_bits": 0.4,
            "entropy": 0.5,
            "posterior": posterior,
            "patches": {"left": 1.0, "right": 1 - p},
            "effects": {"": 1.0},
            "normalised_rms": 1.0,
            "discrepancy_probability": 0.1,
            "outbound": None,
            "options": [],
            "spent": 1.0,
            "predicted": 4,
            "seconds": 1.0,
        }

    return {
        "reason": "decided",
        "anchored": ["left"],
        "effect": "",
        "probability": 0.98,
        "patches": {"left": 1.0, "right": 0.02},
        "effects": {"": 1.0},
        "parameters": {},
        "entropy": 0.14,
        "rms": 0.2,
        "normalised_rms": 1.0,
        "discrepancy_probability": 0.1,
        "stiffness": None,
        "remarks": [],
        "not_allowed": [],
        "not_separated": [],
        "length_unit": "mm",
        "steps": [step(1, 0.6), step(2, 0.98)],
    }


def started(path: Path, command: str = "explain") -> RunFolder:
    return RunFolder.start(path, command, {"scene": "64babdf4", "measurement": "ccf20348", "options": {"level": None}})


def explained(path: Path) -> Path:
    """A finished run of `bcid explain`."""
    run = started(path)
    run.write_json("diagnosis.json", diagnosis())
    run.write_json("identification.json", identification())
    run.write_dataset("body.nc", body())
    run.write_dataset("residuals.nc", positions())
    run.write_text("summary.txt", "Missing in the plain model: gravity.\n")
    run.record["names"] = {"scene": "slab.toml", "measurement": "pulled"}
    run.finish({})
    return path


def identified(path: Path) -> Path:
    """A finished run of `bcid identify`."""
    run = started(path, "identify")
    run.write_json("identification.json", identification())
    run.write_dataset("body.nc", body())
    run.write_dataset("prediction.nc", positions().drop_vars("predicted_first"))
    run.write_text("summary.txt", "Anchored patches of slab: {left}\n")
    run.finish({})
    return path


def explored(path: Path) -> Path:
    """A finished run of `bcid explore`."""
    run = started(path, "explore")
    run.write_json("exploration.json", exploration())
    run.write_text("summary.txt", "Anchored patches of slab: {left}\n")
    run.finish({})
    return path


class Played:
    """A job whose run folder is there already, or is made by `work`."""

    def __init__(self, work: Callable[[Path], Path], files: Sequence[Path] = ()) -> None:
        self.work, self.made = work, list(files)

    def run(self, folder: Path, *_: Any) -> Path:
        return self.work(folder)

    def files(self, folder: Path) -> list[Path]:
        return [folder / file for file in self.made]


def play(monkeypatch: pytest.MonkeyPatch, job: Played) -> None:
    """Let a job stand for what `identify`, `compare`, `diagnose`, `fit` and `explain` compute, whatever their files hold."""
    source = SimpleNamespace(measurement=SimpleNamespace(remarks=()))
    for name in ("from_files", "from_run"):
        monkeypatch.setattr(f"bcid.search.answer.source.{name}", lambda *_: source)
    for name in ("compare", "diagnose", "fit", "explain"):
        monkeypatch.setattr(f"bcid.search.answer.comparison_job.{name}_job", lambda *_: job)
    monkeypatch.setattr("bcid.search.answer.identification_job.IdentificationJob.of_files", lambda *_: job)


def seal(folder: Path, *names: str) -> None:
    """Let the checksums be those of files that were changed: what a run could have written, had it found such things."""
    record = json.loads((folder / "run.json").read_text(encoding="utf-8"))
    record.setdefault("files", {})
    for name in names:
        record["files"][name] = hashlib.sha256((folder / name).read_bytes()).hexdigest()[:32]
    (folder / "run.json").write_text(json.dumps(sealed(record)), encoding="utf-8")


def rewrite(folder: Path, name: str, content: str) -> None:
    """Put something else into a file of a run, checksum and all."""
    (folder / name).write_text(content, encoding="utf-8")
    seal(folder, name)
