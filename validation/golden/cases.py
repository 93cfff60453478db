"""The sixty golden cases: for each a folder with `scene.toml`, `measurement/` and `truth.json`.

hidden-SEED-INDEX    cases of `bcid-validate synthetic --seed SEED --least 3`: the first of each of its 24 conditions,
                     then the first that are left
beyond-INDEX         the first ten cases of `bcid-validate beyond`
lab-*, lab2-*        measurements of independent finite element codes
awkward-*            simulated measurements with ordinary faults (`tests/verify/test_awkward.py`)
strip, beam          published measurements of rubber and silicone
"""

from __future__ import annotations

import importlib.util
import json
import re
import shutil
import sys
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from bcid.base.errors import InputError
from bcid.measurement import Measurement
from bcid.scene import Scene
from validation import stored_input
from validation.beyond import beyond_case
from validation.beyond.beyond_study import BeyondOptions
from validation.stored_input import TRUTH
from validation.synthetic import truth as hidden_truth
from validation.synthetic.drawing import CaseChoice

PROJECT = Path(__file__).resolve().parents[2]
SCENES = PROJECT / "examples" / "scenes"
# Measurements beside the checkout, for those that may not be copied into it.
DATA = PROJECT.parent / "shared" / "data"
INPUTS = Path(__file__).resolve().parent / "inputs"
SCENE, MEASUREMENT = "scene.toml", "measurement"

BLINDED = {
    211: (0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 14, 18, 20),
    # Case 2 of it cannot be made.
    223: (0, 1, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 22),
}
LEAST_SIZE = 3.0
BEYOND = 10
_LEVEL = re.compile(r"\[\[levels\]\]\n(?:\w.*\n)+\n?")
_FIDUCIALS = re.compile(r"\[fiducials\]\n(?:.+\n?)*")
_GEOMETRY = re.compile(r'^file = "(.*)"$', re.MULTILINE)


