"""`bcid track` as a job: read, check, follow the beads, and write the measurement and what is needed to check it."""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Mapping
from pathlib import Path
from time import perf_counter

import numpy as np
import xarray as xr

from bcid.base.fingerprint import file_fingerprint, fingerprint
from bcid.base.progress import Progress, Silent
from bcid.base.run_folder import RunFolder, running
from bcid.measurement import AXES, Measurement
from bcid.vision.camera import SIDES
from bcid.vision.film import Film, legend
from bcid.vision.recording import Recording
from bcid.vision.track import StereoFrame
from bcid.vision.tracking import Pair, Tracking, track

MAKES = ("measurement/", "tracking.json", "tracking.nc", "film.mp4", "rest.png", "summary.txt", "tracking.png")


def run_tracking(
    recording_file: Path,
    layout: Mapping[str, tuple[float, float, float]],
    folder: Path,
    progress: Progress | None = None,
    overwrite: bool = False,
    expected: Measurement | None = None,
    film: bool = True,
) -> Path:
    """Follow the beads of a layout through a recording and write a run folder; returns it.

    The folder holds measurement/ (a measurement folder), tracking.json, tracking.nc, summary.txt, and film.mp4 with rest.png. It is
    not touched before the beads have been found in the first images.

    Args:
        recording_file: see `Recording`.
        layout: rest positions by name in the body's frame, m: the fiducials of a scene.
        expected: what a model has the beads do, frame by frame.
        film: whether to write the film.

    Raises:
        BcidError: see `Recording.read`, `track`, `RunFolder.start`.
    """
    progress = progress or Silent()
    recording = Recording.read(recording_file)
    inputs = {
        "recording": file_fingerprint(recording_file),
        "layout": fingerprint({name: np.array(place) for name, place in layout.items()}),
        "expected": None if expected is None else expected.fingerprint(),
    }
    runs: list[RunFolder] = []
    began, drawing = perf_counter(), 0.0
    with contextlib.ExitStack() as stack:
        made: list[Film] = []

        def started() -> None:
            progress.say(f"the layout of {len(layout)} beads was found in the first images")
            # What an earlier process left is computed again: it takes no longer than looking at it.
            run = stack.enter_context(running(None, folder, "track", inputs, MAKES, overwrite))
            assert run is not None
            runs.append(run)
            if film:
                made.append(stack.enter_context(Film(folder / "film.mp4", recording.cameras, list(layout))))

        def watch(place: int, pair: Pair, frame: StereoFrame) -> None:
            nonlocal drawing
            before = perf_counter()
            if made:
                drawn = made[0].add(
                    *pair, frame, f"pair {place}: {frame.seen.sum()} of {len(layout)} beads   ({legend()})"
                )
                if place == 0:
                    runs[0].write_bytes("rest.png", _png(drawn))
            if place % 20 == 0:
                progress.say(f"pair {place}: {frame.seen.sum()} of {len(layout)} beads")
            drawing += perf_counter() - before

        found = track(recording, layout, watch, started, expected)
        seconds = perf_counter() - began - drawing
        _write(runs[0], found, recording, seconds)
    return folder


def _png(drawn: np.ndarray) -> bytes:
    import cv2

    return bytes(cv2.imencode(".png", drawn)[1])


def _write(run: RunFolder, found: Tracking, recording: Recording, seconds: float) -> None:
    measurement = found.measurement(recording)
    # A run that was killed in the end may have left one.
    shutil.rmtree(run.path / "measurement", ignore_errors=True)
    measurement.write(run.path / "measurement")
    run.write_dataset("tracking.nc", _arrays(found))
    scale, error = found.registration.free_scale
    sigma = measurement.data["sigma"].values
    result = {
        "frames": len(found.frames),
        "beads": len(found.names),
        "seen": float(found.seen.mean()),
        "sigma": float(np.nanmedian(sigma)),
        "chi2_median": float(np.nanmedian(found.misfit)),
        "frames_per_second": len(found.frames) / seconds,
        "registration": {
            "rotation": found.registration.rotation.tolist(),
            "translation": found.registration.translation.tolist(),
            "scale": found.registration.scale,
            "rms": found.registration.rms,
            "free_scale": scale,
            "free_scale_sigma": error,
            "error_rms": found.registration.error.rms(found.positions),
        },
        "warnings": found.warnings,
        "troubles": found.troubles,
    }
    run.write_json("tracking.json", result)
    run.write_text("summary.txt", summary(found, measurement, len(found.frames) / seconds))
    run.finish({key: result[key] for key in ("frames", "beads", "seen", "sigma")})


def _arrays(found: Tracking) -> xr.Dataset:
    labels = [(action.name, int(step)) for action in found.actions for step in action.steps]
    pixels = np.array([frame.pixels for frame in found.frames])
    return xr.Dataset(
        {
            "position": (("frame", "fiducial", "axis"), found.positions),
            "covariance": (("frame", "fiducial", "axis", "axis2"), found.covariance),
            "pixel": (("frame", "side", "fiducial", "component"), pixels),
            "misfit": (("frame", "fiducial"), found.misfit),
            "layout_residual": (("fiducial", "axis"), found.registration.residuals),
        },
        coords={
            "action": ("frame", [name for name, _ in labels]),
            "step": ("frame", [step for _, step in labels]),
            "image": ("frame", found.numbers),
            "fiducial": found.names,
            "axis": AXES,
            "side": list(SIDES),
        },
        attrs={"length_unit": "m"},
    )


def summary(found: Tracking, measurement: Measurement, rate: float) -> str:
    """What was found, in plain sentences, the verdict first."""
    seen, registration = found.seen, found.registration
    sigma = measurement.data["sigma"].values * 1e3
    gaps = {name: int(count) for name, count in zip(found.names, (~seen).sum(axis=0), strict=True) if count}
    lines = [
        f"Tracked {len(found.names)} beads through {len(found.frames)} pairs of images: {seen.mean():.1%} of the positions "
        f"({seen.sum()} of {seen.size}), standard deviation {np.nanmedian(sigma):.3g} mm (median of a coordinate)."
        + ("" if found.warnings else " Nothing is suspicious."),
    ]
    if found.warnings:
        lines += ["", "Look at this first:"] + [f"  - {text}" for text in found.warnings]
    lines += [
        "",
        "Gaps (frames in which one of the cameras does not see a bead): " + (_gaps(gaps) if gaps else "none") + ".",
    ]
    scale, error = registration.free_scale
    lines += [
        f"Registration: the beads at rest are {registration.rms * 1e3:.3g} mm (RMS of a coordinate) from the scene's layout; "
        f"a scale would be {scale:.5f} ± {error:.1g}. What is not known of it displaces all positions together by "
        f"{registration.error.rms(found.positions) * 1e3:.2g} mm; it stands in measurement/frame.toml, not in the noise.",
        f"Agreement of the two cameras: median of chi-square {np.nanmedian(found.misfit):.2g} (0.45 is expected).",
        f"Speed: {rate:.1f} pairs per second, without the film.",
    ]
    if found.troubles:
        lines += ["", "Images:"] + [f"  - {text}" for text in found.troubles]
    return "\n".join(lines) + "\n"


def _gaps(gaps: dict[str, int]) -> str:
    return ", ".join(f"{name} ({count})" for name, count in gaps.items())
