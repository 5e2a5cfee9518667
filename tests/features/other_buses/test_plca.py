"""10BASE-T1S with PLCA: Ethernet frames bit by bit, PLCA cycles, bounds, a network's bus."""

import random
from collections import deque
from collections.abc import Sequence
from itertools import pairwise
from math import inf

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import concord as cc
from concord.bus.arbitration import ARBITERS
from concord.bus.bus import Captured, Rejected
from concord.bus.schedule import full_publish, round_robin
from concord.features.other_buses.plca.cycle import (
    PlcaSettings,
    longest_walk_bits,
    share_bits,
    walk,
    worst_access_bits,
)
from concord.features.other_buses.plca.ethernet import FRAMING, frame_bits, pack, unpack
from concord.features.other_buses.plca.plca_bus import PlcaBus
from concord.features.other_buses.plca.without_beacons import (
    COLLISION_BITS,
    SLOT_BITS,
    contend,
)
from concord.scenarios.preparation import prepare
from concord.scenarios.user.bus import broken_promises
from concord.scenarios.warnings import warnings_of
from tests.bus.support import long_division, quick

timings = st.builds(PlcaSettings, st.integers(1, 255), st.integers(0, 3))
payloads = st.binary(min_size=46, max_size=400)

# --- frames --------------------------------------------------------------------------------------


def check_sequence(data: bytes) -> int:
    """CRC-32 by long division: each byte sent with its lowest bit first, first 32 bits inverted."""
    bits = "".join(f"{byte:08b}"[::-1] for byte in data)
    remainder = long_division(bits, 0x04C11DB7, 32, 0xFFFFFFFF) ^ 0xFFFFFFFF
    return int(f"{remainder:032b}"[::-1], 2)


def test_the_check_sequence_is_that_of_ieee_802_3():
    # Check value of CRC-32 in the catalogue of parametrised CRC algorithms (Cook).
    assert check_sequence(b"123456789") == 0xCBF43926


@quick
@given(st.integers(0, 254), payloads)
def test_a_frame_has_addresses_type_and_check_sequence(node: int, payload: bytes):
    frame = pack(node, payload)
    assert frame[:14] == b"\xff" * 6 + bytes((2, 0, 0, 0, 0, node)) + b"\x88\xb5"
    assert int.from_bytes(frame[-4:], "little") == check_sequence(frame[:-4])
    assert unpack(frame) == (node, payload)
    assert frame_bits(len(payload)) == 8 * (8 + len(frame))


def test_short_payloads_are_padded_to_64_bytes_of_frame():
    assert len(pack(3, b"abc")) == 64
    assert FRAMING.sizes(1) == (46,) and FRAMING.sizes(1492) == (1500,)
    assert FRAMING.sizes(1493) == (1500, 46)


