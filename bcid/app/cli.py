"""The command line: ``bcid demo``, ``identify``, ``compare``, ``diagnose``, ``fit``, ``explain``, ``explore``, ``scene``,
``simulate``, ``check-effect`` (also under ``mpirun -n N``), ``import``, ``report``, ``figure``, ``calibrate``, ``track``,
``doctor``, ``bench``, ``study``, ``examples``.
"""

from __future__ import annotations

import argparse
import os
import signal
import sys
import time
import traceback
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from bcid.app.commands import (
    bench,
    calibrate,
    check_effect,
    compare,
    complain,
    demo,
    diagnose,
    examples,
    explain,
    explore,
    figure,
    fit,
    identify,
    import_recording,
    report,
    simulate,
    study,
    track,
)
from bcid.app.scene_command import add_scene
from bcid.base.collective import Comm, first, launched
from bcid.base.errors import SHORT_OF_MEMORY, BcidError, MachineError, nearest, shortened
from bcid.base.scratch import require
from bcid.base.version import VERSION

# Commands without MPI in this process, for they start others that are jobs of their own; what becomes of an interrupted one.
_WITHOUT_MPI = {
    "bench": "what was measured before is in bench.json",
    "study": "the same command goes on where it was",
    "calibrate": "nothing is lost but the time",
    "track": "give the same command again",
    "import": "nothing was written",
    "report": "nothing was written",
    "figure": "nothing was written",
    "examples": "remove the folder",
}

# How long the ranks that are not the first wait for it to end the job, s.
_PATIENCE = 3.0
# Those of them that start jobs with MPI.
_STARTING = ("bench", "study")

_DESCRIPTION = """bcid finds out how a soft body is held, and what its model lacks, by watching it being pulled.

From the trajectories of a few markers on the body and the motion of the gripper it computes which
patches of the boundary are anchored, how sure that is, and which physical effect the model misses."""

_EXAMPLES = """examples:
  bcid demo                                                     the main job on a shipped measurement, in two minutes
  bcid identify scene.toml measurement -o run                   which patches are anchored?
  mpirun -n 2 bcid identify scene.toml measurement -o run       the same on two ranks, with the same answer
  bcid explain scene.toml measurement -o run                    ... and which physical effect does the model lack?
  bcid compare run                                              is the model of a run adequate, and where does it fail?
  bcid diagnose run                                             which effect is missing in it?
  bcid fit run --add gravity -o run2                            add the effect and watch the error fall
  bcid explore scene.toml --robot folder:lab -o run             which pull next? until the anchors are decided
  bcid report run -o report.html                                one page of it that opens from disk
  bcid figure run -o figures                                    its figures and tables for a paper, fields for ParaView
  bcid calibrate left right --board "chessboard 10x7 10 mm" -o cameras   two cameras, from images of a board
  bcid import take.csv --scene scene.toml                       what is in a recording, and a mapping that reads it
  bcid track scene.toml recording.toml -o tracked               from their images of beads to a measurement
  bcid scene check scene.toml -o scene.png                      is it right? areas, distances, and a picture
  bcid simulate scene.toml --anchors 1,2 --motion pull -o made  a measurement made by the model
  bcid check-effect my_effect.py                                does an effect of one's own keep the contract?
  bcid examples slabs                                           the scenes and measurements that come with bcid
  bcid doctor                                                   is everything installed that is needed?
  bcid bench                                                    how fast is it, against other codes? (half an hour)

exit codes: 0 done, 1 a fault of bcid, 2 bad input, 3 the machine (disk, memory, programs), 4 the model could not be solved"""


