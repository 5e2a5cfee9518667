"""The editions of the FlexRay specification, and physics, that a cluster may be held to.

A `Cluster` keeps the rules that 2.1 and 3.0.1 share. A level adds what one of them alone demands,
or what nodes on a real wire need.
"""

import math
from collections.abc import Callable, Iterator

from concord.bus.flexray.clock_constraints import offset_correction_macroticks
from concord.bus.flexray.cluster import SAMPLES_PER_BIT, Cluster
from concord.bus.flexray.cluster_parameters import CLOCK_DEVIATION

_USUAL_DAMPING_MICROTICKS = 1
_MICROTICKS_PER_CYCLE_3_0 = 960
_MINISLOTS_2_1 = 7986
_DAMPING_3_0 = 10


def precision_us(cluster: Cluster) -> float:
    """Return the largest difference of two nodes' clocks, in microseconds: the stated
    gAssumedPrecision, or the worst case of FlexRay 3.0.1.

    The worst case is (34 + 20 gClusterDriftDamping) microticks and twice the propagation delay;
    a damping that is not stated counts as 1 microtick.
    """
    if cluster.precision_us is not None:
        return cluster.precision_us
    damping = cluster.drift_damping_microticks
    microticks = 34 + 20 * (_USUAL_DAMPING_MICROTICKS if damping is None else damping)
    return microticks * cluster.microtick_us + 2 * (cluster.propagation_delay_us or 0.0)


def broken_rules(cluster: Cluster) -> dict[str, tuple[str, ...]]:
    """Return for each level the rules that the cluster breaks."""
    return {level: tuple(rules(cluster)) for level, rules in LEVELS.items()}


def _edition_2_1(cluster: Cluster) -> Iterator[str]:
    if cluster.number_of_cycles != 64:
        yield (
            f"number_of_cycles is {cluster.number_of_cycles}, but FlexRay 2.1 always counts 64 "
            "cycles; set 64"
        )
    if cluster.minislots > _MINISLOTS_2_1:
        yield (
            f"minislots (gNumberOfMinislots) is {cluster.minislots}, but FlexRay 2.1 has "
            f"{_MINISLOTS_2_1} at most; set fewer"
        )


def _edition_3_0_1(cluster: Cluster) -> Iterator[str]:
    if cluster.microticks_per_cycle < _MICROTICKS_PER_CYCLE_3_0:
        yield (
            f"microticks_per_cycle (pMicroPerCycle) is {cluster.microticks_per_cycle}, but must be "
            f"at least {_MICROTICKS_PER_CYCLE_3_0}; make the cycle longer"
        )
    samples = round(cluster.microtick_us * SAMPLES_PER_BIT * cluster.bit_rate_mbps)
    if samples > 2:
        yield (
            f"microtick_us (pdMicrotick) is {cluster.microtick_us:g}, {samples} samples, but "
            f"pSamplesPerMicrotick is 1 or 2; set microtick_us to {cluster.microtick_us / 2:g}"
        )
    damping = cluster.drift_damping_microticks or 0
    if damping > _DAMPING_3_0:
        yield (
            f"drift_damping_microticks (pClusterDriftDamping) is {damping}, but must be at most "
            f"{_DAMPING_3_0}; set fewer"
        )


def _physical(cluster: Cluster) -> Iterator[str]:
    """Clocks as far apart as the precision: frames stay in their slots, corrections in theirs."""
    precision = precision_us(cluster)
    fast_us = cluster.macrotick_us * (1 - CLOCK_DEVIATION)
    offset = math.ceil(precision / fast_us - 1e-9)
    rest = math.ceil((precision + (cluster.propagation_delay_us or 0.0)) / fast_us - 1e-9)
    if cluster.action_point_macroticks < offset:
        yield (
            f"action point (gdActionPointOffset >= precision): action_point_macroticks is "
            f"{cluster.action_point_macroticks}, but a precision of {precision:g} us is {offset} "
            f"macroticks; set {offset}"
        )
    if cluster.minislots and cluster.minislot_action_point_macroticks < offset:
        yield (
            "minislot action point (gdMinislotActionPointOffset >= precision): "
            f"minislot_action_point_macroticks is {cluster.minislot_action_point_macroticks}, but "
            f"a precision of {precision:g} us is {offset} macroticks; set {offset}"
        )
    short = cluster.minislot_action_point_macroticks + rest > cluster.minislot_macroticks
    if cluster.minislots and short:
        yield (
            "minislot (gdMinislot >= gdMinislotActionPointOffset + precision + propagation): "
            f"minislot_macroticks is {cluster.minislot_macroticks}, but needs "
            f"{cluster.minislot_action_point_macroticks + rest}; set this"
        )
    window = cluster.symbol_window_least_macroticks()
    if 0 < cluster.symbol_window_macroticks < window:
        yield (
            "constraint 16 (gdSymbolWindow holds a symbol, or is 0): symbol_window_macroticks is "
            f"{cluster.symbol_window_macroticks}, but a symbol needs {window}; set 0 or {window}"
        )
    need = 1 + offset_correction_macroticks(cluster, precision)
    if cluster.network_idle_time_macroticks < need:
        yield (
            "network idle time (gdNIT holds the offset correction): network_idle_time_macroticks "
            f"is {cluster.network_idle_time_macroticks}, but a correction by the precision of "
            f"{precision:g} us needs {need}; set {need} or more"
        )


LEVELS: dict[str, Callable[[Cluster], Iterator[str]]] = {
    "2.1": _edition_2_1,
    "3.0.1": _edition_3_0_1,
    "physical": _physical,
}
