"""The part of a bus that knows how many nodes contend, and how long they wait."""

from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from concord.bus.arbitration import Arbiter, Numbers
from concord.bus.longest_wait import LongestWait, longest_wait
from concord.bus.schedule import Schedule


class BidClasses(Protocol):
    """Classes of bids: 0 is the most urgent (`concord.bus.arbitration`)."""

    @property
    def count(self) -> int:
        """Return the number of classes."""
        ...

    @property
    def old_after(self) -> int | None:
        """Return after how many contests in vain a node has the first class; None for never."""
        ...

    def of(self, bids: Numbers, waits: Numbers) -> NDArray[np.int64]:
        """Return the class of each bid (...) of a node that asked in vain `waits` (...) times."""
        ...


class ContendedBus:
    """A bus whose arbiter awards slots to the contenders of a schedule."""

    schedule: Schedule
    classes: BidClasses
    _arbiter: Arbiter

    def dynamic_room(self) -> int:
        """Return how many of the contenders that may win in a cycle fit whichever of them do, in
        whatever class."""
        return self._most_winners

    @property
    def longest_wait(self) -> LongestWait | None:
        """Return the longest wait of any contender; None where it may be for ever."""
        room = self.dynamic_room()
        return longest_wait(self._arbiter, self.classes.old_after, self.schedule, room)

    @property
    def _most_winners(self) -> int:
        slots = max(self.schedule.dynamic_slot_table)
        contenders = len(self._contenders) if slots else 0
        return min(slots, contenders) if self._arbiter.withdraws else contenders

    @cached_property
    def _contenders(self) -> list[int]:
        return sorted({node for row in self.schedule.contender_table for node in row})
