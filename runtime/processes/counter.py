"""Counts that several threads add to."""

import threading


class Counter:
    """A number that any thread may add to. Holds: its own lock, for one addition."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._number = 0

    @property
    def number(self) -> int:
        """The count so far."""
        return self._number

    def add(self) -> int:
        """Add one; returns the count before."""
        with self._lock:
            self._number += 1
            return self._number - 1

    def take(self) -> int:
        """Return the count, and begin again at 0."""
        with self._lock:
            taken, self._number = self._number, 0
            return taken
