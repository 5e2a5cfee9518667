"""`concord flexray plan` and `show`: the slots of a scenario, and one of its cycles drawn."""

import sys
from pathlib import Path
from typing import Annotated

import msgspec
import tyro
from rich.table import Table

from concord.experiments.scenario_flags import ScenarioFlags, resolved
from concord.experiments.standard_output import plain_console
from concord.experiments.user_errors import user_errors
from concord.features.flexray_tools.commands.clusters import ranges, write_new
from concord.features.flexray_tools.commands.plan_report import (
    PlanAnswer,
    PlanReport,
    SlotRow,
    answer_plan,
    slots_to_write,
    with_cluster,
)
from concord.features.flexray_tools.commands.rehearsal import rehearse
from concord.features.flexray_tools.timeline import timeline
from concord.results.bus import bus_report
from concord.results.bus.bus_times import timetable
from concord.scenarios.build import build_bus
from concord.scenarios.bus_table.clusters import FITTED
from concord.scenarios.preparation import prepare
from concord.scenarios.types.buses import FlexRay
from concord.scenarios.types.rules import number_of
from concord.scenarios.types.schedules import occupancy_of

MOST_PRINTED_ROWS = 1000
REHEARSED = "every contender asks in every cycle, the longest silent most urgently"


def plan(
    scenario: Annotated[ScenarioFlags, tyro.conf.arg(name="")],
    *,
    out: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None,
    json: bool = False,
) -> None:
    """Plan the bus of a scenario: slot table, occupancy, load, delays, what would starve.

    If the bus does not fit the cluster, the report gives the numbers and shows the largest
    occupancy that fits.

    Args:
        out: Slot table (.toml) to write, for --slots and `concord flexray wcrt`.
        json: Print one JSON object.
    """
    with user_errors():
        asked = resolved(scenario)
        answer = answer_plan(asked)
        if out is not None:
            if answer.problem is not None:
                raise ValueError(f"--out {out}: what was asked for does not fit: {answer.problem}")
            write_new(out, slots_to_write(asked))
    if json:
        sys.stdout.write(msgspec.json.encode(answer).decode() + "\n")
        return
    _print_answer(answer)


