"""Answers of `concord flexray plan`: the requested plan, or the largest that fits."""

import shlex
from collections import defaultdict

import msgspec

from concord.bus.bus import Bus
from concord.bus.flexray.cluster import Cluster
from concord.bus.flexray.flexray_bus import FlexRayBus
from concord.bus.flexray.slot_file import slots_to_toml
from concord.bus.flexray.slot_table import SlotTable, deviations
from concord.bus.flexray.timing import TimingError
from concord.bus.flexray.written_slots import message_slots
from concord.features.flexray_tools.commands.rehearsal import (
    Alternative,
    alternatives,
    changed,
    prepare_without_bus,
    rehearse,
    shares_per_cycle,
)
from concord.results.bus.bus_report import BusFigures, bus_figures
from concord.scenarios.build import build_bus
from concord.scenarios.bus_table.bus_plan import build_schedule
from concord.scenarios.bus_table.clusters import FITTED
from concord.scenarios.preparation import share_bytes
from concord.scenarios.scenario import Scenario
from concord.scenarios.scenario_options import in_options
from concord.scenarios.setup import Setup
from concord.scenarios.types.assignment import check_ranges
from concord.scenarios.types.buses import stretch_of
from concord.scenarios.types.rules import number_of
from concord.scenarios.types.schedules import occupancy_of

MOST_REHEARSED_STEPS = 500


class SlotRow(msgspec.Struct, frozen=True):
    """Slots of one node: sent in the cycles with `cycle % repetition == base_cycle`."""

    node: int
    segment: str
    frame_ids: list[int]
    channel: str
    base_cycle: int
    repetition: int


class PlanReport(msgspec.Struct, frozen=True):
    """A schedule with its slots on a cluster, and its rehearsal.

    `published` is the part of the nodes that publishes in a rehearsed cycle, on average.
    `dynamic_slots` is how many contenders the schedule lets into a cycle, and `dynamic_room` how
    many of them fit whoever wins. `other_load` is the part of the time in which other stations of a
    written slot table send. Each contender has frame IDs in `urgency_classes` classes. `time`
    and `remarks` are for people: whether the cycles of a step fit into it, and what a FlexRay
    controller alone cannot do.
    """

    schedule: str
    number: str
    occupancy: float
    shares_per_cycle: int
    command: str
    cluster: Cluster
    share_bytes: int
    static_payloads: list[int]
    dynamic_payloads: list[int]
    dynamic_slots: int
    dynamic_room: int
    urgency_classes: int
    other_load: float
    time: str
    fits_time: bool
    remarks: list[str]
    slots: list[SlotRow]
    published: float
    figures: BusFigures


class PlanAnswer(msgspec.Struct, frozen=True):
    """Answer of `concord flexray plan`.

    `problem` says why the requested bus is impossible; it is None if the bus is possible. `shown`
    is the requested bus if it is possible, otherwise the first of `alternatives`. `fitted_cycle_us`
    is the cycle of a cluster that fits the request, None if there is none.
    """

    asked: Scenario
    problem: str | None
    fitted_cycle_us: float | None
    shown: PlanReport
    alternatives: list[PlanReport]


def answer_plan(scenario: Scenario) -> PlanAnswer:
    """Return the plan of a scenario's bus, or the best that its cluster holds.

    Raises:
        ValueError: the scenario cannot be, or its cluster does not hold a single share in a cycle.
    """
    check_ranges(scenario)
    build_schedule(scenario)
    setup = prepare_without_bus(scenario)
    try:
        bus = build_bus(setup)
    except ValueError as error:
        others = [_report(other) for other in alternatives(setup)]
        if not others:
            raise
        return PlanAnswer(scenario, str(error), _fitted_cycle_us(setup), others[0], others)
    timed = with_cluster(bus, scenario)
    return PlanAnswer(scenario, None, None, _report(Alternative(setup, timed)), [])


def slots_to_write(scenario: Scenario) -> str:
    """Return the slot table of a scenario's bus as the text of a file.

    Raises:
        ValueError: the bus is impossible, has no cluster, or its slots have no such form.
    """
    bus = with_cluster(build_bus(prepare_without_bus(scenario)), scenario)
    return slots_to_toml(message_slots(bus.table, bus.cluster))


