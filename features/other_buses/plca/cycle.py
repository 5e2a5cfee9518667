"""Cycles of PLCA: a beacon, then one transmit opportunity for each node, in order.

Source: IEEE 802.3cg-2019, clause 148. The gap between packets counts before each frame: a node
holds its opportunity by COMMIT until the gap of its MAC is over.
"""

from collections.abc import Sequence
from typing import NamedTuple

from concord.features.other_buses.plca.ethernet import GAP_BITS, frame_bits

BIT_US = 0.1
BEACON_BITS = 20


class PlcaSettings(NamedTuple):
    """Settings of all nodes of a PLCA network.

    Attributes:
        opportunity_bits: an opportunity that its node does not use (aPLCATransmitOpportunityTimer).
        burst_frames: frames that a node may send after the first of its opportunity
            (aPLCAMaxBurstCount).
        burst_timer_bits: how long the others wait for the next frame of a burst that is not full
            (aPLCABurstTimer).
    """

    opportunity_bits: int = 32
    burst_frames: int = 0
    burst_timer_bits: int = 128

    def waits_bits(self, frames: int) -> int:
        """Return how long the bus is idle after a burst of so many frames."""
        return self.burst_timer_bits if 0 < frames <= self.burst_frames else 0


class PlcaTransmission(NamedTuple):
    """Frame `number` of a node, in bit times from the first beacon: preamble to check sequence."""

    node: int
    number: int
    start_bits: int
    end_bits: int


def walk(
    timing: PlcaSettings, payloads: Sequence[Sequence[int]]
) -> tuple[list[PlcaTransmission], int]:
    """Return the frames of all nodes with their times, and the end of the last PLCA cycle.

    `payloads` has the payload bytes of each frame of each node, ready at the first beacon. PLCA
    cycles follow each other until all are sent.
    """
    sent: list[PlcaTransmission] = []
    done, now = [0] * len(payloads), 0
    while any(count < len(sizes) for count, sizes in zip(done, payloads, strict=True)):
        now += BEACON_BITS
        for node, sizes in enumerate(payloads):
            first = done[node]
            turn = sizes[first : first + 1 + timing.burst_frames]
            for number, size in enumerate(turn, first):
                start = now + GAP_BITS
                now = start + frame_bits(size)
                sent.append(PlcaTransmission(node, number, start, now))
            done[node] += len(turn)
            now += timing.waits_bits(len(turn)) if turn else timing.opportunity_bits
    return sent, now


def cycles_of(timing: PlcaSettings, frames: int) -> int:
    """Return the PLCA cycles that a share of so many frames takes."""
    return -(-frames // (1 + timing.burst_frames))


def share_bits(payloads: Sequence[int]) -> int:
    """Return the time of the frames of a share with the gaps before them."""
    return sum(GAP_BITS + frame_bits(size) for size in payloads)


def longest_walk_bits(
    timing: PlcaSettings, nodes: int, senders: int, payloads: Sequence[int]
) -> int:
    """Return the time in which `senders` of the nodes send a share of these frames each."""
    cycles = cycles_of(timing, len(payloads))
    idle = cycles * (BEACON_BITS + (nodes - senders) * timing.opportunity_bits)
    last = len(payloads) - (cycles - 1) * (1 + timing.burst_frames)
    return idle + senders * (share_bits(payloads) + timing.waits_bits(last))


def worst_access_bits(timing: PlcaSettings, nodes: int, payloads: Sequence[int]) -> int:
    """Return the longest time from the request of a share to its last bit.

    The request comes as the opportunity of its node has begun, and all other nodes send as many of
    their longest frames as they may in every PLCA cycle.
    """
    turn = share_bits([max(payloads)] * (1 + timing.burst_frames))
    others = (nodes - 1) * max(turn, timing.opportunity_bits)
    cycles = cycles_of(timing, len(payloads))
    return timing.opportunity_bits + cycles * (BEACON_BITS + others) + share_bits(payloads)
