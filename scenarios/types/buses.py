"""Buses as values: which nodes may publish in which cycle, and on what kind of bus."""

from typing import Annotated, ClassVar, Literal, get_args

from concord.scenarios.types.option import USER, Choice, Option, name_of
from concord.scenarios.user.values import FromFile, builder_source


class BusSchedule(Choice, frozen=True, kw_only=True):
    """Which nodes may publish in a communication cycle."""


class FullSchedule(BusSchedule, frozen=True, kw_only=True, tag="full"):
    """Every node publishes in every cycle."""


class PartialSchedule(BusSchedule, frozen=True, kw_only=True):
    """A schedule in which a part of the nodes publishes in a cycle."""

    occupancy: Annotated[
        float,
        Option("Share of the nodes that publish in a cycle.", above=0, at_most=1, is_setting=True),
    ] = 1.0


class RoundRobinSchedule(PartialSchedule, frozen=True, kw_only=True, tag="round-robin"):
    """Nodes publish in turns of fixed order."""


URGENCY = "urgency"
"""The arbiter of the dynamic segment that users get: FlexRay's, with frame IDs by urgency."""


class ContendedSchedule(PartialSchedule, frozen=True, kw_only=True):
    """A schedule with nodes that contend for slots of the dynamic segment."""

    arbiter: Annotated[
        str,
        Option(
            "Arbiter of the dynamic segment: urgency and minislot (FlexRay's own), wtod (ideal, "
            "but real on CAN FD), round-robin (ideal: no controller does that), FILE.py:NAME.",
            is_setting=True,
        ),
    ] = URGENCY
    urgency_classes: Annotated[
        int,
        Option("Frame IDs of a contender with the arbiter urgency, one for each class of urgency.",
               at_least=2, at_most=64, is_setting=True),
    ] = 8  # fmt: skip
    trigger: Annotated[
        float,
        Option("Ask for a dynamic slot only after a change of the estimate larger than this, as a "
               "squared distance in units of its covariance; 0 asks always.", at_least=0,
               is_setting=True),
    ] = 0.0  # fmt: skip


class HybridSchedule(ContendedSchedule, frozen=True, kw_only=True, tag="hybrid"):
    """Half of the slots are static and the nodes without one contend for the others."""


class LeavesSchedule(ContendedSchedule, frozen=True, kw_only=True, tag="hybrid-leaves"):
    """hybrid in which the nodes with the fewest neighbours own the static slots."""


class DynamicSchedule(ContendedSchedule, frozen=True, kw_only=True, tag="dynamic"):
    """All nodes contend for all slots."""


class WrittenSchedule(BusSchedule, frozen=True, kw_only=True, tag="written"):
    """The slots of a file on a cluster that is named; dynamic slots go by their frame IDs."""

    slots: Annotated[
        str,
        Option("Slot table of the cluster, as fit and plan write it, or in a FIBEX or AUTOSAR "
               "file: which node sends in which slot and cycle."),
    ] = ""  # fmt: skip


class SensorSlots(BusSchedule, frozen=True, kw_only=True, tag="flexray"):
    """Some sensors of a measurement bus own a slot each, the others contend for one (meng2025)."""

    static_slots: Annotated[
        int, Option("Sensors of a measurement bus that own a slot each.", at_least=0)
    ] = 4


class SilentSchedule(BusSchedule, frozen=True, kw_only=True, tag="none"):
    """No sensor of a measurement bus ever sends (meng2025)."""


ScheduleChoice = (
    FullSchedule
    | RoundRobinSchedule
    | HybridSchedule
    | LeavesSchedule
    | DynamicSchedule
    | SensorSlots
    | SilentSchedule
)
ClusterSchedule = ScheduleChoice | WrittenSchedule
TimelessSchedule = FullSchedule | RoundRobinSchedule
STRETCH = Option(
    "Stretch the plant's sampling time by this factor to hold the bus cycles.", at_least=1
)
SCHEDULE = Option("Schedule: which nodes may publish in a cycle.", group="bus", is_setting=True)


class SharedBus(Choice, frozen=True, kw_only=True):
    """A bus that all nodes share.

    Attributes:
        partial_schedule: the usual schedule where a part of the nodes publishes in a cycle.
        serves_urgency: the bus itself arbitrates by urgency.
    """

    partial_schedule: ClassVar[str] = "dynamic"
    serves_urgency: ClassVar[bool] = False


ALL_CHANNELS: Literal["all"] = "all"
"""Every frame is on all channels of its cluster."""


class TimedBus(SharedBus, frozen=True, kw_only=True):
    """A bus whose cycles take time."""

    stretch: Annotated[float, STRETCH] = 1.0


