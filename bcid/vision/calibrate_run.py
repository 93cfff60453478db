"""`bcid calibrate` as a job: look for corners in the images, calibrate, and write the run folder."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from bcid.base.errors import InputError, Problems
from bcid.base.fingerprint import fingerprint
from bcid.base.progress import Progress, Silent
from bcid.base.run_folder import RunFolder, running
from bcid.vision.adjustment import COEFFICIENTS, LENSES, MATRIX, check_lens
from bcid.vision.board import CHESSBOARD, Board
from bcid.vision.calibrate import DISTORTION, FEWEST, calibrate
from bcid.vision.calibration import GRID, Calibration
from bcid.vision.camera import SIDES
from bcid.vision.corners import find_corners
from bcid.vision.images import Images

MAKES = ("calibration.json", "cameras.json", "summary.txt", "calibration.png")


def run_calibration(
    left: Path,
    right: Path,
    board: str,
    folder: Path,
    distortion: int = DISTORTION,
    progress: Progress | None = None,
    overwrite: bool = False,
) -> Path:
    """Calibrate two cameras from their images of a board and write the run folder. Returns the folder.

    Nothing is written before the calibration is there; a run that `overwrite` discards stays until then.

    Args:
        left, right: folders of images, or videos (see `Images.open`).
        board: see `Board.parse`.
        distortion: see `calibrate`.

    Raises:
        InputError: images, board or number of coefficients cannot be used, or too few pairs show the board.
        MachineError: the folder cannot be written.
    """
    progress = progress or Silent()
    pattern = Board.parse(board)
    problems = Problems("calibration")
    check_lens(distortion, problems)
    problems.raise_if_any()
    # Told before the work.
    if not overwrite and (folder / "run.json").is_file() and RunFolder.open(folder).record["state"] == "finished":
        raise InputError(f"{folder}: holds a finished run; choose another folder, or add --overwrite")
    images = _opened(left, right)
    try:
        corners, missing = find_corners(*images, pattern, progress)
    finally:
        for one in images:
            one.close()
    if len(corners) < FEWEST:
        raise InputError(_too_few(len(corners), pattern, missing))
    progress.say(f"{len(corners)} pairs show the board; calibrating")
    found = calibrate(corners, images[0].size, images[1].size, distortion)
    about = {"left": str(left), "right": str(right), "board": str(pattern)}
    content = [[c.number, c.board, c.left, c.right] for c in corners]
    sizes = [found.cameras.left.size, found.cameras.right.size]
    inputs = {"corners": fingerprint([content, sizes]), "distortion": distortion}
    with running(None, folder, "calibrate", inputs, MAKES, overwrite) as run:
        assert run is not None
        found.cameras.write(folder / "cameras.json")
        run.write_json("calibration.json", numbers(found, missing) | {"from": about})
        run.write_text("summary.txt", summary(found, missing, about))
        run.finish({"verdict": found.verdict, "usable": found.usable, "error": found.error})
    return folder


def _opened(left: Path, right: Path) -> tuple[Images, Images]:
    """Images of both cameras; all that is wrong is told at once."""
    problems = Problems("images of the two cameras")
    found = []
    for side, path in zip(SIDES, (left, right), strict=True):
        try:
            found.append(Images.open(path))
        except InputError as error:
            problems.add(side, str(error))
    problems.raise_if_any()
    if not set(found[0].numbers) & set(found[1].numbers):
        raise InputError(
            f"{left} and {right}: no image has the same number in both ({_some(found[0].numbers)} and "
            f"{_some(found[1].numbers)}); the two images of a pair need the same number"
        )
    return found[0], found[1]


def _some(numbers: Sequence[int]) -> str:
    return ", ".join(map(str, numbers[:6])) + (", ..." if len(numbers) > 6 else "")


def _too_few(count: int, board: Board, missing: dict[int, str]) -> str:
    """What to say when hardly any pair shows the board, with the reasons of the first twenty."""
    counted = "inner corners" if board.kind == CHESSBOARD else "squares"
    lines = [
        f"{count} pair(s) show the {board} in both images, at least {FEWEST} are needed; "
        f"does it have {board.columns} x {board.rows} {counted}?"
    ]
    lines += [f"  pair {number}: {reason}" for number, reason in list(missing.items())[:20]]
    if len(missing) > 20:
        lines.append(f"  ... and {len(missing) - 20} more")
    return "\n".join(lines)


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
        "tilts": list(found.tilts),
        "spread": found.spread,
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
        f"Boards are tilted by {found.tilts[0]:.0f} to {found.tilts[1]:.0f} deg, and by up to {found.spread:.0f} deg against "
        "each other.",
        f"Standard deviations (+-) are from the {found.deviations_from}.",
    ]
    lines += _about_pairs(found, missing)
    if found.findings:
        lines += ["", "To make it better:"]
        lines += [f"  {advice}" for advice in dict.fromkeys(f.advice for f in found.findings)]
    if about:
        lines += ["", "From " + ", ".join(f"{what} {text}" for what, text in about.items())]
    return "\n".join(lines) + "\n"


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
