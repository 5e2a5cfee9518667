"""What `concord flexray plan` answers: the plan that was asked for, or the most that fits."""

import shlex
from collections import defaultdict

import msgspec

from bus.cluster import Cluster
from bus.slot_table import SlotTable, deviations
from bus.timing import TimingError
from experiments.bus_rehearsal import (
    Alternative,
    alternatives,
    changed,
    dynamic_room,
    prepare_without_bus,
    rehearse,
    shares_per_cycle,
)
from experiments.bus_report import BusFigures, bus_figures
from scenarios.build import build_plan
from scenarios.bus_plan import FITTED, BusPlan, build_schedule, check_bus
from scenarios.catalogue import kind_of
from scenarios.scenario import Scenario, check_ranges
from scenarios.setup import Setup, share_bytes

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

    `published` is the part of the nodes that publishes in a rehearsed cycle, on average;
    `dynamic_slots` is how many contenders the schedule lets into a cycle, and `dynamic_room` how
    many of them fit whoever wins. `time` and `remarks` are for people: whether the cycles of a step
    fit into it, and what a FlexRay controller alone cannot do.
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
    time: str
    fits_time: bool
    remarks: list[str]
    slots: list[SlotRow]
    published: float
    figures: BusFigures


class Answer(msgspec.Struct, frozen=True):
    """What `concord flexray plan` says.

    `problem` is why the bus that was asked for cannot be, and None where it can; then `shown` is
    that bus, else the first of `alternatives`. `fitted_cycle_us` is the cycle of a cluster made to
    measure for what was asked, None where there is none.
    """

    asked: Scenario
    problem: str | None
    fitted_cycle_us: float | None
    shown: PlanReport
    alternatives: list[PlanReport]


def answer_plan(scenario: Scenario) -> Answer:
    """The plan of a scenario's bus, or the best that its cluster holds.

    Raises:
        ValueError: the scenario cannot be, or its cluster does not hold a single share in a cycle.
    """
    check_ranges(scenario)
    build_schedule(scenario)
    setup = prepare_without_bus(scenario)
    try:
        bus = build_plan(setup)
    except ValueError as error:
        others = [_report(other) for other in alternatives(setup)]
        if not others:
            raise
        return Answer(scenario, str(error), _fitted_cycle_us(setup), others[0], others)
    cluster_of(bus, scenario)
    return Answer(scenario, None, None, _report(Alternative(setup, bus)), [])


def cluster_of(bus: BusPlan, scenario: Scenario) -> Cluster:
    """The cluster of a bus with time.

    Raises:
        ValueError: the bus has none.
    """
    if bus.cluster is None:
        raise ValueError(
            f"--cluster {scenario.cluster}: a bus without time has no plan; leave --cluster out, "
            "or choose a preset or a file"
        )
    return bus.cluster


def slot_rows(table: SlotTable) -> list[SlotRow]:
    """The slot table with the slots of one share in one row, in order of slots."""
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
    """The command line that runs a scenario."""
    defaults = kind_of(scenario.name).defaults
    words = ["concord", "run", "--scenario", scenario.name]
    for field in msgspec.structs.fields(scenario):
        value = getattr(scenario, field.name)
        if field.name != "name" and value != getattr(defaults, field.name):
            words += [f"--{field.encode_name.replace('_', '-')}", str(value)]
    return shlex.join(words)


def _report(alternative: Alternative) -> PlanReport:
    setup, bus = alternative
    scenario, table = setup.scenario, bus.table
    cluster = cluster_of(bus, scenario)
    assert table is not None
    rehearsal = rehearse(setup, bus, min(scenario.steps, MOST_REHEARSED_STEPS))
    time, fits_time = _time(setup, bus, cluster)
    return PlanReport(
        schedule=scenario.schedule,
        number=scenario.number,
        occupancy=scenario.occupancy,
        shares_per_cycle=shares_per_cycle(bus.schedule),
        command=run_command(scenario),
        cluster=cluster,
        share_bytes=share_bytes(setup),
        static_payloads=list(table.static_payloads),
        dynamic_payloads=list(table.dynamic_payloads),
        dynamic_slots=max(bus.schedule.dynamic_slot_table),
        dynamic_room=dynamic_room(bus),
        time=time,
        fits_time=fits_time,
        remarks=list(deviations(table.assignments, cluster)),
        slots=slot_rows(table),
        published=float(rehearsal.published.mean()),
        figures=bus_figures(bus, rehearsal.payload_bytes, rehearsal.asked, rehearsal.ages.ravel()),
    )


def _time(setup: Setup, bus: BusPlan, cluster: Cluster) -> tuple[str, bool]:
    rounds, stretch = setup.scenario.rounds, setup.scenario.stretch
    try:
        check_bus(bus, setup.scenario, setup.time_step_s)
    except TimingError as error:
        return f"does not fit the sampling time: {error}", False
    step_ms = setup.time_step_s * stretch * 1e3
    return (
        f"{rounds} cycles of {cluster.cycle_us / 1e3:.4g} ms are "
        f"{rounds * cluster.cycle_us / 1e3:.4g} ms of the {step_ms:g} ms of a step"
    ), True


def _fitted_cycle_us(setup: Setup) -> float | None:
    try:
        cluster = build_plan(changed(setup, cluster=FITTED)).cluster
    except ValueError:
        return None
    return None if cluster is None else cluster.cycle_us
