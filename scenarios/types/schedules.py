"""Schedules as values: which nodes may publish in a communication cycle."""

from typing import Annotated

from concord.scenarios.types.option import Choice, Option


class BusSchedule(Choice, frozen=True, kw_only=True):
    """Which nodes may publish in a communication cycle."""


class FullSchedule(BusSchedule, frozen=True, kw_only=True, tag="full"):
    """Every node publishes in every cycle."""


class PartialSchedule(BusSchedule, frozen=True, kw_only=True):
    """A schedule in which a part of the nodes publishes in a cycle."""

    occupancy: Annotated[
        float,
        Option(
            "Share of the nodes that publish in a cycle.",
            above=0,
            at_most=1,
            is_setting=True,
            first=True,
        ),
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


def trigger_of(schedule: BusSchedule) -> float:
    """The change of an estimate from which a contender asks; 0 where no node contends."""
    return schedule.trigger if isinstance(schedule, ContendedSchedule) else 0.0
