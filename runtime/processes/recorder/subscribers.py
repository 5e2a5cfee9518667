"""Subscribers of the recorder hear each message, and as many whole steps as an eye follows.

A subscriber that comes later asks for the newest step and for all readings up to it. A link that is
full drops what is offered, so each step says how many events there were, and who lacks one asks.
"""

import math
import threading
import time
from collections.abc import Callable, Sequence

import msgspec

from concord.runtime.network.zenoh_transport import Transport
from concord.runtime.processes.recorder.throttled_feed import ThrottledFeed
from concord.runtime.whole_steps import EVENTS_ALONE, Handover, WholeStep, WholeSteps

# Kept of the readings of a run: some 15 000 steps of eight nodes.
_MOST_READING_BYTES = 16_000_000


class Subscribers:
    """The subscribers of a network; `wake()` makes the recorder call `look`."""

    def __init__(self, offered: Transport, steps: WholeSteps, wake: Callable[[], None]) -> None:
        self._offered, self._steps, self._wake = offered, steps, wake
        self._feed = ThrottledFeed()
        self._alarm: threading.Timer | None = None
        self._are_there = False
        self._newest: WholeStep | None = None
        self._events: list[bytes] = []
        self._readings: list[WholeStep] | None = []
        self._reading_bytes = 0
        offered.listened("watch/**", self._see)
        offered.answer("handover", self._hand_over)

    def _see(self, are_there: bool) -> None:
        """In zenoh's thread."""
        self._are_there = are_there

    def tell(self, messages: Sequence[tuple[str, bytes]]) -> None:
        """Messages were recorded."""
        for topic, data in messages:
            if topic == "event":
                self._events.append(data)
            whole = self._steps.take(topic, data)
            for step in whole:
                self._keep(step)
            if not self._are_there:
                continue
            self._offered.offer(f"watch/{topic}", data)
            for step in whole:
                self._offer(self._feed.take(step, time.monotonic()))

    def look(self) -> None:
        """The time may have come for a step that was kept."""
        self._offer(self._feed.due(time.monotonic()))

    def close(self) -> None:
        """Nothing more will be recorded."""
        if self._alarm is not None:
            self._alarm.cancel()
        self._offer(self._feed.due(math.inf))
        self._offered.close()

    def _keep(self, step: WholeStep) -> None:
        """Keep a step that is over for subscribers that come later."""
        if self._readings is not None:
            told = [(topic, data) for topic, data in step.messages if topic.startswith("measured/")]
            self._readings.append(WholeStep(step.number, told))
            self._reading_bytes += sum(len(data) for _, data in told)
            if self._reading_bytes > _MOST_READING_BYTES:
                self._readings = None
        self._newest = step

    def _hand_over(self, asked: bytes) -> bytes:
        """Return the newest step with all events, and the readings so far unless `EVENTS_ALONE` is
        asked; nothing before the first step is over.

        Runs on: zenoh's thread. Holds: no lock; the lists only grow, and are read in one go.
        """
        newest, readings = self._newest, self._readings
        if newest is None:
            return b""
        if asked == EVENTS_ALONE:
            readings = None
        if readings is not None:
            readings = [step for step in list(readings) if step.number <= newest.number]
        return msgspec.msgpack.encode(Handover(newest, list(self._events), readings))

    def _offer(self, step: WholeStep | None) -> None:
        if step is not None:
            step = step._replace(events=len(self._events))
            self._offered.offer("watch/steps", msgspec.msgpack.encode(step))
        if self._feed.keeps_one and self._alarm is None:
            # If nothing more comes, it is the step at which the network stands.
            rest_s = self._feed.rest_s(time.monotonic())
            self._alarm = threading.Timer(rest_s, self._ring)
            self._alarm.daemon = True
            self._alarm.start()

    def _ring(self) -> None:
        """In a thread of its own."""
        self._alarm = None
        self._wake()
