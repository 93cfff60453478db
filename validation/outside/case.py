"""The input of a case from its specification: scene, geometry, measurement and truth."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bcid.base.errors import MachineError, SolveError
from validation import stored_input
from validation.golden.cases import MEASUREMENT, SCENE
from validation.outside.worlds import GRASPS, KINDS, MARKERS, NOISES, PATCHES, SEED, SIZES, Box, Spec, draw
from validation.stored_input import TRUTH
from validation.synthetic.truth import rms

WORLD = Path(__file__).with_name("felupe_world.py")
INPUTS = Path(__file__).with_name("inputs")
# CPU seconds of the independent code.
_LIMIT = 900
_SCENE = """format = "bcid-scene/1"
name = "box"
description = "box of soft tissue, six candidate patches on two faces and the bottom"
down = [0, -1, 0]
support = "bottom"
noise_sigma = "{noise:g} mm"

[geometry]
file = "box.geo"
length_unit = "mm"

[[levels]]
element_size = "16 mm"
degree = 2

[[levels]]
element_size = "10 mm"
degree = 2

[[levels]]
element_size = "6 mm"
degree = 2

[material]
law = "neo_hooke"
young = "{young:g} kPa"
poisson = {poisson:g}

[patches]
{patches}

[grasps]
{grasps}

[places]
bottom = {{ plane = {{ point = "0 0 0 mm", normal = [0, 1, 0] }} }}