class FlexRay(TimedBus, frozen=True, kw_only=True, tag="flexray"):
    """FlexRay: static and dynamic slots of a cluster, with times."""

    serves_urgency: ClassVar[bool] = True
    schedule: Annotated[ClusterSchedule, SCHEDULE] = FullSchedule()
    cluster: Annotated[
        str,
        Option("FlexRay cluster: fitted (the shortest cycle that holds the schedule), fitted-ab "
               "(on both channels), a preset (audi, bosch, ...), a TOML, FIBEX or ARXML file."),
    ] = "fitted"  # fmt: skip
    channels: Annotated[
        Literal["all", "A", "B", "split", "mixed"],
        Option("Channels of the frames: all that the cluster has, A or B alone, split (half on "
               "each), mixed (static ones on both, dynamic ones split)."),
    ] = ALL_CHANNELS  # fmt: skip
    withdrawal: Annotated[
        bool,
        Option("Hosts withdraw a request for the dynamic segment whose share would not fit whole, "
               "or be one too many for the occupancy; without it frames are sent up to pLatestTx."),
    ] = True  # fmt: skip


class Plca(TimedBus, frozen=True, kw_only=True, tag="plca"):
    """10BASE-T1S with PLCA: Ethernet at 10 Mbit/s on one pair, transmit opportunities in order."""

    partial_schedule: ClassVar[str] = "round-robin"
    schedule: Annotated[ScheduleChoice, SCHEDULE] = FullSchedule()
    opportunity_bits: Annotated[
        int,
        Option("Transmit opportunity that a node leaves unused, in bit times.", at_least=1,
               at_most=255),
    ] = 32  # fmt: skip
    burst_frames: Annotated[
        int,
        Option("Frames that a node may send after the first in one transmit opportunity.",
               at_least=0, at_most=255),
    ] = 0  # fmt: skip


class CanFd(TimedBus, frozen=True, kw_only=True, tag="can-fd"):
    """CAN FD: frames arbitrate by identifiers, which bids choose; the lowest identifier wins."""

    serves_urgency: ClassVar[bool] = True
    schedule: Annotated[ScheduleChoice, SCHEDULE] = FullSchedule()
    identifiers: Annotated[
        Literal["base", "extended"], Option("Identifiers of 11 bits (base) or of 29 (extended).")
    ] = "extended"
    nominal_kbit_s: Annotated[
        int, Option("Bit rate of the arbitration.", unit="kbit/s", at_least=10, at_most=1000)
    ] = 500
    data_kbit_s: Annotated[
        int, Option("Bit rate of the data.", unit="kbit/s", at_least=10, at_most=8000)
    ] = 2000
    retransmissions: Annotated[
        int,
        Option(
            "How often a frame is sent again after an error; a cycle has time for it.",
            at_least=0,
            at_most=16,
        ),
    ] = 0


class Ideal(SharedBus, frozen=True, kw_only=True, tag="ideal"):
    """Slots without time: whatever the schedule allows is transmitted."""

    partial_schedule: ClassVar[str] = "round-robin"
    schedule: Annotated[TimelessSchedule, SCHEDULE] = FullSchedule()


class UserBus(FromFile, TimedBus, frozen=True, kw_only=True, tag=USER):
    """A bus of your own, from a Python file: `build(schedule, share_bytes, arbiter) -> Bus`."""

    source: str = ""
    digest: str = ""
    schedule: Annotated[ScheduleChoice, SCHEDULE] = FullSchedule()

    @classmethod
    def made_of(cls, asked: object) -> "UserBus | None":
        """A bus by the name of its file, or as the function or class that builds it."""
        found = builder_source(asked)
        return found and cls(source=found.name, digest=found.digest)


BusChoice = FlexRay | Plca | CanFd | Ideal | UserBus


def bus_type(name: str) -> type[SharedBus]:
    """The class of a bus by its name; that of a user's bus for all other names."""
    return {name_of(one): one for one in get_args(BusChoice)}.get(name, UserBus)


def occupancy_of(schedule: BusSchedule) -> float:
    """The share of the nodes that publish in a cycle; 1 where the schedule lets all publish."""
    return schedule.occupancy if isinstance(schedule, PartialSchedule) else 1.0


def arbiter_of(schedule: BusSchedule) -> str:
    """The arbiter of the dynamic segment: a written table has one frame ID a node, and the sensors
    of the paper have its own."""
    if isinstance(schedule, WrittenSchedule):
        return "minislot"
    return schedule.arbiter if isinstance(schedule, ContendedSchedule) else "wtod"


def urgency_classes_of(schedule: BusSchedule) -> int:
    """The frame IDs of a contender; 1 where no bids tell it which to take."""
    if isinstance(schedule, ContendedSchedule) and schedule.arbiter == URGENCY:
        return schedule.urgency_classes
    return 1


def withdraws(bus: SharedBus) -> bool:
    """Whether no share is ever cut."""
    return bus.withdrawal if isinstance(bus, FlexRay) else True


def stretch_of(bus: SharedBus) -> float:
    """The factor by which the plant's sampling time is stretched; 1 on a bus without time."""
    return bus.stretch if isinstance(bus, TimedBus) else 1.0


def trigger_of(schedule: BusSchedule) -> float:
    """The change of an estimate from which a contender asks; 0 where no node contends."""
    return schedule.trigger if isinstance(schedule, ContendedSchedule) else 0.0
