"""Double-entry book-keeping of frames: what must have become of each, beside what nodes count.

The books follow from what was sent, what arrived, and which changes were announced. They are made
frame by frame and compared with the counters of a node after every event; so every frame that
arrives is heard, lost, late, repeated or rejected, and exactly once.
"""

from collections import Counter
from collections.abc import Iterable
from typing import NamedTuple

from bus.fragments import join
from nodes.changes import (
    Calm,
    Cut,
    Event,
    Fault,
    Healed,
    Joined,
    Left,
    Loss,
    Set,
    Welcome,
)
from nodes.history import History, history_of, with_event
from nodes.link_state import hears
from nodes.messages import (
    CycleClosed,
    Estimate,
    Grant,
    NodeEvent,
    ShareHeard,
    Truth,
    decode,
)
from nodes.node_state import NodeConfig, NodeState, Phase
from nodes.share import read_frame

Key = tuple[int, int, int]
_BOOKED = ("sent", "heard", "lost", "late", "repeated", "missed")
_EVENTS_PER_FRAME = 50
_WORDS = {Left: "kill", Joined: "restart", Cut: "cut", Healed: "heal", Loss: "loss", Set: "set"}


class Broken(Exception):
    """An invariant does not hold: its name, and what was seen."""

    def __init__(self, invariant: str, seen: str) -> None:
        super().__init__(f"{invariant}: {seen}")
        self.invariant, self.seen = invariant, seen


class _Sent(NamedTuple):
    """A frame as it was sent: its place among the `parts` of its share."""

    sender: int
    cycle: int
    frame_id: int
    number: int
    parts: int
    data: bytes


class _Page:
    """The books of one node since it was started."""

    def __init__(self, cycle: int, end_cycle: int) -> None:
        self.cycle, self.end_cycle = cycle, end_cycle
        self.phase, self.group = Phase.MEASUREMENT, 0
        self.counts: Counter[str] = Counter()
        self.seen: set[Key] = set()
        self.early: list[tuple[int, _Sent | None, Key]] = []
        self.arrived: dict[tuple[int, int], list[bool]] = {}
        self.refused_shares = 0


