"""A FlexRay cluster whose parameters have been checked against the specification."""

from collections.abc import Iterator
from decimal import Decimal

import msgspec

from concord.bus.flexray.clock_constraints import (
    Parameter,
    clock_range_violations,
    clock_violations,
)
from concord.bus.flexray.cluster_parameters import ClusterParameters

PARAMETERS: dict[str, Parameter] = {
    "cycle_us": Parameter("gdCycle", 10, 16000),
    "macroticks_per_cycle": Parameter("gMacroPerCycle", 8, 16000),
    "macrotick_us": Parameter("gdMacrotick", 1, 6),
    "microticks_per_cycle": Parameter("pMicroPerCycle", 640, 1280000),
    "static_slots": Parameter("gNumberOfStaticSlots", 2, 1023),
    "static_slot_macroticks": Parameter("gdStaticSlot", 3, 664),
    "action_point_macroticks": Parameter("gdActionPointOffset", 1, 63),
    "static_payload_words": Parameter("gPayloadLengthStatic", 0, 127),
    "minislots": Parameter("gNumberOfMinislots", 0, 7988),
    "minislot_macroticks": Parameter("gdMinislot", 2, 63),
    "minislot_action_point_macroticks": Parameter("gdMinislotActionPointOffset", 1, 31),
    "dynamic_slot_idle_phase_minislots": Parameter("gdDynamicSlotIdlePhase", 0, 2),
    "dynamic_payload_words": Parameter("pPayloadLengthDynMax", 0, 127),
    "latest_transmission_minislot": Parameter("pLatestTx", 0, 7988),
    "symbol_window_macroticks": Parameter("gdSymbolWindow", 0, 162),
    "network_idle_time_macroticks": Parameter("gdNIT", 2, 15978),
    "transmission_start_bits": Parameter("gdTSSTransmitter", 1, 15),
    "number_of_cycles": Parameter("gCycleCountMax + 1", 8, 64),
}
TIMES = ("cycle_us", "macrotick_us")
BIT_RATES_MBPS = (10.0, 5.0, 2.5)
MICROTICKS_US = (0.0125, 0.025, 0.05)
SAMPLES_PER_BIT = 8
SAMPLES_PER_MICROTICK = (1, 2, 4)
MICROTICKS_PER_MACROTICK = (40, 240)
MOST_MISPRINT_US = 0.0005


def range_violations(cluster: ClusterParameters) -> tuple[str, ...]:
    """Every value that no FlexRay cluster has, whatever the others are."""
    return (*_name_and_choices(cluster), *_ranges(cluster), *clock_range_violations(cluster))


def macrotick_violations(cluster: ClusterParameters) -> tuple[str, ...]:
    """Constraint 17, for the macrotick as it is printed.

    gdCycle / gMacroPerCycle is the truth. A printed macrotick may differ from it by one in its last
    digit, and by half a nanosecond at most: 1.375 us stands for 5 ms / 3636.
    """
    macrotick_us = cluster.cycle_us / cluster.macroticks_per_cycle
    digits = -int(Decimal(repr(float(cluster.macrotick_us))).as_tuple().exponent)
    tolerance_us = max(min(10.0**-digits, MOST_MISPRINT_US), 1e-9)
    if abs(cluster.macrotick_us - macrotick_us) <= tolerance_us:
        return ()
    product_us = cluster.macrotick_us * cluster.macroticks_per_cycle
    return (
        "constraint 17 (gdCycle = gdMacrotick x gMacroPerCycle): "
        f"cycle_us is {cluster.cycle_us:g}, but {cluster.macrotick_us:.9g} us x "
        f"{cluster.macroticks_per_cycle} = {product_us:.9g} us; set cycle_us to "
        f"{product_us:.9g} or macrotick_us to {macrotick_us!r}",
    )


