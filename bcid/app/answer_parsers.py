"""Commands that answer from a measurement, as they are written."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from bcid.app.answer_commands import compare, demo, diagnose, explain, explore, fit, identify, propose
from bcid.app.options import (
    add_command,
    add_effect_files,
    add_inputs,
    add_level,
    add_only,
    add_output,
    add_run,
    add_source,
    add_store,
    seed,
)


def add_demo(commands: Any) -> None:
    """`bcid demo`."""
    parser = add_command(
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
    add_output(parser)


def add_identify(commands: Any) -> None:
    """`bcid identify`."""
    parser = add_command(
        commands,
        "identify",
        identify,
        "find the anchored patches from a measurement",
        "Writes a run folder: identification.json, summary.txt, picture.png, arrays (NetCDF) and ParaView files.\n"
        "A run that was killed goes on where it was when the same command is given again.",
    )
    add_inputs(parser)
    add_output(parser)
    search = parser.add_argument_group("search")
    search.add_argument(
        "--certify",
        default="auto",
        help="follow every set of patches until it has lost: yes, no, or auto (up to 10 patches; else those near the likely ones)",
    )
    add_level(search)
    search.add_argument(
        "--refine", type=int, default=0, metavar="ROUNDS", help="halve patches that leave a doubt, so many times (0)"
    )
    stages = parser.add_argument_group(
        "stages", "Climb to the sets to begin with in stages over the mesh ladder (Algorithms 1 and 2 of the paper)."
    )
    stages.add_argument("--stages", action="store_true", help="search in stages; the options below are of it")
    stages.add_argument("--seeds", type=int, metavar="N", help="random seeds of the first stage (24)")
    stages.add_argument("--random-state", type=seed, metavar="N", help="of the seeds (0)")
    stages.add_argument("--coarsest", type=int, metavar="LEVEL", help="first mesh level (0)")
    stages.add_argument("--finest", type=int, metavar="LEVEL", help="last mesh level (the scene's last)")
    stages.add_argument(
        "--stop",
        metavar="RULE",
        help='when no finer level is needed: same (default), "similarity 0.95", "refinement 0.5 mm", or last: all are used',
    )
    stages.add_argument("--start", help="seeds of later stages: maxima (default), or threshold")
    stages.add_argument(
        "--threshold", type=float, metavar="X", help="similarity for threshold, part of the best's (0.95)"
    )
    stages.add_argument("--toggles", type=int, metavar="N", help="random toggles of the seeds of later stages (0)")


def add_compare(commands: Any) -> None:
    """`bcid compare`."""
    parser = add_command(
        commands,
        "compare",
        compare,
        "adequate? where does the model of a run fail?",
        "Tests the residual against noise and the error of the mesh, and finds the force that would explain it.\n"
        "Writes diagnosis.json, where.json, summary.txt, residuals.nc and pictures.",
    )
    parser.add_argument("-o", "--output", type=Path, metavar="RUN2", help="run folder to write (RUN-compare)")
    add_source(parser)


def add_diagnose(commands: Any) -> None:
    """`bcid diagnose`."""
    parser = add_command(
        commands,
        "diagnose",
        diagnose,
        "which effect is missing in the model of a run?",
        "Ranks all effects of the catalogue by what they would explain, and refits the first of them.",
    )
    parser.add_argument("-o", "--output", type=Path, metavar="RUN2", help="run folder to write (RUN-diagnose)")
    add_only(parser)
    add_source(parser)


def add_fit(commands: Any) -> None:
    """`bcid fit`."""
    parser = add_command(
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
        help='effect, as "gravity", "soft_anchor:3" (a place) or "gravity: weight = 9.8 kN/m^3" (where to begin); '
        'with "gravity: course = 8" its amounts follow a course in time of 8 knots; repeatable',
    )
    parser.add_argument("--free", action="append", default=[], metavar="a,b", help='fit these too, as "poisson"')
    parser.add_argument("--fixed", action="append", default=[], metavar="a,b", help='keep these, as "gravity.weight"')
    add_source(parser)


def add_explain(commands: Any) -> None:
    """`bcid explain`."""
    parser = add_command(
        commands,
        "explain",
        explain,
        "anchors and missing effects from a measurement, until the model is adequate or unknown",
        "Identifies the anchors, compares, ranks what is missing, adds the best, searches the anchors again, and so on. Where no\n"
        "known effect explains it, a term that does is looked for, as by bcid propose, in RUN/propose.\n"
        "A run that was killed goes on where it was when the same command is given again.",
    )
    add_inputs(parser)
    add_only(parser)
    parser.add_argument("--most", type=int, default=2, metavar="N", help="effects that may be adopted together (2)")
    parser.add_argument(
        "--no-propose", action="store_true", help="where no known effect explains it, do not look beyond the catalogue"
    )
    add_store(parser)
    add_level(parser)
    add_effect_files(parser)
    add_output(parser)


def add_propose(commands: Any) -> None:
    """`bcid propose`."""
    parser = add_command(
        commands,
        "propose",
        propose,
        "a term beyond the catalogue, for what no known effect explains",
        "Scores hundreds of energies, boundary terms and forces from one converged run, fits the most promising, and writes the\n"
        "one that explains what is missing as the file of an effect, which --effects takes. See docs/propose.md.",
    )
    parser.add_argument("run_folder", type=Path, metavar="RUN", help="run folder of explain, identify, diagnose or fit")
    parser.add_argument(
        "-o", "--output", type=Path, metavar="EFFECT.py", help="file to write (proposed_term.py in the run folder)"
    )
    parser.add_argument("--folder", type=Path, metavar="RUN2", help="run folder to write (RUN-propose)")
    parser.add_argument("--most", type=int, default=2, metavar="N", help="terms that may be proposed together (2)")
    parser.add_argument(
        "--kinds",
        metavar="a,b",
        help="of terms that are tried, as energy for the law alone where it has no direction: energy, fibres, boundary, "
        "body force, grip, observation (all)",
    )
    add_level(parser)
    add_effect_files(parser)
    add_output(parser)


def add_explore(commands: Any) -> None:
    """`bcid explore`."""
    parser = add_command(
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
    add_run(parser)
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
    parser.add_argument(
        "--wrench-noise", metavar='"0.02 N"', help="of the gripper's force, which then counts (it does not)"
    )
    parser.add_argument("--samples", type=int, default=1000, metavar="N", help="of the estimate of information (1000)")
    parser.add_argument("--random-state", type=seed, default=0, metavar="N", help="of all that is drawn (0)")
    parser.add_argument("--wait", type=float, default=3600.0, metavar="SECONDS", help="for a measurement (3600)")
    add_store(parser)
    add_level(parser)
    add_output(parser)
