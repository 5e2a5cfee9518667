"""Frames that are sent again after an error, on a bus with automatic retransmission.

Any receiver that sees an error sends an error frame, so all receivers drop the frame and its sender
sends it again (ISO 11898-1:2015, 10.7 and 10.9). Faults that spoil a frame on the wire cause
errors: noise of a babbling node, a wrong checksum of the sender, and wrong bits at a receiver.
"""

from collections.abc import Sequence
from typing import NamedTuple

from concord.bus.bus import Bus
from concord.bus.schedule import Schedule
from concord.nodes.faults.active import EVERYBODY, Faults, hangs

_ERRORS = ("babble", "crc", "corrupt")


class Passage(NamedTuple):
    """One frame and its way: number `number` of the share of `sender` in `cycle`, in slot
    `frame_id` of these channels; empty for all channels of the bus."""

    step: int
    cycle: int
    sender: int
    receiver: int
    number: int
    frame_id: int
    channels: str = ""


def tried(kind: str, retry: int) -> str:
    """Return the name of a fault's draw for a frame that is sent for the `retry`-th time again."""
    return f"{kind} again {retry}" if retry else kind


def collides(faults: Faults, way: Passage, schedule: Schedule, retry: int = 0) -> bool:
    """Return whether a node babbles in this slot, and nothing blocks it; for every receiver.

    A bus guardian knows the owner of each slot that the schedule gives to one node. It cannot know
    which contender wins a slot of the dynamic segment (FlexRay bus guardian specification 2.0.9).
    """
    owned = way.sender in schedule.static_senders(way.cycle)
    if owned and faults.at("guardian", way.step):
        return False
    babblers = [nodes[0] for kind, nodes in faults.standing if kind == "babble"]
    for node in babblers:
        babble = faults.at("babble", way.step, node)
        if babble is None or node == way.sender or hangs(faults, way.step, node):
            continue
        kind = tried("babble", retry)
        if faults.draw(kind, way.cycle, node, EVERYBODY, way.frame_id) < babble[0]:
            return True
    return False


def failed_tries(faults: Faults, way: Passage, schedule: Schedule) -> int:
    """Return how many tries of a frame end in an error, for every receiver.

    It is at most one more than the bus sends a frame again; the frame is then lost.
    """
    tries = faults.equipment.retransmissions + 1
    if not any(kind in _ERRORS for kind, _ in faults.standing):
        return 0
    return next((k for k in range(tries) if not _fails(faults, way, schedule, k)), tries)


def failed_frames(
    faults: Faults, step: int, cycle: int, sender: int, frames: Sequence[bytes], bus: Bus
) -> int:
    """Return how many tries of all frames of a share end in an error."""
    ids = [bus.receive(frame).frame_id for frame in frames]
    ways = [
        Passage(step, cycle, sender, EVERYBODY, number, frame_id)
        for number, frame_id in enumerate(ids)
    ]
    return sum(failed_tries(faults, way, bus.schedule) for way in ways)


def is_given_up(faults: Faults, failed: int) -> bool:
    """Return whether a frame with so many failed tries is lost."""
    return failed > faults.equipment.retransmissions


def without_errors(faults: Faults) -> Faults:
    """Return the faults that strike a try without an error."""
    standing = {place: one for place, one in faults.standing.items() if place[0] not in _ERRORS}
    return faults._replace(standing=standing)


def _fails(faults: Faults, way: Passage, schedule: Schedule, retry: int) -> bool:
    if collides(faults, way, schedule, retry):
        return True
    receivers = [
        node for node, heard in enumerate(faults.equipment.neighbours) if way.sender in heard
    ]
    return _strikes(faults, "crc", way, (way.sender,), EVERYBODY, retry) or any(
        _strikes(faults, "corrupt", way, (way.sender, node), node, retry) for node in receivers
    )


def _strikes(
    faults: Faults, kind: str, way: Passage, place: tuple[int, ...], receiver: int, retry: int
) -> bool:
    numbers = faults.at(kind, way.step, *place)
    draw = faults.draw(tried(kind, retry), way.cycle, way.sender, receiver, way.number)
    return numbers is not None and draw < numbers[0]
