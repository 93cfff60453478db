"""Random pulls and memory, reduced; docs/reliability.md has the full sizes."""

from __future__ import annotations

import re

from benchmarks.reliability import solving


def test_most_random_pulls_converge_and_the_rest_has_a_name() -> None:
    found = solving.convergence(60)
    match = re.search(r"with room .*: (\d+) of (\d+) ", found.reached)
    assert match
    good, roomy = map(int, match.groups())
    assert roomy >= 30
    assert good >= 0.96 * roomy, found.reached


def test_memory_does_not_grow() -> None:
    found = solving.memory(600, settled=100, far=2)
    assert found.met, found.reached
