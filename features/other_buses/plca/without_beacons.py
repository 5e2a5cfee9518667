"""10BASE-T1S without beacons: its nodes fall back to CSMA/CD, or are silent.

Source: IEEE 802.3cg-2019, clause 148.4.4: a node that receives no beacon leaves PLCA inactive, and
its MAC uses carrier sense and collision detection. IEEE 802.3-2018, clause 4.2.3.2.5: truncated
binary exponential backoff with slots of 512 bits, and 16 attempts. Some PHYs keep their transmitter
off instead.
"""

from collections.abc import Callable, Sequence
from functools import lru_cache
from math import inf

from concord.features.other_buses.plca.ethernet import GAP_BITS, frame_bits
from concord.nodes.faults.losses import fraction

SLOT_BITS = 512
COLLISION_BITS = 96
"""Preamble and jam of the frames that collide; the delay of the cable is left out."""
MOST_ATTEMPTS = 16
_MOST_DOUBLINGS = 10
_NO_RECEIVER = (1 << 16) + 2


@lru_cache(4096)
def gets_through(
    key: tuple[int, int],
    cycle: int,
    senders: tuple[int, ...],
    payloads: tuple[int, ...],
    cycle_bits: float,
) -> frozenset[int]:
    """Return the nodes whose shares CSMA/CD sends whole in a cycle; `key` is that of the draws.

    All shares are ready at the beginning of the cycle, in frames with these payload bytes.
    """

    def draw(node: int, collision: int) -> float:
        return fraction(key, cycle, node, _NO_RECEIVER, collision)

    ends = contend(senders, payloads, draw)
    return frozenset(node for node, end in ends.items() if end <= cycle_bits)


def contend(
    senders: Sequence[int], payloads: Sequence[int], draw: Callable[[int, int], float]
) -> dict[int, float]:
    """Return when each node's last frame ends, in bit times; infinite for a share that is given up.

    `draw` of a node and the number of its collision is in [0, 1): the part of the backoff window.
    """
    ready = dict.fromkeys(senders, 0)
    left = dict.fromkeys(senders, 0)
    attempts, collisions = dict.fromkeys(senders, 0), dict.fromkeys(senders, 0)
    ends: dict[int, float] = {}
    free = 0
    while ready:
        # Each waits for an idle medium, so those that became ready meanwhile begin together.
        begin = max(free, min(ready.values())) + GAP_BITS
        starting = [node for node, since in ready.items() if since + GAP_BITS <= begin]
        if len(starting) == 1:
            (node,) = starting
            free = begin + frame_bits(payloads[left[node]])
            left[node] += 1
            attempts[node] = 0
            if left[node] == len(payloads):
                ends[node] = free
                del ready[node]
            else:
                ready[node] = free
            continue
        free = begin + COLLISION_BITS
        for node in starting:
            attempts[node] += 1
            collisions[node] += 1
            if attempts[node] == MOST_ATTEMPTS:
                ends[node] = inf
                del ready[node]
                continue
            window = 1 << min(attempts[node], _MOST_DOUBLINGS)
            ready[node] = free + SLOT_BITS * int(draw(node, collisions[node]) * window)
    return ends
