"""Worst-case response times on CAN: from the request of a message to its last bit.

Source: Davis, Burns, Bril and Lukkien, "Controller Area Network (CAN) schedulability analysis:
refuted, revisited and revised", Real-Time Systems 35 (2007), equations 3 to 7 and section 3.2. The
busy period of a level may hold several instances of its message; the worst is not always the first.
"""

from collections.abc import Sequence
from fractions import Fraction
from math import ceil
from typing import NamedTuple


class Message(NamedTuple):
    """A message of a node.

    Attributes:
        identifier: the lowest wins.
        time_us: longest frame with the intermission behind it.
        period_us: shortest time between requests.
        jitter_us: longest time from the event of a request to the queue.
    """

    identifier: int
    time_us: Fraction | float
    period_us: Fraction | float
    jitter_us: Fraction | float = 0


class MessageResponse(NamedTuple):
    """The bound of a message.

    `worst_us` counts from the event of a request to the end of the intermission; None where frames
    with lower identifiers may keep it waiting for ever. `instances` are in the busy period.
    """

    identifier: int
    worst_us: Fraction | None
    blocking_us: Fraction
    instances: int


def response_times(messages: Sequence[Message], bit_us: Fraction | float) -> list[MessageResponse]:
    """Return the bound of each message, by identifier. `bit_us` is a bit of the arbitration.

    Raises:
        ValueError: two messages have one identifier, or a time is not positive.
    """
    ordered = [_exact(one) for one in sorted(messages)]
    if len({one.identifier for one in ordered}) < len(ordered):
        raise ValueError("two messages with one identifier: give each message its own")
    for one in ordered:
        if one.time_us <= 0 or one.period_us <= 0 or one.jitter_us < 0:
            raise ValueError(
                f"message {one.identifier} lasts {float(one.time_us):g} us, has period "
                f"{float(one.period_us):g} us and jitter {float(one.jitter_us):g} us: the first "
                "two must be above 0, the last 0 or more"
            )
    return [_response(ordered, place, Fraction(bit_us)) for place in range(len(ordered))]


def _exact(one: Message) -> Message:
    return one._replace(
        time_us=Fraction(one.time_us),
        period_us=Fraction(one.period_us),
        jitter_us=Fraction(one.jitter_us),
    )


def _response(ordered: Sequence[Message], place: int, bit_us: Fraction) -> MessageResponse:
    own, level = ordered[place], ordered[: place + 1]
    blocking = Fraction(max((one.time_us for one in ordered[place + 1 :]), default=0))
    use = sum(Fraction(one.time_us) / Fraction(one.period_us) for one in level)
    waits = blocking or any(one.jitter_us for one in level)
    if use > 1 or (use == 1 and waits):
        return MessageResponse(own.identifier, None, blocking, 0)
    busy = _fixed_point(blocking, level, Fraction(0), Fraction(own.time_us))
    instances = ceil((busy + Fraction(own.jitter_us)) / Fraction(own.period_us))
    worst, wait = Fraction(0), blocking
    for instance in range(instances):
        ready = blocking + instance * Fraction(own.time_us)
        wait = _fixed_point(ready, ordered[:place], bit_us, max(wait, ready))
        end = wait - instance * Fraction(own.period_us) + Fraction(own.time_us)
        worst = max(worst, Fraction(own.jitter_us) + end)
    return MessageResponse(own.identifier, worst, blocking, instances)


def _fixed_point(
    constant: Fraction, messages: Sequence[Message], bit_us: Fraction, first: Fraction
) -> Fraction:
    """Return the least w >= first with w = constant + sum of ceil((w + J + bit) / T) C."""
    window = first
    while True:
        found = constant + sum(
            ceil((window + Fraction(one.jitter_us) + bit_us) / Fraction(one.period_us))
            * Fraction(one.time_us)
            for one in messages
        )
        if found <= window:
            return window
        window = Fraction(found)
