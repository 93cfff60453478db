"""
A strip of rubber before two cameras
====================================

From two real cameras to what a model of rubber gets wrong: a strip that is narrower in the model than in the images.

The measurement was published with DuoDIC (Solav et al., JOSS 2022, 10.21105/joss.04279; github.com/SolavLab/DuoDIC, Apache-2.0):
two cameras, calibrated with 37 pairs of images of a chessboard, watch 435 speckles on a strip of rubber whose left end is fixed
and whose right end is moved by 1 mm in each of 19 steps. Here the speckles are triangulated, some of them become the
fiducials of a measurement folder, and the model is driven by what the ends of the strip do.

::

    ./dev python examples/07_strip.py FOLDER -o strip
    ./dev python examples/07_strip.py FOLDER --explain run
    ./dev python examples/07_strip.py FOLDER --propose run

With ``--explain`` all speckles in all states are explained as they are, a dense field: is rubber that keeps its volume enough,
and if not, where does it fail? With ``--propose`` an energy is looked for that explains the fiducials in every third state.

FOLDER holds stereo_calibration.json and uniaxial_points.csv.gz: calibration and tracked pixels, which are counted from 1.
"""

import argparse
import json
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from bcid import ExplainOptions, Measurement, ProposeOptions, Scene, explain, propose
from bcid.api.results import DiagnosisResult, ProposeResult
from bcid.forms.model import Model
from bcid.forms.simulate import recorded
from bcid.measurement import Action, Units
from bcid.predict.predictor import Predictor
from bcid.scene import Material
from bcid.search.fitting.fit import Fit, fit
from bcid.search.fitting.state import State
from bcid.vision.camera import Camera, Cameras
from bcid.vision.triangulate import triangulate

HERE = Path(__file__).resolve().parent
Array = NDArray[np.float64]
# Of the model: where its ends are, m; the ends of the gauge are so long.
START, END, EDGE = -0.010, 0.060, 0.004
# Fiducials: so many along the gauge and across it.
ALONG, ACROSS = 9, 5
# The thickness is not known, and so is not how far the surface sinks: by less than this, m.
THICKNESS = 1e-4
FIXED = frozenset({"fixed"})


@dataclass(frozen=True)
class Found:
    """What comes out.

    Attributes:
        positions: of all points in all states in the left camera's frame, shape (states, points, 3), m.
        measurement: of the fiducials.
        rubber: the incompressible model.
        fitted: the model with Poisson's ratio fitted.
        width: width stretch in the last state: measured, incompressible, fitted.
        stretch: along the strip in the last state.
    """

    positions: Array
    measurement: Measurement
    rubber: State
    fitted: Fit
    width: tuple[float, float, float]
    stretch: float


def main(folder: Path, output: Path | None = None) -> Found:
    """The whole job; `output` is a folder for the measurement."""
    positions = triangulated(folder)
    placed, moved = in_body(positions)
    plain = Scene.read(HERE / "scenes/strip.toml")
    chosen = speckles(placed)
    scene = replace(plain, fiducials={f"p{i}": triple(placed[0, i]) for i in chosen})
    measurement = replace(pulled(scene, placed[:, chosen], moved), units=Units())
    if output is not None:
        measurement.write(output)

    predictor = Predictor(scene, measurement, MPI.COMM_SELF)
    rubber = State.of(predictor, Model.of(scene), FIXED)
    # Fitted as a law that can be compressed.
    soft = Material("neo_hooke", {"young": "1 MPa", "poisson": 0.45})
    other = Predictor(replace(scene, material=soft), measurement, MPI.COMM_SELF)
    fitted = fit(State.of(other, Model.of(other.scene), FIXED), ("poisson",))
    rest = placed[0, chosen]
    measured = width_stretch(rest, measurement.positions[-1])
    predicted = [width_stretch(rest, state.predicted[-1]) for state in (rubber, fitted.state)]
    stretch = 1 + float(moved[-1, 0])
    print(f"stretch along the strip in the last state: {stretch:.4f}")
    print(f"width: measured {measured:.4f}, incompressible {predicted[0]:.4f}, fitted {predicted[1]:.4f}")
    print(f"Poisson's ratio: {fitted.values['poisson']:.3f} ± {fitted.stderr['poisson']:.3f}")
    for name, state in (("incompressible", rubber), ("fitted", fitted.state)):
        left = 1e3 * np.sqrt(np.nanmean((measurement.positions - state.predicted) ** 2, axis=(0, 1)))
        print(f"{name}: error {left[0]:.3f} mm along, {left[1]:.3f} mm across, {left[2]:.3f} mm normal to the strip")
    return Found(positions, measurement, rubber, fitted, (measured, predicted[0], predicted[1]), stretch)


def explained(folder: Path, every: int = 1, options: ExplainOptions | None = None) -> DiagnosisResult:
    """What explains the whole field, or every so many of its states: all points that were seen at rest are fiducials."""
    placed, moved = in_body(triangulated(folder))
    plain = Scene.read(HERE / "scenes/strip.toml")
    seen = np.flatnonzero(np.isfinite(placed[0]).all(axis=1))
    scene = replace(plain, fiducials={f"p{i}": triple(placed[0, i]) for i in seen})
    return explain(scene, pulled(scene, placed[::every, seen], moved[::every]), options=options)


