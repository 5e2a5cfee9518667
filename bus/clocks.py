"""Clocks of the nodes of a bus that keeps them together."""

from typing import NamedTuple, Protocol, runtime_checkable


class ClockDrift(NamedTuple):
    """The oscillator of a node leaves its rate for another one, `ppm` millionths faster."""

    node: int
    ppm: float
    first_cycle: int


class SyncOutage(NamedTuple):
    """No other node receives the sync frames of a node from a cycle on, and before `end_cycle`;
    None is an outage without an end."""

    node: int
    first_cycle: int
    end_cycle: int | None = None


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

    sync_in_frames: bool  # so a host that sends no frames gives no sync

    @property
    def sync_nodes(self) -> tuple[int, ...]:
        """Return the nodes that send sync frames.

        Numbers beyond the network are other controllers. It is empty where all sync frames are
        theirs.
        """
        ...

    def clock_errors(
        self,
        nodes: int,
        drifts: tuple[ClockDrift, ...],
        outages: tuple[SyncOutage, ...],
        cycle: int,
        key: tuple[int, int],
    ) -> ClockErrors:
        """Return the clocks of so many nodes in a cycle where some oscillators drift, and sync
        frames of some nodes are missing; `key` is that of a run's draws."""
        ...
