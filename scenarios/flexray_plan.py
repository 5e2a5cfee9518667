"""FlexRay as the bus of a scenario: its cluster, its channels, and written slot tables."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import msgspec

from concord.bus.bus import Bus
from concord.bus.flexray.channels.plan import ChannelPlan, channel_plan
from concord.bus.flexray.cluster import Cluster
from concord.bus.flexray.cluster_files import FILE_ENDINGS, read_cluster_file
from concord.bus.flexray.cluster_parameters import Channels
from concord.bus.flexray.fitted import fitted_cluster
from concord.bus.flexray.flexray_bus import flexray_bus, written_bus
from concord.bus.flexray.message_slot import MessageSlot
from concord.bus.flexray.presets import PRESETS, preset
from concord.bus.flexray.share_frames import SHARE_FRAMES, payload_lengths
from concord.bus.flexray.slot_file import read_slot_file
from concord.bus.flexray.written_slots import written_schedule
from concord.bus.schedule import Schedule
from concord.scenarios.bus_definition import BusDefinition, BusRequest
from concord.scenarios.types.buses import ALL_CHANNELS, FlexRay
from concord.scenarios.types.schedules import WrittenSchedule, arbiter_of
from concord.topology.names import unknown_name

FITTED = "fitted"
# The same with every frame on both channels.
REDUNDANT = "fitted-ab"


def cluster_names() -> tuple[str, ...]:
    """Return the names that --cluster accepts beside files."""
    return (FITTED, REDUNDANT, *PRESETS)


def schedule_of_table(bus: FlexRay, chosen: WrittenSchedule, nodes: int) -> Schedule:
    """Return the schedule of a written slot table.

    Raises:
        ValueError: there is no such table, or it is not of this network.
    """
    cluster, slots = _written(bus, chosen)
    with _naming(chosen.slots):
        return written_schedule(slots, cluster, nodes)


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
    cluster = _named_cluster(bus.cluster)
    with _naming(schedule.slots):
        return cluster, read_slot_file(Path(schedule.slots), cluster)


def _flexray(chosen: FlexRay, asked: BusRequest) -> Bus:
    if not chosen.withdrawal:
        _check_cuts(chosen, asked)
        asked = asked._replace(arbiter=asked.arbiter._replace(withdraws=False, cuts=True))
    if isinstance(chosen.schedule, WrittenSchedule):
        cluster, slots = _written(chosen, chosen.schedule)
        _check_no_written_relay(asked.schedule)
        _check_no_written_channels(chosen)
        with _naming(chosen.schedule.slots):
            return written_bus(slots, cluster, asked.schedule, asked.share_bytes, asked.arbiter)
    cluster, plan = _cluster(chosen, asked)
    return flexray_bus(
        asked.schedule,
        cluster,
        asked.share_bytes,
        asked.arbiter,
        asked.latch_delay_us,
        asked.classes,
        plan,
    )


def _check_cuts(chosen: FlexRay, asked: BusRequest) -> None:
    """Refuse hosts that do not withdraw where no controller could send what they leave."""
    arbiter, schedule = arbiter_of(chosen.schedule), asked.schedule
    if not any(schedule.contender_table):
        raise ValueError(
            "--no-withdrawal: no node contends for the dynamic segment; use --schedule dynamic or "
            "hybrid, or leave --no-withdrawal out"
        )
    if asked.arbiter.is_ideal:
        raise ValueError(
            f"--no-withdrawal --arbiter {arbiter}: an ideal arbiter awards whole shares, which no "
            "controller does; use --arbiter urgency or minislot, or leave --no-withdrawal out"
        )
    if schedule.relay:
        raise ValueError(
            "--no-withdrawal --relay: with --relay a host composes each frame in its slot, and "
            "leaves none in its buffers; leave one of the two out"
        )


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


def _cluster(chosen: FlexRay, asked: BusRequest) -> tuple[Cluster, ChannelPlan]:
    """Return the cluster, and the channels of the shares on it."""
    name = chosen.cluster
    if name not in (FITTED, REDUNDANT):
        cluster = _named_cluster(name)
        return cluster, channel_plan(chosen.channels, cluster.channels, name)
    channels: Channels = "A" if name == FITTED else "AB"
    plan = channel_plan(chosen.channels, channels, name)
    fitted = _fitted(asked.schedule, asked.share_bytes, asked.classes.count, plan)
    return msgspec.structs.replace(fitted, channels=channels), plan


def _named_cluster(name: str) -> Cluster:
    """Return the cluster of a preset or a file."""
    if name in PRESETS:
        return preset(name)
    path = Path(name)
    if path.suffix not in FILE_ENDINGS:
        raise unknown_name(
            "cluster", name, (*cluster_names(), "FILE.toml", "FILE.xml", "FILE.arxml")
        )
    return read_cluster_file(path)


def _fitted(schedule: Schedule, share_bytes: int, classes: int, plan: ChannelPlan) -> Cluster:
    try:
        return fitted_cluster(schedule, payload_lengths(share_bytes), classes, plan)
    except ValueError as error:
        senders = max(
            len(schedule.static_senders(cycle)) + schedule.dynamic_slots(cycle)
            for cycle in range(schedule.period)
        )
        raise ValueError(
            f"no FlexRay cycle (16 ms at most) holds {senders} shares of {share_bytes} bytes"
            + (f" and frame IDs of {classes} urgency classes" if classes > 1 else "")
            + "; lower --occupancy"
            + (" or --urgency-classes" if classes > 1 else "")
            + ", use --number float32, or --bus ideal for a bus without time "
            f"({error})"
        ) from None


FLEXRAY = BusDefinition(_flexray, lambda _: SHARE_FRAMES)
