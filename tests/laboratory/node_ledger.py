"""Ledger of one node in a run: the counts that it must report, and the shares still to come."""

from collections import Counter
from typing import NamedTuple

from concord.nodes.node_state import Phase
from tests.laboratory.outcomes import Fate

Key = tuple[int, ...]
"""Sender, cycle and frame ID, and the cycle counter of a frame that has a wrong one."""


class Sent(NamedTuple):
    """A frame as it was sent: its place among the `parts` of its share."""

    sender: int
    cycle: int
    frame_id: int
    number: int
    parts: int
    data: bytes
    frame: bytes


class NodeLedger:
    """Ledger of one node since its start."""

    def __init__(self, cycle: int, end_cycle: int) -> None:
        self.cycle, self.end_cycle = cycle, end_cycle
        self.phase, self.group = Phase.MEASUREMENT, 0
        self.counts: Counter[str] = Counter()
        self.seen: set[Key] = set()
        self.early: list[tuple[int, Sent | None, Key]] = []
        self.refused_shares = 0
        # The checks of an event run after all of its entries are made. Until then these lists hold
        # cycles, (step, cycle) of turns, (sender, cycle) of shares.
        self.fused: list[int] = []
        self.turns: list[tuple[int, int]] = []
        self.used: list[tuple[int, int]] = []
        self._arrived: dict[tuple[int, int], list[bool]] = {}
        self._parts: dict[tuple[int, int], int] = {}
        self._overtaken: set[tuple[int, int]] = set()
        self._later: list[tuple[int, str]] = []

    def book_untold(self, sender: int, cycle: int, key: Key) -> None:
        """Enter a frame that is wrong in a way that no node knows before the step begins."""
        if cycle < self.end_cycle or self.phase is not Phase.MEASUREMENT:
            self.counts["rejected"] += 1
        elif any(key == other for *_, other in self.early):
            self.counts["repeated"] += 1
        else:
            self.early.append((sender, None, key))

    def arrive(self, sender: int, sent: Sent, is_usable: bool) -> None:
        """Enter a frame that has come in its slot, usable or not."""
        key = (sent.cycle, sender)
        self._parts[key] = sent.parts
        self._arrived.setdefault(key, []).append(is_usable)
        if key not in self._overtaken:
            self.counts["heard"] += self.is_whole(sender, sent.cycle)

    def suffer(self, sender: int, sent: Sent, fate: Fate) -> None:
        """Enter a frame that a fault has affected."""
        self.counts.update(fate.counts)
        self._later += fate.later
        self._overtaken |= {(sent.cycle, sender)} if fate.is_overtaken else set()
        self.arrive(sender, sent, fate.is_usable)

    def is_whole(self, sender: int, cycle: int) -> bool:
        """Return whether all frames of a share have come unchanged."""
        came = self._arrived.get((cycle, sender), [])
        return len(came) == self._parts.get((cycle, sender)) and all(came)

    def let_in_overtaken(self) -> None:
        """Count the overtaken frames of a group before the group is fused."""
        for cycle in self.fused:
            overtaken = {key for key in self._overtaken if key[0] == cycle}
            self._overtaken -= overtaken
            self.counts["heard"] += sum(self.is_whole(sender, cycle) for _, sender in overtaken)

    def book_what_was_late(self) -> None:
        """Count each delayed frame when the cycle begins in which it is due."""
        is_open = self.phase in (Phase.GRANT, Phase.SHARES)
        begun = self.cycle if is_open else self.cycle - 1
        self.counts.update(counted for cycle, counted in self._later if cycle <= begun)
        self._later = [one for one in self._later if one[0] > begun]
