"""How good and how fast tracking is: rendered sequences with known truth.

./dev python -m validation.accuracy.vision [SEQUENCES [FIRST]]

Each sequence is the benchmark slab, held at {1 2} and pulled around three half circles, in 31 pairs of images of two cameras of
1.3 megapixels at 30 cm: 16 beads of 1 mm, six false ones, texture, noise of two grey levels, light from another side each time,
and instruments that hide a fifth of the beads. Printed are errors against the truth, positions given to the wrong bead, the ratio
of squared errors to the stated variances (one if these are honest), and pairs of images per second.
"""

from __future__ import annotations

import os
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
from numpy.typing import NDArray

from bcid import Scene
from bcid.scene.motions import motion
from bcid.vision.recording import Recording
from bcid.vision.tracking import Tracking, track
from validation.rendering.appearance import Appearance
from validation.rendering.scene_images import RenderedRecording, SurfaceMotion, moved, render_recording

SCENE = Path(__file__).resolve().parents[2] / "examples/scenes/slab.toml"
HIDDEN, DECOYS = 0.2, 6
# A position further from its bead than this, m, is another bead's; beads are 20 mm apart.
WRONG = 2e-3
Array = NDArray[np.float64]


@dataclass(frozen=True)
class Score:
    """Of one sequence.

    Attributes:
        visible, seen: positions that both cameras can see, and that were found.
        wrong: positions that are not those of their bead.
        errors: of the others in the body's frame, shape (n, 3), m; chi2 of each, shape (n,), with three degrees of freedom.
        rate: pairs of images per second.
    """

    visible: int
    seen: int
    wrong: int
    errors: Array
    chi2: Array
    rate: float


def look(number: int) -> Appearance:
    """Beads and light of a sequence."""
    rng = np.random.default_rng(number)
    side = rng.uniform(0, 2 * np.pi)
    lamp = (0.2 * np.cos(side), 0.2 * np.sin(side), 0.02)
    return Appearance(lamp=lamp, noise=2.0, blur=rng.uniform(0.5, 1.0), strength=rng.uniform(0.4, 0.7), decoys=DECOYS)


def sequence(scene: Scene, surface: SurfaceMotion, number: int, folder: Path) -> Score:
    """Film, track and score one sequence."""
    actions = motion("semicircle", "II")
    rendered = render_recording(scene, surface, actions, folder, look(number), random_state=number, hidden=HIDDEN)
    began = perf_counter()
    found = track(Recording.read(rendered.recording), scene.fiducials)
    return score(scene, rendered, found, len(rendered.beads) / (perf_counter() - began))


def score(scene: Scene, rendered: RenderedRecording, found: Tracking, rate: float) -> Score:
    """What was found against the truth: where the registration, which knows the layout at rest, has the beads."""
    error = found.positions - (rendered.beads - (rendered.beads[0] - scene.rest))
    right = found.seen & (np.linalg.norm(error, axis=2) < WRONG)
    chi2 = np.einsum("ni,nij,nj->n", error[right], np.linalg.inv(found.covariance[right]), error[right])
    visible = int(rendered.visible.all(axis=1).sum())
    return Score(visible, int(found.seen.sum()), int((found.seen & ~right).sum()), error[right], chi2, rate)


def main(count: int = 20, first: int = 0) -> list[Score]:
    """Run and print."""
    scene = Scene.read(SCENE)
    surface = moved(scene, ("1", "2"), motion("semicircle", "II"), 1)
    print("sequence  visible  seen  wrong  RMS mm  largest mm  chi2 / 3  pairs/s")
    scores = []
    for number in range(first, first + count):
        with tempfile.TemporaryDirectory() as folder:
            scores.append(sequence(scene, surface, number, Path(folder) / "filmed"))
        line(f"{number:8d}", scores[-1:])
    line("     all", scores)
    return scores


def line(name: str, scores: list[Score]) -> None:
    """A row of the table."""
    errors, chi2 = np.vstack([s.errors for s in scores]), np.concatenate([s.chi2 for s in scores])
    visible, seen, wrong = (sum(getattr(s, key) for s in scores) for key in ("visible", "seen", "wrong"))
    rms, largest = np.sqrt(np.mean(errors**2)) * 1e3, np.linalg.norm(errors, axis=1).max() * 1e3
    rate = np.median([s.rate for s in scores])
    counts = f"{visible:7d}  {seen:4d}  {wrong:5d}"
    print(f"{name}  {counts}  {rms:6.4f}  {largest:10.4f}  {chi2.mean() / 3:8.3f}  {rate:7.1f}", flush=True)


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