def main(argv: list[str] | None = None) -> int:
    """Run a command; returns its exit code."""
    # Nothing above has loaded numpy yet: ranks must not fight for cores.
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    parser = build_parser()
    given = sys.argv[1:] if argv is None else argv
    known = parser.get_default("known")
    if given and not given[0].startswith("-") and given[0] not in known:
        parser.error(f"'{shortened(given[0], 60)}' is no command; {nearest(given[0], known)}")
    arguments = parser.parse_args(given)
    if arguments.command == "doctor":
        from bcid.app import doctor

        return doctor.main()
    if arguments.command in _WITHOUT_MPI and not (arguments.command == "study" and launched()):
        return _run_without_mpi(arguments)
    trouble = _of_the_machine()
    if trouble:
        complain(trouble)
        return trouble.exit_code
    comm = _communicator()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, partial(_interrupted, comm))
    try:
        arguments.run(arguments, comm)
        return 0
    except BcidError as error:
        if comm.rank == 0:
            complain(error)
        return error.exit_code
    except MemoryError:
        complain(SHORT_OF_MEMORY)
        return _end_all(comm, MachineError.exit_code)
    except BaseException:
        traceback.print_exc()
        return _end_all(comm, 1)


def _run_without_mpi(arguments: argparse.Namespace) -> int:
    """Run one of `_WITHOUT_MPI`; returns its exit code."""
    try:
        if arguments.command in _STARTING:
            require()
        arguments.run(arguments)
        return 0
    except KeyboardInterrupt:
        complain(f"interrupted; {_WITHOUT_MPI[arguments.command]}")
        return 128 + signal.SIGINT
    except MemoryError:
        complain(SHORT_OF_MEMORY)
        return MachineError.exit_code
    except BcidError as error:
        complain(error)
        return error.exit_code


def _of_the_machine() -> MachineError | None:
    """What is missing before MPI can be begun: Open MPI dies of a temporary folder that is full or cannot be written."""
    try:
        require()
    except MachineError as error:
        if not first():
            # The first rank has the same to say, unless it is another machine, and ends all of them.
            time.sleep(_PATIENCE)
        return error
    return None


def _communicator() -> Any:
    try:
        from mpi4py import MPI
    except ImportError:
        complain("mpi4py and DOLFINx are not installed here; `bcid doctor` tells what is missing")
        raise SystemExit(3) from None
    return MPI.COMM_WORLD


def _interrupted(comm: Comm, number: int, _frame: object) -> None:
    """End at once: an exception inside a PETSc callback would be taken for a failed solve. Runs resume from what they kept."""
    if comm.rank == 0:
        complain("interrupted; the same command goes on where it was")
    if comm.size > 1:
        comm.Abort(128 + number)
    os._exit(128 + number)


def _end_all(comm: Comm, code: int) -> int:
    """An error on one rank must not leave the others waiting for it."""
    if comm.size > 1:
        sys.stderr.flush()
        comm.Abort(code)
    return code


def _seed(text: str) -> int:
    """A seed: a run keeps it as a number of 64 bits."""
    if text.isascii() and text.isdigit() and len(text) < 20 and int(text) < 2**63:
        return int(text)
    raise argparse.ArgumentTypeError(f"'{shortened(text, 60)}': expected a whole number from 0 to 2^63 - 1")