class Books:
    """Recorder and onlooker of one run; `loses_frames` says that some never come."""

    def __init__(self, rounds: int, nodes: int, loses_frames: bool) -> None:
        self.history: History = history_of(rounds, ())
        self.estimates: dict[tuple[int, int], Estimate] = {}
        self.truths: dict[int, Truth] = {}
        self.grants: dict[tuple[int, int], tuple[int, ...]] = {}
        self._sent: dict[tuple[int, int], list[_Sent]] = {}
        self._owners: dict[tuple[int, int], int] = {}
        self._unchecked: list[_Sent] = []
        self.changes: Counter[str] = Counter()
        self._genuine: dict[bytes, _Sent] = {}
        self._pages = [_Page(0, 0) for _ in range(nodes)]
        self._cuts: set[tuple[int, int]] = set()
        self._events = 0
        self._loses_frames = loses_frames

    # --- what is sent ----------------------------------------------------------------------------

    def record(self, topic: str, data: bytes) -> None:
        """Take note of one message."""
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
            case Truth() as message:
                self.truths[message.step] = message
            case Grant() as message:
                self.grants[message.cycle, message.group] = tuple(message.winners)
            case Event() as message:
                self._note_change(message)

    def close(self) -> None:
        """Nothing to do."""

    def _note_frame(self, node: int, frame: bytes) -> None:
        fragment = read_frame(frame)
        number, parts = fragment.data[0], fragment.data[1]
        sent = _Sent(node, fragment.cycle, fragment.frame_id, number, parts, fragment.data)
        self._genuine[frame] = sent
        self._sent.setdefault((node, fragment.cycle), []).append(sent)
        self._pages[node].counts["sent"] += 1
        slot = (fragment.cycle, fragment.frame_id)
        if slot in self._owners:
            raise Broken(
                "one sender per slot and channel",
                f"nodes {self._owners[slot]} and {node} send frame {slot[1]} in cycle {slot[0]}",
            )
        self._owners[slot] = node
        self._unchecked.append(sent)

    def step_of(self, cycle: int) -> int:
        """The step that a cycle belongs to."""
        return self.history.place(cycle)[0]

    def body(self, node: int, cycle: int) -> bytes | None:
        """What a node has sent in a cycle; None for nothing."""
        frames = self._sent.get((node, cycle))
        return None if frames is None else join([one.data for one in frames])

    def _note_change(self, event: Event) -> None:
        self.history = with_event(self.history, event)
        change = event.change
        if isinstance(change, Fault):
            self.changes[change.kind] += 1
        elif type(change) in _WORDS:
            self.changes[_WORDS[type(change)]] += 1
        match event.change:
            case Cut(sender, receiver):
                self._cuts.add((sender, receiver))
            case Healed(sender, receiver):
                self._cuts.discard((sender, receiver))
            case Calm():
                self._cuts.clear()

    # --- what arrives ----------------------------------------------------------------------------

    def watch(self, config: NodeConfig, event: NodeEvent | Welcome, state: NodeState) -> None:
        """After an event at a node: book it, and compare."""
        node = config.index
        if isinstance(event, Welcome):
            self._pages[node] = _Page(state.cycle, _end_cycle(config, state))
            return
        self._check_progress()
        self._check_turns(config)
        page = self._pages[node]
        if isinstance(event, CycleClosed):
            self._check_patience(node, page, event)
        if isinstance(event, ShareHeard):
            self._book(config, page, event.sender, event.frame)
        end = _end_cycle(config, state)
        if end != page.end_cycle:
            page.end_cycle = end
            due = [one for one in page.early if one[2][1] < end]
            page.early = [one for one in page.early if one[2][1] >= end]
            for sender, sent, _ in due:
                self._file(config, page, sender, sent)
        page.cycle, page.group, page.phase = state.cycle, state.group, state.phase
        self._compare(node, page, state.counters)

    def _check_turns(self, config: NodeConfig) -> None:
        """What the node has just sent, it may send."""
        unchecked, self._unchecked = self._unchecked, []
        for one in unchecked:
            groups = range(len(config.schedule.groups(one.cycle)))
            winners = [w for group in groups for w in self.grants.get((one.cycle, group), ())]
            if one.sender not in (*config.schedule.static_senders(one.cycle), *winners):
                raise Broken(
                    "who sends has a turn", f"node {one.sender} has none in cycle {one.cycle}"
                )

    def _check_patience(self, node: int, page: _Page, closed: CycleClosed) -> None:
        """Time runs out only where something that was sent never comes."""
        if (page.cycle, page.group) != (closed.cycle, closed.group):
            return
        if page.phase is Phase.GRANT or not self._loses_frames:
            what = "a grant" if page.phase is Phase.GRANT else "a share"
            raise Broken("nobody waits in vain", f"node {node} in cycle {page.cycle} for {what}")

    def _check_progress(self) -> None:
        self._events += 1
        if self._events > 10_000 + _EVENTS_PER_FRAME * (len(self._genuine) + len(self.estimates)):
            raise Broken("progress", f"{self._events} events and no end")

    def _book(self, config: NodeConfig, page: _Page, sender: int, frame: bytes) -> None:
        """One frame that has arrived."""
        sent = self._genuine.get(frame)
        if sent is None:
            page.counts["rejected"] += 1
            return
        key = (sender, sent.cycle, sent.frame_id)
        if sent.cycle < page.cycle:
            page.counts["late"] += 1
        elif sent.sender != sender:
            self._book_spoof(page, sender, sent, key)
        elif key in page.seen:
            page.counts["repeated"] += 1
        else:
            page.seen.add(key)
            if sent.cycle >= page.end_cycle:
                page.early.append((sender, sent, key))
            else:
                self._file(config, page, sender, sent)

    def _book_spoof(self, page: _Page, sender: int, sent: _Sent, key: Key) -> None:
        """A sound frame of somebody else, who sent it in a slot of its own."""
        if sent.cycle < page.end_cycle:
            page.counts["rejected"] += 1
        elif any(key == other for *_, other in page.early):
            page.counts["repeated"] += 1
        else:
            page.early.append((sender, None, key))

    def _file(self, config: NodeConfig, page: _Page, sender: int, sent: _Sent | None) -> None:
        """A frame of the open step."""
        if sent is None:
            page.counts["rejected"] += 1
            return
        # What a cut link brings all the same is told by the changes, and not by the node.
        step, _ = self.history.place(sent.cycle)
        receiver = config.index
        arrives = (sender, receiver) not in self._cuts and hears(
            config.links._replace(cuts=frozenset()), step, sent.cycle, sender, receiver, sent.number
        )
        parts = page.arrived.setdefault((sent.cycle, sender), [])
        parts.append(arrives)
        page.counts["lost"] += not arrives
        page.counts["heard"] += len(parts) == sent.parts and all(parts)

    # --- what nodes say of themselves ---------------------------------------------------------

    def missed(self, config: NodeConfig, cycle: int, group: int, silent: Iterable[int]) -> None:
        """A node has fused a part of a cycle, in which these neighbours said nothing usable."""
        senders = config.schedule.groups(cycle)[group].senders
        due = {*senders, *self.grants.get((cycle, group), ())}
        step, _ = self.history.place(cycle)
        self._pages[config.index].counts["missed"] += sum(
            j in due and self.history.is_in(j, step) for j in silent
        )

    def refused(self, node: int, shares: int) -> None:
        """A node's estimator has refused so many shares that it had heard."""
        self._pages[node].refused_shares += shares

    def _compare(self, node: int, page: _Page, counters: dict[str, int]) -> None:
        rejected = sum(n for name, n in counters.items() if name.startswith("rejected "))
        said = {name: counters.get(name, 0) for name in _BOOKED}
        said["rejected"] = rejected - page.refused_shares
        booked = {name: page.counts[name] for name in said}
        if said != booked:
            wrong = [
                f"{name} {said[name]} for {booked[name]}"
                for name in said
                if said[name] != booked[name]
            ]
            raise Broken(
                "counters add up", f"node {node} in cycle {page.cycle} counts {', '.join(wrong)}"
            )


def _end_cycle(config: NodeConfig, state: NodeState) -> int:
    return config.first_cycle + (state.step + 1 - config.first_step) * config.rounds
