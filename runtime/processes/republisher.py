"""The republisher keeps the latest messages of a process, and repeats them after a loss.

zenoh loses nothing on a link that stands. A link that breaks loses the messages under way, and a
process that was held up for longer than the lease breaks its own links. In lockstep a node would
wait for a lost message for ever. So a process repeats its messages of the last steps below `again/`
in two cases: it has sent nothing new for a second and for several steps, or a link has come back.
That is enough: if one process cannot go on, all wait, also the sender of the lost message. The
sender still has it, as no process is further behind than `EARLY_STEPS`. A receiver takes the
messages that it lacks (`runtime/processes/republisher.py`).

No process waits for the recorder, so the network would go on while the recorder loses messages.
While its link is away publishers pause. When it is back, they first repeat their buffers below
`keep/`. They do so once more a second later: a link that has just come back does not know yet who
listens, and drops what is said on it. On a busy machine a second may be too short. A process at its
end waits for the recorder, so it repeats its buffer as long as it waits.
"""

import math
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from itertools import pairwise

from concord.bus.bus import FrameFormat, Rejected
from concord.nodes.inbox import EARLY_STEPS
from concord.nodes.messages import Grant, Measured, NodeEvent, ShareHeard
from concord.nodes.node_state import NodeState
from concord.runtime.network.links import RECORDER
from concord.runtime.network.zenoh_transport import Transport

AGAIN, KEEP = "again", "keep"
# A process that has sent nothing for so long repeats: at first, and later.
_AGAIN_S, _AT_MOST_S = 1.0, 10.0
# And for so many times the longest of its last steps: with 200 processes on two cores a step takes
# a second.
_AGAIN_STEPS, _LAST_STEPS = 4, 8
# Messages of the last seconds may be under way: a link that stands still for longer than the
# lease is broken.
_UNDER_WAY_S = 6.0
# How often a process says which others it waits for.
_TELL_S = 10.0
# Messages of a former life of a node are for the recorder alone.
_ANEW = ("", b"")


class Republisher:
    """Publishes messages that others wait for, and repeats them.

    `last` is the kind of message that ends a step, `kept` the number of messages that are kept at
    least. `waiting()` names the processes that this one waits for. `standing()` are messages that
    hold now, and are repeated after all others.
    """

    def __init__(
        self,
        transport: Transport,
        who: str,
        last: str,
        kept: int,
        waiting: Callable[[], str],
        standing: Callable[[], list[tuple[str, bytes]]] = list,
    ) -> None:
        self._transport, self._who, self._last = transport, who, last
        self._waiting, self._standing = waiting, standing
        self._kept: deque[tuple[str, bytes]] = deque()
        self._at_least, self._dropped = kept, 0
        # How much had been said when.
        self._marks: deque[tuple[float, int]] = deque()
        # When its last steps ended.
        self._ends_s: deque[float] = deque(maxlen=_LAST_STEPS + 1)
        # A repetition comes after what it repeats.
        self._order = threading.Lock()
        self._links = threading.Lock()
        self._lost: set[str] = set()
        self._back: set[str] = set()
        # Since when the recorder is out of reach, if it is.
        self._is_cut, self._cut_s = False, 0.0
        self._linked, self._ring = threading.Event(), threading.Event()
        self._closed = self._finished = False
        self._thread = threading.Thread(target=self._look, daemon=True)

    def begin(self) -> None:
        """From now on look whether something must be said again."""
        self._thread.start()

    def finish(self) -> None:
        """Repeat for the recorder from now on: the process waits until the recorder has all."""
        self._finished = True

    def close(self) -> None:
        """Nothing more is said again; before the transport is closed."""
        self._closed = True
        self._ring.set()
        self._thread.join()

    def say(self, topic: str, data: bytes) -> None:
        """Publish, and keep it; waits for a recorder that is out of reach."""
        if self._is_cut:
            self._linked.wait()
        with self._order:
            self._transport.send(topic, data)
            self._kept.append((topic, data))
            if self._ends_step(topic):
                self._ends_s.append(time.monotonic())

    def _ends_step(self, topic: str) -> bool:
        return topic.partition("/")[0] == self._last

    def begin_anew(self) -> None:
        """From here on earlier messages concern the recorder alone."""
        self._kept.append(_ANEW)

    def see(self, name: str, is_there: bool) -> bool:
        """In zenoh's thread: a link is broken, or there; whether it had been broken and is back."""
        with self._links:
            if not is_there:
                self._lost.add(name)
                if name == RECORDER:
                    self._linked.clear()
                    if not self._is_cut:
                        self._is_cut, self._cut_s = True, time.monotonic()
            is_back = is_there and name in self._lost
            if is_back:
                self._lost.discard(name)
                self._back.add(name)
                self._ring.set()
        return is_back

    def _look(self) -> None:
        """In a thread of its own."""
        latest, since, pause_s, told = None, time.monotonic(), quiet_s(()), 0
        # When the recorder is told once more.
        once_more_s = math.inf
        while True:
            self._ring.wait(min(pause_s, max(once_more_s - time.monotonic(), 0.0)))
            if self._closed:
                return
            self._ring.clear()
            with self._links:
                back, self._back = self._back, set()
            if RECORDER in back:
                self._tell_recorder()
                once_more_s = time.monotonic() + _AGAIN_S
            elif time.monotonic() >= once_more_s:
                self._repeat(f"{KEEP}/", list(self._copy()))
                once_more_s = math.inf
            self._forget(time.monotonic())
            before, latest = latest, (self._kept[-1] if self._kept else None)
            if latest is not before:
                since, pause_s, told = time.monotonic(), quiet_s(tuple(self._ends_s)), 0
            if back or latest is before:
                self._repeat(f"{AGAIN}/", self._recent())
                if self._finished:
                    self._repeat(f"{KEEP}/", list(self._copy()))
                # Nothing is said between a look at what holds and the saying of it.
                with self._order:
                    self._repeat("", self._standing())
                pause_s = min(2 * pause_s, _AT_MOST_S)
            # A process in real time may have nothing to say for long.
            waited_s = time.monotonic() - (max(since, self._cut_s) if self._is_cut else since)
            if waited_s > (told + 1) * _TELL_S:
                told += 1
                self._tell(waited_s)

    def _tell(self, waited_s: float) -> None:
        if for_whom := self._for_whom():
            sys.stderr.write(f"{self._who} has waited {waited_s:.0f} s for {for_whom}\n")

    def _for_whom(self) -> str:
        if self._is_cut:
            return "the recorder, which is out of reach"
        if self._finished:
            return "the recorder, which has not said that it has all messages"
        return self._waiting()

    def _tell_recorder(self) -> None:
        """Its link is back: all that it may have lost, before anything new."""
        self._repeat(f"{KEEP}/", list(self._copy()))
        with self._links:
            if RECORDER not in self._lost:
                self._is_cut = False
                self._linked.set()

    def _copy(self) -> deque[tuple[str, bytes]]:
        with self._order:
            return self._kept.copy()

    def _forget(self, now_s: float) -> None:
        """Drop what has arrived for certain; nothing while the recorder is out of reach."""
        # Never both locks at once: a publisher may wait for the thread that sees links.
        with self._order:
            self._marks.append((now_s, self._dropped + len(self._kept)))
            while not self._is_cut and self._marks[0][0] < now_s - _UNDER_WAY_S:
                published = self._marks.popleft()[1]
                while self._dropped < published and len(self._kept) > self._at_least:
                    self._kept.popleft()
                    self._dropped += 1

    def _recent(self) -> list[tuple[str, bytes]]:
        """The messages of the last steps, in order."""
        recent: list[tuple[str, bytes]] = []
        steps = 0
        for message in reversed(self._copy()):
            if message is _ANEW or steps > EARLY_STEPS:
                break
            recent.append(message)
            steps += self._ends_step(message[0])
        return recent[::-1]

    def _repeat(self, below: str, messages: list[tuple[str, bytes]]) -> None:
        for topic, data in messages:
            if topic:
                self._transport.send(below + topic, data)


