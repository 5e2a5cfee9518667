"""CAN FD: bits and checksums against other algorithms, identifiers from bids, a network's bus."""

import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from concord.bus.arbitration import ARBITERS, ONE_CLASS, UrgencyClasses, award, begin_arbitration
from concord.bus.bus import Captured, Rejected
from concord.bus.schedule import dynamic_only, full_publish, hybrid
from concord.features.measurement_bus import measurement_bus
from concord.features.other_buses.can_fd.bits import (
    DATA_BYTES,
    FrameBits,
    Rates,
    checksum,
    head_bits,
    longest_bits,
    padded,
    stuff_count,
    wire,
)
from concord.features.other_buses.can_fd.can_fd_bus import CanFdBus, can_fd_bus
from concord.features.other_buses.can_fd.frame import FRAMINGS, pack, unpack
from concord.features.other_buses.can_fd.priority import BidLevels, layout
from concord.scenarios.user.bus import broken_promises
from tests.bus.support import long_division, quick

sizes = st.sampled_from(DATA_BYTES)
# Zeros and ones in a row need stuff bits, which random bytes rarely do.
contents = sizes.flatmap(
    lambda size: st.lists(
        st.sampled_from((0, 0, 255, 0x1F, 0xF8, 0x55, 7)), min_size=size, max_size=size
    ).map(bytes)
)
formats = st.sampled_from((11, 29))


def exact_bits(identifier: int, identifier_bits: int, data: bytes) -> FrameBits:
    """Bits with the stuff bits that a frame has: the CRC field is 4 + 17 bits with 6 fixed stuff
    bits, or 4 + 21 with 7; the end is 10."""
    made = wire(identifier, identifier_bits, data)
    behind = len(made.stuffed) - made.arbitration_bits
    return FrameBits(made.arbitration_bits + 10, behind + (27 if len(data) <= 16 else 32))


# --- bits ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("width", "generator", "check"), [(17, 0x1685B, 0x04F03), (21, 0x102899, 0x0ED841)]
)
def test_the_generators_have_the_published_check_values(width: int, generator: int, check: int):
    # Catalogue of parametrised CRC algorithms (Cook): CRC-17/CAN-FD and CRC-21/CAN-FD, start at 0.
    bits = "".join(f"{byte:08b}" for byte in b"123456789")
    assert checksum(bits, width, generator, 0) == check
    assert long_division(bits, generator, width, 0) == check


@quick
@given(formats, st.integers(0, 2**11 - 1), contents)
def test_a_receiver_finds_the_bits_under_the_stuff_bits(bits: int, identifier: int, data: bytes):
    made = wire(identifier, bits, data)
    kept, run, last, dropped = [], 0, "", 0
    for bit in made.stuffed:
        if run == 5:
            assert bit != last
            dropped, run, last = dropped + 1, 1, bit
            continue
        run, last = (run + 1 if bit == last else 1), bit
        kept.append(bit)
    sent = head_bits(identifier, bits) + f"0{DATA_BYTES.index(len(data)):04b}"
    assert "".join(kept) == sent + "".join(f"{byte:08b}" for byte in data)
    assert dropped == made.stuff_bits
    width, generator = (17, 0x1685B) if len(data) <= 16 else (21, 0x102899)
    covered = made.stuffed + f"{made.stuff_count:04b}"
    assert made.crc == long_division(covered, generator, width, 1 << width - 1)


def test_the_stuff_count_is_gray_code_with_even_parity():
    # ISO 11898-1:2015, table 8.
    table = ["0000", "0011", "0110", "0101", "1100", "1111", "1010", "1001"]
    assert [f"{stuff_count(number):04b}" for number in range(8)] == table
    assert stuff_count(13) == stuff_count(5)


def test_bits_of_a_frame_by_hand():
    # Base, no data: 17 bits to the bit rate switch, 5 of control, 27 of CRC field, 10 of end.
    # 14 zeros need stuff bits after 5 and 10; the fixed one comes after the last five zeros.
    assert head_bits(0, 11) == "0" + 11 * "0" + "00101"
    assert wire(0, 11, b"").stuff_bits == 2
    assert exact_bits(0x555, 11, bytes([0x55] * 8)) == (17 + 10, 5 + 64 + 27)
    assert longest_bits(11, 0) == (17 + 4 + 10, 5 + 1 + 27)
    # 64 bytes, extended: 36 bits, and one stuff bit in four of 553 after the first.
    assert longest_bits(29, 64) == (36 + 8 + 10, 5 + 512 + 138 - 8 + 32)


