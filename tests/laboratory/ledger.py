"""Double-entry book-keeping of frames: what must have become of each, beside what nodes count.

The ledger follows from what was sent, what arrived, and which changes were announced. They are made
frame by frame and compared with the counters of a node after every event; so every frame that
arrives is heard, lost, late, repeated or rejected, and exactly once.
"""

from collections import Counter
from collections.abc import Iterable

import numpy as np

from concord.bus.bus import Rejected
from concord.nodes.changes import Welcome
from concord.nodes.faults.losses import hears
from concord.nodes.faults.retries import Passage
from concord.nodes.messages import CycleClosed, NodeEvent, ShareHeard
from concord.nodes.node_state import NodeConfig, NodeState, Phase
from tests.laboratory.broken import Broken
from tests.laboratory.node_ledger import NodeLedger, Sent
from tests.laboratory.outcomes import Fate, fate_of, must_be_silent
from tests.laboratory.run_record import RunRecord

_BOOKED = ("sent", "silent", "heard", "lost", "late", "repeated", "reordered", "missed")
_EVENTS_PER_FRAME = 50
# First bytes of a share whose numbers are NaN, in either number format.
_NO_NUMBERS = (np.full(1, np.nan, "<f8").tobytes(), np.full(2, np.nan, "<f4").tobytes())


class OracleLedger:
    """Onlooker of one run; `loses_frames` says that some frames never come."""

    def __init__(self, record: RunRecord, nodes: int, loses_frames: bool) -> None:
        self.record = record
        self.struck: Counter[str] = Counter()
        self._node_ledgers = [NodeLedger(0, 0) for _ in range(nodes)]
        self._events = 0
        self._owners: dict[tuple[int, int, str], int] = {}
        self._loses_frames = loses_frames

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
            _check_peer_timeout(node, ledger, event, self._loses_frames)
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
        ledger.cycle, ledger.group, ledger.phase = state.cycle, state.group, state.phase
        self._settle(config, ledger)
        ledger.book_what_was_late()
        silent = self._keeps_silent(config, ledger, state.step)
        _compare(node, ledger, state.counters, silent)

    def _keeps_silent(self, config: NodeConfig, ledger: NodeLedger, step: int) -> bool:
        """Return whether a node has let a turn pass in the open group of the cycle."""
        if ledger.phase not in (Phase.GRANT, Phase.SHARES):
            return False
        turns = config.schedule.groups(ledger.cycle)[ledger.group].senders
        if ledger.phase is Phase.SHARES:
            turns = (*turns, *self.record.dynamic_turns(ledger.cycle, ledger.group))
        faults = self.record.faults(config, step)
        return config.index in turns and bool(
            must_be_silent(faults, step, ledger.cycle, config.index)
        )

    def _check_turns(self, config: NodeConfig) -> None:
        """Check that the node had a turn for each frame that it has just sent."""
        unchecked, self.record.unchecked = self.record.unchecked, []
        for one in unchecked:
            self._node_ledgers[one.sender].counts["sent"] += 1
            _check_slot(config, self._owners, one)
            groups = range(len(config.schedule.groups(one.cycle)))
            winners = [w for group in groups for w in self.record.dynamic_turns(one.cycle, group)]
            if one.sender not in (*config.schedule.static_senders(one.cycle), *winners):
                raise Broken(
                    "who sends has a turn", f"node {one.sender} has none in cycle {one.cycle}"
                )

    def _check_progress(self) -> None:
        self._events += 1
        if self._events > 10_000 + _EVENTS_PER_FRAME * (
            len(self.record.genuine) + len(self.record.estimates)
        ):
            raise Broken("progress", f"{self._events} events and no end")

    def _book(self, config: NodeConfig, ledger: NodeLedger, sender: int, frame: bytes) -> None:
        """One frame that has arrived."""
        sent = self.record.genuine.get(frame)
        if sent is None:
            _book_forgery(config, ledger, sender, frame)
            return
        key = (sender, sent.cycle, sent.frame_id)
        if sent.cycle < ledger.cycle:
            ledger.counts["late"] += 1
        elif sent.sender != sender:
            # A valid frame that another node sent in its own slot.
            ledger.book_untold(sender, sent.cycle, key)
        elif key in ledger.seen:
            ledger.counts["repeated"] += 1
        else:
            ledger.seen.add(key)
            if sent.cycle >= ledger.end_cycle:
                ledger.early.append((sender, sent, key))
            else:
                self._file(config, ledger, sender, sent)

    def _file(self, config: NodeConfig, ledger: NodeLedger, sender: int, sent: Sent | None) -> None:
        """Enter a frame of the open step."""
        if sent is None:
            ledger.counts["rejected"] += 1
            return
        # The changes, not the node, tell which links are cut.
        step, _ = self.record.history.place(sent.cycle)
        receiver, cycle = config.index, sent.cycle
        arrives = (sender, receiver) not in self.record.cuts and hears(
            config.links._replace(cuts=frozenset()), step, cycle, sender, receiver, sent.number
        )
        if arrives and self.record.faults(config, step).are_active:
            fate = self._fate(config, step, sender, sent)
            self.struck.update(fate.struck)
            ledger.suffer(sender, sent, fate)
            return
        ledger.counts["lost"] += not arrives
        ledger.arrive(sender, sent, arrives)

    def _fate(self, config: NodeConfig, step: int, sender: int, sent: Sent) -> Fate:
        place = config.bus.place(sender, config.bus.receive(sent.frame))
        way = Passage(
            step, sent.cycle, sender, config.index, sent.number, sent.frame_id, place.channels
        )
        return fate_of(
            self.record.faults(config, step),
            way,
            sent.frame,
            sender in config.schedule.contenders(sent.cycle),
            lambda node: config.bus.in_slot_of(sent.frame, node, sent.cycle) is not None,
        )

    # --- what nodes say of themselves ---------------------------------------------------------

    def missed(self, config: NodeConfig, cycle: int, group: int, silent: Iterable[int]) -> None:
        """Enter that a node fuses a group of a cycle without usable shares of these neighbours."""
        senders = config.schedule.groups(cycle)[group].senders
        due = {*senders, *self.record.grants.get((cycle, group), ())}
        step, _ = self.record.history.place(cycle)
        ledger = self._node_ledgers[config.index]
        ledger.counts["missed"] += sum(
            j in due and self.record.history.is_in(j, step) for j in silent
        )
        ledger.fused.append(cycle)
        if config.index in (*senders, *self.record.dynamic_turns(cycle, group)):
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
        why = must_be_silent(self.record.faults(config, step), step, cycle, node)
        self._node_ledgers[node].counts["silent"] += bool(why)
        if why:
            self.struck[why] += 1
        if bool(why) == self.record.has_sent(node, cycle):
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


