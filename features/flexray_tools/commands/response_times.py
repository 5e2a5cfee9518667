"""`concord flexray wcrt`: worst-case response times of the frames of a slot table."""

import sys
from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np
import tyro
from rich.table import Table

from concord.bus.flexray.cluster import Cluster
from concord.bus.flexray.slot_file import read_slot_file
from concord.experiments.standard_output import plain_console
from concord.experiments.user_errors import user_errors
from concord.features.flexray_tools.commands.clusters import read_cluster
from concord.features.flexray_tools.commands.frame_logs import Columns, slots_of_log
from concord.features.flexray_tools.frame_logs.log_files import is_frame_log
from concord.features.flexray_tools.response_times import (
    FrameResponse,
    ResponseTimes,
    last_minislot,
)
from concord.features.flexray_tools.traffic import worst_responses


class ResponseRow(msgspec.Struct, frozen=True):
    """The bound of one frame. `worst_us` is None if lower IDs may hold it up for ever; `spare_us`
    is the deadline less the bound, None without either. `latest_minislot` is the last in which a
    dynamic frame may begin. `seen_us` is the worst response in random traffic, and `margin_us` the
    bound less that; None without traffic."""

    frame_id: int
    node: int
    base_cycle: int
    repetition: int
    payload_bytes: int
    worst_us: float | None
    filled_cycles: int
    exact: bool
    deadline_us: float | None
    spare_us: float | None
    latest_minislot: int | None = None
    seen_us: float | None = None
    margin_us: float | None = None


def wcrt(
    slots: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="SLOTS")],
    /,
    *,
    cluster: str,
    name: str | None = None,
    columns: Columns = None,
    simulate: int = 0,
    seed: int = 1,
    json: bool = False,
) -> None:
    """Bound the time from a request to the end of its frame, for every frame of a slot table.

    Args:
        slots: Slot table: TOML, FIBEX (.xml) or AUTOSAR (.arxml). Or a log of frames: the
            slots in it, with the longest payloads and the shortest periods.
        cluster: A preset, or a file: TOML, FIBEX (.xml) or AUTOSAR (.arxml).
        name: Which cluster of a FIBEX or AUTOSAR file that has several.
        columns: Columns file of a CSV log.
        simulate: Cycles of random traffic whose worst responses are shown beside the bounds.
        seed: Seed of the traffic.
        json: Print one JSON object.
    """
    with user_errors():
        bus = read_cluster(cluster, name)
        log = is_frame_log(slots, columns)
        table = slots_of_log(slots, bus, columns) if log else read_slot_file(slots, bus)
        if simulate < 0 or seed < 0:
            raise ValueError(
                f"--simulate {simulate} --seed {seed}: both are numbers from 0 on; correct them"
            )
    random = np.random.default_rng(seed)
    seen = worst_responses(bus, table, simulate, random)
    responses = ResponseTimes(bus, table).responses
    rows = [_row(bus, *one) for one in zip(responses, seen, strict=True)]
    if json:
        result = {"cluster": bus.name, "cycle_us": bus.cycle_us, "frames": rows}
        sys.stdout.write(msgspec.json.encode(result).decode() + "\n")
        return
    plain_console().print(_table(rows))
    for line in _remarks(rows, bus):
        sys.stdout.write(f"{line}\n")


def _row(cluster: Cluster, response: FrameResponse, seen_us: float | None) -> ResponseRow:
    slot, worst_us = response.slot, response.worst_us
    spare_us = None
    if worst_us is not None and slot.deadline_us is not None:
        spare_us = slot.deadline_us - worst_us
    return ResponseRow(
        frame_id=slot.frame_id,
        node=slot.node,
        base_cycle=slot.base_cycle,
        repetition=slot.repetition,
        payload_bytes=slot.payload_bytes,
        worst_us=worst_us,
        filled_cycles=response.filled_cycles,
        exact=response.exact,
        deadline_us=slot.deadline_us,
        spare_us=spare_us,
        latest_minislot=last_minislot(slot, cluster)
        if slot.frame_id >= cluster.first_dynamic_id
        else None,
        seen_us=seen_us,
        margin_us=None if worst_us is None or seen_us is None else worst_us - seen_us,
    )


def _table(rows: list[ResponseRow]) -> Table:
    """The rows with the columns that have an entry."""
    grid = Table("ID", "node", "cycles", "bytes", "worst us", "filled", show_edge=False)
    optional = ("deadline_us", "spare_us", "seen_us", "margin_us")
    known = [field for field in optional if any(getattr(row, field) is not None for row in rows)]
    for field in known:
        grid.add_column(field.replace("_", " "))
    for row in rows:
        turns = "all" if row.repetition == 1 else f"{row.base_cycle} modulo {row.repetition}"
        grid.add_row(
            str(row.frame_id),
            str(row.node),
            turns,
            str(row.payload_bytes),
            _number(row.worst_us) or "none",
            f"{row.filled_cycles}" + ("" if row.exact else " at most"),
            *(_number(getattr(row, field)) for field in known),
        )
    return grid


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.1f}"


def _remarks(rows: list[ResponseRow], cluster: Cluster) -> list[str]:
    """Deadlines that are missed and frames without a bound, each with a cure."""
    said = [
        f"frame ID {row.frame_id}: {row.worst_us:.1f} us exceed the deadline of "
        f"{row.deadline_us:g} us by {-row.spare_us:.1f} us; give it a lower ID, a smaller "
        "repetition, or lower IDs fewer bytes"
        for row in rows
        if row.spare_us is not None and row.spare_us < 0
    ]
    said += [
        f"frame ID {row.frame_id}: lower IDs may keep it beyond minislot {row.latest_minislot} "
        "(pLatestTx of its node, or the end of the segment) for "
        "ever; give it a lower ID, or lower IDs longer periods or fewer bytes"
        for row in rows
        if row.worst_us is None
    ]
    bounded = [row.worst_us for row in rows if row.worst_us is not None]
    if bounded:
        said.append(
            f"{len(bounded)} of {len(rows)} frames are bounded, the slowest by {max(bounded):.1f} "
            f"us; a cycle lasts {cluster.cycle_us:g} us"
        )
    return said
