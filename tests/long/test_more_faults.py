"""Faults of disk and processes that take long; the fast ones are in reliability/test_faults."""

from __future__ import annotations

import errno

from reliability.test_faults import met

from validation.reliability import disk, signals


def test_a_disk_that_fails_at_any_write() -> None:
    met(disk.failures(3, only=(errno.ENOSPC,)))


def test_an_interrupted_job_goes_on_two_ranks() -> None:
    met(signals.signals(1, seed=2, ranks=(2,)))
