"""The bus of a network on 10BASE-T1S with PLCA: a schedule of turns in the order of the nodes."""

from collections.abc import Sequence

from concord.bus.arbitration import ONE_CLASS, Arbiter, LosingBids, largest_bid, unclassed
from concord.bus.bus import Transmission
from concord.bus.clocks import ClockDrift, ClockErrors, SyncOutage
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
from concord.features.other_buses.plca.without_beacons import gets_through
from concord.nodes.commands import Kill
from concord.scenarios.bus_table.bus_definition import BusDefinition, BusRequest
from concord.scenarios.scenario import Scenario
from concord.scenarios.script import script_of

COORDINATOR = 0
"""The node with PLCA ID 0, which sends the beacons."""


class PlcaBus(IdentifiedBus):
    """A schedule on 10BASE-T1S (`concord.bus.bus.Bus`); the PLCA ID of a node is its number.

    A communication cycle is as many PLCA cycles as the longest share needs. Every node has an
    opportunity in each; the schedule says which nodes use theirs.

    Raises:
        ValueError: more nodes than PLCA has IDs.
    """

    name = "plca"
    # The PHY of node 0 sends the beacons, whatever frames its host sends.
    sync_nodes = (COORDINATOR,)
    sync_in_frames = False
    segment_name = "transmit opportunities"

    def __init__(
        self,
        schedule: Schedule,
        share_bytes: int,
        arbiter: Arbiter,
        timing: PlcaSettings,
        is_silent: bool = False,
    ) -> None:
        if schedule.nodes > MAX_NODES:
            raise ValueError(
                f"--bus plca with {schedule.nodes} nodes: PLCA has {MAX_NODES} node IDs; use fewer "
                "--nodes, or --bus ideal"
            )
        super().__init__(schedule, share_bytes, FRAMING, arbiter, ONE_CLASS)
        self.timing = timing
        self._is_silent = is_silent

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

    def clock_errors(
        self,
        nodes: int,
        drifts: tuple[ClockDrift, ...],
        outages: tuple[SyncOutage, ...],
        cycle: int,
        key: tuple[int, int],
    ) -> ClockErrors:
        """Return which of so many nodes send in a cycle (`concord.bus.clocks.KeepsClocks`): without
        beacons those whose shares CSMA/CD brings through, or none."""
        out = any(
            one.first_cycle <= cycle and (one.end_cycle is None or cycle < one.end_cycle)
            for one in outages
        )
        sends = (True,) * nodes
        if out:
            through: frozenset[int] = frozenset()
            if not self._is_silent:
                may = {*self.schedule.static_senders(cycle), *self.schedule.contenders(cycle)}
                senders = tuple(sorted(may - set(self.sync_nodes)))
                bits = self.cycle_us / BIT_US
                through = gets_through(key, cycle, senders, self._longest, bits)
            sends = tuple(node in through for node in range(nodes))
        return ClockErrors((0.0,) * nodes, sends, (True,) * nodes)

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
    timing = PlcaSettings(chosen.opportunity_bits, chosen.burst_frames, chosen.burst_timer_bits)
    silent = chosen.without_beacons == "silence"
    return PlcaBus(asked.schedule, asked.share_bytes, asked.arbiter_without_classes, timing, silent)


def _notes(scenario: Scenario) -> tuple[str, ...]:
    """Say what happens when a script takes the node that sends the beacons."""
    steps = [
        one.step
        for one in script_of(scenario)
        if isinstance(one.command, Kill) and one.command.node == COORDINATOR
    ]
    bus = scenario.bus
    if not steps or not isinstance(bus, Plca):
        return ()
    after = (
        "the others send nothing (--without-beacons silence)"
        if bus.without_beacons == "silence"
        else "the others fall back to CSMA/CD, and a share that collides too often is not sent "
        "(--without-beacons csma-cd)"
    )
    return (
        f"--bus plca: node {COORDINATOR} sends the beacons and is out from step {steps[0]}; until "
        f"it is back {after}; no other node takes over, as PLCA has one coordinator",
    )


DEFINITION = BusDefinition(_plca, lambda _: FRAMING.frame_format(), _notes)
