"""Shared parts of the bus tests: random clusters, requests and frames, and bitwise checksums."""

import math
from collections.abc import Sequence

import msgspec
import pytest
from hypothesis import settings
from hypothesis import strategies as st

from concord.bus.flexray.cluster import Cluster, ClusterError
from concord.bus.flexray.dynamic_segment import Request, walk
from concord.bus.flexray.frame import Frame

quick = settings(max_examples=60)


def long_division(bits: str, polynomial: int, width: int, initial: int) -> int:
    """CRC of a text of 0 and 1 by dividing polynomials: the definition, without tables.

    The initial value adds to the first `width` bits; the generator has an implicit leading one.
    """
    dividend = [int(bit) for bit in bits] + [0] * width
    for place in range(width):
        dividend[place] ^= initial >> (width - 1 - place) & 1
    divisor = [1] + [polynomial >> (width - 1 - place) & 1 for place in range(width)]
    for place in range(len(bits)):
        if dividend[place]:
            for offset, bit in enumerate(divisor):
                dividend[place + offset] ^= bit
    return int("".join(map(str, dividend[-width:])), 2)


def binary(data: bytes) -> str:
    return "".join(f"{byte:08b}" for byte in data)


def broken(cluster: Cluster, **fields: object) -> str:
    """Return why a cluster with these fields is refused."""
    with pytest.raises(ClusterError) as refused:
        msgspec.structs.replace(cluster, **fields)
    return str(refused.value)


@st.composite
def clusters(draw: st.DrawFn, min_minislots: int = 0) -> Cluster:
    """Clusters that meet every constraint, made from slots, so that constraint 18 gives the NIT."""
    ticks = [(10.0, 1.0, 0.025), (10.0, 1.25, 0.0125), (5.0, 2.0, 0.025), (2.5, 3.5, 0.05)]
    rate, macrotick_us, microtick_us = draw(st.sampled_from(ticks))
    action_point = draw(st.integers(1, 5))
    start_bits = draw(st.integers(1, 15))
    words = draw(st.integers(0, 10))
    bits = start_bits + 1 + 10 * (8 + 2 * words) + 2 + 11
    # Sender slow, receiver fast, each by 1500 ppm.
    slow_us, fast = 1.0015 / rate, 0.9985 * macrotick_us
    slot = 2 * action_point + math.ceil(bits * slow_us / fast) + draw(st.integers(0, 5))
    slots = draw(st.integers(2, 8))
    minislots = draw(st.integers(min_minislots, 90))
    minislot_action_point = draw(st.integers(1, 4))
    minislot = minislot_action_point + draw(st.integers(1, 6))
    idle_phase = draw(st.integers(0, 2))
    dynamic_words = draw(st.integers(0, 12))
    dynamic_us = (start_bits + 1 + 10 * (8 + 2 * dynamic_words) + 2 + 1) * slow_us
    longest = math.ceil(dynamic_us / (minislot * fast)) + 1 + idle_phase
    window, idle = draw(st.integers(0, 20)), draw(st.integers(2, 30))
    difference = max(0, action_point - minislot_action_point) if minislots else 0
    macroticks = slot * slots + difference + minislot * minislots + window + idle
    return Cluster(
        name="random",
        channels=draw(st.sampled_from(["A", "B", "AB"])),
        bit_rate_mbps=rate,
        cycle_us=macroticks * macrotick_us,
        macroticks_per_cycle=macroticks,
        macrotick_us=macrotick_us,
        microtick_us=microtick_us,
        microticks_per_cycle=round(macroticks * macrotick_us / microtick_us),
        number_of_cycles=2 * draw(st.integers(4, 32)),
        static_slots=slots,
        static_slot_macroticks=slot,
        action_point_macroticks=action_point,
        static_payload_words=words,
        minislots=minislots,
        minislot_macroticks=minislot,
        minislot_action_point_macroticks=minislot_action_point,
        dynamic_slot_idle_phase_minislots=idle_phase,
        dynamic_payload_words=dynamic_words,
        latest_transmission_minislot=draw(st.integers(0, max(0, minislots - longest + 1))),
        symbol_window_macroticks=window,
        network_idle_time_macroticks=idle,
        transmission_start_bits=start_bits,
    )


@st.composite
def dynamic_segments(draw: st.DrawFn) -> tuple[Cluster, list[Request]]:
    """A cluster, and requests for distinct dynamic slots, of one frame each."""
    cluster = draw(clusters(min_minislots=1))
    places = draw(st.sets(st.integers(0, 60), max_size=12))
    requests = [
        Request(
            node=place,
            frame_id=cluster.first_dynamic_id + place,
            payload_bytes=2 * draw(st.integers(0, cluster.dynamic_payload_words)),
        )
        for place in sorted(places)
    ]
    return cluster, draw(st.permutations(requests))


def served(cluster: Cluster, requests: Sequence[Request]) -> list[Request]:
    """The requests that the minislots of a cycle hold, low frame IDs first."""
    waiting = walk(cluster, requests).waiting
    return [request for request in requests if request not in waiting]


@st.composite
def frames(draw: st.DrawFn) -> Frame:
    sync = draw(st.booleans())
    return Frame(
        frame_id=draw(st.integers(1, 2047)),
        cycle_count=draw(st.integers(0, 63)),
        payload=draw(st.binary(max_size=127).map(lambda half: half + half)),
        payload_preamble=draw(st.booleans()),
        null=draw(st.booleans()),
        sync=sync,
        startup=sync and draw(st.booleans()),
    )