[fiducials]
{markers}
"""
_GEOMETRY = """SetFactory("OpenCASCADE");
DefineConstant[ h = {{8, Name "element size in mm"}} ];
eps = 1e-3;
Box(1) = {{0, 0, 0, {0:g}, {1:g}, {2:g}}};
{pieces}
BooleanFragments{{ Volume{{1}}; Delete; }}{{ Surface{{101:{last}}}; Delete; }}
Physical Volume("body") = {{Volume{{:}}}};
{names}
Mesh.MeshSizeFromPoints = 0;
Mesh.MeshSizeExtendFromBoundary = 0;
Mesh.MeshSizeMin = h;
Mesh.MeshSizeMax = h;
Mesh.Algorithm = 6;
Mesh.Optimize = 1;
"""
Array = NDArray[np.float64]
Truth = dict[str, Any]


def prepare(kind: str, index: int, folder: Path, python: str | None) -> Truth:
    """Write the input of a case, from the stored copy where there is one; returns its truth.

    Args:
        kind: of the world.
        index: of the measurement.
        folder: takes the input.
        python: a Python that has the independent code.

    Raises:
        MachineError: the independent code is not there.
        SolveError: it cannot follow the world.
    """

    def make() -> None:
        spec = draw(kind, index)
        write(spec, computed(spec, folder, python), folder)

    return stored_input.prepared(folder, INPUTS / f"{kind}-{index}.zip", make)


def store(kind: str, index: int, folder: Path) -> None:
    """Keep the input of a case in the repository."""
    files = [folder / SCENE, folder / "box.geo", folder / TRUTH, *sorted((folder / MEASUREMENT).iterdir())]
    stored_input.store(INPUTS / f"{kind}-{index}.zip", folder, files)


def computed(spec: Spec, folder: Path, python: str | None) -> dict[str, Array]:
    """The motion of the markers by the independent code, see `felupe_world`."""
    if python is None:
        raise MachineError("the independent code is not installed; it is needed to make a measurement")
    world = {**spec, **spec.get("other", {})}
    file, output = folder / "world.json", folder / "world.npz"
    file.write_text(json.dumps(world), encoding="utf-8")
    done = subprocess.run(
        [python, str(WORLD), str(file), str(output)], capture_output=True, text=True, timeout=_LIMIT, check=False
    )
    if done.returncode != 0:
        said = done.stderr.strip().splitlines()
        raise SolveError(f"{WORLD.name} failed: {said[-1] if said else f'code {done.returncode}'}")
    with np.load(output) as arrays:
        return dict(arrays)


def noise_of(spec: Spec, arrays: Mapping[str, Array]) -> float:
    """Standard deviation of the noise, mm: it makes what is wrong as large as is wanted, where it can."""
    least, most = NOISES
    if not spec["world"]:
        share = np.log(spec["wanted"] / SIZES[0]) / np.log(SIZES[1] / SIZES[0])
        return float(round(most * (least / most) ** share, 3))
    return float(round(np.clip(_difference(arrays) / spec["wanted"], least, most), 3))


def truth_of(spec: Spec, arrays: Mapping[str, Array], noise: float) -> Truth:
    """What is true, as `validation.golden.score` reads it."""
    kind = KINDS[spec["kind"]]
    hidden = [name for name, change in zip(PATCHES, arrays["toggled"], strict=True) if np.abs(change).max() <= noise]
    size = _difference(arrays) / noise if spec["world"] else SIZES[1]
    effects = [] if spec["kind"] == "control" else [{"effect": spec["kind"], "size": round(size, 2)}]
    return {
        "kind": "outside" if effects else "none",
        "anchored": spec["anchored"] if kind.anchors_right else None,
        "not_asked": sorted({*hidden, *kind.open_patches(spec)}),
        "effects": effects,
        "noise": noise,
        "spec": spec,
    }


def _difference(arrays: Mapping[str, Array]) -> float:
    """RMS of what is wrong over pulls, steps, markers and coordinates, mm, as in the blinded study."""
    return rms((arrays["motion"] - arrays["plain"])[:, 1:])


def write(spec: Spec, arrays: Mapping[str, Array], folder: Path) -> None:
    """Scene, geometry, measurement and truth; the truth last, for what has one is whole."""
    noise, size = noise_of(spec, arrays), np.array(spec["size"])
    (folder / SCENE).write_text(_scene(spec, noise), encoding="utf-8")
    (folder / "box.geo").write_text(_geometry(size), encoding="utf-8")
    rng = np.random.default_rng([SEED, list(KINDS).index(spec["kind"]), spec["index"], 1])
    seen = np.array(MARKERS) * size + arrays["motion"]
    _measurement(folder / MEASUREMENT, spec, seen + rng.normal(0, noise, seen.shape), noise)
    truth = truth_of(spec, arrays, noise)
    (folder / TRUTH).write_text(json.dumps(truth, indent=1) + "\n", encoding="utf-8")


def _scene(spec: Spec, noise: float) -> str:
    size = np.array(spec["size"])

    def place(share: Any) -> str:
        return " ".join(f"{x:.6g}" for x in np.array(share) * size) + " mm"

    grasps = (
        f'{name} = {{ on = "grasp_{name}", centre = "{place(np.mean(box, axis=0))}" }}' for name, box in GRASPS.items()
    )
    return _SCENE.format(
        noise=noise,
        young=spec["young"],
        poisson=spec["poisson"],
        patches="\n".join(f'"{name}" = "patch_{name}"' for name in PATCHES),
        grasps="\n".join(grasps),
        markers="\n".join(f'"{i}" = "{place(share)}"' for i, share in enumerate(MARKERS, start=1)),
    )


def _geometry(size: Array) -> str:
    surfaces = {f"patch_{name}": box for name, box in PATCHES.items()}
    surfaces |= {f"grasp_{name}": box for name, box in GRASPS.items()}
    pieces = [_rectangle(101 + i, box, size) for i, box in enumerate(surfaces.values())]
    names = []
    for name, box in surfaces.items():
        low, high = ([f"{x:.9g}" for x in np.array(corner) * size] for corner in box)
        ends = [f"{x}-eps" for x in low] + [f"{x}+eps" for x in high]
        names.append(f'Physical Surface("{name}") = Surface In BoundingBox{{{", ".join(ends)}}};')
    return _GEOMETRY.format(*size, pieces="\n".join(pieces), last=100 + len(surfaces), names="\n".join(names))


def _rectangle(tag: int, box: Box, size: Array) -> str:
    """A rectangle across one axis; of its corners, in turn, lines and a loop are made."""
    low, high = np.array(box) * size
    axis = int(np.flatnonzero(high - low < 1e-9)[0])
    one, other = (a for a in range(3) if a != axis)
    corners = []
    for a, b in ((low, low), (high, low), (high, high), (low, high)):
        corner = low.copy()
        corner[one], corner[other] = a[one], b[other]
        corners.append(corner)
    first = 10 * tag
    lines = [f"Point({first + i}) = {{{', '.join(f'{x:.9g}' for x in c)}}};" for i, c in enumerate(corners)]
    lines += [f"Line({first + i}) = {{{first + i}, {first + (i + 1) % 4}}};" for i in range(4)]
    loop = ", ".join(str(first + i) for i in range(4))
    return " ".join([*lines, f"Curve Loop({tag}) = {{{loop}}}; Plane Surface({tag}) = {{{tag}}};"])


def _measurement(folder: Path, spec: Spec, seen: Array, noise: float) -> None:
    """As `tests/data/lab2`: one row for each marker and each grasp in each frame."""
    folder.mkdir(exist_ok=True)
    markers, grasps = ["action,step,time,fiducial,x,y,z"], ["action,step,time,grasp,x,y,z,qw,qx,qy,qz"]
    time = 0
    for action, (pull, frames) in enumerate(zip(spec["pulls"], seen, strict=True), start=1):
        for step, frame in enumerate(frames):
            to = np.array(pull["to"]) * step / spec["steps"]
            grasps.append(f"{action},{step},{time},{pull['grasp']}," + ",".join(f"{x:.6f}" for x in to) + ",1,0,0,0")
            markers += [
                f"{action},{step},{time},{i}," + ",".join(f"{x:.4f}" for x in place)
                for i, place in enumerate(frame, start=1)
            ]
            time += 1
    (folder / "fiducials.csv").write_text("\n".join(markers) + "\n", encoding="utf-8")
    (folder / "grasps.csv").write_text("\n".join(grasps) + "\n", encoding="utf-8")
    header = 'format = "bcid-measurement/1"\nlength_unit = "mm"\ntime_unit = "s"\nforce_unit = "N"\n'
    (folder / "measurement.toml").write_text(f"{header}noise_sigma = {noise:g}\n", encoding="utf-8")
