"""Buses as values: what kind of bus the nodes share."""

from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

from concord.scenarios.types.declarations import choice_of
from concord.scenarios.types.option import USER, Choice, Option
from concord.scenarios.types.schedules import (
    BusSchedule,
    FullSchedule,
    RoundRobinSchedule,
    WrittenSchedule,
)
from concord.scenarios.user.values import FromFile, builder_source

if TYPE_CHECKING:
    ScheduleChoice = BusSchedule
    ClusterSchedule = BusSchedule
else:
    ScheduleChoice = choice_of("SCHEDULES")
    ClusterSchedule = ScheduleChoice | WrittenSchedule
TimelessSchedule = FullSchedule | RoundRobinSchedule
STRETCH = Option(
    "Stretch the plant's sampling time by this factor to hold the bus cycles.", at_least=1
)
SCHEDULE = Option(
    "Schedule: which nodes may publish in a cycle.", group="bus", is_setting=True, first=True
)


class SharedBus(Choice, frozen=True, kw_only=True):
    """A bus that all nodes share.

    Attributes:
        partial_schedule: the usual schedule where a part of the nodes publishes in a cycle.
        serves_urgency: the bus itself arbitrates by urgency.
    """

    partial_schedule: ClassVar[str] = "dynamic"
    serves_urgency: ClassVar[bool] = False
    if TYPE_CHECKING:  # Each kind declares the schedules that it can have.
        schedule: BusSchedule


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


def withdraws(bus: SharedBus) -> bool:
    """Whether no share is ever cut."""
    return bus.withdrawal if isinstance(bus, FlexRay) else True


def stretch_of(bus: SharedBus) -> float:
    """The factor by which the plant's sampling time is stretched; 1 on a bus without time."""
    return bus.stretch if isinstance(bus, TimedBus) else 1.0
