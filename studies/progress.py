"""How far a long run is, and how long it still takes: a bar on a terminal, lines elsewhere.

Both go to standard error. Lines are plain, or JSON where the command prints JSON.
"""

import math
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial

import msgspec
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

_PLAIN_LINES = 5
# Longer work has more of them: somebody who reads along learns whether it goes on.
_LONGEST_SILENCE_S = 120.0
# The first estimate is due after this part of the work; less than so many seconds are not named.
_EARLY, _LEAST_S = 0.05, 10.0
# Programs that read events learn of progress so often.
_EVENT_PERIOD_S = 1.0


class ProgressEvent(msgspec.Struct, frozen=True, tag="progress", tag_field="event"):
    """A line of JSON: so many of `total` steps of a work are done; the time left may be unknown."""

    of: str
    done: int
    total: int
    seconds_left: float | None


@contextmanager
def progress(
    title: str, total: int, brief: bool = False, as_json: bool = False
) -> Iterator[Callable[[int], None]]:
    """Yield a function that is told how many of `total` steps are done.

    With `brief`, plain lines are written only where they name the time left. With `as_json`, a
    `ProgressEvent` stands in their place, one a second at most and one at the end. A terminal
    shows a bar.
    """
    if sys.stderr.isatty():
        columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn())
        with Progress(*columns, TimeRemainingColumn(), console=Console(stderr=True)) as bar:
            task = bar.add_task(title, total=total)
            yield lambda done: bar.update(task, completed=done)
        return
    yield (_events if as_json else partial(_plain_lines, brief=brief))(title, total)


def _events(title: str, total: int) -> Callable[[int], None]:
    left_s, told_s = _seconds_left(total, time.monotonic), -math.inf

    def say(done: int) -> None:
        nonlocal told_s
        seconds = left_s(done)
        if done < total and time.monotonic() - told_s < _EVENT_PERIOD_S:
            return
        told_s = time.monotonic()
        event = ProgressEvent(title, done, total, None if seconds is None else round(seconds, 1))
        sys.stderr.write(msgspec.json.encode(event).decode() + "\n")
        sys.stderr.flush()

    return say


def _plain_lines(title: str, total: int, brief: bool) -> Callable[[int], None]:
    left = time_left(total, time.monotonic)
    shown, estimated, told_s = 0, False, time.monotonic()

    def say(done: int) -> None:
        nonlocal shown, estimated, told_s
        part, words, now_s = done * _PLAIN_LINES // total, left(done), time.monotonic()
        is_late = now_s - told_s >= _LONGEST_SILENCE_S
        due = (part > shown or is_late) and (words or not brief)
        if due or (words and not estimated):
            shown, estimated, told_s = part, estimated or bool(words), now_s
            sys.stderr.write(f"{title}: {done} of {total}{words}\n")
            sys.stderr.flush()

    return say


def time_left(total: int, clock: Callable[[], float]) -> Callable[[int], str]:
    """Return a function from the steps done to the words for the time left, by a clock in seconds.

    The words are empty before the first part of the work, and where little time is left.
    """
    seconds_left = _seconds_left(total, clock)

    def words(done: int) -> str:
        left_s = seconds_left(done)
        if left_s is None or done < _EARLY * total or left_s < _LEAST_S:
            return ""
        return f", about {_in_words(left_s)} left"

    return words


def _seconds_left(total: int, clock: Callable[[], float]) -> Callable[[int], float | None]:
    """Return a function from the steps done to the seconds left, None before the first step.

    The rate counts from the first call: a sweep that goes on begins with the steps of its last
    start.
    """
    begun: list[tuple[int, float]] = []

    def seconds(done: int) -> float | None:
        now = clock()
        if not begun:
            begun.append((done, now))
        steps = done - begun[0][0]
        return (now - begun[0][1]) * (total - done) / steps if steps else None

    return seconds


def _in_words(seconds: float) -> str:
    for unit, length_s in (("h", 3600.0), ("min", 60.0)):
        if seconds >= 2 * length_s:
            return f"{seconds / length_s:.0f} {unit}"
    return f"{seconds:.0f} s"
