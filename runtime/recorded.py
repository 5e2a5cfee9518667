"""The meaning of recorded bytes.

A recorder hears every sender, even one that obeys no rule. Bytes that are no message, or that
belong to no node of the network, are kept as received and mean nothing.
"""

from typing import NamedTuple

from concord.bus.bus import Fragment, FrameFormat, Rejected
from concord.nodes.bounds import MAX_ROUNDS
from concord.nodes.messages import Estimate, MalformedMessage, Message, Truth, decode, is_topic
from concord.scenarios.setup import Setup


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


def fits(message: Message | SharedFrame | None, setup: Setup) -> bool:
    """Whether a truth or an estimate has the sizes of a network, and ages that its step allows."""
    match message:
        case Truth():
            return len(message.state) == len(setup.initial_state)
        case Estimate():
            n, oldest = len(setup.prior_mean), (message.step + 1) * MAX_ROUNDS
            return (
                (len(message.mean), len(message.cov)) == (n, n * (n + 1) // 2)
                and len(message.ages) <= setup.scenario.nodes
                and all(-1 <= age <= oldest for age in message.ages)
            )
    return True
