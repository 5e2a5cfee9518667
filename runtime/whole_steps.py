"""Messages put together by steps: what was said of each, once it is over.

A step is over when the last word of all its participants has come. The words of one process keep
their order, so who speaks of a later step has said the last of an earlier one. Words of different
processes overtake each other: on a loaded machine a link falls many steps behind.
"""

from contextlib import suppress
from dataclasses import dataclass, field
from typing import NamedTuple

import msgspec

from concord.bus.bus import FrameFormat
from concord.nodes.bounds import UNREADABLE, Instant, node_of
from concord.nodes.history import history_of, with_event
from concord.nodes.messages import MalformedMessage, decode

# A bound on memory alone: in lockstep an event tells of each node that is gone.
_LONGEST_WAIT_STEPS = 1000
# A process that spoke so few steps before the end of a recording had not left.
_STILL_THERE_STEPS = 8


EVENTS_ALONE = b"events"
"""Question of a page that has all readings."""


class WholeStep(NamedTuple):
    """A step that is over: its truth, measurements, shares and estimates as (topic, bytes).

    `events` is the number of events of the run when a page was offered it.
    """

    number: int
    messages: list[tuple[str, bytes]]
    events: int = 0


class Handover(NamedTuple):
    """The newest whole step, all events so far, and the readings of all steps up to it; None where
    they are too many, or where events alone are asked for.

    The recorder gives it to a page that begins to listen, or that lacks an event.
    """

    step: WholeStep
    events: list[bytes]
    readings: list[WholeStep] | None


class _Told(msgspec.Struct):
    step: Instant


@dataclass
class _Step:
    """Messages of a step received so far, in which `members` take part."""

    members: set[int]
    messages: list[tuple[str, bytes]] = field(default_factory=list)
    measured: set[int] = field(default_factory=set)
    estimated: set[int] = field(default_factory=set)
    has_truth: bool = False
    # Of the environment, which says the truth first and then what was measured.
    is_left: bool = False

    def is_complete(self) -> bool:
        """Whether nothing more will come of it."""
        # Counted first: to compare sets with every estimate would cost the square of the nodes.
        if len(self.estimated) < len(self.members) or not (self.has_truth or self.is_left):
            return False
        return self.members <= self.estimated and (self.is_left or self.members <= self.measured)


class WholeSteps:
    """Takes the messages of a run one by one, from the first on, and gives its steps in order."""

    def __init__(
        self,
        nodes: int,
        rounds: int,
        frame_format: FrameFormat,
        longest_wait_steps: int = _LONGEST_WAIT_STEPS,
    ) -> None:
        """A network of so many nodes that begins with so many rounds per step, on a bus with frames
        of this format; a step is given up when the plant is `longest_wait_steps` further."""
        self._cycle_of = frame_format.cycle_of
        self.nodes = nodes
        self._everybody = frozenset(range(nodes))
        self._history = history_of(rounds, ())
        self._steps: dict[int, _Step] = {}
        # By cycle: which step that belongs to may be told a little later.
        self._shares: list[tuple[int, tuple[str, bytes]]] = []
        self._next, self._reached = 0, 0
        self._longest_wait_steps = longest_wait_steps
        self._latest = [-1] * nodes
        self.torn_step: int | None = None
        """The step within which the messages end; known after `rest`."""

    def take(self, topic: str, data: bytes) -> list[WholeStep]:
        """Take one message; return the steps over now. Ignore bytes that are no message."""
        kind, _, name = topic.partition("/")
        node = node_of(name, self.nodes)
        if kind == "event":
            self._hear(data)
            return self._over()
        if kind == "share":
            self._shares.append((self._cycle_of(data), (topic, data)))
            return []
        number = self._step_of(kind, data)
        # Only the plant's truth may be further ahead than the messages under way.
        soon = kind == "truth" or (number or 0) <= self._reached + _LONGEST_WAIT_STEPS
        if number is None or number < self._next or not soon:
            return []
        step = self._steps.get(number)
        if step is None:
            step = self._steps[number] = self._begun(number)
        step.messages.append((topic, data))
        if kind == "truth":
            step.has_truth = True
            self._reached = max(self._reached, number)
            for earlier in self._before(number):
                earlier.is_left = True
        elif node is not None and kind == "measured":
            step.measured.add(node)
        elif node is not None:
            step.estimated.add(node)
            if number > self._latest[node] + 1:
                for earlier in self._before(number):
                    earlier.estimated.add(node)
            self._latest[node] = max(number, self._latest[node])
        return self._over()

    def rest(self) -> list[WholeStep]:
        """Nothing more will be said: return the steps that were waited for, up to a torn one."""
        self.torn_step = min(filter(self._is_torn, self._steps), default=None)
        if self.torn_step is not None:
            self._steps = {n: step for n, step in self._steps.items() if n < self.torn_step}
        self._longest_wait_steps = -1
        return self._over()

    def _is_torn(self, number: int) -> bool:
        """Say whether the recording ends within a step: a process that was there is missing."""
        step = self._steps[number]
        missing = step.members - step.estimated
        lately = max(self._latest) - _STILL_THERE_STEPS
        is_cut_off = any(self._latest[node] >= lately for node in missing)
        return is_cut_off or not (step.has_truth or step.is_left)

    def _begun(self, number: int) -> _Step:
        passed = {node for node, latest in enumerate(self._latest) if latest > number}
        members, is_left = self._members(number), self._reached > number
        return _Step(members, estimated=passed, is_left=is_left)

    def _before(self, number: int) -> list[_Step]:
        return [step for earlier, step in self._steps.items() if earlier < number]

    def _step_of(self, kind: str, data: bytes) -> int | None:
        """The step of a message that is drawn."""
        if kind not in ("truth", "measured", "estimate"):
            return None
        with suppress(*UNREADABLE):
            return msgspec.json.decode(data, type=_Told).step
        return None

    def _hear(self, event: bytes) -> None:
        """Apply an event to the history, and to the steps that are under way."""
        with suppress(MalformedMessage):
            history = with_event(self._history, decode("event", event))
            # Nodes of an overloaded network are out and back all the time.
            self._history = history.since(self._next)
        for number, step in self._steps.items():
            step.members = self._members(number)

    def _members(self, number: int) -> set[int]:
        return {node for node in self._everybody if self._history.is_in(node, number)}

    def _over(self) -> list[WholeStep]:
        """The steps that are over, from the oldest on; one without a truth cannot be shown."""
        over: list[WholeStep] = []
        while self._steps:
            number = min(self._steps)
            step = self._steps[number]
            if not step.is_complete() and self._reached <= number + self._longest_wait_steps:
                break
            shares = self._shares_of(number)
            if step.has_truth:
                over.append(WholeStep(number, step.messages + shares))
            del self._steps[number]
            self._next = number + 1
        return over

    def _shares_of(self, number: int) -> list[tuple[str, bytes]]:
        """Return the shares sent in a step, and forget them."""
        placed = [(self._history.place(cycle)[0], cycle, told) for cycle, told in self._shares]
        ahead = range(number + 1, self._reached + _LONGEST_WAIT_STEPS)
        self._shares = [(cycle, told) for step, cycle, told in placed if step in ahead]
        return [told for step, _, told in placed if step == number]
