"""Frames of a node that is broken or lies: other bodies, and other frames on the bus."""

import numpy as np

from concord.bus.bus import Bus
from concord.filters.gaussian import Gaussian
from concord.nodes.faults.active import EVERYBODY, Faults
from concord.nodes.vector_codec import BeliefCodec, not_numbers

# A bit of the checksum that a broken controller turns over.
_LAST_BIT = 1


def spoken(faults: Faults, step: int, cycle: int, node: int, body: bytes) -> bytes:
    """The body of a share as the node sends it: its own, or what it says instead."""
    equipment = faults.equipment
    codec = equipment.codec
    if codec is not None and (lie := faults.at("lie", step, node)):
        body = _lied(codec, body, *lie)
    if codec is not None and _strikes(faults, "indefinite", step, cycle, node):
        belief = codec.decode(body)
        body = codec.encode(Gaussian(belief.mean, -belief.cov))
    if equipment.number and _strikes(faults, "nan", step, cycle, node):
        count = len(body) // np.dtype(equipment.number).itemsize
        body = not_numbers(count, equipment.number)
    return body


def sent(
    faults: Faults, step: int, cycle: int, node: int, number: int, frame: bytes, bus: Bus
) -> bytes:
    """Frame `number` of a node's share in a cycle as its bus controller sends it."""
    wrong = faults.at("wrong-step", step, node)
    if wrong is not None and faults.draw("wrong-step", cycle, node, EVERYBODY, number) < wrong[0]:
        # Before the first cycle there is no earlier one.
        frame = bus.renumbered(frame, max(0, cycle - int(wrong[1])))
    if _strikes(faults, "null", step, cycle, node, number):
        frame = bus.frame_format.emptied(frame)
    if _strikes(faults, "crc", step, cycle, node, number):
        frame = frame[:-1] + bytes([frame[-1] ^ _LAST_BIT])
    return frame


def spoofed(faults: Faults, step: int, cycle: int, node: int, number: int) -> tuple[int, ...]:
    """In whose names a node also sends what its frame says."""
    return tuple(
        victim
        for kind, nodes in faults.standing
        if kind == "spoof" and nodes[0] == node
        for victim in nodes[1:]
        if (spoof := faults.at("spoof", step, node, victim))
        and faults.draw("spoof", cycle, node, victim, number) < spoof[0]
    )


def _strikes(faults: Faults, kind: str, step: int, cycle: int, node: int, number: int = 0) -> bool:
    numbers = faults.at(kind, step, node)
    return numbers is not None and faults.draw(kind, cycle, node, EVERYBODY, number) < numbers[0]


def _lied(codec: BeliefCodec, body: bytes, size: float, inverse_volume: float) -> bytes:
    belief = codec.decode(body)
    spread = np.sqrt(np.diagonal(belief.cov))
    return codec.encode(Gaussian(belief.mean + size * spread, belief.cov / inverse_volume))
