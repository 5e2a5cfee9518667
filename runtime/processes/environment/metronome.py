"""Beats of a clock for a process that otherwise waits for messages."""

import threading
import time
from collections.abc import Callable, Iterable
from typing import TypeVar

Word = TypeVar("Word")


def tell_on_time(
    start_s: float, timetable: Iterable[tuple[float, Word]], tell: Callable[[Word], None]
) -> None:
    """Call `tell(word)` in a thread of its own for each (seconds after `start_s` of the monotonic
    clock, word), which ascend; one that comes late takes nothing from the next."""

    def run() -> None:
        for after_s, word in timetable:
            time.sleep(max(0.0, start_s + after_s - time.monotonic()))
            tell(word)

    threading.Thread(target=run, daemon=True).start()


class Metronome:
    """Calls `beat()` in a thread of its own, so many times a second; never twice to catch up."""

    def __init__(self, beat: Callable[[], None]) -> None:
        self._beat = beat
        self._changed = threading.Condition()
        self._period_s: float | None = None
        self._thread: threading.Thread | None = None

    def set(self, beats_per_second: float) -> None:
        """Another rate; 0 is silence."""
        with self._changed:
            self._period_s = 1 / beats_per_second if beats_per_second else None
            self._changed.notify()
        if self._thread is None and beats_per_second:
            self._thread = threading.Thread(target=self._run, daemon=True)
            self._thread.start()

    def _run(self) -> None:
        due = time.monotonic()
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._period_s is not None)
                period = self._period_s
                assert period is not None
                due = max(due + period, time.monotonic())
                # A change of the rate ends the wait and counts as a beat.
                self._changed.wait(due - time.monotonic())
                silenced = self._period_s is None
            if not silenced:
                self._beat()
