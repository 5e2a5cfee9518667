"""Repetitions of the environment process under a virtual clock."""

from collections.abc import Callable

from concord.experiments.simulation_testing.lives.virtual_clock import VirtualClock

_AGAIN_S = 1.0


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
        self._clock.after(_AGAIN_S, self.begin)

    def note(self) -> None:
        """A message is sent."""
        self._is_silent = False
