"""``./dev python -m validation.reliability [ROW ...] [--count N] [--seed N]``: the checks of docs/reliability.md, full size."""

from __future__ import annotations

import argparse
import inspect
import sys
import time
from collections.abc import Callable
from importlib import import_module

from validation.reliability import Reached

# The row of docs/reliability.md, and where its check is.
CHECKS = {
    "L1": ("solving", "convergence"),
    "L2": ("solving", "memory"),
    "F1": ("kills", "workers_die"),
    "F2": ("kills", "all_die"),
    "F3": ("disk", "failures"),
    "F7": ("temporary", "full"),
    "F4": ("signals", "signals"),
    "F4-memory": ("signals", "memory"),
    "F4-hanging": ("kills", "hanging"),
    "F5": ("solver", "faulty"),
    "F8": ("resumed", "resumed"),
    "B1": ("meshes", "damage"),
    "B2": ("configuration", "refusals"),
    "B5": ("absurd", "absurd"),
    "S1": ("hostile", "hostile"),
    "S2": ("names", "names"),
    "B4": ("slips", "seen_first"),
    "C3D": ("recordings", "damage"),
    "B3": ("folders", "damage"),
    "S7": ("readers", "damage"),
    "S8": ("foreign_runs", "foreign"),
}


def check(row: str) -> Callable[..., Reached]:
    """The function that makes a row's check."""
    module, name = CHECKS[row]
    found: Callable[..., Reached] = getattr(import_module(f"validation.reliability.{module}"), name)
    return found


def main() -> int:
    """Run the rows that are named, print what was reached; 1 when a goal is missed."""
    parser = argparse.ArgumentParser("reliability", description=__doc__)
    parser.add_argument("rows", nargs="*", metavar="ROW", help=f"one of {', '.join(CHECKS)} (all)")
    parser.add_argument("--count", type=int, help="how many cases (default: the goal's)")
    parser.add_argument("--seed", type=int, default=0, help="of the random cases (0)")
    arguments = parser.parse_args()
    unknown = [row for row in arguments.rows if row not in CHECKS]
    if unknown:
        parser.error(f"{', '.join(unknown)}: not a row; known: {', '.join(CHECKS)}")
    missed = 0
    for row in arguments.rows or CHECKS:
        function = check(row)
        given = {"count": arguments.count, "seed": arguments.seed}
        known = inspect.signature(function).parameters
        start = time.monotonic()
        found = function(**{name: value for name, value in given.items() if name in known and value is not None})
        missed += not found.met
        print(f"{row} {'met' if found.met else 'MISSED'} ({time.monotonic() - start:.0f} s)")
        print(f"   goal:    {found.goal}\n   reached: {found.reached}", flush=True)
        for miss in found.misses[:60]:
            print(f"   {miss}", flush=True)
    return int(missed > 0)


if __name__ == "__main__":
    sys.exit(main())
