"""The bus of a network on 10BASE-T1S with PLCA: a schedule of turns in the order of the nodes."""

from collections.abc import Sequence

from concord.bus.arbitration import ONE_CLASS, Arbiter, LosingBids, largest_bid, unclassed
from concord.bus.bus import Transmission
from concord.bus.schedule import Schedule
from concord.features.other_buses.identified_bus import IdentifiedBus
from concord.features.other_buses.identified_frames import frame_id_of
from concord.features.other_buses.options import Plca
from concord.features.other_buses.plca.cycle import (
    BIT_US,
    PlcaSettings,
    longest_walk_bits,
    walk,
    worst_access_bits,
)
from concord.features.other_buses.plca.ethernet import FRAMING, MAX_NODES
from concord.scenarios.bus_table.bus_definition import BusDefinition, BusRequest


class PlcaBus(IdentifiedBus):
    """A schedule on 10BASE-T1S (`concord.bus.bus.Bus`); the PLCA ID of a node is its number.

    A communication cycle is as many PLCA cycles as the longest share needs. Every node has an
    opportunity in each; the schedule says which nodes use theirs.

    Raises:
        ValueError: more nodes than PLCA has IDs.
    """

    name = "plca"
    segment_name = "transmit opportunities"

    def __init__(
        self, schedule: Schedule, share_bytes: int, arbiter: Arbiter, timing: PlcaSettings
    ) -> None:
        if schedule.nodes > MAX_NODES:
            raise ValueError(
                f"--bus plca with {schedule.nodes} nodes: PLCA has {MAX_NODES} node IDs; use fewer "
                "--nodes, or --bus ideal"
            )
        super().__init__(schedule, share_bytes, FRAMING, arbiter, ONE_CLASS)
        self.timing = timing

    def identifiers(self, node: int, cycle: int) -> range:
        """Return the node's number where the schedule lets it send."""
        schedule = self.schedule
        may = node in schedule.static_senders(cycle) or node in schedule.contenders(cycle)
        return range(node, node + may)

    def cycle_of_senders_us(self, senders: int) -> float:
        """Return the time in which so many nodes send their longest shares."""
        nodes = self.schedule.nodes
        return BIT_US * longest_walk_bits(self.timing, nodes, senders, self._longest)

    @property
    def worst_access_us(self) -> float:
        """The longest time from the request of a share, at any moment, to its last bit."""
        return BIT_US * worst_access_bits(self.timing, self.schedule.nodes, self._longest)

    @property
    def losing_bids(self) -> LosingBids | None:
        """The largest bids that losers may have beside a winner's; None where bids do not count."""
        return unclassed if self._arbiter.urgency is largest_bid else None

    def transmissions(
        self, cycle: int, payload_bytes: Sequence[int], classes: Sequence[int] = ()
    ) -> tuple[Transmission, ...]:
        """Return the frames of a cycle from the payload bytes of each node, 0 of a silent one."""
        owners = self.schedule.static_senders(cycle)
        payloads = [self.split_payload(size) for size in payload_bytes]
        return tuple(
            Transmission(
                one.node,
                frame_id_of(one.node, one.number),
                "A",
                "static" if one.node in owners else "dynamic",
                payloads[one.node][one.number],
                BIT_US * one.start_bits,
                BIT_US * one.end_bits,
            )
            for one in walk(self.timing, payloads)[0]
        )


def _plca(chosen: Plca, asked: BusRequest) -> PlcaBus:
    timing = PlcaSettings(chosen.opportunity_bits, chosen.burst_frames)
    return PlcaBus(asked.schedule, asked.share_bytes, asked.arbiter_without_classes, timing)


DEFINITION = BusDefinition(_plca, lambda _: FRAMING.frame_format())
