"""The meaning of recorded bytes.

A recorder hears every sender, even one that obeys no rule. Bytes that are no message, or that
belong to no node of the network, are kept as received and mean nothing.
"""

from typing import NamedTuple

from concord.bus.bus import Fragment, FrameFormat, Rejected
from concord.nodes.messages import MalformedMessage, Message, decode, is_topic


class SharedFrame(NamedTuple):
    """A frame of a share, and which node has sent it."""

    node: int
    fragment: Fragment


def meaning(
    topic: str, data: bytes, nodes: int, frame_format: FrameFormat
) -> Message | SharedFrame | None:
    """Return the message or the frame in recorded bytes of a network of so many nodes, whose bus
    has frames of this format; None for anything else."""
    kind, _, owner = topic.partition("/")
    if kind != "share":
        return message_of(topic, data, nodes)
    if not is_topic(topic, nodes):
        return None
    try:
        return SharedFrame(int(owner), frame_format.read(data))
    except Rejected:
        return None


def message_of(topic: str, data: bytes, nodes: int) -> Message | None:
    """Return the message (`nodes/messages.py`) in recorded bytes; None for anything else."""
    if not is_topic(topic, nodes):
        return None
    try:
        return decode(topic, data)
    except MalformedMessage:
        return None