def _check_slot(config: NodeConfig, owners: dict[tuple[int, int, str], int], sent: Sent) -> None:
    """Check that no other node has sent in the slot of a frame, on one of its channels."""
    place = config.bus.place(sent.sender, config.bus.receive(sent.frame))
    for channel in place.channels or config.bus.channels:
        owner = owners.setdefault((sent.cycle, sent.frame_id, channel), sent.sender)
        if owner != sent.sender:
            raise Broken(
                "one sender per slot and channel",
                f"nodes {owner} and {sent.sender} send frame {sent.frame_id} in cycle {sent.cycle}",
            )


def _book_forgery(config: NodeConfig, ledger: NodeLedger, sender: int, frame: bytes) -> None:
    """Enter a frame that no sender sent: broken, or with the cycle counter of another cycle."""
    try:
        fragment = config.bus.frame_format.read(frame)
    except Rejected:
        ledger.counts["rejected"] += 1
        return
    key = (sender, fragment.cycle, fragment.frame_id, fragment.count or 0)
    if fragment.cycle < ledger.cycle:
        ledger.counts["late"] += 1
    else:
        ledger.book_untold(sender, fragment.cycle, key)


def _check_peer_timeout(
    node: int, ledger: NodeLedger, closed: CycleClosed, loses_frames: bool
) -> None:
    """Time runs out only where something that was sent never comes."""
    if (ledger.cycle, ledger.group) != (closed.cycle, closed.group):
        return
    if ledger.phase is Phase.GRANT or not loses_frames:
        what = "a grant" if ledger.phase is Phase.GRANT else "a share"
        raise Broken("nobody waits in vain", f"node {node} in cycle {ledger.cycle} for {what}")


def _compare(node: int, ledger: NodeLedger, counters: dict[str, int], silent: bool) -> None:
    rejected = sum(n for name, n in counters.items() if name.startswith("rejected "))
    counted = {name: counters.get(name, 0) for name in _BOOKED}
    counted["rejected"] = rejected - ledger.refused_shares
    booked = {name: ledger.counts[name] for name in counted}
    booked["silent"] += silent
    wrong = [f"{name} {counted[name]} for {n}" for name, n in booked.items() if counted[name] != n]
    if wrong:
        raise Broken(
            "counters add up", f"node {node} in cycle {ledger.cycle} counts {', '.join(wrong)}"
        )


def _end_cycle(config: NodeConfig, state: NodeState) -> int:
    return config.first_cycle + (state.step + 1 - config.first_step) * config.rounds
