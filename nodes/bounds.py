"""Bounds on the size and the numbers of any message; a receiver checks them before use."""

from typing import Annotated

from msgspec import Meta, MsgspecError

# Exceptions that a decoder of JSON may raise for bytes that are not JSON, or nested too deep.
UNREADABLE = (MsgspecError, UnicodeDecodeError, RecursionError)
# An estimate of a hundred states takes about 120 kB of JSON.
MAX_MESSAGE_BYTES = 1 << 20
# The longest frame of any bus: header (5), payload (254), checksum (3).
MAX_FRAME_BYTES = 262

NodeIndex = Annotated[int, Meta(ge=0, lt=1 << 16)]
# Steps and cycles: a cycle number has four bytes in a frame.
Instant = Annotated[int, Meta(ge=0, lt=1 << 32)]
Group = Annotated[int, Meta(ge=0, lt=1 << 16)]
UrgencyClass = Annotated[int, Meta(ge=0, lt=1 << 16)]
# More rounds than this no step of a running network has.
MAX_ROUNDS = 100
NodeList = Annotated[list[NodeIndex], Meta(max_length=1 << 16)]
NodeTuple = Annotated[tuple[NodeIndex, ...], Meta(max_length=1 << 16)]


def node_of(name: str, nodes: int) -> int | None:
    """The node of a network of so many that has this name; None where no node has it."""
    # Other spellings of its number are other names, and some are too long to be numbers.
    if len(name) > len(str(nodes)) or not (name.isascii() and name.isdecimal()):
        return None
    node = int(name)
    return node if node < nodes and str(node) == name else None
