"""Slips of writing, units and frames; docs/reliability.md has the full size."""

from __future__ import annotations

from validation.reliability import slips


def test_slips_are_seen_before_anything_is_computed() -> None:
    found = slips.seen_first(most=14)
    assert found.met, "\n".join([found.reached, *found.misses[:10]])
