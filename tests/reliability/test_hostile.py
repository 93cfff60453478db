"""Files that want to be run, and names that lead out of the run folder."""

from __future__ import annotations

from validation.reliability import hostile, names


def test_hostile_files() -> None:
    found = hostile.hostile(full=False)
    assert found.met, "\n".join([found.reached, *found.misses])


def test_names_and_links() -> None:
    found = names.names()
    assert found.met, "\n".join([found.reached, *found.misses])