def build_parser() -> argparse.ArgumentParser:
    """The parser of all commands."""
    raw = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser("bcid", description=_DESCRIPTION, epilog=_EXAMPLES, formatter_class=raw)
    parser.add_argument("--version", action="version", version=f"bcid {VERSION}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    _add_demo(commands)
    _add_identify(commands)
    _add_compare(commands)
    _add_diagnose(commands)
    _add_fit(commands)
    _add_explain(commands)
    _add_explore(commands)
    _add_import(commands)
    _add_report(commands)
    _add_figure(commands)
    _add_calibrate(commands)
    _add_track(commands)
    add_scene(commands)
    _add_simulate(commands)
    _add_check_effect(commands)
    _add_examples(commands)
    commands.add_parser("doctor", help="tell what is installed and whether it works")
    _add_bench(commands)
    _add_study(commands)
    parser.set_defaults(known=tuple(commands.choices))
    return parser


def _add(commands: Any, name: str, run: Callable[..., Any], help_text: str, more: str = "") -> argparse.ArgumentParser:
    raw = argparse.RawDescriptionHelpFormatter
    text = help_text[0].upper() + help_text[1:] + ".\n\n" + more
    parser: argparse.ArgumentParser = commands.add_parser(name, help=help_text, description=text, formatter_class=raw)
    parser.set_defaults(run=run)
    return parser


def _add_run(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="RUN", help="run folder to write")


def _add_output(parser: argparse.ArgumentParser, picture: bool = True) -> None:
    parser.add_argument("--overwrite", action="store_true", help="discard a run that the folder already holds")
    if picture:
        parser.add_argument("--no-picture", action="store_true", help="do not draw pictures and write ParaView files")
    _add_quiet(parser)


def _add_quiet(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--quiet", action="store_true", help="say only the result")


def _add_inputs(parser: argparse.ArgumentParser) -> None:
    """What a run without an earlier one starts from, and where it goes."""
    parser.add_argument(
        "scene", type=Path, help="scene file (TOML): body, mesh ladder, candidate patches, grasps, fiducials"
    )
    parser.add_argument(
        "measurement", type=Path, help="measurement folder, NetCDF file, or mapping file of a recording (bcid import)"
    )
    _add_run(parser)


def _add_demo(commands: Any) -> None:
    parser = _add(
        commands,
        "demo",
        demo,
        "explain a shipped measurement: how the body is held, and what its model lacks",
        "The measurement hides an effect that its scene does not name, under noise of 0.2 mm. See examples/measurements.\n"
        "Writes what `bcid explain` does.",
    )
    parser.add_argument(
        "-o", "--output", type=Path, default=Path("bcid-demo"), metavar="RUN", help="run folder (bcid-demo)"
    )
    _add_output(parser)


def _add_identify(commands: Any) -> None:
    parser = _add(
        commands,
        "identify",
        identify,
        "find the anchored patches from a measurement",
        "Writes a run folder: identification.json, summary.txt, picture.png, arrays (NetCDF) and ParaView files.\n"
        "A run that was killed goes on where it was when the same command is given again.",
    )
    _add_inputs(parser)
    _add_output(parser)
    search = parser.add_argument_group("search")
    search.add_argument(
        "--certify", default="auto", help="look at every set of patches in the end: yes, no, or auto (up to 10 patches)"
    )
    search.add_argument("--seeds", type=int, metavar="N", help="random seeds of the first stage (24; 4 if certified)")
    search.add_argument("--random-state", type=_seed, default=0, metavar="N", help="of the seeds (0)")
    search.add_argument("--coarsest", type=int, default=0, metavar="LEVEL", help="first mesh level (0)")
    search.add_argument(
        "--finest", type=int, metavar="LEVEL", help="last mesh level (default: when the residual has settled)"
    )
    search.add_argument(
        "--stop",
        default="settled",
        metavar="RULE",
        help='when no finer level is needed: settled (default), same, "similarity 0.95", "refinement 0.5 mm"',
    )
    search.add_argument(
        "--refine", type=int, default=0, metavar="ROUNDS", help="halve patches that leave a doubt, so many times (0)"
    )
    search.add_argument("--climbed", type=int, default=2, metavar="N", help="levels that are climbed on (2)")
    search.add_argument("--start", default="maxima", help="seeds of later stages: maxima (default), or threshold")
    search.add_argument(
        "--threshold", type=float, default=0.95, metavar="X", help="similarity for threshold, part of the best's"
    )
    search.add_argument(
        "--toggles", type=int, default=0, metavar="N", help="random toggles of the seeds of later stages (0)"
    )
    search.add_argument(
        "--fit", type=float, default=1.05, help="end a stage when the residual is this many times the noise"
    )
    search.add_argument("--patience", type=int, default=12, help="... or when so many seeds led to nothing better (12)")
    search.add_argument(
        "--budget", type=float, default=10_000, help="... or when so many trajectories were computed on a level"
    )


def _add_source(parser: argparse.ArgumentParser) -> None:
    """A run to start from, and what all jobs on one have in common."""
    parser.add_argument("run_folder", type=Path, metavar="RUN", help="run folder of identify, diagnose, fit or explain")
    _add_level(parser)
    _add_effect_files(parser)
    _add_output(parser)


def _add_level(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--level", type=int, metavar="LEVEL", help="fine mesh level (the last with at most 40,000 unknowns)"
    )


def _add_only(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--only", metavar="a,b", help="look at these effects only")


def _add_effect_files(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--effects",
        type=Path,
        action="append",
        default=[],
        metavar="FILE",
        help="Python file with an effect of your own (docs/effects.md); it is run. May be given several times",
    )


def _add_compare(commands: Any) -> None:
    parser = _add(
        commands,
        "compare",
        compare,
        "adequate? where does the model of a run fail?",
        "Tests the residual against noise and the error of the mesh, and finds the force that would explain it.\n"
        "Writes diagnosis.json, where.json, summary.txt, residuals.nc and pictures.",
    )
    parser.add_argument("-o", "--output", type=Path, metavar="RUN2", help="run folder to write (RUN-compare)")
    _add_source(parser)


def _add_diagnose(commands: Any) -> None:
    parser = _add(
        commands,
        "diagnose",
        diagnose,
        "which effect is missing in the model of a run?",
        "Ranks all effects of the catalogue by what they would explain, and refits the first of them.",
    )
    parser.add_argument("-o", "--output", type=Path, metavar="RUN2", help="run folder to write (RUN-diagnose)")
    _add_only(parser)
    _add_source(parser)


def _add_fit(commands: Any) -> None:
    parser = _add(
        commands,
        "fit",
        fit,
        "add effects to the model of a run and watch the error fall",
        "Values without a unit are in SI units, angles in degrees. The numbers of added effects are fitted, as are those that\n"
        "were fitted before.",
    )
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="RUN2", help="run folder to write")
    parser.add_argument(
        "--add",
        action="append",
        default=[],
        metavar="EFFECT",
        help='effect, as "gravity", "soft_anchor:3" (a place) or "gravity: weight = 9.8 kN/m^3" (where to begin); repeatable',
    )
    parser.add_argument("--free", action="append", default=[], metavar="NUMBER", help='fit this too, as "poisson"')
    parser.add_argument("--fixed", action="append", default=[], metavar="NUMBER", help='keep this, as "gravity.weight"')
    _add_source(parser)


def _add_explain(commands: Any) -> None:
    parser = _add(
        commands,
        "explain",
        explain,
        "anchors and missing effects from a measurement, until the model is adequate or unknown",
        "Identifies the anchors, compares, ranks what is missing, adds the best, searches the anchors again, and so on.",
    )
    _add_inputs(parser)
    _add_only(parser)
    parser.add_argument("--most", type=int, default=2, metavar="N", help="effects that may be adopted together (2)")
    _add_level(parser)
    _add_effect_files(parser)
    _add_output(parser)


def _add_explore(commands: Any) -> None:
    parser = _add(
        commands,
        "explore",
        explore,
        "choose and make pulls until the anchors are decided",
        "The scene's [explore] table says what a robot may do. A robot is a folder, through which any set-up can be driven,\n"
        "or simulated. Writes a run folder: exploration.json, summary.txt, belief.png, and every pull with what was seen.\n"
        "An exploration that was stopped goes on when the same command is given again. See docs/explore.md.",
    )
    parser.add_argument("scene", type=Path, help="scene file (TOML) with an [explore] table")
    parser.add_argument(
        "--robot", required=True, metavar="ROBOT", help="folder:DIR, or simulated:1,2 with the anchored patches"
    )
    _add_run(parser)
    parser.add_argument("--grasps", metavar="I,II", help="grasps to use (all)")
    parser.add_argument("--effects", metavar="NAME,NAME", help="that may act besides, as gravity,fibres (none)")
    parser.add_argument(
        "--hide",
        action="append",
        default=[],
        metavar='"fibres: k1 = 5 kPa, angle = 30 deg"',
        help="an effect that the simulated body has and the scene does not; may be repeated",
    )
    parser.add_argument("--confidence", type=float, default=0.95, metavar="P", help="when a set is decided (0.95)")
    parser.add_argument("--budget", type=float, default=12.0, metavar="COST", help="of all pulls together (12)")
    parser.add_argument(
        "--criterion", default="information", metavar="NAME", help="information, entropy (as in the paper) or random"
    )
    parser.add_argument("--no-look-ahead", action="store_true", help="do not look at pairs of pulls")
    parser.add_argument("--noise", metavar='"0.3 mm"', help="of pulls to come (the scene's)")
    parser.add_argument("--samples", type=int, default=1000, metavar="N", help="of the estimate of information (1000)")
    parser.add_argument("--random-state", type=_seed, default=0, metavar="N", help="of all that is drawn (0)")
    parser.add_argument("--wait", type=float, default=3600.0, metavar="SECONDS", help="for a measurement (3600)")
    parser.add_argument(
        "--store", type=Path, metavar="FOLDER", help="for predictions, shared by runs (in the run folder)"
    )
    _add_level(parser)
    _add_output(parser)


def _add_import(commands: Any) -> None:
    parser = _add(
        commands,
        "import",
        import_recording,
        "tell what is in a recording, and write a mapping that reads it as a measurement",
        "Motion capture (C3D, TRC, Motive, Nexus, Qualisys), DeepLabCut, Anipose, image correlation, MAT, HDF5, ROS bags, tables.\n"
        "Writes the mapping (TOML), with what is left to fill in as comments, and a picture of the paths beside it; for points\n"
        "without names also a table of fiducials to paste into a scene. See docs/formats.md.",
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


def _add_report(commands: Any) -> None:
    parser = _add(
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
    _add_quiet(parser)


def _add_figure(commands: Any) -> None:
    parser = _add(
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
    _add_quiet(parser)


def _add_calibrate(commands: Any) -> None:
    parser = _add(
        commands,
        "calibrate",
        calibrate,
        "calibrate two cameras from pairs of images of a board",
        "Writes a run folder: cameras.json, calibration.json, summary.txt with a verdict, calibration.png. See docs/vision.md.",
    )
    parser.add_argument("left", type=Path, help="folder of images of the left camera, or a video")
    parser.add_argument("right", type=Path, help="the same of the right camera; pairs have equal numbers")
    parser.add_argument(
        "--board",
        required=True,
        metavar='"chessboard 10x7 10 mm"',
        help='inner corners and square; or "charuco 8x6 30 mm 22 mm DICT_5X5_100": squares, square, marker, dictionary',
    )
    parser.add_argument(
        "--distortion", type=int, default=4, metavar="N", help="coefficients of the lenses: 0, 2, 4 (default), 5 or 8"
    )
    _add_run(parser)
    _add_output(parser)


def _add_track(commands: Any) -> None:
    parser = _add(
        commands,
        "track",
        track,
        "follow the beads of a scene through images of two cameras, and write a measurement",
        "Writes a run folder: measurement/ for identify and explain, summary.txt, film.mp4 to check it, tracking.png,\n"
        "tracking.nc. See docs/vision.md for the recording file.",
    )
    parser.add_argument("scene", type=Path, help="scene file (TOML); its fiducials are the beads")
    parser.add_argument("recording", type=Path, help="recording file (TOML): cameras, images, gripper, beads")
    _add_run(parser)
    parser.add_argument(
        "--expected", type=Path, metavar="MEASUREMENT", help="what a model has the beads do: they are looked for there"
    )
    parser.add_argument("--no-film", action="store_true", help="do not write film.mp4")
    _add_output(parser)


def _add_simulate(commands: Any) -> None:
    from bcid.scene.motions import MOTIONS

    parser = _add(
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
        "--hide",
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
    parser.add_argument("--random-state", type=_seed, default=0, metavar="N", help="of the noise (0)")
    parser.add_argument("--wrench", action="store_true", help="also record force and torque of the gripper")
    parser.add_argument("--wrench-noise", metavar='"0.02 N"', help="the same with noise of this standard deviation")
    _add_quiet(parser)


def _add_examples(commands: Any) -> None:
    parser = _add(
        commands,
        "examples",
        examples,
        "copy the scenes, measurements, studies and scripts that come with bcid",
        "The commands of the documentation work in the folder that it makes.",
    )
    parser.add_argument("folder", type=Path, metavar="FOLDER", help="to make")


def _add_check_effect(commands: Any) -> None:
    parser = _add(
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


def _add_bench(commands: Any) -> None:
    help_text = "measure speed against other codes, goals and limits"
    parser = _add(
        commands, "bench", bench, help_text, "Prints a table per part; writes bench.json and plots. See docs/bench.md."
    )
    parser.add_argument("parts", nargs="*", metavar="PART", help="trajectory, toggles, identification, growth (all)")
    parser.add_argument(
        "-o", "--output", type=Path, default=Path("bcid-bench"), metavar="FOLDER", help="folder to write (bcid-bench)"
    )
    parser.add_argument("--quick", action="store_true", help="a reduced form of each part, without a network")


def _add_study(commands: Any) -> None:
    parser = _add(
        commands,
        "study",
        study,
        "find out with many made-up bodies what an answer is worth",
        "paper        the tables and figures of the paper; FILE.toml one of them, or one of your own (see studies/)\n"
        "hidden       measurements with effects hidden in them are made and diagnosed blindly, and the answers scored\n"
        "exploration  how many pulls does it take to know the anchors?\n\n"
        "Under mpirun the ranks make the trials, rank 0 hands them out; else child processes do. A study that was stopped,\n"
        "in whatever way, goes on where it was when the same command is given again. See docs/study.md.",
    )
    parser.add_argument("study", metavar="STUDY", help="paper, hidden, exploration, or a study file (TOML)")
    _add_run(parser)
    parser.add_argument("--quick", action="store_true", help="paper and files: the reduced study")
    parser.add_argument("--jobs", type=int, default=2, metavar="N", help="processes at a time without mpirun (2)")
    parser.add_argument(
        "--part",
        metavar="I/N",
        help="files: every N-th trial from the I-th, as one of N jobs that share the run folder",
    )
    parser.add_argument("--predict-only", action="store_true", help="files: only what all trials share")
    parser.add_argument("--cases", type=int, default=400, metavar="N", help="number of cases of hidden (400)")
    parser.add_argument("--seed", type=_seed, default=0, metavar="N", help="of what is random (0)")
    parser.add_argument("--trials", type=int, default=30, metavar="N", help="of each setting of exploration (30)")
    parser.add_argument(
        "--limit",
        type=float,
        default=900.0,
        metavar="SECONDS",
        help="CPU seconds that a trial may take (900)",
    )
    parser.add_argument(
        "--least", type=float, default=0.5, metavar="SIZE", help="of an effect of hidden, in units of noise (0.5)"
    )
    parser.add_argument(
        "--bodies", metavar="NAMES", help="of hidden, as slab,finger (those and gallbladder take turns)"
    )
    parser.add_argument(
        "--conditions",
        choices=("all", "exact", "inexact"),
        default="all",
        help="hidden: everything as the scene states it, everything but the noise slightly wrong, or all conditions in turns (all)",
    )
    _add_output(parser, picture=False)


if __name__ == "__main__":
    sys.exit(main())
