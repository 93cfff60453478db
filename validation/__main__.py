"""Evidence about bcid, in a checkout: `bcid-validate`, or `python -m validation`. Studies also run under mpirun."""

from __future__ import annotations

import argparse
import sys

from bcid.app.process import alone, on_ranks, prepare
from bcid.base.collective import launched
from validation.experiment_commands import add_experiments
from validation.study_commands import STUDIES, add_studies


def main(words: list[str] | None = None) -> int:
    """The command line; returns the exit code."""
    prepare()
    parser = argparse.ArgumentParser("bcid-validate", description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    add_experiments(commands)
    add_studies(commands)
    chosen = parser.parse_args(words)
    if chosen.command in STUDIES and launched():
        return on_ranks(lambda comm: chosen.run(chosen, comm))
    kept = "what was measured before is in bench.json" if chosen.command == "bench" else "the same command goes on"
    return alone(lambda: chosen.run(chosen), kept, starts_jobs=True)


if __name__ == "__main__":
    sys.exit(main())
