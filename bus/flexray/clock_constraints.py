"""The ranges and constraints of start-up and clock synchronisation that a cluster states.

Ranges: FlexRay 3.0.1, appendix B, as vectorgrp/sil-kit cites them; the drift damping is that of 2.1
(0..20). Numbers of constraints: 2.1. A parameter that is not stated breaks no rule.
"""

import math
from collections.abc import Iterator
from typing import NamedTuple

from concord.bus.flexray.cluster_parameters import (
    CLOCK_DEVIATION,
    ClockParameters,
    ClusterParameters,
)


class Parameter(NamedTuple):
    """A parameter's name in the specification, and its range (both ends belong to it)."""

    standard_name: str
    low: int
    high: int


CLOCK_PARAMETERS: dict[str, Parameter] = {
    "sync_nodes_most": Parameter("gSyncFrameIDCountMax", 2, 15),
    "cold_start_attempts": Parameter("gColdstartAttempts", 2, 31),
    "listen_noise": Parameter("gListenNoise", 2, 16),
    "passive_after_cycle_pairs": Parameter("gMaxWithoutClockCorrectionPassive", 1, 15),
    "halt_after_cycle_pairs": Parameter("gMaxWithoutClockCorrectionFatal", 1, 15),
    "drift_damping_microticks": Parameter("pClusterDriftDamping", 0, 20),
    "precision_us": Parameter("gAssumedPrecision", 0, 30),
    "propagation_delay_us": Parameter("gdMaxPropagationDelay", 0, 3),
    "offset_correction_us": Parameter("gOffsetCorrectionMax", 0, 400),
    "offset_correction_start_macroticks": Parameter("gOffsetCorrectionStart", 7, 15999),
    "offset_correction_microticks": Parameter("pOffsetCorrectionOut", 15, 16082),
    "rate_correction_microticks": Parameter("pRateCorrectionOut", 3, 3846),
    "drift_microticks": Parameter("pdMaxDrift", 2, 3846),
    "listen_timeout_microticks": Parameter("pdListenTimeout", 1926, 2567692),
    "startup_range_microticks": Parameter("pdAcceptedStartupRange", 29, 2743),
}
CLOCK_TIMES = ("precision_us", "propagation_delay_us", "offset_correction_us")
MOST_SYNC_NODES = 15
# Macroticks that a correction shortens keep at least 20 microticks (cMicroPerMacroMin).
SHORTEST_MACROTICK_MICROTICKS = 20


def clock_range_violations(cluster: ClockParameters) -> Iterator[str]:
    """Yield a sentence for each stated parameter that is out of its range."""
    for field, (standard_name, low, high) in CLOCK_PARAMETERS.items():
        value = getattr(cluster, field)
        number = "a number" if field in CLOCK_TIMES else "a whole number"
        kind = (int, float) if field in CLOCK_TIMES else int
        known = value is None or (isinstance(value, kind) and not isinstance(value, bool))
        if not known or (value is not None and not low <= value <= high):
            yield (
                f"{field} ({standard_name}) is {value!r}, but must be {number} from {low} to "
                f"{high}; set a value in this range, or leave it out"
            )


def clock_violations(cluster: ClusterParameters) -> Iterator[str]:
    """Yield a sentence for each broken constraint between parameters that are stated."""
    yield from _key_slots(cluster)
    passive, halt = cluster.passive_after_cycle_pairs, cluster.halt_after_cycle_pairs
    if passive is not None and halt is not None and halt < passive:
        yield (
            "clock correction (gMaxWithoutClockCorrectionPassive <= "
            f"gMaxWithoutClockCorrectionFatal): halt_after_cycle_pairs is {halt}, but "
            f"passive_after_cycle_pairs is {passive}; set halt_after_cycle_pairs to {passive}"
        )
    yield from _rates(cluster)
    yield from _offset_correction(cluster)


def offset_correction_macroticks(cluster: ClusterParameters, offset_us: float) -> int:
    """Macroticks in which a clock can be set back by that much (FlexRay 2.1, equation 17)."""
    shortest_us = SHORTEST_MACROTICK_MICROTICKS * cluster.microtick_us * (1 + CLOCK_DEVIATION)
    spare_us = cluster.macrotick_us * (1 - CLOCK_DEVIATION) - shortest_us
    return math.ceil(offset_us / spare_us - 1e-9)