@quick
@given(formats, st.integers(0, 2**11 - 1), contents)
def test_no_frame_is_longer_than_the_bound(bits: int, identifier: int, data: bytes):
    exact, longest, rates = (
        exact_bits(identifier, bits, data),
        longest_bits(bits, len(data)),
        Rates(),
    )
    assert sum(exact) <= sum(longest) and exact.nominal <= longest.nominal
    assert rates.us(exact) <= rates.us(longest)


def test_a_frame_comes_near_the_bound():
    """The densest pattern is five equal bits, then four of the other, and so on."""
    shifted = [("1" * 4 + "0" * 4) * 65 for _ in range(8)]
    densest = [
        int(bits[shift : shift + 512], 2).to_bytes(64, "big") for shift, bits in enumerate(shifted)
    ]
    # Data length code 15 ends in ones, which begin a run.
    best = max(exact_bits(0, 11, data).data for data in densest)
    assert best >= longest_bits(11, 64).data - 3


# --- frames as bytes -----------------------------------------------------------------------------


@quick
@given(formats, st.integers(0, 2**11 - 1), st.binary(max_size=64))
def test_a_frame_comes_back_padded(bits: int, identifier: int, payload: bytes):
    frame = pack(bits, identifier, payload)
    assert unpack(bits, frame) == (identifier, payload.ljust(padded(len(payload)), b"\0"))
    assert len(frame) == padded(len(payload)) + FRAMINGS[bits].overhead_bytes


