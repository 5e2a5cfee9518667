"""`concord flexray design-slots`: static slots for frames with deadlines and shares with ages."""

import sys
from pathlib import Path
from typing import Annotated

import msgspec
import tyro
from rich.table import Table

from concord.bus.flexray.cluster import Cluster
from concord.bus.flexray.slot_file import slots_to_toml
from concord.experiments.standard_output import plain_console
from concord.experiments.user_errors import user_errors
from concord.features.flexray_tools.commands.clusters import read_cluster, write_new
from concord.features.flexray_tools.slot_design.demand import read_demand
from concord.features.flexray_tools.slot_design.design import SlotDesign, design_slots
from concord.features.flexray_tools.slot_design.programme import Edition, Goal


def design_slots_command(
    demand: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="FRAMES.toml")],
    /,
    *,
    cluster: str,
    name: str | None = None,
    minimise: Goal = "slots",
    edition: Edition = "3.0.1",
    out: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None,
    json: bool = False,
) -> None:
    """Design a slot table in which every frame meets its deadline and every share keeps its age.

    Args:
        demand: Table with [[frames]] (node, payload_bytes, period_us, deadline_us, offset_us,
            channel) and [[shares]] (node, share_bytes, age_us, growth, channel).
        cluster: A preset, or a file: TOML, FIBEX (.xml) or AUTOSAR (.arxml).
        name: Which cluster of a FIBEX or AUTOSAR file that has several.
        minimise: The static slots in use, or the error that the largest ages of shares add.
        edition: FlexRay 2.1 gives a static slot to one node; 3.0.1 lets nodes take turns in it.
        out: Slot table (.toml) to write, for --slots and `concord flexray wcrt`.
        json: Print one JSON object.
    """
    with user_errors():
        bus = read_cluster(cluster, name)
        wanted = read_demand(demand)
        try:
            designed = design_slots(wanted, bus, minimise, edition)
        except ValueError as error:
            raise ValueError(f"{demand}: {error}") from None
        if out is not None:
            write_new(out, slots_to_toml(designed.slots))
    if json:
        sys.stdout.write(msgspec.json.encode(designed._asdict()).decode() + "\n")
        return
    plain_console().print(_table(designed))
    sys.stdout.writelines(f"{line}\n" for line in _lines(designed, bus, minimise, out))


def _table(designed: SlotDesign) -> Table:
    grid = Table("slot", "channel", "node", "in cycles", "bytes", show_edge=False)
    for slot in designed.slots:
        when = "all" if slot.repetition == 1 else f"{slot.base_cycle} modulo {slot.repetition}"
        row = (slot.frame_id, slot.channel, slot.node, when, slot.payload_bytes)
        grid.add_row(*map(str, row))
    return grid


def _lines(designed: SlotDesign, bus: Cluster, minimise: Goal, out: Path | None) -> list[str]:
    best = "the least" if designed.exact else "the best that was found in time"
    text = [
        f"every frame and share is in time; {len(designed.slots)} entries in {designed.used_slots} "
        f"of {bus.static_slots} static slots" + (f", {best}" if minimise == "slots" else "")
    ]
    if designed.error:
        beside = f", {best}" if minimise == "error" else ""
        text.append(
            f"largest ages of shares, each in us times its growth, sum to {designed.error:.6g}"
            f"{beside}"
        )
    return text + ([f"the slot table is in {out}"] if out is not None else [])
