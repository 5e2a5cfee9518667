"""How far a long run is, and how long it still takes: a bar on a terminal, plain lines elsewhere.

Both go to standard error.
"""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

_PLAIN_LINES = 5
# The first estimate is due after this part of the work; less than so many seconds are not named.
_EARLY, _LEAST_S = 0.05, 10.0


@contextmanager
def progress(title: str, total: int, brief: bool = False) -> Iterator[Callable[[int], None]]:
    """Yield a function that is told how many of `total` steps are done.

    With `brief`, plain lines are written only where they name the time left.
    """
    if sys.stderr.isatty():
        columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn())
        with Progress(*columns, TimeRemainingColumn(), console=Console(stderr=True)) as bar:
            task = bar.add_task(title, total=total)
            yield lambda done: bar.update(task, completed=done)
        return
    left = time_left(total, time.monotonic)
    shown, estimated = 0, False

    def say(done: int) -> None:
        nonlocal shown, estimated
        part, words = done * _PLAIN_LINES // total, left(done)
        due = part > shown and (words or not brief)
        if due or (words and not estimated):
            shown, estimated = part, estimated or bool(words)
            sys.stderr.write(f"{title}: {done} of {total}{words}\n")
            sys.stderr.flush()

    yield say


def time_left(total: int, clock: Callable[[], float]) -> Callable[[int], str]:
    """Return a function from the steps done to the words for the time left, by a clock in seconds.

    The words are empty before the first part of the work, and where little time is left. The rate
    counts from the first call: a sweep that goes on begins with the steps of its last start.
    """
    begun: list[tuple[int, float]] = []

    def words(done: int) -> str:
        now = clock()
        if not begun:
            begun.append((done, now))
        steps = done - begun[0][0]
        if not steps or done < _EARLY * total:
            return ""
        left_s = (now - begun[0][1]) * (total - done) / steps
        if left_s < _LEAST_S:
            return ""
        return f", about {_in_words(left_s)} left"

    return words


def _in_words(seconds: float) -> str:
    for unit, length_s in (("h", 3600.0), ("min", 60.0)):
        if seconds >= 2 * length_s:
            return f"{seconds / length_s:.0f} {unit}"
    return f"{seconds:.0f} s"
