"""What recorded bytes mean.

Who records hears everybody, also somebody who obeys no rule: what is no message, or of no node of
the network, is kept as it came and means nothing.
"""

from typing import Any, NamedTuple

from nodes.estimator import Rejected
from nodes.messages import MalformedMessage, decode, is_topic
from nodes.share import Fragment, read_frame


class SharedFrame(NamedTuple):
    """A frame of a share, and which node has sent it."""

    node: int
    fragment: Fragment


def meaning(topic: str, data: bytes, nodes: int) -> Any:
    """The message (`nodes/messages.py`) or `SharedFrame` of a network of so many nodes; None for
    anything else."""
    if not is_topic(topic, nodes):
        return None
    kind, _, owner = topic.partition("/")
    try:
        if kind == "share":
            return SharedFrame(int(owner), read_frame(data))
        return decode(topic, data)
    except (MalformedMessage, Rejected):
        return None
