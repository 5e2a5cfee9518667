"""The record of a run under test: all messages as they were sent, and the announced changes."""

from collections.abc import Sequence

from concord.bus.bus import Bus
from concord.nodes.changes import Calm, Cut, Event, Fault, Healed
from concord.nodes.faults.active import Faults
from concord.nodes.history import History, history_of, with_event
from concord.nodes.messages import Estimate, Grant, Measured, Truth, decode
from concord.nodes.node_state import NodeConfig
from tests.laboratory.broken import Broken
from tests.laboratory.node_ledger import Sent


class RunRecord:
    """Recorder of one run, which begins with this bus.

    Attributes:
        genuine: frames as they were sent, by their bytes. unchecked: frames whose turn is not
        checked yet. cut_shares: nodes of which only the first frames of a share are sent, by
        (cycle, group). cuts, wrong: links and faults as announced last. liars: nodes that were
        told to lie.
    """

    def __init__(self, bus: Bus, rounds: int) -> None:
        self._frames = bus.frame_format
        self.history: History = history_of(rounds, ())
        self.estimates: dict[tuple[int, int], Estimate] = {}
        self.truths: dict[int, Truth] = {}
        self.measured: dict[tuple[int, int], Measured] = {}
        self.grants: dict[tuple[int, int], tuple[int, ...]] = {}
        self.cut_shares: dict[tuple[int, int], tuple[int, ...]] = {}
        self.liars: set[int] = set()
        self.unchecked: list[Sent] = []
        self.genuine: dict[bytes, Sent] = {}
        self.cuts: set[tuple[int, int]] = set()
        self.wrong: dict[tuple[str, tuple[int, ...]], Fault] = {}
        self._sent: dict[tuple[int, int], list[Sent]] = {}

    def record(self, messages: Sequence[tuple[str, bytes]]) -> None:
        """Take note of messages, (topic, bytes), in this order."""
        for topic, data in messages:
            self._note(topic, data)

    def _note(self, topic: str, data: bytes) -> None:
        kind, _, node = topic.partition("/")
        if kind == "share":
            self._note_frame(int(node), data)
            return
        match decode(topic, data):
            case Estimate() as message:
                key = message.step, message.node
                if key in self.estimates:
                    raise Broken("one estimate a step", f"node {key[1]} gave two of step {key[0]}")
                self.estimates[key] = message
            case Measured() as message:
                self.measured[message.step, message.node] = message
            case Truth() as message:
                self.truths[message.step] = message
            case Grant() as message:
                key = message.cycle, message.group
                self.grants[key] = tuple(message.winners)
                self.cut_shares[key] = tuple(message.cut_shares)
            case Event() as message:
                self._note_change(message)

    def close(self) -> None:
        """Nothing to do."""

    def _note_frame(self, node: int, frame: bytes) -> None:
        fragment = self._frames.read(frame)
        data, place = fragment.data, self._frames.numbered(fragment.data)
        sent = Sent(
            node, fragment.cycle, fragment.frame_id, place.number, place.frames, data, frame
        )
        self.genuine[frame] = sent
        self._sent.setdefault((node, fragment.cycle), []).append(sent)
        self.unchecked.append(sent)

    def dynamic_turns(self, cycle: int, group: int) -> tuple[int, ...]:
        """Return the nodes that send in dynamic slots, a whole share or its first frames."""
        key = cycle, group
        return self.grants.get(key, ()) + self.cut_shares.get(key, ())

    def step_of(self, cycle: int) -> int:
        """Return the step of a cycle."""
        return self.history.place(cycle)[0]

    def has_sent(self, node: int, cycle: int) -> bool:
        """Say whether a node has sent a frame in a cycle."""
        return (node, cycle) in self._sent

    def body(self, node: int, cycle: int) -> bytes | None:
        """Return the body that a node has sent in a cycle; None for nothing."""
        frames = self._sent.get((node, cycle))
        return None if frames is None else self._frames.join([one.data for one in frames])

    def _note_change(self, event: Event) -> None:
        self.history = with_event(self.history, event)
        match event.change:
            case Fault(kind, nodes, numbers) as fault:
                self.wrong[kind, nodes] = fault
                if kind == "lie" and numbers[0]:
                    self.liars.add(nodes[0])
            case Cut(sender, receiver):
                self.cuts.add((sender, receiver))
            case Healed(sender, receiver):
                self.cuts.discard((sender, receiver))
            case Calm():
                self.cuts.clear()
                self.wrong.clear()

    def faults(self, config: NodeConfig, step: int) -> Faults:
        """Return the faults announced for a step; a node that is out does not affect others."""
        return config.faults._replace(
            standing={
                place: fault
                for place, fault in self.wrong.items()
                if fault.kind != "babble" or self.history.is_in(fault.nodes[0], step)
            }
        )
