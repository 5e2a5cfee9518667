"""Written slot tables as the schedule and the bus of a scenario."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from concord.bus.bus import Bus
from concord.bus.flexray.cluster import Cluster
from concord.bus.flexray.dynamic_segment import MessageSlot
from concord.bus.flexray.presets import PRESETS
from concord.bus.flexray.slot_file import read_slot_file
from concord.bus.flexray.written_slots import written_bus, written_schedule
from concord.bus.schedule import Schedule
from concord.scenarios.bus_table.bus_definition import BusRequest
from concord.scenarios.bus_table.clusters import FITTED, REDUNDANT, named_cluster
from concord.scenarios.types.buses import ALL_CHANNELS, FlexRay
from concord.scenarios.types.schedules import WrittenSchedule


def schedule_of_table(bus: FlexRay, chosen: WrittenSchedule, nodes: int) -> Schedule:
    """Return the schedule of a written slot table.

    Raises:
        ValueError: there is no such table, or it is not of this network.
    """
    cluster, slots = _written(bus, chosen)
    with _naming(chosen.slots):
        return written_schedule(slots, cluster, nodes)


def bus_of_table(chosen: FlexRay, schedule: WrittenSchedule, asked: BusRequest) -> Bus:
    """Return the bus of a written slot table.

    Raises:
        ValueError: the table cannot be read, or does not hold the shares.
    """
    cluster, slots = _written(chosen, schedule)
    _check_no_written_relay(asked.schedule)
    _check_no_written_channels(chosen)
    with _naming(schedule.slots):
        return written_bus(slots, cluster, asked.schedule, asked.share_bytes, asked.arbiter)


@contextmanager
def _naming(slots: str) -> Iterator[None]:
    """Say which slot table is wrong."""
    try:
        yield
    except ValueError as error:
        raise ValueError(f"--slots {slots}: {error}") from None


def _written(bus: FlexRay, schedule: WrittenSchedule) -> tuple[Cluster, tuple[MessageSlot, ...]]:
    """Return the cluster and the slots of a bus with a written table.

    Raises:
        ValueError: there is no such table, or no cluster that it could be of.
    """
    if not schedule.slots:
        raise ValueError("--schedule written: name its slot table with --slots FILE.toml")
    if bus.cluster in (FITTED, REDUNDANT):
        raise ValueError(
            f"--cluster {bus.cluster}: a slot table belongs to one cluster; name it, as a preset "
            f"({', '.join(PRESETS)}) or a file"
        )
    cluster = named_cluster(bus.cluster)
    with _naming(schedule.slots):
        return cluster, read_slot_file(Path(schedule.slots), cluster)


def _check_no_written_relay(schedule: Schedule) -> None:
    if schedule.relay:
        raise ValueError(
            "--relay --schedule written: a host latches its frame in the slot order that "
            "concord gives; use another --schedule, or leave --relay out"
        )


def _check_no_written_channels(chosen: FlexRay) -> None:
    if chosen.channels != ALL_CHANNELS:
        raise ValueError(
            f"--channels {chosen.channels} --schedule written: the slot table says which channel "
            "carries a frame; leave --channels out, or use another --schedule"
        )