def show(
    scenario: Annotated[ScenarioFlags, tyro.conf.arg(name="")],
    *,
    cycle: int = 0,
    json: bool = False,
) -> None:
    """Draw one communication cycle of a scenario as a timeline.

    Args:
        cycle: Which of the cycles that carry rounds, counted from the beginning of the run.
        json: Print one JSON object.
    """
    with user_errors():
        setup = prepare(resolved(scenario))
        bus = with_cluster(build_bus(setup), setup.scenario)
        rounds, cycles = setup.scenario.rounds, setup.scenario.steps * setup.scenario.rounds
        if not 0 <= cycle < cycles:
            raise ValueError(
                f"--cycle {cycle}: the run has cycles 0..{cycles - 1} ({setup.scenario.steps} "
                f"steps of {rounds} rounds); choose one of these, or more --steps"
            )
    rehearsal = rehearse(setup, bus, cycle // rounds + 1)
    frames = timetable(bus, rehearsal.sent)[cycle]
    if bus.schedule.contenders(cycle):
        sys.stderr.write(f"rehearsed: {REHEARSED}\n")
    if json:
        result = {
            "cluster": bus.cluster,
            "cycle": cycle,
            "bus_cycle": bus.timebase.bus_cycle(cycle),
            "cycle_count": bus.cycle_count(cycle),
            "begins_us": bus.timebase.begins_us(cycle),
            "load": bus.load(frames),
            "segments": [part._asdict() for part in bus.segments()],
            "frames": [frame._asdict() for frame in frames],
        }
        sys.stdout.write(msgspec.json.encode(result).decode() + "\n")
        return
    step, number = divmod(cycle, rounds)
    sys.stdout.write(f"round {number} of step {step}: ")
    sys.stdout.write(timeline(bus.cluster, bus.timebase.bus_cycle(cycle), frames))


def _print_answer(answer: PlanAnswer) -> None:
    asked, shown = answer.asked, answer.shown
    cluster = asked.bus.cluster if isinstance(asked.bus, FlexRay) else "none"
    out = sys.stdout.write
    console = plain_console()
    out(
        f"asked for: {asked.name}, {asked.nodes} nodes, {asked.bus.schedule.name} schedule, "
        f"occupancy {occupancy_of(asked.bus.schedule):g}, {number_of(asked.rule)}, cluster "
        f"{cluster}\n"
    )
    if answer.problem is not None:
        out(f"does not fit: {answer.problem}\n\n")
        out("what fits, largest occupancy first:\n")
        console.print(_alternative_table(answer.alternatives))
        if answer.fitted_cycle_us is not None and cluster != FITTED:
            cycle_ms = answer.fitted_cycle_us / 1e3
            out(f"--cluster {FITTED} holds what was asked for in cycles of {cycle_ms:.4g} ms\n")
        out(f"\nshown below: NOT what was asked for, but the first of these\n  {shown.command}\n")
    else:
        out("fits; shown below: what was asked for\n")
    for line in _shown_lines(shown):
        out(f"{line}\n")
    console.print(_slot_grid(shown.slots[:MOST_PRINTED_ROWS]))
    more = len(shown.slots) - MOST_PRINTED_ROWS
    if more > 0:
        out(f"{more} more rows of the slot table; --json has them all\n")
    how = f" ({REHEARSED})" if shown.figures.contenders else ""
    out(f"rehearsed{how}: {100 * shown.published:.3g} % of the nodes publish in a cycle\n")
    for line in bus_report.lines(shown.figures):
        out(f"{line}\n")


def _shown_lines(shown: PlanReport) -> list[str]:
    cluster = shown.cluster
    text = [
        f"{shown.schedule}, occupancy {shown.occupancy:g}: {shown.shares_per_cycle} shares of "
        f"{shown.share_bytes} bytes ({shown.number}) in a cycle of cluster {cluster.name}, which "
        f"has {cluster.static_slots} static slots and {cluster.minislots} minislots",
        shown.time,
    ]
    used = {row.segment for row in shown.slots}
    if "static" in used:
        full = [cluster.static_payload_bytes] * len(shown.static_payloads)
        text.append(f"a share in the static segment: {_frames(full)}")
    if "dynamic" in used:
        minislots = sum(map(cluster.dynamic_slot_minislots, shown.dynamic_payloads))
        text.append(
            f"a share in the dynamic segment: {_frames(shown.dynamic_payloads)}, {minislots} "
            f"minislots; {shown.dynamic_slots} contenders may win in a cycle, and "
            + (
                "all of them fit"
                if shown.dynamic_room >= shown.dynamic_slots
                else f"only {shown.dynamic_room} of them fit whoever wins; the others wait"
            )
        )
        if shown.urgency_classes > 1:
            text.append(_price_of_classes(shown))
    if shown.other_load:
        text.append(
            f"other stations of the slot table occupy {100 * shown.other_load:.1f} % of the bus, "
            "and go before shares in dynamic slots with higher IDs"
        )
    if shown.remarks:
        others = f" (and {len(shown.remarks) - 1} more slots)" if len(shown.remarks) > 1 else ""
        text.append(f"beyond cycle multiplexing: {shown.remarks[0]}{others}")
    return text


def _price_of_classes(shown: PlanReport) -> str:
    owned = sum(len(row.frame_ids) for row in shown.slots if row.segment == "dynamic")
    empty = max(0, owned - shown.dynamic_slots * len(shown.dynamic_payloads))
    lost_us = empty * shown.cluster.minislot_us
    return (
        f"{shown.urgency_classes} urgency classes of {owned // shown.urgency_classes} frame IDs, "
        f"for which at most {empty} empty minislots ({lost_us:.4g} us) pass in a cycle"
    )


def _frames(payloads: list[int]) -> str:
    if len(set(payloads)) == 1:
        return f"{len(payloads)} frame{'s' * (len(payloads) > 1)} of {payloads[0]} bytes"
    return f"{len(payloads)} frames of {', '.join(map(str, payloads))} bytes"


def _alternative_table(reports: list[PlanReport]) -> Table:
    grid = Table("schedule", "number", show_edge=False)
    for heading in ("occupancy", "shares", "load", "delay ms", "time fits"):
        grid.add_column(heading, justify="right")
    for report in reports:
        grid.add_row(
            report.schedule,
            report.number,
            f"{report.occupancy:.3g}",
            str(report.shares_per_cycle),
            f"{100 * report.figures.bus_load:.0f} %",
            f"{report.figures.delay_us / 1e3:.4g}",
            "yes" if report.fits_time else "no",
        )
    return grid


def _slot_grid(rows: list[SlotRow]) -> Table:
    grid = Table(show_edge=False)
    grid.add_column("node", justify="right")
    for heading in ("segment", "frame IDs", "channel", "in cycles"):
        grid.add_column(heading)
    for row in rows:
        if row.segment == "dynamic":
            when = "when it wins"
        elif row.repetition == 1:
            when = "all"
        else:
            when = f"{row.base_cycle} modulo {row.repetition}"
        grid.add_row(str(row.node), row.segment, _ids(row.frame_ids), row.channel, when)
    return grid


def _ids(frame_ids: list[int]) -> str:
    """Return ascending frame IDs in short: `1-7`, or `52, 72, ... 192` where they have gaps."""
    runs = ranges(frame_ids)
    return ", ".join(runs if len(runs) < 4 else (*runs[:2], f"... {runs[-1]}"))
