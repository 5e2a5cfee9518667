"""Clocks of the nodes of a bus that keeps them together."""

from typing import NamedTuple, Protocol, runtime_checkable


class ClockDrift(NamedTuple):
    """The oscillator of a node leaves its rate for another one, `ppm` millionths faster."""

    node: int
    ppm: float
    first_cycle: int


class ClockErrors(NamedTuple):
    """The clocks of all nodes in a cycle.

    Attributes:
        ahead_us: how far each clock is ahead of the nominal time.
        sends: whether the node may send: its clock is synchronised.
        hears: whether its controller runs at all.
    """

    ahead_us: tuple[float, ...]
    sends: tuple[bool, ...]
    hears: tuple[bool, ...]


@runtime_checkable
class KeepsClocks(Protocol):
    """A bus whose nodes synchronise their clocks. Without it clocks drift uncorrected."""

    def clock_errors(self, nodes: int, drifts: tuple[ClockDrift, ...], cycle: int) -> ClockErrors:
        """Return the clocks of so many nodes in a cycle where some oscillators drift."""
        ...