def _key_slots(cluster: ClusterParameters) -> Iterator[str]:
    sync, startup = cluster.sync_slots, cluster.startup_slots
    for field, slots in (("sync_slots", sync), ("startup_slots", startup)):
        beyond = [slot for slot in slots if not 1 <= slot <= cluster.static_slots]
        if beyond or len(set(slots)) < len(slots):
            yield (
                f"key slots (pKeySlotId is a static slot of one node): {field} has "
                f"{', '.join(map(str, slots))}, but static slots are 1 to {cluster.static_slots}; "
                "name each static slot of a sync node once"
            )
    most = cluster.sync_nodes_most or MOST_SYNC_NODES
    if sync and not 2 <= len(sync) <= most:
        yield (
            f"sync nodes (2 to gSyncFrameIDCountMax = {most}): sync_slots has {len(sync)}; name "
            f"2 to {most} key slots"
        )
    if startup and not set(startup) <= set(sync):
        alone = ", ".join(str(slot) for slot in startup if slot not in sync)
        yield (
            "start-up (a startup frame is a sync frame): startup_slots has "
            f"{alone}, but sync_slots does not; add it to sync_slots"
        )
    if (startup or sync) and len(startup) < 2:
        yield (
            "start-up (two cold-start nodes at least): startup_slots has "
            f"{len(startup)}; name the key slots of two or three nodes that start the cluster"
        )


def _rates(cluster: ClusterParameters) -> Iterator[str]:
    per_cycle = cluster.microticks_per_cycle
    most = math.ceil(per_cycle * 2 * CLOCK_DEVIATION / (1 - CLOCK_DEVIATION))
    for field in ("drift_microticks", "rate_correction_microticks"):
        value = getattr(cluster, field)
        if value is not None and value > most:
            yield (
                f"constraint 30 ({CLOCK_PARAMETERS[field].standard_name} <= 2 x 1500 ppm of "
                f"pMicroPerCycle): {field} is {value}, but {per_cycle} microticks allow {most}; "
                f"set {field} to {most}"
            )
    drift, timeout = cluster.drift_microticks, cluster.listen_timeout_microticks
    if drift is not None and timeout is not None and timeout != 2 * (per_cycle + drift):
        yield (
            "constraint 31 (pdListenTimeout = 2 x (pMicroPerCycle + pdMaxDrift)): "
            f"listen_timeout_microticks is {timeout}, but 2 x ({per_cycle} + {drift}) = "
            f"{2 * (per_cycle + drift)}; set listen_timeout_microticks to {2 * (per_cycle + drift)}"
        )


def _offset_correction(cluster: ClusterParameters) -> Iterator[str]:
    offset_us, microticks = cluster.offset_correction_us, cluster.offset_correction_microticks
    fast_us = cluster.microtick_us * (1 - CLOCK_DEVIATION)
    if offset_us is not None and microticks is not None and microticks * fast_us < offset_us - 1e-9:
        need = math.ceil(offset_us / fast_us - 1e-9)
        yield (
            "constraint 25 (pOffsetCorrectionOut >= gOffsetCorrectionMax / pdMicrotick): "
            f"offset_correction_microticks is {microticks}, but {offset_us:g} us need {need}; set "
            f"offset_correction_microticks to {need}"
        )
    start = cluster.offset_correction_start_macroticks
    if start is None:
        return
    if offset_us is None:
        offset_us = (microticks or 0) * fast_us
    end = cluster.macroticks_per_cycle
    idle = end - cluster.network_idle_time_macroticks
    need = max(1, offset_correction_macroticks(cluster, offset_us))
    if not idle < start <= end - need:
        cure = (
            f"set offset_correction_start_macroticks to {end - need}"
            if idle < end - need
            else f"set network_idle_time_macroticks to {need + 1} or more"
        )
        yield (
            "constraint 26 (offset correction lies in the network idle time, after its first "
            f"macrotick): offset_correction_start_macroticks is {start}, but the idle time is "
            f"{idle} to {end} and the correction takes {need} macroticks; {cure}"
        )
