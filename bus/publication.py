"""The slots that one node's share takes in one cycle."""

from typing import NamedTuple


class Slot(NamedTuple):
    """One frame: its ID and its payload length in bytes, padding included."""

    frame_id: int
    payload_bytes: int
