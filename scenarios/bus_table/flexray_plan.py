"""FlexRay as the bus of a scenario: its cluster, its channels, and written slot tables."""

from pathlib import Path

import msgspec

from concord.bus.bus import Bus, TooLong
from concord.bus.flexray.channels.plan import ChannelPlan, channel_plan
from concord.bus.flexray.cluster import Cluster
from concord.bus.flexray.cluster_parameters import Channels
from concord.bus.flexray.fitted import fitted_cluster
from concord.bus.flexray.flexray_bus import flexray_bus
from concord.bus.flexray.share_frames import SHARE_FRAMES, payload_lengths
from concord.bus.schedule import Schedule
from concord.scenarios.bus_table.bus_definition import BusDefinition, BusRequest
from concord.scenarios.bus_table.clusters import FITTED, REDUNDANT, named_cluster
from concord.scenarios.scenario import Scenario
from concord.scenarios.types.buses import FlexRay
from concord.scenarios.types.schedules import WrittenSchedule, arbiter_of


def _flexray(chosen: FlexRay, asked: BusRequest) -> Bus:
    if not chosen.withdrawal:
        _check_cuts(chosen, asked)
        asked = asked._replace(arbiter=asked.arbiter._replace(withdraws=False, cuts=True))
    if isinstance(chosen.schedule, WrittenSchedule):
        # Only here: most networks have no written table.
        from concord.scenarios.bus_table.written_plan import bus_of_table

        return bus_of_table(chosen, chosen.schedule, asked)
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


def _cluster(chosen: FlexRay, asked: BusRequest) -> tuple[Cluster, ChannelPlan]:
    """Return the cluster, and the channels of the shares on it."""
    name = chosen.cluster
    if name not in (FITTED, REDUNDANT):
        cluster = named_cluster(name)
        return cluster, channel_plan(chosen.channels, cluster.channels, name)
    channels: Channels = "A" if name == FITTED else "AB"
    plan = channel_plan(chosen.channels, channels, name)
    fitted = _fitted(asked.schedule, asked.share_bytes, asked.classes.count, plan)
    return msgspec.structs.replace(fitted, channels=channels), plan


def _fitted(schedule: Schedule, share_bytes: int, classes: int, plan: ChannelPlan) -> Cluster:
    try:
        return fitted_cluster(schedule, payload_lengths(share_bytes), classes, plan)
    except ValueError as error:
        senders = max(
            len(schedule.static_senders(cycle)) + schedule.dynamic_slots(cycle)
            for cycle in range(schedule.period)
        )
        raise TooLong(
            f"no FlexRay cycle (16 ms at most) holds {senders} shares of {share_bytes} bytes"
            + (f" and frame IDs of {classes} urgency classes" if classes > 1 else "")
            + f" ({error}); use fewer senders, or shorter shares"
        ) from None


def _notes(scenario: Scenario) -> tuple[str, ...]:
    chosen = scenario.bus
    if not isinstance(chosen, FlexRay) or "." not in chosen.cluster:
        return ()
    from concord.bus.flexray.cluster_files import cluster_with_notes

    return cluster_with_notes(Path(chosen.cluster))[1]


FLEXRAY = BusDefinition(_flexray, lambda _: SHARE_FRAMES, _notes)
