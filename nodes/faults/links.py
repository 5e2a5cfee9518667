"""Faults of links: the outcome of one frame on its way to one receiver.

All frames travel in every driver. The receiver applies the faults here, as a pure function of the
active faults and of the frame. So no node waits for a frame that never comes, and all drivers
agree. Altered bytes go through the receiver's own checks, which must detect them.
"""

from typing import NamedTuple

from concord.bus.bus import Bus
from concord.nodes.faults.active import EVERYBODY, Faults, hangs
from concord.nodes.faults.retries import (
    Passage,
    collides,
    failed_tries,
    is_given_up,
    without_errors,
)
from concord.nodes.faults.senders import sent


class Arrival(NamedTuple):
    """Arrival of a frame at a receiver.

    Attributes:
        frame: as it comes. in_slot: whether it does so in its own.
        counted: what the receiver counts of one that does not come at all.
        copies: how often it comes again at once. later: in how many cycles it comes as well.
        is_overtaken: all others of the cycle come before it.
    """

    frame: bytes
    in_slot: bool = True
    counted: tuple[str, ...] = ()
    copies: int = 0
    later: tuple[int, ...] = ()
    is_overtaken: bool = False


def arrival(faults: Faults, way: Passage, frame: bytes, bus: Bus) -> Arrival:
    """Return the arrival of a frame, given the frame that its sender meant to send."""
    clocks = faults.clocks(way.cycle)
    halted = clocks is not None and not clocks.hears[way.receiver]
    if halted or hangs(faults, way.step, way.receiver):
        return _nothing("lost")
    if faults.equipment.retransmissions:
        if is_given_up(faults, failed_tries(faults, way, bus.schedule)):
            return _nothing("rejected error-frame")
        faults = without_errors(faults)
    apart_us = _ahead_us(faults, way, way.sender) - _ahead_us(faults, way, way.receiver)
    if abs(apart_us) > faults.equipment.precision_us:
        return _nothing("rejected slot-boundary")
    if collides(faults, way, bus.schedule):
        return _nothing("rejected collision")
    if not _carried(faults, way):
        return _nothing("lost")
    whole = sent(faults, way.step, way.cycle, way.sender, way.number, frame, bus)
    read = _corrupted(faults, way, whole)
    replay = faults.at("replay", way.step, way.sender)
    later = (int(replay[1]),) if replay and _before(faults, "replay", way, replay[0]) else ()
    late = _late(faults, way)
    if late:
        return Arrival(read, False, later=(late, *(late + again for again in later)))
    copies = int(_strikes(faults, "duplicate", way))
    return Arrival(read, True, (), copies, later, _strikes(faults, "reorder", way))


def _nothing(why: str) -> Arrival:
    return Arrival(b"", False, (why,))


def _ahead_us(faults: Faults, way: Passage, node: int) -> float:
    """How far a node's clock is ahead of the nominal time."""
    clocks = faults.clocks(way.cycle)
    if clocks is not None:
        return clocks.ahead_us[node]
    drift = faults.at("drift", way.step, node)
    if drift is None:
        return 0.0
    cycles = way.cycle + 1 - faults.first_cycle("drift", node)
    return drift[0] * 1e-6 * cycles * faults.equipment.cycle_us


def _carried(faults: Faults, way: Passage) -> bool:
    """Whether one of the channels brings it: each loses frames for all who listen to it."""
    return any(carries(faults, way, one) for one in way.channels or faults.equipment.channels)


def carries(faults: Faults, way: Passage, channel: str) -> bool:
    """Return whether the channel carries a frame that is on it; for every receiver."""
    place = faults.equipment.channels.index(channel)
    fails = faults.at("channel", way.step, place)
    draw = faults.draw("channel", way.cycle, way.sender, EVERYBODY + 1 + place, way.number)
    return fails is None or draw >= fails[0]


def _corrupted(faults: Faults, way: Passage, frame: bytes) -> bytes:
    """The frame with so few wrong bits that its receiver is sure to find them."""
    if not _strikes(faults, "corrupt", way):
        return frame
    bits = bytearray(frame)
    flipped = 1 + int(faults.equipment.noticed_bits * _draw(faults, "corrupted bits", way))
    places = {
        int(8 * len(frame) * _draw(faults, f"corrupted bit {place}", way))
        for place in range(flipped)
    }
    for place in places:
        bits[place // 8] ^= 1 << place % 8
    return bytes(bits)


def _late(faults: Faults, way: Passage) -> int:
    """Return by how many cycles the frame is late."""
    late = 0
    if slow := faults.at("slow", way.step, way.sender):
        late += int(slow[0])
    delay = faults.at("delay", way.step, way.sender, way.receiver)
    if delay and _before(faults, "delay", way, delay[0]):
        late += int(delay[1])
    if jitter := faults.at("jitter", way.step, way.sender, way.receiver):
        late += int((int(jitter[0]) + 1) * _draw(faults, "jitter", way))
    return late


def _strikes(faults: Faults, kind: str, way: Passage) -> bool:
    numbers = faults.at(kind, way.step, way.sender, way.receiver)
    return numbers is not None and _before(faults, kind, way, numbers[0])


def _before(faults: Faults, kind: str, way: Passage, probability: float) -> bool:
    return _draw(faults, kind, way) < probability


def _draw(faults: Faults, kind: str, way: Passage) -> float:
    return faults.draw(kind, way.cycle, way.sender, way.receiver, way.number)
