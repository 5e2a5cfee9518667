"""The fault `slow-cpu`: a node takes several times its processor time."""

import time
from collections.abc import Callable


class SlowProcessor:
    """Adds processor time to the work of the thread that calls it.

    `used_s` returns the processor time that this thread has used so far.
    """

    def __init__(self, used_s: Callable[[], float] = time.thread_time) -> None:
        self._used_s, self._since_s = used_s, used_s()

    def work(self, factor: float) -> None:
        """Compute on until the work since the last call has taken `factor` times its time."""
        until_s = self._since_s + factor * (self._used_s() - self._since_s)
        while self._used_s() < until_s:
            # The thread must use the processor: a pause would leave it to other nodes.
            pass
        self._since_s = self._used_s()