def proposed(folder: Path, every: int = 3) -> ProposeResult:
    """The energy that explains the fiducials, in every so many of the states."""
    placed, moved = in_body(triangulated(folder))
    chosen = speckles(placed)
    plain = Scene.read(HERE / "scenes/strip.toml")
    scene = replace(plain, fiducials={f"p{i}": triple(placed[0, i]) for i in chosen})
    seen = pulled(scene, placed[::every, chosen], moved[::every])
    return propose(scene, seen, options=ProposeOptions(kinds=("energy", "fibres")), name="rubber")


def triangulated(folder: Path) -> Array:
    """Positions of all points in all states, shape (states, points, 3), m."""
    table = np.genfromtxt(folder / "uniaxial_points.csv.gz", delimiter=",", names=True)
    left, right = (np.column_stack([table[f"{axis}{n}_px"] for axis in "uv"]) - 1 for n in (1, 2))
    states = int(table["state"].max()) + 1
    return triangulate(calibration(folder), left, right).positions.reshape(states, -1, 3)


def calibration(folder: Path) -> Cameras:
    """The published calibration."""
    values = json.loads((folder / "stereo_calibration.json").read_text(encoding="utf-8"))
    sides = []
    for name in ("cam1", "cam2"):
        matrix = np.array(values[name]["K"])
        matrix[:2, 2] -= 1
        rows, columns = values[name]["image_size_rows_cols"]
        sides.append(Camera(matrix, np.array([*values[name]["radial"], 0.0, 0.0]), (int(columns), int(rows))))
    shift = np.array(values["t_cam1_to_cam2_mm"]) * 1e-3
    return Cameras(sides[0], sides[1], np.array(values["R_cam1_to_cam2"]), shift)


def in_body(positions: Array) -> tuple[Array, Array]:
    """Positions in the model's frame, and how far the right end of the gauge moves from the left one, in parts of it (states, 3).

    The frame is that of the strip at rest: x along it, y across, z towards the cameras. It moves with the left end of the gauge,
    and further by what the longer model adds between its own end and that one.
    """
    rest = positions[0] - positions[0].mean(axis=0)
    along, across, _ = np.linalg.svd(rest, full_matrices=False)[2]
    along, across = along * np.sign(along[0]), across * np.sign(-across[1])
    turned = positions @ np.column_stack([along, across, np.cross(along, across)])
    x = turned[0, :, 0]
    first, last = x < x.min() + EDGE, x > x.max() - EDGE
    ends = [np.nanmean(turned[:, which], axis=1) for which in (first, last)]
    apart = ends[1] - ends[0]
    moved = (apart - apart[0]) / apart[0, 0]
    # The left end of the gauge comes to rest where the model has it.
    place = np.array([EDGE / 2, 0.0, 0.5e-3])
    turned = turned - ends[0][:, None] + place
    turned += (moved * (place[0] - START))[:, None]
    turned[..., 1] -= np.mean([turned[0, :, 1].min(), turned[0, :, 1].max()])
    return turned, moved


def triple(values: Array) -> tuple[float, float, float]:
    """Three numbers."""
    x, y, z = map(float, values)
    return x, y, z


def speckles(placed: Array) -> list[int]:
    """The points nearest to the knots of a grid, of those that were tracked in all states."""
    rest, whole = placed[0], np.isfinite(placed).all(axis=(0, 2))
    x, y = (
        np.linspace(np.quantile(rest[:, axis], 0.04), np.quantile(rest[:, axis], 0.96), n)
        for axis, n in ((0, ALONG), (1, ACROSS))
    )
    knots = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    away = np.linalg.norm(rest[None, :, :2] - knots[:, None], axis=2)
    away[:, ~whole] = np.inf
    return sorted({int(i) for i in away.argmin(axis=1)})


def pulled(scene: Scene, positions: Array, moved: Array) -> Measurement:
    """The measurement: the model's right end moves as the gauge's does, in proportion to its length."""
    steps = np.arange(len(positions))
    action = Action("1", steps, steps, "moved", moved * (END - START), np.tile([1.0, 0.0, 0.0, 0.0], (len(steps), 1)))
    made = recorded(
        scene, [action], positions, 0.0, np.random.default_rng(0), description="strip of rubber, two cameras"
    )
    sigma = np.broadcast_to([scene.noise_sigma, scene.noise_sigma, THICKNESS], positions.shape)
    return replace(made, data=made.data.assign(sigma=(("frame", "fiducial", "axis"), sigma)))


def width_stretch(rest: Array, now: Array) -> float:
    """Stretch across the strip, from the best affine motion in its plane."""
    flat = np.column_stack([rest[:, :2], np.ones(len(rest))])
    return float(np.linalg.lstsq(flat, now[:, :2], rcond=None)[0][1, 1])


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, metavar="FOLDER")
    parser.add_argument("-o", "--output", type=Path, metavar="MEASUREMENT")
    parser.add_argument("--explain", type=Path, metavar="RUN", help="explain all speckles, into this run folder")
    parser.add_argument("--propose", type=Path, metavar="RUN", help="look for an energy, into this run folder")
    chosen = parser.parse_args()
    if chosen.explain or chosen.propose:
        found = explained(chosen.folder) if chosen.explain else proposed(chosen.folder)
        print(found.summary)
        found.write(chosen.explain or chosen.propose)
    else:
        main(chosen.folder, chosen.output)