@quick
@given(payloads, st.sets(st.integers(0, 10_000), min_size=1, max_size=3))
def test_up_to_three_wrong_bits_are_noticed(payload: bytes, places: set[int]):
    frame = bytearray(pack(7, payload))
    for place in {place % (8 * len(frame)) for place in places}:
        frame[place // 8] ^= 1 << place % 8
    with pytest.raises(Rejected):
        unpack(bytes(frame))


def test_frames_that_are_none_of_ours_have_a_reason():
    for frame, reason in (
        (b"", "too-short"),
        (pack(1, bytes(46))[:-1], "too-short"),
        (pack(1, bytes(1501)), "too-long"),
        (pack(1, bytes(46))[:-1] + b"\x00", "frame-crc"),
    ):
        with pytest.raises(Rejected) as refused:
            unpack(frame)
        assert refused.value.reason == reason


def test_a_collision_is_captured_with_a_wrong_check_sequence():
    frame = pack(1, bytes(46))
    assert FRAMING.link.body(Captured(0.0, frame)) == frame
    with pytest.raises(Rejected, match="frame-crc"):
        unpack(FRAMING.link.body(Captured(0.0, frame, collision=True)))
    # 4 bytes of check sequence: the top nibble counts words of 16 bits.
    assert FRAMING.link.number == 0x24000001


# --- PLCA cycles ---------------------------------------------------------------------------------


def by_tokens(timing: PlcaSettings, queues: Sequence[Sequence[int]]) -> list[tuple[int, int, int]]:
    """Node, start and end of each frame, as nodes see it that count opportunities themselves."""
    waiting, now, found = [deque(queue) for queue in queues], 0, []
    while any(waiting):
        now += 20
        for node, queue in enumerate(waiting):
            burst = 0
            while queue and burst <= timing.burst_frames:
                begin = now + 96
                now = begin + 64 + 8 * (18 + max(46, queue.popleft()))
                found.append((node, begin, now))
                burst += 1
            if not burst:
                now += timing.opportunity_bits
            elif burst <= timing.burst_frames:
                # The next frame could still come.
                now += timing.burst_timer_bits
    return found


@quick
@given(timings, st.lists(st.lists(st.integers(1, 1500), max_size=4), min_size=1, max_size=6))
def test_frames_follow_the_beacon_and_the_opportunities(
    timing: PlcaSettings, queues: list[list[int]]
):
    sent, _ = walk(timing, queues)
    assert [(one.node, one.start_bits, one.end_bits) for one in sent] == by_tokens(timing, queues)


@quick
@given(timings, st.integers(1, 9), st.data())
def test_the_longest_walk_is_a_closed_form(timing: PlcaSettings, nodes: int, data):
    senders = data.draw(st.sets(st.integers(0, nodes - 1), min_size=1))
    share = data.draw(st.lists(st.integers(1, 1500), min_size=1, max_size=5))
    queues = [share if node in senders else [] for node in range(nodes)]
    _, end = walk(timing, queues)
    assert end == longest_walk_bits(timing, nodes, len(senders), share)


def worst_seen(timing: PlcaSettings, nodes: int, share: Sequence[int], seed: int) -> int:
    """The longest wait of node 0 while all others always have frames, over random requests."""
    drawn = random.Random(seed)
    longest, most = max(share), 1 + timing.burst_frames
    now, left, since, worst = 0, 0, inf, 0
    request = drawn.randrange(1, 100_000)
    for _ in range(400):
        now += 20
        for node in range(nodes):
            if node:
                turn = most if drawn.random() < 0.9 else 0
                now += turn * (96 + frame_bits(longest)) or timing.opportunity_bits
                continue
            if not left and now >= request:
                left, since = len(share), request
            if not left:
                # An opportunity that is under way is lost to a request that comes within it.
                now += timing.opportunity_bits
                if now - timing.opportunity_bits < request < now:
                    left, since = len(share), request
                continue
            for size in list(share)[len(share) - left :][:most]:
                now += 96 + frame_bits(size)
                left -= 1
            if not left:
                worst = max(worst, now - int(since))
                # Half of the requests come as the next opportunity has just begun.
                late = drawn.randrange(10_000)
                rest = (nodes - 1) * most * (96 + frame_bits(longest))
                request = now + 20 + (rest + 1 if drawn.random() < 0.5 else late)
    return worst


@pytest.mark.parametrize("burst", [0, 1])
@pytest.mark.parametrize("share", [(168,), (1500, 1500, 500)])
def test_no_request_waits_longer_than_the_bound(burst: int, share: tuple[int, ...]):
    timing = PlcaSettings(burst_frames=burst)
    bound = worst_access_bits(timing, 6, share)
    seen = max(worst_seen(timing, 6, share, seed) for seed in range(30))
    assert 0.9 * bound < seen <= bound


# --- the bus of a network ------------------------------------------------------------------------


def bus_of(share_bytes: int = 160, nodes: int = 5, **timing: int) -> PlcaBus:
    return PlcaBus(full_publish(nodes), share_bytes, ARBITERS["wtod"], PlcaSettings(**timing))


@pytest.mark.parametrize("share_bytes", [1, 160, 1492, 4000])
@pytest.mark.parametrize("burst_frames", [0, 2])
def test_the_bus_keeps_the_promises_of_the_interface(share_bytes: int, burst_frames: int):
    bus = bus_of(share_bytes, burst_frames=burst_frames)
    assert list(broken_promises(bus, share_bytes)) == []


def test_the_cycle_is_the_longest_round_of_the_schedule():
    # By hand: beacon 2 us, gap 9.6 us and 8 + 14 + 168 + 4 bytes at 0.8 us for each node.
    assert bus_of().cycle_us == pytest.approx(2 + 5 * (9.6 + 0.8 * 194))
    turns = PlcaBus(round_robin(5, 2), 160, ARBITERS["wtod"], PlcaSettings())
    assert turns.cycle_us == pytest.approx(2 + 3 * 3.2 + 2 * (9.6 + 0.8 * 194))
    full = bus_of().transmissions(0, [168] * 5)
    assert full[-1].end_us == pytest.approx(bus_of().cycle_us)
    assert bus_of().worst_access_us == pytest.approx(3.2 + bus_of().cycle_us)


def test_a_share_of_two_frames_takes_two_plca_cycles_or_one_burst():
    share = bus_of(1600)
    assert share.payloads(0, 0, 1600) == (1500, 116)
    assert share.cycle_us == pytest.approx(0.1 * (40 + 5 * share_bits((1500, 116))))
    sent = share.transmissions(0, [1616] * 5)
    assert [frame.node for frame in sent] == [0, 1, 2, 3, 4] * 2
    burst = bus_of(1600, burst_frames=1).transmissions(0, [1616] * 5)
    assert [frame.node for frame in burst] == [0, 0, 1, 1, 2, 2, 3, 3, 4, 4]


def test_a_frame_counts_for_its_own_sender_alone():
    bus = bus_of()
    (frame,) = bus.encode(2, 7, bytes(160))
    fragment = bus.receive(frame)
    assert bus.place(2, fragment).frames == 1
    with pytest.raises(Rejected, match="wrong-slot"):
        bus.place(3, fragment)
    moved = bus.in_slot_of(frame, 3, 7)
    assert moved is not None and bus.place(3, bus.receive(moved)).number == 0
    turns = PlcaBus(round_robin(5, 2), 160, ARBITERS["wtod"], PlcaSettings())
    with pytest.raises(Rejected, match="unscheduled"):
        turns.place(2, fragment)
    with pytest.raises(Rejected, match="null-frame"):
        bus.receive(bus.frame_format.emptied(frame))
    assert bus.receive(bus.renumbered(frame, 9)).cycle == 9


def test_more_nodes_than_plca_has_are_refused():
    assert bus_of(nodes=255).cycle_us > 0
    with pytest.raises(ValueError, match="PLCA has 255 node IDs; use fewer --nodes"):
        bus_of(nodes=256)


# --- bursts and beacons ---------------------------------------------------------------------------


def test_a_burst_that_is_not_full_is_waited_for():
    """Four nodes with one frame each of a burst of four: 4 x 128 bit times of waiting."""
    timing, payloads = PlcaSettings(burst_frames=3), [(46,)] * 4
    end = walk(timing, payloads)[1]
    assert end == walk(PlcaSettings(), payloads)[1] + 4 * 128 == 3220
    assert longest_walk_bits(timing, 4, 4, (46,)) == 3220
    # A full burst ends at once.
    assert walk(timing, [(46,) * 4])[1] == 20 + 4 * (96 + frame_bits(46))


def test_csma_cd_sends_one_alone_at_once_and_lets_two_draw():
    assert contend([2], (46, 46), lambda *_: 0.0) == {2: 2 * (96 + frame_bits(46))}
    ends = contend([1, 2], (46,), lambda node, _: 0.0 if node == 1 else 0.9)
    first = 96 + COLLISION_BITS + 96 + frame_bits(46)
    # The slot of the other is over while the first frame is on the medium.
    assert ends == {1: first, 2: max(first, 96 + COLLISION_BITS + SLOT_BITS) + 96 + frame_bits(46)}
    # Nodes that always draw alike give up.
    assert contend([1, 2], (46,), lambda *_: 0.0) == {1: inf, 2: inf}


@quick
@given(st.integers(1, 12), st.integers(1, 3), st.integers(0, 2**32))
def test_frames_of_csma_cd_never_overlap(nodes: int, frames: int, seed: int):
    rng = random.Random(seed)
    ends = contend(range(nodes), (46,) * frames, lambda *_: rng.random())
    last = sorted(end for end in ends.values() if end < inf)
    assert len(ends) == nodes
    for earlier, later in pairwise(last):
        assert later - earlier >= 96 + frame_bits(46)


@pytest.mark.parametrize(
    ("without_beacons", "sent"), [("csma-cd", range(11, 40)), ("silence", [10])]
)
def test_a_coordinator_that_dies_is_said_and_takes_the_beacons_along(without_beacons, sent):
    scenario = cc.scenario(
        "oscillator", nodes=4, steps=40, bus="plca", rounds=1, changes="10 kill 0",
        without_beacons=without_beacons,
    )  # fmt: skip
    (warning,) = [one for one in warnings_of(prepare(scenario)) if "beacons" in one]
    assert "node 0" in warning and "step 10" in warning and without_beacons in warning
    runs = cc.simulate(scenario)
    published = shares(runs)
    assert published[0] == 10
    assert all(count in sent for count in published[1:])


def shares(runs) -> list[int]:
    """Return how many shares each node sends."""
    return (np.asarray(runs["payload_bytes"])[0] > 0).sum(axis=(0, 1)).tolist()


def test_a_host_that_sends_no_frames_leaves_the_beacons():
    plain, missing = (
        cc.simulate(
            cc.scenario("oscillator", nodes=4, steps=20, bus="plca", rounds=1, changes=changes)
        )
        for changes in ((), "5 missing 0 1")
    )
    for runs in (plain, missing):
        assert shares(runs)[1:] == [20, 20, 20]