def with_cluster(bus: Bus, scenario: Scenario) -> FlexRayBus:
    """Return the bus, if it has a cluster.

    Raises:
        ValueError: it has none.
    """
    if not isinstance(bus, FlexRayBus):
        raise ValueError(
            f"--bus {scenario.bus.name}: a bus without time has no plan; use --bus flexray"
        )
    return bus


def slot_rows(table: SlotTable) -> list[SlotRow]:
    """Return the slot table with the slots of one share in one row, in order of slots."""
    ids: dict[tuple[int, str, str, int, int], list[int]] = defaultdict(list)
    for slot in table.assignments:
        segment = "static" if slot.frame_id < table.first_dynamic_id else "dynamic"
        key = (slot.node, segment, slot.channel, slot.base_cycle, slot.repetition)
        ids[key].append(slot.frame_id)
    rows = [
        SlotRow(node, segment, sorted(frame_ids), channel, base, repetition)
        for (node, segment, channel, base, repetition), frame_ids in ids.items()
    ]
    return sorted(rows, key=lambda row: (row.frame_ids[0], row.base_cycle))


def run_command(scenario: Scenario) -> str:
    """Return the command line that runs a scenario."""
    return shlex.join(["concord", "run", "--scenario", scenario.name, *in_options(scenario)])


def _report(alternative: Alternative) -> PlanReport:
    setup, bus = alternative
    scenario, table, cluster = setup.scenario, bus.table, bus.cluster
    rehearsal = rehearse(setup, bus, min(scenario.steps, MOST_REHEARSED_STEPS))
    time, fits_time = _time(setup, bus)
    return PlanReport(
        schedule=scenario.bus.schedule.name,
        number=number_of(scenario.rule),
        occupancy=occupancy_of(scenario.bus.schedule),
        shares_per_cycle=shares_per_cycle(bus.schedule),
        command=run_command(scenario),
        cluster=cluster,
        share_bytes=share_bytes(setup),
        static_payloads=list(table.static_payloads),
        dynamic_payloads=list(table.dynamic_payloads),
        dynamic_slots=max(bus.schedule.dynamic_slot_table),
        dynamic_room=bus.dynamic_room(),
        urgency_classes=table.classes,
        other_load=bus.other_load,
        time=time,
        fits_time=fits_time,
        remarks=[*_turns(setup, bus), *deviations(table.assignments, cluster)],
        slots=slot_rows(table),
        published=float(rehearsal.published.mean()),
        figures=bus_figures(bus, rehearsal.sent, rehearsal.asked, rehearsal.ages),
    )


def _time(setup: Setup, bus: Bus) -> tuple[str, bool]:
    rounds, stretch = setup.scenario.rounds, stretch_of(setup.scenario.bus)
    try:
        bus.check_pace(rounds, setup.time_step_s, stretch)
    except TimingError as error:
        return f"does not fit the sampling time: {error}", False
    step_ms = setup.time_step_s * stretch * 1e3
    return (
        f"{rounds} cycles of {bus.cycle_us / 1e3:.4g} ms are "
        f"{rounds * bus.cycle_us / 1e3:.4g} ms of the {step_ms:g} ms of a step"
    ), True


def _turns(setup: Setup, bus: FlexRayBus) -> list[str]:
    """Say where turns cannot go by the cycles of the bus."""
    timebase = bus.timebase
    if timebase.keeps_turns or timebase.pace is None:
        return []
    period, rounds = timebase.period, timebase.pace.rounds
    needed = (rounds + period - 1) * bus.cycle_us / (setup.time_step_s * 1e6)
    return [
        f"turns repeat after {period} cycles, and a step has no time for {rounds} rounds and a "
        f"wait of {period - 1}, so turns go by rounds and the hosts must reassign the slots; or "
        f"use --stretch {needed:.4g}"
    ]


def _fitted_cycle_us(setup: Setup) -> float | None:
    try:
        return build_bus(changed(setup, cluster=FITTED)).cycle_us
    except ValueError:
        return None
