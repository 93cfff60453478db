"""`bcid calibrate` as a job: look for corners in the images or read points, calibrate, and write the run folder."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from bcid.base.errors import InputError, Problems
from bcid.base.fingerprint import fingerprint
from bcid.base.progress import Progress, Silent
from bcid.base.run_folder import RunFolder, running
from bcid.vision.adjustment import COEFFICIENTS, LENSES, MATRIX, check_lens
from bcid.vision.board_views import board_in_images, is_file_of_points, picked_points
from bcid.vision.calibrate import DISTORTION, calibrate
from bcid.vision.calibration import GRID, Calibration
from bcid.vision.camera import SIDES

MAKES = ("calibration.json", "cameras.json", "summary.txt", "calibration.png")


def run_calibration(
    left: Path | None,
    right: Path | None,
    board: str,
    folder: Path,
    distortion: int = DISTORTION,
    progress: Progress | None = None,
    overwrite: bool = False,
    *,
    picked: Path | None = None,
    image_size: str | None = None,
    first_pixel: float = 0.0,
) -> Path:
    """Calibrate two cameras from what they saw of a board and write the run folder. Returns the folder.

    Nothing is written before the calibration is there; a run that `overwrite` discards stays until then.

    Args:
        left, right: folders of images, or videos (see `Images.open`); not needed with `picked` and `image_size`.
        board: a pattern (see `Board.parse`), or a file of points that are known in space (see `KnownPoints.read`).
        distortion: see `calibrate`.
        picked: where the known points were picked in the images (see `KnownPoints.picked`).
        image_size: width and height, as "1280x1024", px.
        first_pixel: coordinate of the middle of the first pixel in `picked`.

    Raises:
        InputError: images, board, picked points or number of coefficients cannot be used, or too few pairs show the board.
        MachineError: the folder cannot be written.
    """
    progress = progress or Silent()
    problems = Problems("calibration")
    check_lens(distortion, problems)
    problems.raise_if_any()
    # Told before the work.
    if not overwrite and (folder / "run.json").is_file() and RunFolder.open(folder).record["state"] == "finished":
        raise InputError(f"{folder}: holds a finished run; choose another folder, or add --overwrite")
    if is_file_of_points(board) != (picked is not None):
        raise InputError(
            "a file of known points (--board POINTS.csv) and one of where they were picked in the images (--picked PICKED.csv) "
            "go together; corners of a chessboard or charuco board are found without"
        )
    if picked is not None:
        shown = picked_points(board, picked, left, right, image_size, first_pixel)
    elif left is None or right is None:
        raise InputError("the images are missing: give the folders of the left and of the right camera")
    else:
        shown = board_in_images(left, right, board, progress)
    progress.say(f"{len(shown.corners)} pairs show the board; calibrating")
    found = calibrate(shown.corners, *shown.sizes, distortion)
    content = [[c.number, c.board, c.left, c.right] for c in shown.corners]
    sizes = [found.cameras.left.size, found.cameras.right.size]
    inputs = {"corners": fingerprint([content, sizes]), "distortion": distortion}
    with running(None, folder, "calibrate", inputs, MAKES, overwrite) as run:
        assert run is not None
        found.cameras.write(folder / "cameras.json")
        run.write_json("calibration.json", numbers(found, shown.missing) | {"from": shown.about})
        run.write_text("summary.txt", summary(found, shown.missing, shown.about))
        run.finish({"verdict": found.verdict, "usable": found.usable, "error": found.error})
    return folder


def numbers(found: Calibration, missing: dict[int, str] | None = None) -> dict[str, Any]:
    """What `calibration.json` holds: lengths in m, angles in deg, pixels; null where a number is not determined."""
    cameras = found.cameras
    sides: dict[str, Any] = {}
    for k, (side, camera) in enumerate(zip(SIDES, (cameras.left, cameras.right), strict=True)):
        own = {n.removeprefix(f"{side}."): _finite(v) for n, v in found.deviations.items() if n.startswith(f"{side}.")}
        sides[side] = {
            "size": list(camera.size),
            "matrix": camera.matrix.tolist(),
            "distortion": camera.distortion.tolist(),
            "deviations": own,
            "error": found.errors[k],
            "coverage": found.coverage[k],
        }
    pairs = []
    for c in found.used:
        left, right = found.residuals[c.number]
        pairs.append(
            {
                "number": c.number,
                "error": found.pair_errors[c.number],
                "board": c.board.tolist(),
                "left": c.left.tolist(),
                "right": c.right.tolist(),
                "left_residuals": left.tolist(),
                "right_residuals": right.tolist(),
            }
        )
    return {
        "verdict": found.verdict,
        "usable": found.usable,
        "findings": [{"text": f.text, "advice": f.advice, "fatal": f.fatal} for f in found.findings],
        "error": found.error,
        **sides,
        "rotation": cameras.rotation.tolist(),
        "translation": cameras.translation.tolist(),
        "baseline": {"value": cameras.baseline, "deviation": _finite(found.deviations["baseline"])},
        "angle": {"value": cameras.angle, "deviation": _finite(found.deviations["angle"])},
        "deviations_from": found.deviations_from,
        "distortion_coefficients": found.distortion,
        "sight_angle": found.sight,
        "tilts": list(found.tilts) if found.flat else None,
        "spread": found.spread if found.flat else None,
        "grid": list(GRID),
        "pairs": pairs,
        "left_out": [{"number": n, "error": found.pair_errors[n]} for n in found.left_out],
        "not_found": [{"number": n, "reason": reason} for n, reason in (missing or {}).items()],
        "turned": list(found.turned),
    }


def summary(found: Calibration, missing: dict[int, str] | None = None, about: dict[str, str] | None = None) -> str:
    """The result in plain sentences."""
    cameras, missing = found.cameras, missing or {}
    lines = [f"Calibration of two cameras: {found.verdict}", ""]
    for k, (side, camera) in enumerate(zip(SIDES, (cameras.left, cameras.right), strict=True)):
        (fx, fy), (cx, cy) = np.diag(camera.matrix)[:2], camera.matrix[:2, 2]
        doubt = {n: _plus_minus(found.deviations[f"{side}.{n}"]) for n in MATRIX}
        lines += [
            f"The {side} camera ({camera.size[0]} x {camera.size[1]} px, corners in {found.coverage[k]:.0%} of the image):",
            f"  focal lengths    {fx:.2f} {doubt['fx']} and {fy:.2f} {doubt['fy']} px",
            f"  principal point  {cx:.2f} {doubt['cx']} and {cy:.2f} {doubt['cy']} px",
        ]
        lens = [
            f"{name} = {camera.distortion[i]:.4g} {_plus_minus(found.deviations[f'{side}.{name}'])}"
            for i, name in enumerate(COEFFICIENTS)
            if i in LENSES[found.distortion]
        ]
        lines += [
            f"  lens             {', '.join(lens) or 'no distortion'}",
            f"  error            {found.errors[k]:.3f} px RMS",
        ]
    lines += [
        "",
        f"Baseline {cameras.baseline * 1e3:.3f} {_plus_minus(found.deviations['baseline'] * 1e3)} mm, angle between the axes "
        f"{cameras.angle:.3f} {_plus_minus(found.deviations['angle'])} deg; the board is seen under {found.sight:.1f} deg.",
        f"Error {found.error:.3f} px RMS over {sum(map(len, found.used))} corners of {len(found.used)} pairs.",
        *_about_boards(found),
        f"Standard deviations (+-) are from the {found.deviations_from}.",
    ]
    lines += _about_pairs(found, missing)
    if found.findings:
        lines += ["", "To make it better:"]
        lines += [f"  {advice}" for advice in dict.fromkeys(f.advice for f in found.findings)]
    if about:
        lines += ["", "From " + ", ".join(f"{what} {text}" for what, text in about.items())]
    return "\n".join(lines) + "\n"


def _about_boards(found: Calibration) -> list[str]:
    """How flat boards were tilted; of points with names, which fits worst."""
    lines = []
    if found.flat:
        lines += [
            f"Boards are tilted by {found.tilts[0]:.0f} to {found.tilts[1]:.0f} deg, and by up to {found.spread:.0f} deg "
            "against each other."
        ]
    worst = found.worst_point
    return lines + ([] if worst is None else [f"The largest residual is {worst}."])


def _about_pairs(found: Calibration, missing: dict[int, str]) -> list[str]:
    lines: list[str] = []
    if found.left_out:
        lines += ["", "Left out, for their errors are far above the others':"]
        lines += [f"  pair {number}: {found.pair_errors[number]:.2f} px" for number in found.left_out]
    if found.turned:
        lines += [
            "",
            "Counted from the other end of the board in the right image: pair " + ", ".join(map(str, found.turned)),
        ]
    if missing:
        lines += ["", "Pairs that could not be used:"]
        lines += [f"  pair {number}: {reason}" for number, reason in missing.items()]
    return lines


def _plus_minus(value: float) -> str:
    if not math.isfinite(value):
        return "(not determined)"
    return f"+- {value:.0f}" if value >= 100 else f"+- {value:.2g}"


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
