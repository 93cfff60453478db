"""The command line: ``bcid demo``, ``identify``, ``compare``, ``diagnose``, ``fit``, ``explain``, ``propose``, ``explore``,
``scene``, ``simulate``, ``check-effect`` (also under ``mpirun -n N``), ``import``, ``report``, ``figure``, ``calibrate``,
``track``, ``doctor``, ``bench``, ``study``, ``examples``.
"""

from __future__ import annotations

import argparse
import os
import signal
import sys
import time
import traceback
from functools import partial
from typing import Any, NoReturn

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
from bcid.app.console import complain
from bcid.app.scene_command import add_scene
from bcid.app.tool_parsers import (
    add_bench,
    add_calibrate,
    add_check_effect,
    add_examples,
    add_figure,
    add_import,
    add_report,
    add_simulate,
    add_study,
    add_track,
)
from bcid.base.collective import Comm, first, launched
from bcid.base.errors import SHORT_OF_MEMORY, BcidError, MachineError, nearest, shortened
from bcid.base.scratch import require
from bcid.base.version import VERSION
from bcid.base.visible import visible

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
  bcid bench                                                    how fast is it, against other codes? (half an hour)

exit codes: 0 done, 1 a fault of bcid, 2 bad input, 3 the machine (disk, memory, programs), 4 the model could not be solved"""


def main(argv: list[str] | None = None) -> int:
    """Run a command; returns its exit code."""
    # Nothing above has loaded numpy yet: ranks must not fight for cores.
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    # Where nobody reads what is printed, as behind "| head", PETSc would end the process with a page of its own.
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGPIPE})
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
        sys.stdout.flush()
        return 0
    except BcidError as error:
        if comm.rank == 0:
            complain(error)
        return error.exit_code
    except MemoryError:
        complain(SHORT_OF_MEMORY)
        return _end_all(comm, MachineError.exit_code)
    except BrokenPipeError:
        return _end_all(comm, _unread())
    except BaseException:
        traceback.print_exc()
        return _end_all(comm, 1)


def _run_without_mpi(arguments: argparse.Namespace) -> int:
    """Run one of `_WITHOUT_MPI`; returns its exit code."""
    try:
        if arguments.command in _STARTING:
            require()
        arguments.run(arguments)
        sys.stdout.flush()
        return 0
    except KeyboardInterrupt:
        complain(f"interrupted; {_WITHOUT_MPI[arguments.command]}")
        return 128 + signal.SIGINT
    except MemoryError:
        complain(SHORT_OF_MEMORY)
        return MachineError.exit_code
    except BrokenPipeError:
        return _unread()
    except BcidError as error:
        complain(error)
        return error.exit_code


def _unread() -> int:
    """Stop printing where nobody reads it; returns the exit code."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return 128 + signal.SIGPIPE


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


class _Parser(argparse.ArgumentParser):
    """Complains of arguments without the control characters in them."""

    def error(self, message: str) -> NoReturn:
        super().error(visible(message))


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
    add_bench(commands)
    add_study(commands)
    parser.set_defaults(known=tuple(commands.choices))
    return parser


if __name__ == "__main__":
    sys.exit(main())
