"""Commands that answer from a measurement, as they are written."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from bcid.app.answer_commands import compare, demo, diagnose, explain, explore, fit, identify, propose
from bcid.app.flags import add_flags
from bcid.app.shared_flags import add_command, add_effect_files, add_inputs, add_output, add_run, add_source, add_store
from bcid.base.options import ExplainOptions, ExploreOptions, IdentifyOptions, ProposeOptions, StageOptions


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
    add_flags(search, IdentifyOptions)
    search.add_argument(
        "--refine", type=int, default=0, metavar="ROUNDS", help="halve patches that leave a doubt, so many times (0)"
    )
    stages = parser.add_argument_group(
        "stages", "Climb to the sets to begin with in stages over the mesh hierarchy (Algorithms 1 and 2 of the paper)."
    )
    stages.add_argument("--stages", action="store_true", help="search in stages; the options below are of it")
    add_flags(stages, StageOptions)


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
    add_flags(parser, ExplainOptions, ("only",))
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
    add_flags(parser, ExplainOptions)
    parser.add_argument(
        "--no-propose", action="store_true", help="where no known effect explains it, do not look beyond the catalogue"
    )
    add_store(parser)
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
    add_flags(parser, ProposeOptions)
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
        "or simulated. Writes a run folder: exploration.json, summary.txt, posterior.png, and every pull with what was seen.\n"
        "An exploration that was stopped goes on when the same command is given again. See docs/explore.md.",
    )
    parser.add_argument("scene", type=Path, help="scene file (TOML) with an [explore] table")
    parser.add_argument(
        "--robot", required=True, metavar="ROBOT", help="folder:DIR, or simulated:1,2 with the anchored patches"
    )
    add_run(parser)
    add_flags(parser, ExploreOptions)
    parser.add_argument(
        "--true-effect",
        action="append",
        default=[],
        metavar='"fibres: k1 = 5 kPa, angle = 30 deg"',
        help="an effect that the simulated body has and the scene does not; may be repeated",
    )
    parser.add_argument("--wait", type=float, default=3600.0, metavar="SECONDS", help="for a measurement (3600)")
    add_store(parser)
    add_output(parser)