def violations(cluster: ClusterParameters) -> tuple[str, ...]:
    """Every constraint between values that the cluster breaks; its ranges are kept."""
    return (
        *_tick_constraints(cluster),
        *_segment_violations(cluster),
        *clock_violations(cluster),
    )


def _name_and_choices(cluster: ClusterParameters) -> Iterator[str]:
    name = cluster.name
    if not name or name != name.strip() or not name.isprintable():
        yield (
            f"name is {name!r}, but must be printable text without spaces at its ends; "
            "give it a name such as 'demo'"
        )
    if cluster.channels not in ("A", "B", "AB"):
        yield f"channels is {cluster.channels!r}, but must be 'A', 'B' or 'AB'; set one of these"
    if cluster.bit_rate_mbps not in BIT_RATES_MBPS:
        yield (
            f"bit_rate_mbps is {cluster.bit_rate_mbps}, but FlexRay knows 10, 5 and 2.5 Mbit/s; "
            "set one of these"
        )
    if cluster.microtick_us not in MICROTICKS_US:
        yield (
            f"microtick_us (pdMicrotick) is {cluster.microtick_us}, but FlexRay knows 0.0125, "
            "0.025 and 0.05 us; set one of these"
        )


def _ranges(cluster: ClusterParameters) -> Iterator[str]:
    for field, (standard_name, low, high) in PARAMETERS.items():
        value = getattr(cluster, field)
        kind, number = ((int, float), "a number") if field in TIMES else (int, "a whole number")
        if not isinstance(value, kind) or isinstance(value, bool) or not low <= value <= high:
            yield (
                f"{field} ({standard_name}) is {value!r}, but must be {number} from {low} to "
                f"{high}; set a value in this range"
            )
        elif field == "number_of_cycles" and value % 2:
            yield (
                f"number_of_cycles is {value}, but must be even, because gCycleCountMax "
                f"({value - 1}) must be odd; set {value + 1}"
            )


def _tick_constraints(cluster: ClusterParameters) -> Iterator[str]:
    sample_us = cluster.bit_us / SAMPLES_PER_BIT
    samples = round(cluster.microtick_us / sample_us, 6)
    if samples not in SAMPLES_PER_MICROTICK:
        fitting = [f"{n * sample_us:g}" for n in SAMPLES_PER_MICROTICK]
        known = [time for time in fitting if float(time) in MICROTICKS_US]
        yield (
            "microtick (pdMicrotick = pSamplesPerMicrotick x gdBit / 8, 1, 2 or 4 samples): "
            f"microtick_us is {cluster.microtick_us:g}, {samples:g} samples at "
            f"{cluster.bit_rate_mbps:g} Mbit/s; set microtick_us to {' or '.join(known)}"
        )
    ratio = cluster.macrotick_us / cluster.microtick_us
    fewest, most = MICROTICKS_PER_MACROTICK
    if not fewest - 1e-6 <= ratio <= most + 1e-6:
        yield (
            "constraint 6 (40 x pdMicrotick <= gdMacrotick <= 240 x pdMicrotick): macrotick_us is "
            f"{cluster.macrotick_us:.9g}, {ratio:.4g} x {cluster.microtick_us:g} us; set "
            f"macrotick_us between {fewest * cluster.microtick_us:g} and "
            f"{most * cluster.microtick_us:g}, or another microtick_us"
        )
    microticks = round(cluster.cycle_us / cluster.microtick_us)
    if cluster.microticks_per_cycle != microticks:
        yield (
            "constraint 19 (pMicroPerCycle = round(gdCycle / pdMicrotick)): "
            f"microticks_per_cycle is {cluster.microticks_per_cycle}, but {cluster.cycle_us:g} "
            f"us / {cluster.microtick_us} us = {microticks}; set microticks_per_cycle to "
            f"{microticks}"
        )
    yield from _cycle_sum(cluster)


