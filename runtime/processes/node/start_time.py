"""When the common start of a network in real time was, on the clock of this process."""

import threading

import msgspec

from concord.runtime.network.zenoh_transport import Transport
from concord.runtime.processes.clock import EnvironmentClock, ahead_s

_ASK_AGAIN_S = 1.0


class StartTime:
    """Asks the environment process for the common start."""

    def __init__(self, transport: Transport) -> None:
        self._transport, self._ahead_s = transport, 0.0
        self._announced = threading.Event()
        transport.listen("start", lambda name, data: self._announced.set())

    def compare_clocks(self) -> None:
        """Measure how far another host's clock is ahead of this one's."""
        self._ahead_s = ahead_s(self._their_time)

    def wait(self) -> float:
        """Wait until the start is known; when step 0 begins or began, on our monotonic clock."""
        while True:
            clock = self._clock()
            if clock is not None and clock.start_s is not None:
                return clock.start_s - self._ahead_s
            # A node that is there from the beginning on hears the announcement. Another one asks
            # again: an answer may be lost on a busy machine.
            self._announced.wait(_ASK_AGAIN_S)
            self._announced.clear()

    def _clock(self) -> EnvironmentClock | None:
        answer = self._transport.ask("clock")
        return None if answer is None else msgspec.json.decode(answer, type=EnvironmentClock)

    def _their_time(self) -> float | None:
        clock = self._clock()
        return None if clock is None else clock.now_s
