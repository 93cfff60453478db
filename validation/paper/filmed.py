"""The replica of a laboratory: two cameras, calibrated by pictures of a board, film the body, and its markers are tracked."""

from __future__ import annotations

import tempfile
from pathlib import Path

from bcid.base.run_folder import write_whole
from bcid.measurement import Measurement
from bcid.measurement.folder_writer import grasp_lines
from bcid.scene import Scene
from bcid.vision.board import Board
from validation.paper.condition import Condition
from validation.paper.trial_errors import numbers, true_actions, true_scene

# Pairs of pictures of the board, and the board: about as large as the body.
_PAIRS, _BOARD = 14, "chessboard 9x6 10 mm"


def filmed(condition: Condition, scene: Scene, number: int, seed: int) -> Measurement:
    """What a trial's images tell: pictures of the board and of the body, `bcid calibrate`, `bcid track`.

    The recording states the motion that was commanded, the cameras as calibrated, and how well the markers are placed. Images are
    not kept.

    Raises:
        BcidError: the body cannot be followed, or the markers cannot be found.
    """
    from bcid.vision.calibrate_run import run_calibration
    from bcid.vision.track_run import run_tracking
    from validation.rendering.board_images import photograph_board
    from validation.rendering.rig import stereo_rig
    from validation.rendering.scene_images import moved, render_recording

    state = int(numbers("pictures", number, seed).integers(2**31))
    true, actions = true_scene(condition, scene, number, seed), true_actions(condition, number, seed)
    rig = stereo_rig()
    with tempfile.TemporaryDirectory(prefix="bcid-filmed-") as made:
        folder = Path(made)
        photograph_board(rig[0], Board.parse(_BOARD), folder / "board", _PAIRS, state)
        cameras = run_calibration(folder / "board/left", folder / "board/right", _BOARD, folder / "cameras")
        motion = moved(true, condition.held(number), actions)
        rendered = render_recording(true, motion, actions, folder / "filmed", rig=rig, random_state=state)
        recording = rendered.recording
        # What a laboratory knows.
        (recording.parent / "cameras.json").write_bytes((cameras / "cameras.json").read_bytes())
        lines = grasp_lines(condition.actions(), 1e-3, 1.0)
        write_whole(recording.parent / "grasps.csv", "\n".join(lines) + "\n")
        layout = f'\n[layout]\nsigma = "{condition.placement * 1e3:g} mm"\n'
        write_whole(recording, recording.read_text(encoding="utf-8") + layout)
        run = run_tracking(recording, scene.fiducials, folder / "tracked", film=False)
        return Measurement.read(run / "measurement")
