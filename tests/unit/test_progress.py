"""What a command says while it works: a bar on a terminal, lines in a log, and how much time is left."""

import io

import pytest

from bcid.base import progress
from bcid.base.progress import Bar, Lines, Steps, how_far, progress_on, roughly


class Terminal(io.StringIO):
    """A stream that says that it is a terminal."""

    def isatty(self) -> bool:
        """It is one."""
        return True


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """Seconds, which a test moves."""
    now = [100.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    return now


def test_a_log_has_lines_and_the_time_left(clock: list[float]) -> None:
    out = io.StringIO()
    lines = progress_on(out)
    assert isinstance(lines, Lines)
    lines.say("begun")
    for done in range(1, 11):
        clock[0] += 1.0
        lines.step("trials", done, 100, "all well")
    written = out.getvalue().splitlines()
    assert written[0] == "[   0.0 s] begun"
    # One line in two seconds; what was done when the first step came took an unknown time.
    assert len(written) == 6
    assert written[-1] == "[  10.0 s] trials: 10 of 100, about 2 min left; all well"
    assert "\r" not in out.getvalue()


def test_another_piece_of_work_has_another_clock(clock: list[float]) -> None:
    out = io.StringIO()
    lines = Lines(out, every=0.0)
    lines.step("first", 0, 10)
    clock[0] += 20.0
    lines.step("first", 1, 10)
    lines.step("second", 0, 10)
    clock[0] += 1.0
    lines.step("second", 1, 10)
    assert out.getvalue().splitlines()[1].endswith("first: 1 of 10, about 3 min left")
    assert out.getvalue().splitlines()[3].endswith("second: 1 of 10, about 9 s left")


def test_a_terminal_has_one_bar_in_place() -> None:
    out = Terminal()
    bar = progress_on(out)
    assert isinstance(bar, Bar)
    bar.step("sets {3 4}", 1, 4, "best so far {1 2}")
    bar.step("sets {3 4}", 2, 4)
    shown = out.getvalue()
    assert "sets {3 4}: 1 of 4; best so far {1 2}" in shown
    assert "\n" not in shown
    bar.say("done")
    assert out.getvalue().rstrip().endswith("s] done")
    bar.step("something of unknown length")
    progress.clear()
    # What is printed next begins on an empty line.
    assert out.getvalue().endswith("\r")


def test_a_part_tells_how_far_it_is_and_nothing_else() -> None:
    out = io.StringIO()
    part = Steps(Lines(out, every=0.0))
    part.say("of no interest here")
    part.step("sets", 3)
    assert out.getvalue().splitlines() == [f"[   0.0 s] {how_far('sets', 3, 0, None)}"]


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(0.2, "1 s"), (5.4, "5 s"), (89, "89 s"), (200, "3 min"), (5300, "88 min"), (7800, "2 h 10 min")],
)
def test_time_as_a_person_says_it(seconds: float, text: str) -> None:
    assert roughly(seconds) == text