@dataclass(frozen=True)
class Truth:
    """What is true of a case that no study drew.

    Attributes:
        anchored: patches, separated by spaces; "" where nobody has published them.
        kind: "none", "one", "outside" of the catalogue, or "unpublished".
        effects: names of those that act; all are much larger than the noise.
        allowed: names of those that act within what the scene states as uncertain, and so may be named or not.
    """

    anchored: str
    kind: str = "none"
    effects: tuple[str, ...] = ()
    allowed: tuple[str, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """As the blinded study writes it."""
        effects = [{"effect": name, "size": 10.0} for name in self.effects]
        effects += [{"effect": name, "size": 1.0} for name in self.allowed]
        return {"kind": self.kind, "anchored": self.anchored.split(), "not_asked": [], "effects": effects}


UNPUBLISHED = Truth("", "unpublished")


def prepare(name: str, folder: Path) -> dict[str, Any]:
    """Write the input of a case into `folder`, from the stored copy where there is one; returns its truth.

    Raises:
        InputError: no such case, or its measurement is neither stored nor beside the checkout.
    """
    if name not in CASES:
        raise InputError(f"there is no golden case '{name}'")
    return stored_input.prepared(folder, INPUTS / f"{name}.zip", lambda: CASES[name](folder))


def store(name: str, folder: Path) -> None:
    """Keep the input of a case in the repository, but for published measurements, which stay where they are."""
    if name in UNSTORED:
        return
    files = sorted(file for file in folder.rglob("*") if file.is_file())
    own = [file for file in files if file.relative_to(folder).parts[0] not in ("run", "diagnosis")]
    stored_input.store(INPUTS / f"{name}.zip", folder, own)


def _write(folder: Path, scene: str, directory: Path, measurement: Measurement | Path, truth: Truth) -> None:
    """A scene's text with its geometry beside it, a measurement, and the truth."""
    found = _GEOMETRY.search(scene)
    assert found is not None
    geometry = directory / found[1]
    shutil.copyfile(geometry, folder / geometry.name)
    (folder / SCENE).write_text(scene.replace(found[0], f'file = "{geometry.name}"'), encoding="utf-8")
    if isinstance(measurement, Measurement):
        measurement.write(folder / MEASUREMENT)
    else:
        (folder / MEASUREMENT).mkdir()
        for file in measurement.iterdir():
            shutil.copyfile(file, folder / MEASUREMENT / file.name)
    (folder / TRUTH).write_text(json.dumps(truth.to_json(), indent=1) + "\n", encoding="utf-8")


def _blinded(seed: int, index: int, folder: Path) -> None:
    hidden_truth.make(folder, index, CaseChoice(seed, LEAST_SIZE))


def _beyond(index: int, folder: Path) -> None:
    beyond_case.make(folder, index, 0, BeyondOptions().bodies)


def _beside(scene: Path, measurement: Path, truth: Truth, folder: Path) -> None:
    if not measurement.is_dir():
        raise InputError(f"{measurement}: is not there; this case needs the published data beside the checkout")
    _write(folder, scene.read_text(encoding="utf-8"), scene.parent, measurement, truth)


def _awkward(case: str, truth: Truth, folder: Path) -> None:
    """On the scene of the slab with the three levels of the test."""
    module = _loaded(PROJECT / "tests" / "verify" / "test_awkward.py")
    text = (SCENES / "slab.toml").read_text(encoding="utf-8")
    sizes = [f"{1e3 * size:g} mm" for size in (0.05, 0.025, 0.0125)]
    levels = "".join(f'[[levels]]\nelement_size = "{size}"\ndegree = 2\n\n' for size in sizes)
    first = _LEVEL.search(text)
    assert first is not None
    text = text[: first.start()] + levels + _LEVEL.sub("", text[first.start() :])
    text = text.replace('noise_sigma = "0.3 mm"', f'noise_sigma = "{1e3 * module.NOISE:g} mm"')
    base = folder / ".base"
    base.mkdir(exist_ok=True)
    (base / SCENE).write_text(text.replace("../../meshes", str(PROJECT / "meshes")), encoding="utf-8")
    scene, measurement = module.AWKWARD[case](Scene.read(base / SCENE))
    shutil.rmtree(base)
    if scene.noise_sigma is None:
        text = re.sub(r"^noise_sigma = .*\n", "", text, flags=re.MULTILINE)
    text = re.sub(r"^poisson = .*$", f"poisson = {scene.material.values['poisson']:g}", text, flags=re.MULTILINE)
    _write(folder, text, SCENES, measurement, truth)


def _strip(folder: Path) -> None:
    """All speckles in all states, as `examples/07_strip.py --explain`."""
    module = _loaded(PROJECT / "examples" / "07_strip.py")
    placed, moved = module.in_body(module.triangulated(DATA / "real" / "duodic_rubber"))
    seen = np.flatnonzero(np.isfinite(placed[0]).all(axis=1))
    places = {f"p{i}": " ".join(f"{1e3 * x:.9g}" for x in placed[0, i]) + " mm" for i in seen}
    text = (SCENES / "strip.toml").read_text(encoding="utf-8")
    listed = "".join(f'{name} = "{place}"\n' for name, place in places.items())
    text = _FIDUCIALS.sub(f"[fiducials]\n{listed}", text)
    scene = Scene.read(SCENES / "strip.toml")
    scene = replace(
        scene,
        fiducials={f"p{i}": (float(x), float(y), float(z)) for i, (x, y, z) in zip(seen, placed[0, seen], strict=True)},
    )
    _write(folder, text, SCENES, module.pulled(scene, placed[:, seen], moved), Truth("fixed", "outside"))


def _beam(folder: Path) -> None:
    """Released under its weight, which the scene does not have, alone and with a known weight at its tip."""
    module = _loaded(PROJECT / "examples" / "03_beam.py")
    text = (SCENES / "beam.toml").read_text(encoding="utf-8")
    text = re.sub(r"\[effects\.gravity\]\n.*\n", "", text)
    scene = replace(Scene.read(SCENES / "beam.toml"), effects={})
    measurement, _ = module.states_of_rest(scene)
    _write(folder, text, SCENES, measurement, Truth("clamp", "one", ("gravity",)))


def _loaded(file: Path) -> ModuleType:
    """A Python file that is no module of a package."""
    name = f"golden_{file.stem}"
    spec = importlib.util.spec_from_file_location(name, file)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    # Dataclasses look their module up.
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


_EXPLAIN = SCENES / "slab_explain.toml"
_LAB = {
    "hidden-a": (_EXPLAIN, Truth("3 4", "one", ("fibres",))),
    "hidden-b": (_EXPLAIN, UNPUBLISHED),
    "hidden-c": (_EXPLAIN, UNPUBLISHED),
    "hidden-d": (_EXPLAIN, Truth("3 4")),
    "slab-12-semicircle": (_EXPLAIN, Truth("1 2")),
    "slab-1234-semicircle": (_EXPLAIN, Truth("1 2 3 4")),
    "slab-27-five": (_EXPLAIN, Truth("2 7")),
    "slab-34-complex": (_EXPLAIN, Truth("3 4")),
    "slab-34-buckles": (_EXPLAIN, Truth("3 4")),
}
_LAB2 = {"block": Truth("1 6"), "organ": Truth("1 4", "one", ("gravity",))}
_AWKWARD = {
    "six-markers": ("six markers", Truth("1 3")),
    "gaps": ("a fifth of all positions is missing", Truth("1 3")),
    "gripper-off": ("the gripper is 3 mm from where it is reported", Truth("1 3", allowed=("grasp_offset",))),
    "marker-off": ("one marker is wrong by 20 mm", Truth("1 3", "one", ("marker_fault",))),
    "swapped": ("two markers are swapped half-way", Truth("1 3", "outside", allowed=("marker_fault",))),
    "no-noise": ("no noise, and none is stated", Truth("1 3")),
    "poisson-off": ("Poisson's ratio is wrong by 0.1", Truth("1 3", allowed=("compressibility",))),
}
UNSTORED = ("strip",)


def _cases() -> Iterable[tuple[str, Callable[[Path], None]]]:
    for seed, indices in BLINDED.items():
        for index in indices:
            yield f"hidden-{seed}-{index}", partial(_blinded, seed, index)
    for index in range(BEYOND):
        yield f"beyond-{index}", partial(_beyond, index)
    for name, (scene, truth) in _LAB.items():
        yield f"lab-{name}", partial(_beside, scene, DATA / "lab" / name, truth)
    for name, truth in _LAB2.items():
        folder = PROJECT / "tests" / "data" / "lab2"
        yield f"lab2-{name}", partial(_beside, folder / f"scenes/{name}.toml", folder / f"nuisance-{name}", truth)
    for name, (case, truth) in _AWKWARD.items():
        yield f"awkward-{name}", partial(_awkward, case, truth)
    yield "strip", _strip
    yield "beam", _beam


CASES: Mapping[str, Callable[[Path], None]] = dict(_cases())