def quiet_s(ends_s: Sequence[float]) -> float:
    """How long a process says nothing new before it repeats, where its last steps ended then."""
    steps_s = (after - before for before, after in pairwise(ends_s))
    return min(max(_AGAIN_STEPS * max(steps_s, default=0.0), _AGAIN_S), _AT_MOST_S)


# More than all processes of a network of 64 nodes keep.
_REMEMBERED = 1 << 17


def is_missing(state: NodeState, event: NodeEvent, frame_format: FrameFormat) -> bool:
    """Whether a node can use a message that was said again: one that has come changes nothing, and
    no counter."""
    inbox = state.inbox
    match event:
        case Measured():
            return event.step > state.step and event.step not in inbox.measured
        case Grant():
            key = (event.cycle, event.group)
            return key >= (state.cycle, state.group) and key not in inbox.grants
        case ShareHeard(sender, frame):
            try:
                fragment = frame_format.read(frame)
            except Rejected:
                # It never was a frame: that is for the state machine to count.
                return True
            cycle, number = fragment.cycle, fragment.frame_id
            return (
                sender not in state.absent
                and cycle >= state.cycle
                and (cycle, sender) not in inbox.shares
                and number not in inbox.parts.get((cycle, sender), ())
                and (sender, cycle, number, fragment.count) not in inbox.early
            )
    return False


class Deduplication:
    """The latest messages that the recorder has heard, so that none is recorded twice.

    Their hashes, as messages may be large: of 2^64, so few are ever equal that none is missed.
    """

    def __init__(self) -> None:
        self._latest: deque[int] = deque(maxlen=_REMEMBERED)
        # Made when something is said again, as mostly nothing is.
        self._known: set[int] | None = None

    def what_is_new(
        self, received: Sequence[tuple[str, bytes]], below: str
    ) -> list[tuple[str, bytes]]:
        """Messages (topic, bytes), and of those that were said again, on topics that begin with
        `below`, the ones that have not been heard, under their own names."""
        new: list[tuple[str, bytes]] = []
        for message in received:
            is_repeated = message[0].startswith(below)
            if is_repeated:
                message = message[0][len(below) :], message[1]
            mark = hash(message)
            if is_repeated and self._is_known(mark):
                continue
            new.append(message)
            self._latest.append(mark)
            if self._known is not None:
                self._known.add(mark)
        return new

    def _is_known(self, mark: int) -> bool:
        if self._known is None or len(self._known) > 2 * _REMEMBERED:
            self._known = set(self._latest)
        return mark in self._known
