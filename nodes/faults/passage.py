"""The way of one frame from its sender to one receiver."""

from typing import NamedTuple


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
