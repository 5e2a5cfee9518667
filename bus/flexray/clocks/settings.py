"""The figures of a cluster by which its nodes synchronise their clocks and start up."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from concord.bus.arbitration import Numbers
from concord.bus.flexray.clock_constraints import (
    MOST_SYNC_NODES,
    SHORTEST_MACROTICK_MICROTICKS,
)
from concord.bus.flexray.cluster import Cluster
from concord.bus.flexray.cluster_parameters import CLOCK_DEVIATION
from concord.bus.flexray.levels import precision_us
from concord.bus.flexray.publication import SyncNode

# Chosen for clusters that do not state the parameter.
_DAMPING_MICROTICKS = 1
_PASSIVE_PAIRS = 2
_HALT_PAIRS = 4
_ATTEMPTS = 8

TICK = 10**9
"""Units of time in a microtick of a clock without deviation, so a clock's rate is an integer."""

Mask = NDArray[np.bool_]


class ClockSettings(NamedTuple):
    """Parameters that each node knows of its cluster; names of FlexRay 2.1 beside each value.

    Attributes:
        microticks: pMicroPerCycle. macroticks: gMacroPerCycle. microtick_us: pdMicrotick.
        action_points: (S,), macroticks from the start of the cycle to each sync frame.
        window: microticks by which a sync frame may be early or late (gdActionPointOffset).
        correction_start: macrotick at which offset correction begins (gOffsetCorrectionStart).
        damping: pClusterDriftDamping. rate_limit: pRateCorrectionOut.
        offset_limit: pOffsetCorrectionOut.
        passive_pairs: gMaxWithoutClockCorrectionPassive.
        halt_pairs: gMaxWithoutClockCorrectionFatal.
        attempts: gColdstartAttempts. listen: pdListenTimeout in microticks.
        sync: the sync nodes. precision_us: gAssumedPrecision, or the worst case of FlexRay.
        delay_us: gdMaxPropagationDelay.
    """

    microticks: int
    macroticks: int
    microtick_us: float
    action_points: Numbers
    window: int
    correction_start: int
    damping: int
    rate_limit: int
    offset_limit: int
    passive_pairs: int
    halt_pairs: int
    attempts: int
    listen: int
    sync: tuple[SyncNode, ...]
    precision_us: float
    delay_us: float

    @property
    def senders(self) -> Numbers:
        """The nodes that send sync frames, (S,)."""
        return np.array([one.node for one in self.sync], dtype=np.int64)

    @property
    def starters(self) -> Mask:
        """Whether each sync frame is a startup frame, (S,)."""
        return np.array([one.starts for one in self.sync])


def clock_settings(cluster: Cluster, nodes: int, known: Sequence[SyncNode] = ()) -> ClockSettings:
    """Return the settings of a cluster of so many nodes, with defaults for what it leaves open.

    Without `known` sync nodes the first nodes are these, in the order of their key slots.

    Raises:
        ValueError: the cluster has fewer than two nodes, or more key slots than nodes.
    """
    stated = cluster.offset_correction_start_macroticks
    start = cluster.macroticks_per_cycle - cluster.network_idle_time_macroticks + 1
    sync = tuple(known) or sync_nodes(cluster, nodes)
    per_cycle = cluster.microticks_per_cycle
    most = math.ceil(per_cycle * 2 * CLOCK_DEVIATION / (1 - CLOCK_DEVIATION))
    drift = _or(cluster.drift_microticks, most)
    points = [
        (one.key_slot - 1) * cluster.static_slot_macroticks + cluster.action_point_macroticks
        for one in sync
    ]
    passive = _or(cluster.passive_after_cycle_pairs, _PASSIVE_PAIRS)
    return ClockSettings(
        microticks=per_cycle,
        macroticks=cluster.macroticks_per_cycle,
        microtick_us=cluster.microtick_us,
        action_points=np.array(points, dtype=np.int64),
        window=int(cluster.action_point_us / cluster.microtick_us),
        correction_start=_or(stated, start),
        damping=_or(cluster.drift_damping_microticks, _DAMPING_MICROTICKS),
        rate_limit=_or(cluster.rate_correction_microticks, most),
        offset_limit=_or(cluster.offset_correction_microticks, _offset_room(cluster)),
        passive_pairs=passive,
        halt_pairs=_or(cluster.halt_after_cycle_pairs, max(passive, _HALT_PAIRS)),
        attempts=_or(cluster.cold_start_attempts, _ATTEMPTS),
        listen=_or(cluster.listen_timeout_microticks, 2 * (per_cycle + drift)),
        sync=sync,
        precision_us=precision_us(cluster),
        delay_us=cluster.propagation_delay_us or 0.0,
    )


def sync_nodes(cluster: Cluster, nodes: int) -> tuple[SyncNode, ...]:
    """Return the sync nodes of a cluster of so many nodes, by key slot.

    Without stated key slots each of the first nodes has one, up to the most that a cluster
    carries, and the first three start the cluster.
    """
    if nodes < 2:
        raise ValueError(
            f"cluster {cluster.name!r} has {nodes} node, but clocks are synchronised by the sync "
            "frames of two nodes or more; use at least 2 nodes"
        )
    stated = sorted(cluster.sync_slots)
    if len(stated) > nodes:
        raise ValueError(
            f"cluster {cluster.name!r} has {len(stated)} sync nodes (sync_slots), but there are "
            f"{nodes} nodes; use at least {len(stated)} nodes"
        )
    most = cluster.sync_nodes_most or MOST_SYNC_NODES
    count = min(nodes, most, cluster.static_slots)
    slots: Sequence[int] = stated or range(1, count + 1)
    starters = set(cluster.startup_slots or slots[:3])
    return tuple(SyncNode(node, slot, slot in starters) for node, slot in enumerate(slots))


def _or(stated: int | None, default: int) -> int:
    return default if stated is None else stated


def _offset_room(cluster: Cluster) -> int:
    """Microticks by which the idle time can shorten: macroticks keep 20 microticks each."""
    per_macrotick = cluster.microticks_per_cycle // cluster.macroticks_per_cycle
    spare = max(1, per_macrotick - SHORTEST_MACROTICK_MICROTICKS)
    return max(1, cluster.network_idle_time_macroticks - 1) * spare
