"""
From images to anchors
======================

From the images of two cameras to the patches that hold a slab.

A slab that is held at {1 2} is pulled around three half circles, and filmed by two cameras of 1.3 megapixels at 30 cm, as in the
experiments of Boonvisut & Cavusoglu (IJRR 2014): sixteen beads of 1 mm, shaded tissue, noise, lens distortion, false beads,
and instruments that hide a tenth of the beads. From there on only the images, the calibration, the motion of the gripper and the
scene are used. In a checkout: its package `validation` renders the images.

::

    ./dev python examples/05_from_images.py FOLDER
"""

import sys
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bcid import IdentifyOptions, Measurement, Scene, identify
from bcid.api.results import IdentifyResult
from bcid.scene import Level
from bcid.scene.motions import motion
from bcid.vision.track_run import run_tracking
from validation.rendering.appearance import Appearance
from validation.rendering.scene_images import RenderedRecording, moved, render_recording

HERE = Path(__file__).resolve().parent
Array = NDArray[np.float64]
HELD = ("1", "2")


@dataclass(frozen=True)
class Found:
    """What comes out.

    Attributes:
        rendered: the recording and its truth.
        measurement: what was tracked.
        rms: error of the tracked positions, m.
        honesty: mean of their normalised squared error, one if the covariances are right.
        identification: the anchors.
    """

    rendered: RenderedRecording
    measurement: Measurement
    rms: float
    honesty: float
    identification: IdentifyResult


def main(folder: Path) -> Found:
    """The whole job; `folder` gets the images, the tracking with its film, and the measurement."""
    scene = Scene.read(HERE / "scenes/slab.toml")
    actions = motion("semicircle", "II")
    # On another mesh than those that the anchors are looked for on.
    body = replace(scene, levels=(Level(2, 9e-3),))
    rendered = render_recording(
        scene, moved(body, HELD, actions), actions, folder / "filmed", Appearance(decoys=4), hidden=0.1
    )
    print(
        f"{len(rendered.beads)} pairs of images; "
        f"{1 - rendered.visible.all(axis=1).mean():.0%} of the beads are hidden from a camera"
    )

    run = run_tracking(rendered.recording, scene.fiducials, folder / "tracked")
    print((run / "summary.txt").read_text(encoding="utf-8"))
    measurement = Measurement.read(run / "measurement")
    error = measurement.positions - on_surface(rendered, scene)
    rms = float(np.sqrt(np.nanmean(error**2)))
    honesty = float(np.nanmean((error / measurement.data["sigma"].values) ** 2))
    print(f"error of the positions: {rms * 1e3:.4f} mm (RMS of a coordinate), {honesty:.2f} times the stated variance")

    # Finer meshes would not change the answer.
    found = identify(scene, measurement, options=IdentifyOptions(level=1))
    print(f"anchored: {' '.join(found.anchored)}, residual {found.rms * 1e3:.3f} mm")
    return Found(rendered, measurement, rms, honesty, found)


def on_surface(rendered: RenderedRecording, scene: Scene) -> Array:
    """Where the registration has the beads, which stand on the surface: at rest, on the scene's layout."""
    return np.asarray(rendered.beads - (rendered.beads[0] - scene.rest))


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(tempfile.mkdtemp(prefix="bcid-from-images-")))
