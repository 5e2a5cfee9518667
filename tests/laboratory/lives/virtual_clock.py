"""A virtual clock: what is due next happens next, however long it takes to compute."""

import heapq
from collections.abc import Callable


class VirtualClock:
    """Calls functions at virtual times in s, in the order of these and of their requests."""

    def __init__(self) -> None:
        self.now_s = 0.0
        self._due: list[tuple[float, int, Callable[[], None]]] = []
        self._requests = 0

    def at(self, time_s: float, call: Callable[[], None]) -> None:
        """Call a function at a time, or as soon as possible after it."""
        heapq.heappush(self._due, (max(time_s, self.now_s), self._requests, call))
        self._requests += 1

    def after(self, seconds: float, call: Callable[[], None]) -> None:
        """Call a function when so many seconds are over."""
        self.at(self.now_s + seconds, call)

    def run(self, until_s: float, is_over: Callable[[], bool]) -> None:
        """Go on until it is over, a time is reached, or nothing is due."""
        while self._due and not is_over() and self._due[0][0] <= until_s:
            self.now_s, _, call = heapq.heappop(self._due)
            call()


class Repetition:
    """Repeats what holds after a second without a message, as the republisher does."""

    def __init__(self, clock: VirtualClock, repeat: Callable[[], None]) -> None:
        self._clock, self._repeat = clock, repeat
        self._is_silent = True

    def begin(self) -> None:
        """Look every second whether a message was sent."""
        if self._is_silent:
            self._repeat()
        self._is_silent = True
        self._clock.after(1.0, self.begin)

    def note(self) -> None:
        """A message is sent."""
        self._is_silent = False
