"""Double-entry book-keeping of frames: what must have become of each, beside what nodes count.

The ledger follows from what was sent, what arrived, and which changes were announced. They are made
frame by frame and compared with the counters of a node after every event; so every frame that
arrives is heard, lost, late, repeated or rejected, and exactly once.
"""

from collections import Counter
from collections.abc import Iterable, Sequence

import numpy as np

from bus.bus import Bus
from experiments.simulation_testing.broken import Broken
from experiments.simulation_testing.node_ledger import Key, NodeLedger, Sent
from experiments.simulation_testing.outcomes import Fate, fate_of, must_be_silent
from nodes.changes import Calm, Cut, Event, Fault, Healed, Welcome
from nodes.faults.active import Faults
from nodes.faults.links import Passage
from nodes.faults.losses import hears
from nodes.history import History, history_of, with_event
from nodes.messages import (
    CycleClosed,
    Estimate,
    Grant,
    Measured,
    NodeEvent,
    ShareHeard,
    Truth,
    decode,
)
from nodes.node_state import NodeConfig, NodeState, Phase

_BOOKED = ("sent", "silent", "heard", "lost", "late", "repeated", "reordered", "missed")
_EVENTS_PER_FRAME = 50
# First bytes of a share whose numbers are NaN, in either number format.
_NO_NUMBERS = (np.full(1, np.nan, "<f8").tobytes(), np.full(2, np.nan, "<f4").tobytes())