@quick
@given(contents, st.integers(0, 10_000))
def test_each_wrong_bit_is_noticed(data: bytes, place: int):
    frame = bytearray(pack(29, 0x1234, data))
    place %= 8 * len(frame)
    frame[place // 8] ^= 1 << place % 8
    with pytest.raises(Rejected):
        unpack(29, bytes(frame))


def test_packets_of_a_capture_are_those_of_socketcan():
    body = FRAMINGS[29].link.body
    frame = pack(29, 0x12345, b"abcdefgh")
    assert FRAMINGS[29].link.number == 227
    # 0x80000000: 29 bits; 0x05: flexible data rate, with another rate for the data.
    assert body(Captured(0, frame)) == bytes.fromhex("80012345 08 05 0000") + b"abcdefgh"
    base = FRAMINGS[11].link.body(Captured(0, pack(11, 0x123, b"")))
    assert base == bytes.fromhex("00000123 00 05 0000")
    wrong, collision = body(Captured(0, frame[:-1] + b"\0")), body(Captured(0, frame, "A", True))
    for packet, kind, where in ((wrong, 0, 8), (collision, 1, 0)):
        identifier, length, flags = struct.unpack_from(">IBB", packet)
        assert (identifier, length, flags) == (0x20000008, 8, 0)
        assert packet[8:] == bytes((0, 0, kind, where, 0, 0, 0, 0))


# --- identifiers from bids -----------------------------------------------------------------------


@quick
@given(st.lists(st.integers(0, 1 << 52), min_size=2, max_size=9), st.sampled_from((53, 300, 2047)))
def test_a_larger_bid_never_has_a_higher_identifier(bids: list[int], levels: int):
    scale = BidLevels(levels)
    classes = scale.of(np.array(bids), np.zeros(len(bids), dtype=np.int64)).tolist()
    assert all(0 <= one < scale.count <= levels for one in classes)
    for bid, own in zip(bids, classes, strict=True):
        for other, its in zip(bids, classes, strict=True):
            assert not (bid > other and own > its)
            # Bids apart by a whole step have different identifiers.
            assert not (other and bid > other * 2 ** (1.5 * 52 / (scale.count - 1)) and own == its)


@quick
@given(st.floats(-18, 18), st.floats(1.06, 100), st.sampled_from((1500, 2047)))
def test_identifiers_tell_apart_squared_changes_that_differ_by_a_level(
    exponent: float, ratio: float, levels: int
):
    """A measurement bus bids with the bits of a float, which are a logarithm already."""
    scale = BidLevels(levels, measurement_bus.BID_SPAN)
    squares = 10.0**exponent * np.array([1.0, ratio])
    bids = measurement_bus.bid(np.sqrt(squares)[:, None], np.eye(1))
    less, more = scale.of(bids, np.zeros(2, dtype=np.int64)).tolist()
    assert 0 <= more <= less < scale.count == levels
    assert (more < less) or ratio < 2 ** (128 / (levels - 2)) * 1.05


@quick
@given(st.data(), st.integers(3, 9), st.integers(1, 4))
def test_identifiers_make_try_once_discard_real(data, nodes: int, slots: int):
    """Bids that the identifiers tell apart win as they would by an arbiter that knows all bids."""
    exponents = data.draw(st.permutations(range(nodes)))
    bids = np.array([int(1000 * 1.1**exponent) for exponent in exponents], dtype=np.int64)
    schedule = dynamic_only(nodes, min(1.0, slots / nodes))
    bus = can_fd_bus(schedule, 40, ARBITERS["wtod"], ONE_CLASS, Rates())
    assert not bus.has_ideal_arbiter
    state = begin_arbitration(nodes)
    awards = bus.arbitrate(state, 0, 0, range(nodes), bids, lambda: bids)
    most = schedule.dynamic_slots(0)
    ids = np.arange(nodes)
    _, ideal = award(ARBITERS["wtod"], state, ids, ids, bids, most)
    assert awards.wins.tolist() == ideal.tolist()
    sent = [48 * int(win) for win in awards.wins]
    frames = bus.transmissions(0, sent, awards.classes.tolist())
    assert [frame.node for frame in frames] == sorted(
        np.flatnonzero(ideal).tolist(), key=lambda node: -bids[node]
    )


def test_owners_of_turns_come_before_contenders():
    schedule = hybrid(6, 0.7)
    bus = can_fd_bus(schedule, 40, ARBITERS["urgency"], UrgencyClasses(8), Rates())
    owners, contenders = schedule.static_senders(0), schedule.contenders(0)
    sent = [48 * (node in owners or node in contenders) for node in range(6)]
    frames = bus.transmissions(0, sent, [0] * 6)
    segments = [frame.segment for frame in frames]
    assert segments == sorted(segments, reverse=True) and set(segments) == {"static", "dynamic"}


def test_identifiers_that_are_too_short_are_refused():
    assert layout(32, 11, 8).levels == 63
    for nodes, classes in ((2048, 2), (1024, 2), (300, 8)):
        with pytest.raises(ValueError, match="use --identifiers extended"):
            layout(nodes, 11, classes)
    with pytest.raises(ValueError, match="--arbiter wtod: 31 levels"):
        can_fd_bus(dynamic_only(64, 0.5), 40, ARBITERS["wtod"], ONE_CLASS, Rates(11))
    with pytest.raises(ValueError, match="--data-kbit-s 250: must be at least --nominal-kbit-s"):
        can_fd_bus(full_publish(4), 40, ARBITERS["wtod"], ONE_CLASS, Rates(29, 500, 250))


# --- the bus of a network ------------------------------------------------------------------------


def bus_of(share_bytes: int, rates: Rates = Rates(), nodes: int = 5) -> CanFdBus:  # noqa: B008
    return can_fd_bus(full_publish(nodes), share_bytes, ARBITERS["urgency"], ONE_CLASS, rates)


@pytest.mark.parametrize("share_bytes", [1, 40, 56, 57, 400])
@pytest.mark.parametrize("identifier_bits", [11, 29])
def test_the_bus_keeps_the_promises_of_the_interface(share_bytes: int, identifier_bits: int):
    bus = bus_of(share_bytes, Rates(identifier_bits))
    assert list(broken_promises(bus, share_bytes)) == []


def test_the_cycle_has_the_longest_frames_of_all_senders():
    # 40 + 8 bytes in 48; 36 + 8 + 10 bits at 2 us; 5 + 384 + 106 - 8 + 32 at half a microsecond;
    # three bits of intermission.
    assert bus_of(40).cycle_us == pytest.approx(5 * (2 * 57 + 0.5 * (5 + 384 + 106 - 8 + 32)))
    assert bus_of(100).payloads(0, 0, 100) == (64, 64)
    assert bus_of(40, Rates(29, 1000, 8000)).cycle_us < bus_of(40).cycle_us / 2
    last = bus_of(100).transmissions(0, [128] * 5)[-1]
    assert last.end_us == pytest.approx(bus_of(100).cycle_us - 6)
    assert [frame.node for frame in bus_of(100).transmissions(0, [128] * 5)] == [
        node for node in range(5) for _ in range(2)
    ]


def test_nobody_waits_longer_than_a_cycle_and_a_frame():
    bus = bus_of(100)
    assert bus.cycle_us <= bus.worst_access_us <= bus.cycle_us + float(bus.frame_us(64)) + 6
