"""The command line: ``bcid demo``, ``identify``, ``compare``, ``diagnose``, ``fit``, ``explain``, ``propose``, ``explore``,
``scene``, ``simulate``, ``check-effect`` (also under ``mpirun -n N``), ``import``, ``report``, ``figure``, ``calibrate``,
``track``, ``doctor``, ``examples``.
"""

from __future__ import annotations

import argparse
import re
import sys
from typing import NoReturn

from bcid.app.answer_parsers import (
    add_compare,
    add_demo,
    add_diagnose,
    add_explain,
    add_explore,
    add_fit,
    add_identify,
    add_propose,
)
from bcid.app.process import alone, on_ranks, prepare
from bcid.app.scene_command import add_scene
from bcid.app.tool_parsers import (
    add_calibrate,
    add_check_effect,
    add_examples,
    add_figure,
    add_import,
    add_report,
    add_simulate,
    add_track,
)
from bcid.base.errors import nearest, shortened
from bcid.base.version import VERSION
from bcid.base.visible import visible

# Commands without MPI; what becomes of an interrupted one.
_WITHOUT_MPI = {
    "calibrate": "nothing is lost but the time",
    "track": "give the same command again",
    "import": "nothing was written",
    "report": "nothing was written",
    "figure": "nothing was written",
    "examples": "remove the folder",
}

# Flags that were called otherwise.
_RENAMED = {
    "--certify": "--exhaustive",
    "--toggles": "--perturb",
    "--random-state": "--seed",
    "--most": "--max-effects",
    "--hide": "--true-effect",
    "--no-film": "--no-video",
}

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
  bcid propose run -o effect.py                                 a term beyond the catalogue, as the file of an effect
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

exit codes: 0 done, 1 a fault of bcid, 2 bad input, 3 the machine (disk, memory, programs), 4 the model could not be solved"""


def main(argv: list[str] | None = None) -> int:
    """Run a command; returns its exit code."""
    prepare()
    parser = build_parser()
    given = sys.argv[1:] if argv is None else argv
    known = parser.get_default("known")
    if given and not given[0].startswith("-") and given[0] not in known:
        moved = given[0] in ("study", "bench")
        why = "it is one of a checkout: ./dev bcid-validate" if moved else nearest(given[0], known)
        parser.error(f"'{shortened(given[0], 60)}' is no command; {why}")
    arguments = parser.parse_args(given)
    if arguments.command == "doctor":
        from bcid.app import doctor

        return doctor.main()
    if arguments.command in _WITHOUT_MPI:
        return alone(lambda: arguments.run(arguments), _WITHOUT_MPI[arguments.command])
    return on_ranks(lambda comm: arguments.run(arguments, comm))


class _Parser(argparse.ArgumentParser):
    """Complains of arguments without the control characters in them, and of flags that have another name."""

    def error(self, message: str) -> NoReturn:
        renamed = [f"{old} is {now} now" for old, now in _RENAMED.items() if re.search(rf"{old}\b", message)]
        super().error(visible("; ".join([message, *renamed])))


def build_parser() -> argparse.ArgumentParser:
    """The parser of all commands."""
    raw = argparse.RawDescriptionHelpFormatter
    parser = _Parser("bcid", description=_DESCRIPTION, epilog=_EXAMPLES, formatter_class=raw)
    parser.add_argument("--version", action="version", version=f"bcid {VERSION}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    add_demo(commands)
    add_identify(commands)
    add_compare(commands)
    add_diagnose(commands)
    add_fit(commands)
    add_explain(commands)
    add_propose(commands)
    add_explore(commands)
    add_import(commands)
    add_report(commands)
    add_figure(commands)
    add_calibrate(commands)
    add_track(commands)
    add_scene(commands)
    add_simulate(commands)
    add_check_effect(commands)
    add_examples(commands)
    commands.add_parser("doctor", help="tell what is installed and whether it works")
    parser.set_defaults(known=tuple(commands.choices))
    return parser


if __name__ == "__main__":
    sys.exit(main())
