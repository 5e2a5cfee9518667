"""Automatic retransmission: frames that end in an error are sent again at once."""

from collections.abc import Sequence
from typing import Protocol, TypeGuard, runtime_checkable

from concord.bus.bus import Transmission


@runtime_checkable
class Retransmits(Protocol):
    """A bus whose controllers send a frame again when any receiver reports an error.

    `retransmissions` is how often at most. A cycle has time for all of them.
    """

    @property
    def retransmissions(self) -> int:
        """Return how often a frame is sent again at most."""
        ...

    def failed_us(self, payload_bytes: int) -> float:
        """Return the time of a frame that ends in an error, until the next one may begin."""
        ...

    def delays_us(self, cycle: Sequence[Transmission], failed: Sequence[int]) -> tuple[float, ...]:
        """Return how much later the first try of each frame of a cycle begins because of errors,
        where so many tries of each fail."""
        ...


def retransmits(bus: object) -> TypeGuard[Retransmits]:
    """Return whether a bus sends frames again after errors."""
    return isinstance(bus, Retransmits) and bus.retransmissions > 0
