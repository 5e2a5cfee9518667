"""Retransmissions: a receiver takes a message that it lacks, and drops one that has come."""

from collections import deque
from collections.abc import Sequence

from concord.bus.bus import FrameFormat, Rejected
from concord.nodes.messages import Grant, Measured, NodeEvent, ShareHeard
from concord.nodes.node_state import NodeState

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