def _cycle_sum(cluster: ClusterParameters) -> Iterator[str]:
    difference = cluster.action_point_difference_macroticks
    busy = (
        cluster.static_slots * cluster.static_slot_macroticks
        + difference
        + cluster.minislots * cluster.minislot_macroticks
        + cluster.symbol_window_macroticks
    )
    total = busy + cluster.network_idle_time_macroticks
    if total == cluster.macroticks_per_cycle:
        return
    idle = cluster.macroticks_per_cycle - busy
    cures = [f"set network_idle_time_macroticks to {idle}"] if idle >= 2 else []
    cures.append(f"set macroticks_per_cycle to {total}, or use fewer slots or minislots")
    yield (
        "constraint 18 (gMacroPerCycle = gdStaticSlot x gNumberOfStaticSlots + "
        "adActionPointDifference + gdMinislot x gNumberOfMinislots + gdSymbolWindow + gdNIT): "
        f"macroticks_per_cycle is {cluster.macroticks_per_cycle}, but "
        f"{cluster.static_slot_macroticks} x {cluster.static_slots} + {difference} + "
        f"{cluster.minislot_macroticks} x {cluster.minislots} + {cluster.symbol_window_macroticks} "
        f"+ {cluster.network_idle_time_macroticks} = {total}; " + " or ".join(cures)
    )


def _segment_violations(cluster: ClusterParameters) -> Iterator[str]:
    """Yield a sentence for each slot that is too short for its frame."""
    yield from _short_static_slot(cluster)
    if cluster.minislots == 0:
        return
    if cluster.minislot_action_point_macroticks >= cluster.minislot_macroticks:
        yield (
            "minislot action point (gdMinislotActionPointOffset < gdMinislot): "
            f"minislot_action_point_macroticks is {cluster.minislot_action_point_macroticks}, but "
            f"a minislot has {cluster.minislot_macroticks} macroticks; set a smaller offset"
        )
    yield from _late_transmission(cluster)


def _short_static_slot(cluster: ClusterParameters) -> Iterator[str]:
    need = cluster.static_frame_macroticks(cluster.static_payload_bytes)
    if need > cluster.static_slot_macroticks:
        yield (
            "constraint 12 (gdStaticSlot >= 2 x gdActionPointOffset + frame + 11 idle bits, at "
            "1500 ppm): "
            f"static_slot_macroticks is {cluster.static_slot_macroticks}, but a frame of "
            f"{cluster.static_payload_bytes} bytes needs {need} macroticks; set "
            f"static_slot_macroticks to {need} or fewer static_payload_words"
        )


def _late_transmission(cluster: ClusterParameters) -> Iterator[str]:
    latest = cluster.latest_start_minislot
    if cluster.latest_transmission_minislot > latest:
        longest = cluster.dynamic_slot_most_minislots(cluster.dynamic_payload_bytes)
        yield (
            "constraint 15 (pLatestTx <= gNumberOfMinislots - longest dynamic slot + 1, at 1500 "
            "ppm): "
            f"latest_transmission_minislot is {cluster.latest_transmission_minislot}, but a "
            f"dynamic frame of {cluster.dynamic_payload_bytes} bytes lasts {longest} of "
            f"{cluster.minislots} minislots; set latest_transmission_minislot to {latest} or fewer "
            "dynamic_payload_words"
        )


class ClusterError(ValueError):
    """A cluster that breaks a range or a constraint of the FlexRay specification."""


class Cluster(ClusterParameters, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One FlexRay cluster. Its macrotick is the cycle over the macroticks of a cycle, whatever
    digits were printed.

    Raises `ClusterError` that names every broken rule and its cure.
    """

    def __post_init__(self) -> None:
        broken = range_violations(self)
        if not broken:
            misprint = macrotick_violations(self)
            macrotick_us = self.cycle_us / self.macroticks_per_cycle
            msgspec.structs.force_setattr(self, "macrotick_us", macrotick_us)
            broken = (*misprint, *violations(self))
        if broken:
            raise ClusterError(f"cluster {self.name!r}: " + "; ".join(broken))
