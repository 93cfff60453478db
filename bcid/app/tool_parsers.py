"""Commands that make, show and test things, as they are written."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from bcid.app.flags import seed
from bcid.app.shared_flags import add_command, add_output, add_quiet, add_run
from bcid.app.tool_commands import (
    calibrate,
    check_effect,
    examples,
    figure,
    import_recording,
    report,
    simulate,
    track,
)


def add_import(commands: Any) -> None:
    """`bcid import`."""
    parser = add_command(
        commands,
        "import",
        import_recording,
        "tell what is in a recording, and write a mapping that reads it as a measurement",
        "Motion capture (C3D, TRC, Motive, Nexus, Qualisys), DeepLabCut, Anipose, image and volume correlation, MAT, HDF5, NPZ,\n"
        "ROS bags, tables. Writes the mapping (TOML), with what is left to fill in as comments, and a picture of the paths; for\n"
        "points without names also a table of fiducials to paste into a scene. See docs/formats.md.",
    )
    parser.add_argument(
        "file", type=Path, metavar="FILE", help='recording; a quoted pattern for a file a frame, as "f_*.csv"'
    )
    parser.add_argument(
        "-o", "--output", type=Path, metavar="MAPPING", help="mapping to write (FILE with the suffix .toml)"
    )
    parser.add_argument(
        "--scene", type=Path, help="scene file (TOML): its fiducials and grasps are looked for in the recording"
    )
    parser.add_argument("--no-picture", action="store_true", help="do not draw the paths")


def add_report(commands: Any) -> None:
    """`bcid report`."""
    parser = add_command(
        commands,
        "report",
        report,
        "show runs on one page that opens from disk, without a network",
        "Verdict, the body in 3-D, residuals, missing effects, the ladder of models, belief, what was run. Several runs become\n"
        "sections. Made from the run folders alone. See docs/report.md.",
    )
    parser.add_argument("run_folders", type=Path, nargs="+", metavar="RUN", help="run folders of any command")
    parser.add_argument(
        "-o", "--output", type=Path, default=Path("report.html"), metavar="FILE", help="page to write (report.html)"
    )
    add_quiet(parser)


def add_figure(commands: Any) -> None:
    """`bcid figure`."""
    parser = add_command(
        commands,
        "figure",
        figure,
        "write the figures and tables of a run for a paper, and its fields for ParaView",
        "The figures of `bcid report` as files, its tables as CSV and LaTeX. See docs/report.md.",
    )
    parser.add_argument("run_folder", type=Path, metavar="RUN", help="run folder of any command")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="DIR", help="folder to write into")
    parser.add_argument("--format", default="png,svg,pdf", metavar="a,b", help="of the figures (png,svg,pdf)")
    parser.add_argument("--overwrite", action="store_true", help="replace files of the same names")
    add_quiet(parser)


def add_calibrate(commands: Any) -> None:
    """`bcid calibrate`."""
    parser = add_command(
        commands,
        "calibrate",
        calibrate,
        "calibrate two cameras from pairs of images of a board, or from known points picked in them",
        "Writes a run folder: cameras.json, calibration.json, summary.txt with a verdict, calibration.png. See docs/vision.md.",
    )
    parser.add_argument("left", type=Path, nargs="?", help="folder of images of the left camera, or a video")
    parser.add_argument("right", type=Path, nargs="?", help="the same of the right camera; pairs have equal numbers")
    parser.add_argument(
        "--board",
        required=True,
        metavar='"chessboard 10x7 10 mm"',
        help='inner corners and square; or "charuco 8x6 30 mm 22 mm DICT_5X5_100": squares, square, marker, dictionary; '
        "or a file with points that are known in space (name,x_mm,y_mm,z_mm)",
    )
    parser.add_argument(
        "--picked",
        type=Path,
        metavar="FILE",
        help="where these points are in the images (name,u_left,v_left,u_right,v_right, and pose)",
    )
    parser.add_argument("--image-size", metavar="1280x1024", help="of both images, where no images are given")
    parser.add_argument(
        "--first-pixel", type=int, choices=(0, 1), default=0, help="the middle of the first pixel in FILE (0)"
    )
    parser.add_argument(
        "--distortion", type=int, default=4, metavar="N", help="coefficients of the lenses: 0, 2, 4 (default), 5 or 8"
    )
    add_run(parser)
    add_output(parser)


def add_track(commands: Any) -> None:
    """`bcid track`."""
    parser = add_command(
        commands,
        "track",
        track,
        "follow the beads of a scene through images of two cameras, and write a measurement",
        "Writes a run folder: measurement/ for identify and explain, summary.txt, film.mp4 to check it, tracking.png,\n"
        "tracking.nc. See docs/vision.md for the recording file.",
    )
    parser.add_argument("scene", type=Path, help="scene file (TOML); its fiducials are the beads")
    parser.add_argument("recording", type=Path, help="recording file (TOML): cameras, images, gripper, beads")
    add_run(parser)
    parser.add_argument(
        "--expected", type=Path, metavar="MEASUREMENT", help="what a model has the beads do: they are looked for there"
    )
    parser.add_argument("--no-video", action="store_true", help="do not write film.mp4")
    add_output(parser)


def add_simulate(commands: Any) -> None:
    """`bcid simulate`."""
    from bcid.scene.motions import MOTIONS

    parser = add_command(
        commands,
        "simulate",
        simulate,
        "make a measurement with the forward model",
        "The motions are those of the benchmark slab, pulls along x for example; --like takes those of a measurement.",
    )
    parser.add_argument("scene", type=Path, help="scene file (TOML)")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="MEASUREMENT", help="folder to write")
    parser.add_argument("--anchors", default="", metavar="1,2", help="anchored patches, separated by commas (none)")
    motion = parser.add_mutually_exclusive_group(required=True)
    motion.add_argument("--motion", metavar="NAME", help=", ".join(MOTIONS))
    motion.add_argument("--like", type=Path, metavar="MEASUREMENT", help="repeat the motions of this measurement")
    parser.add_argument("--amplitude", metavar='"8 mm"', help="how far the gripper goes at most (the motion's)")
    parser.add_argument("--steps", type=int, metavar="N", help="of each action, besides rest (the motion's)")
    parser.add_argument("--direction", metavar="X,Y,Z", help="where the motion's x axis goes, as 0,0,1 (1,0,0)")
    parser.add_argument(
        "--true-effect",
        action="append",
        default=[],
        metavar='"gravity: weight = 9.8 kN/m^3"',
        help="an effect that the body has and the scene does not; may be repeated",
    )
    parser.add_argument("--grasp", metavar="NAME", help="grasp that moves (the scene's first, or its second of three)")
    parser.add_argument("--level", type=int, metavar="LEVEL", help="mesh level (the finest)")
    parser.add_argument(
        "--noise", metavar='"0.3 mm"', help='standard deviation of every coordinate (the scene\'s); "0 mm" for none'
    )
    parser.add_argument(
        "--surface", type=int, default=0, metavar="N", help="also points of the surface, so many in each step (none)"
    )
    parser.add_argument("--seed", type=seed, default=0, metavar="N", help="of the noise (0)")
    parser.add_argument("--wrench", action="store_true", help="also record force and torque of the gripper")
    parser.add_argument("--wrench-noise", metavar='"0.02 N"', help="the same with noise of this standard deviation")
    add_quiet(parser)


def add_examples(commands: Any) -> None:
    """`bcid examples`."""
    parser = add_command(
        commands,
        "examples",
        examples,
        "copy the scenes, measurements and scripts that come with bcid",
        "The commands of the documentation work in the folder that it makes.",
    )
    parser.add_argument("folder", type=Path, metavar="FOLDER", help="to make")


def add_check_effect(commands: Any) -> None:
    """`bcid check-effect`."""
    parser = add_command(
        commands,
        "check-effect",
        check_effect,
        "tell whether an effect keeps its contract",
        "It is tried on a small box: does it vanish at its neutral value, is it seen by the tangent, do differences agree,\n"
        "are its units consistent, is it the same on one and two ranks? Exit code 2 if something is wrong. See docs/effects.md.",
    )
    parser.add_argument(
        "effect", metavar="FILE", help="Python file that defines effect = BodyEffect(...), or a name of the catalogue"
    )
