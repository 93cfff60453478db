"""Dealing out tasks: every worker takes the next when it is free."""

import numpy as np
import pytest

from bcid.base.scheduler import Alone, replay, share
from validation.bench.growth_bench import most_efficient


def test_a_single_worker_takes_everything_in_order() -> None:
    assert list(share("abc", Alone())) == ["a", "b", "c"]
    assert list(share([], Alone())) == []


def test_workers_that_ask_in_turn_take_each_task_once() -> None:
    tickets = Alone()
    workers = [share(range(7), tickets) for _ in range(3)]
    taken = [next(worker, None) for _ in range(3) for worker in workers]
    assert taken == [0, 1, 2, 3, 4, 5, 6, None, None]


@pytest.mark.parametrize(
    ("durations", "workers", "seconds"),
    [
        ([1.0] * 8, 4, 2.0),
        ([4.0, 1.0, 1.0, 1.0, 1.0], 2, 4.0),
        # Longest last: all but one wait for it.
        ([1.0, 1.0, 1.0, 1.0, 4.0], 2, 6.0),
        ([2.0], 1000, 2.0),
        ([], 3, 0.0),
    ],
)
def test_a_replay_takes_as_long_as_its_busiest_worker(durations: list[float], workers: int, seconds: float) -> None:
    assert replay(durations, workers) == (seconds, sum(durations))


def test_a_replay_pays_for_every_number_that_is_taken() -> None:
    took, work = replay([1.0, 1.0], 1, latency=0.25)
    assert (took, work) == (2.75, 2.0), "two tasks, and the answer that there are no more"


def test_no_schedule_beats_its_bounds() -> None:
    durations = np.random.default_rng(0).exponential(size=300).tolist()
    for workers in (1, 2, 16, 299, 1024):
        took, work = replay(durations, workers)
        assert (1 - 1e-12) * max(work / workers, max(durations)) <= took <= work / workers + max(durations)


def test_no_schedule_of_batches_is_more_efficient_than_what_each_must_wait_for() -> None:
    batches = [[2.0], [1.0, 0.5, 0.5]]
    assert [most_efficient(batches, ranks) for ranks in (1, 2, 4)] == pytest.approx([1.0, 4 / 6, 4 / 12])
    for ranks in (1, 2, 4):
        took = sum(replay(batch, ranks)[0] for batch in batches)
        assert 4.0 / (ranks * took) <= most_efficient(batches, ranks)
