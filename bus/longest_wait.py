"""The longest wait of a contender: after how many cycles it has won at the latest, whatever all
nodes bid.

Assume that M nodes contend, that any R of their shares fit into a contest, and that the contender
asks in every contest until it wins. Where it asks in vain, R others win.

With urgency classes a contender is in class 0 once it has asked in vain A times in a row. Let
k = floor((M - 1) / R), with 1 <= k <= A.

First win: in contest A + k at the latest. Otherwise the contender asks in vain in the contests A to
A + k. In the last k of these it is in class 0, and so are the R winners before it. A winner is
not in class 0 before it has asked in vain A times again, so the winners of these k + 1 contests are
different nodes. With the contender itself they are R (k + 1) + 1 nodes, which is more than M.
The bound is sharp: R nodes whose bids are the largest win A contests, then the others win by
number, and the last of them wins in contest A + k.

Next win, where all contenders ask in every contest and R of them win: A + 1 contests after the
last one, but not before contest A + k. In one of the contests A + 1 to A + k at most R nodes are in
class 0, as above. They all win. Only the R winners of A + 1 contests ago are in class 0 in the next
contest, and so on.

With relay a cycle has S contests for one slot each. An ID may be over in the cycle in which its
node grows old, but not in the next one: IDs of class 0 come first, and the winners before the
contender have lower ones. It is old at the beginning of a cycle after ceil(A / S) cycles, and at
most M - 1 others win before it does.
"""

from collections.abc import Sequence
from typing import NamedTuple

from concord.bus.arbitration import Arbiter
from concord.bus.schedule import Schedule


class LongestWait(NamedTuple):
    """After how many cycles a contender that asks in all of them has won at the latest.

    `next_cycles` are those between two wins where all contenders ask in every cycle. In the first
    cycles of a run `first_cycles` holds in their place.
    """

    first_cycles: int
    next_cycles: int


def longest_wait(
    arbiter: Arbiter, old_after: int | None, schedule: Schedule, room: int
) -> LongestWait | None:
    """Return the longest wait of the contenders of a schedule.

    Args:
        arbiter: orders the requests.
        old_after: contests in vain after which age decides; None for never.
        schedule: who contends in which cycle.
        room: so many shares fit into a cycle, whichever they are.

    Returns:
        The wait; None where a node may wait for ever, or contends in some of the contests alone.
    """
    rows, slots = set(schedule.contender_table), schedule.dynamic_slot_table
    if arbiter.withdraws or schedule.relay:
        room = min(room, min((one for one in slots if one), default=0))
    if len(rows) > 1 or not room:
        return None
    (contenders,) = rows
    turns = -(-len(contenders) // room)
    if turns == 1:
        return LongestWait(*[_cycles(1, slots)] * 2)
    last = arbiter.last_contest(len(contenders) if schedule.relay else turns, old_after)
    if last is None:
        return None
    first = following = last
    if old_after is None or not arbiter.by_class:
        first = following = turns
    elif schedule.relay:
        first = following = -(-old_after // room) + turns
    elif room == max(slots) and arbiter.withdraws:
        following = old_after + 1
    return LongestWait(_cycles(first, slots), _cycles(following, slots))


def _cycles(contests: int, slots: Sequence[int]) -> int:
    """Return in how many cycles in a row there are so many contests at least."""
    counts = [count > 0 for count in slots]
    whole, rest = divmod(contests, sum(counts))
    longest = 0
    for first in range(len(counts)):
        seen = cycles = 0
        while seen < rest:
            seen += counts[(first + cycles) % len(counts)]
            cycles += 1
        longest = max(longest, cycles)
    return whole * len(counts) + longest