class OracleLedger:
    """Recorder and onlooker of one run, which begins with this bus; `loses_frames` says that some
    never come."""

    def __init__(self, bus: Bus, rounds: int, nodes: int, loses_frames: bool) -> None:
        self._frames = bus.frame_format
        self.history: History = history_of(rounds, ())
        self.estimates: dict[tuple[int, int], Estimate] = {}
        self.truths: dict[int, Truth] = {}
        self.measured: dict[tuple[int, int], Measured] = {}
        self.grants: dict[tuple[int, int], tuple[int, ...]] = {}
        self.struck: Counter[str] = Counter()
        self.liars: set[int] = set()
        self._sent: dict[tuple[int, int], list[Sent]] = {}
        self._owners: dict[tuple[int, int], int] = {}
        self._unchecked: list[Sent] = []
        self._genuine: dict[bytes, Sent] = {}
        self._node_ledgers = [NodeLedger(0, 0) for _ in range(nodes)]
        self._cuts: set[tuple[int, int]] = set()
        self._wrong: dict[tuple[str, tuple[int, ...]], Fault] = {}
        self._events = 0
        self._loses_frames = loses_frames

    # --- what is sent ----------------------------------------------------------------------------

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
                self.grants[message.cycle, message.group] = tuple(message.winners)
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
        self._genuine[frame] = sent
        self._sent.setdefault((node, fragment.cycle), []).append(sent)
        self._node_ledgers[node].counts["sent"] += 1
        slot = (fragment.cycle, fragment.frame_id)
        if slot in self._owners:
            raise Broken(
                "one sender per slot and channel",
                f"nodes {self._owners[slot]} and {node} send frame {slot[1]} in cycle {slot[0]}",
            )
        self._owners[slot] = node
        self._unchecked.append(sent)

    def step_of(self, cycle: int) -> int:
        """Return the step that a cycle belongs to."""
        return self.history.place(cycle)[0]

    def body(self, node: int, cycle: int) -> bytes | None:
        """Return the body that a node has sent in a cycle, or None."""
        frames = self._sent.get((node, cycle))
        return None if frames is None else self._frames.join([one.data for one in frames])

    def _note_change(self, event: Event) -> None:
        self.history = with_event(self.history, event)
        match event.change:
            case Fault(kind, nodes, numbers) as fault:
                self._wrong[kind, nodes] = fault
                if kind == "lie" and numbers[0]:
                    self.liars.add(nodes[0])
            case Cut(sender, receiver):
                self._cuts.add((sender, receiver))
            case Healed(sender, receiver):
                self._cuts.discard((sender, receiver))
            case Calm():
                self._cuts.clear()
                self._wrong.clear()

    def _faults(self, config: NodeConfig, step: int) -> Faults:
        """Return the faults announced for a step; a node that is out does not affect others."""
        return config.faults._replace(
            standing={
                place: fault
                for place, fault in self._wrong.items()
                if fault.kind != "babble" or self.history.is_in(fault.nodes[0], step)
            }
        )

    # --- what arrives ----------------------------------------------------------------------------

    def watch(self, config: NodeConfig, event: NodeEvent | Welcome, state: NodeState) -> None:
        """Enter an event of a node, and compare the counters."""
        node = config.index
        if isinstance(event, Welcome):
            self._node_ledgers[node] = NodeLedger(state.cycle, _end_cycle(config, state))
            return
        self._check_progress()
        self._check_turns(config)
        ledger = self._node_ledgers[node]
        if isinstance(event, CycleClosed):
            self._check_peer_timeout(node, ledger, event)
        if isinstance(event, ShareHeard):
            self._book(config, ledger, event.sender, event.frame)
        end = _end_cycle(config, state)
        if end != ledger.end_cycle:
            ledger.end_cycle = end
            due = [one for one in ledger.early if one[2][1] < end]
            # Once a step is open it is known in whose slots frames of later ones must be.
            later = [one for one in ledger.early if one[2][1] >= end]
            ledger.early = [one for one in later if one[1] is not None]
            ledger.counts["rejected"] += len(later) - len(ledger.early)
            for sender, sent, _ in due:
                self._file(config, ledger, sender, sent)
        ledger.cycle, ledger.group, ledger.phase = (
            state.cycle,
            state.group,
            state.phase,
        )
        self._settle(config, ledger)
        ledger.book_what_was_late()
        silent = self._keeps_silent(config, ledger, state.step)
        self._compare(node, ledger, state.counters, silent)

    def _keeps_silent(self, config: NodeConfig, ledger: NodeLedger, step: int) -> bool:
        """Return whether a node has let a turn pass in the open group of the cycle."""
        if ledger.phase not in (Phase.GRANT, Phase.SHARES):
            return False
        granted = (
            self.grants.get((ledger.cycle, ledger.group), ())
            if ledger.phase is Phase.SHARES
            else ()
        )
        turns = (*config.schedule.groups(ledger.cycle)[ledger.group].senders, *granted)
        faults = self._faults(config, step)
        return config.index in turns and bool(
            must_be_silent(faults, step, ledger.cycle, config.index)
        )

    def _check_turns(self, config: NodeConfig) -> None:
        """Check that the node had a turn for each frame that it has just sent."""
        unchecked, self._unchecked = self._unchecked, []
        for one in unchecked:
            groups = range(len(config.schedule.groups(one.cycle)))
            winners = [w for group in groups for w in self.grants.get((one.cycle, group), ())]
            if one.sender not in (*config.schedule.static_senders(one.cycle), *winners):
                raise Broken(
                    "who sends has a turn", f"node {one.sender} has none in cycle {one.cycle}"
                )

    def _check_peer_timeout(self, node: int, ledger: NodeLedger, closed: CycleClosed) -> None:
        """Time runs out only where something that was sent never comes."""
        if (ledger.cycle, ledger.group) != (closed.cycle, closed.group):
            return
        if ledger.phase is Phase.GRANT or not self._loses_frames:
            what = "a grant" if ledger.phase is Phase.GRANT else "a share"
            raise Broken("nobody waits in vain", f"node {node} in cycle {ledger.cycle} for {what}")

    def _check_progress(self) -> None:
        self._events += 1
        if self._events > 10_000 + _EVENTS_PER_FRAME * (len(self._genuine) + len(self.estimates)):
            raise Broken("progress", f"{self._events} events and no end")

    def _book(self, config: NodeConfig, ledger: NodeLedger, sender: int, frame: bytes) -> None:
        """One frame that has arrived."""
        sent = self._genuine.get(frame)
        if sent is None:
            ledger.counts["rejected"] += 1
            return
        key = (sender, sent.cycle, sent.frame_id)
        if sent.cycle < ledger.cycle:
            ledger.counts["late"] += 1
        elif sent.sender != sender:
            self._book_spoof(ledger, sender, sent, key)
        elif key in ledger.seen:
            ledger.counts["repeated"] += 1
        else:
            ledger.seen.add(key)
            if sent.cycle >= ledger.end_cycle:
                ledger.early.append((sender, sent, key))
            else:
                self._file(config, ledger, sender, sent)

    def _book_spoof(self, ledger: NodeLedger, sender: int, sent: Sent, key: Key) -> None:
        """Enter a valid frame that another node sent in its own slot."""
        if sent.cycle < ledger.end_cycle or ledger.phase is not Phase.MEASUREMENT:
            ledger.counts["rejected"] += 1
        elif any(key == other for *_, other in ledger.early):
            ledger.counts["repeated"] += 1
        else:
            ledger.early.append((sender, None, key))

    def _file(self, config: NodeConfig, ledger: NodeLedger, sender: int, sent: Sent | None) -> None:
        """Enter a frame of the open step."""
        if sent is None:
            ledger.counts["rejected"] += 1
            return
        # The changes, not the node, tell which links are cut.
        step, _ = self.history.place(sent.cycle)
        receiver, cycle = config.index, sent.cycle
        arrives = (sender, receiver) not in self._cuts and hears(
            config.links._replace(cuts=frozenset()), step, cycle, sender, receiver, sent.number
        )
        if arrives and self._wrong:
            fate = self._fate(config, step, sender, sent)
            self.struck.update(fate.struck)
            ledger.suffer(sender, sent, fate)
            return
        ledger.counts["lost"] += not arrives
        ledger.arrive(sender, sent, arrives)

    def _fate(self, config: NodeConfig, step: int, sender: int, sent: Sent) -> Fate:
        way = Passage(step, sent.cycle, sender, config.index, sent.number, sent.frame_id)
        return fate_of(
            self._faults(config, step),
            way,
            sent.frame,
            lambda node: config.bus.in_slot_of(sent.frame, node, sent.cycle) is not None,
        )

    # --- what nodes say of themselves ---------------------------------------------------------

    def missed(self, config: NodeConfig, cycle: int, group: int, silent: Iterable[int]) -> None:
        """Enter that a node fuses a group of a cycle without usable shares of these neighbours."""
        senders = config.schedule.groups(cycle)[group].senders
        due = {*senders, *self.grants.get((cycle, group), ())}
        step, _ = self.history.place(cycle)
        ledger = self._node_ledgers[config.index]
        ledger.counts["missed"] += sum(j in due and self.history.is_in(j, step) for j in silent)
        ledger.fused.append(cycle)
        if config.index in due:
            ledger.turns.append((step, cycle))

    def used(self, node: int, sender: int, cycle: int) -> None:
        """Enter that a node's estimator receives a neighbour's share of a cycle."""
        self._node_ledgers[node].used.append((sender, cycle))

    def _settle(self, config: NodeConfig, ledger: NodeLedger) -> None:
        """Check the fused cycles of an event after all of its entries are made."""
        ledger.let_in_overtaken()
        for step, cycle in ledger.turns:
            self._check_turn_is_used(config, step, cycle)
        for sender, cycle in ledger.used:
            if not ledger.is_whole(sender, cycle):
                seen = f"node {config.index} has used that of node {sender} in cycle {cycle}"
                raise Broken("what did not come is not used", seen)
        ledger.fused, ledger.turns, ledger.used = [], [], []

    def _check_turn_is_used(self, config: NodeConfig, step: int, cycle: int) -> None:
        """Check that a node with a turn sends, unless a fault silences it."""
        node = config.index
        why = must_be_silent(self._faults(config, step), step, cycle, node)
        self._node_ledgers[node].counts["silent"] += bool(why)
        if why:
            self.struck[why] += 1
        if bool(why) == bool(self._sent.get((node, cycle))):
            what = f"speaks under {why!r}" if why else "says nothing"
            raise Broken("who has a turn uses it", f"node {node} {what} in cycle {cycle}")

    def accepted(self, node: int, body: bytes) -> None:
        """Enter that a node's estimator has accepted a share.

        Raises:
            Broken: it has no numbers in it.
        """
        if body.startswith(_NO_NUMBERS):
            raise Broken("numbers that are none are refused", f"node {node} has accepted them")

    def rejected(self, node: int, body: bytes) -> None:
        """A node's estimator has refused to read a share.

        Raises:
            Broken: nothing is wrong with it.
        """
        if not body.startswith(_NO_NUMBERS):
            raise Broken("a share that was said is read", f"node {node} has refused one")
        ledger = self._node_ledgers[node]
        self.struck["nan"] += 1
        ledger.counts["heard"] -= 1
        ledger.counts["rejected"] += 1

    def refused(self, node: int, shares: int) -> None:
        """A node's estimator has refused so many shares that it had heard."""
        self.struck["indefinite"] += shares
        self._node_ledgers[node].refused_shares += shares

    def _compare(
        self, node: int, ledger: NodeLedger, counters: dict[str, int], silent: bool
    ) -> None:
        rejected = sum(n for name, n in counters.items() if name.startswith("rejected "))
        said = {name: counters.get(name, 0) for name in _BOOKED}
        said["rejected"] = rejected - ledger.refused_shares
        booked = {name: ledger.counts[name] for name in said}
        booked["silent"] += silent
        if said != booked:
            wrong = [
                f"{name} {said[name]} for {booked[name]}"
                for name in said
                if said[name] != booked[name]
            ]
            raise Broken(
                "counters add up",
                f"node {node} in cycle {ledger.cycle} counts {', '.join(wrong)}",
            )


def _end_cycle(config: NodeConfig, state: NodeState) -> int:
    return config.first_cycle + (state.step + 1 - config.first_step) * config.rounds
