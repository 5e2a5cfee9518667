"""A bus as the table of buses has it, and the bus without time."""

from collections.abc import Callable
from typing import Any, NamedTuple

from concord.bus.arbitration import ARBITERS, Arbiter, UrgencyClasses
from concord.bus.bus import Bus, FrameFormat
from concord.bus.flexray.share_frames import SHARE_FRAMES
from concord.bus.ideal import TimelessBus
from concord.bus.schedule import Schedule
from concord.entries import chosen as chosen_entry
from concord.scenarios.scenario import Scenario
from concord.scenarios.types.buses import SharedBus, UserBus
from concord.scenarios.user.bus import user_frame_format


class BusRequest(NamedTuple):
    """The schedule of a bus, the longest share in bytes, and how nodes contend.

    bid_span: as `NetworkWiring.bid_span`.
    """

    schedule: Schedule
    share_bytes: int
    arbiter: Arbiter
    classes: UrgencyClasses
    latch_delay_us: float
    bid_span: tuple[int, int] | None = None

    @property
    def arbiter_without_classes(self) -> Arbiter:
        """The arbiter of a bus on which a node has one identifier: the most urgent bid wins."""
        return ARBITERS["wtod"] if self.arbiter.by_class else self.arbiter


class BusDefinition(NamedTuple):
    """A kind of bus.

    Attributes:
        plan: (its options, what is asked of it) -> the bus; raises ValueError if it cannot be.
        frame_format: of its options, how its frames carry shares.
        notes: of a scenario on it, sentences that a user must know of before a run.
    """

    plan: Callable[[Any, BusRequest], Bus]
    frame_format: Callable[[Any], FrameFormat]
    notes: Callable[[Scenario], tuple[str, ...]] = lambda _: ()


def bus_definition(chosen: SharedBus) -> BusDefinition:
    """Return the definition of a bus of the table."""
    found: BusDefinition = chosen_entry("BUSES", chosen.name)
    return found


def frame_format(scenario: Scenario) -> FrameFormat:
    """Return how the frames of a scenario's bus carry shares."""
    bus = scenario.bus
    if isinstance(bus, UserBus):
        return user_frame_format(bus)
    return bus_definition(bus).frame_format(bus)


def bus_notes(scenario: Scenario) -> tuple[str, ...]:
    """Return sentences about a scenario's bus that a user must know of."""
    own = isinstance(scenario.bus, UserBus)
    return () if own else bus_definition(scenario.bus).notes(scenario)


def _ideal(_: SharedBus, asked: BusRequest) -> Bus:
    if any(asked.schedule.dynamic_slot_table):
        raise ValueError(
            "--bus ideal: the arbiter of a dynamic segment needs minislots; use --bus flexray, "
            "or --schedule full or round-robin"
        )
    return TimelessBus(asked.schedule, asked.share_bytes)


IDEAL = BusDefinition(_ideal, lambda _: SHARE_FRAMES)
