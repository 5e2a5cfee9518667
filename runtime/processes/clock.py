"""How the clocks of two hosts are compared."""

import time
from collections.abc import Callable

import msgspec

_ROUND_TRIPS = 9


class EnvironmentClock(msgspec.Struct, frozen=True):
    """The environment process answers `clock` with its monotonic clock and the start of step 0.

    `start_s` is None while the start is not known.
    """

    now_s: float
    start_s: float | None


def ahead_s(ask: Callable[[], float | None], round_trips: int = _ROUND_TRIPS) -> float:
    """How far another clock is ahead of this process's monotonic one; 0 where no difference can be
    told, or nobody answers.

    `ask()` is the other clock's time, or None. Of several round trips the shortest tells best: the
    other clock was read somewhere within it (Cristian, Probabilistic clock synchronization,
    Distributed Computing 3, 1989).
    """
    best_s, difference_s = float("inf"), 0.0
    for _ in range(round_trips):
        before_s = time.monotonic()
        other_s = ask()
        trip_s = time.monotonic() - before_s
        if other_s is not None and trip_s < best_s:
            best_s, difference_s = trip_s, other_s - (before_s + trip_s / 2)
    # Within half a round trip the clocks may be one and the same, as on one machine.
    return difference_s if abs(difference_s) > best_s / 2 else 0.0
