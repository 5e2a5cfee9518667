"""Decoding recordings: a real car's bus to the last bit, made signals, and noise of all kinds."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from concord.bus.flexray.frame import Frame, encode
from concord.features.flexray_tools.recordings.bitstream import byte_bits
from concord.features.flexray_tools.recordings.decoder import Decoding, decode_waveform, reencodes
from concord.features.flexray_tools.recordings.waveform import Waveform, WaveformError, from_samples
from tests.bus.support import binary, long_division, quick
from tests.features.flexray_tools.signals import encode_bits, from_bits


def test_the_recording_has_all_its_frames_with_correct_checksums(audi: Decoding):
    assert len(audi.frames) == 314
    assert sum(decoded.header_crc_ok for decoded in audi.frames) == 314
    assert sum(decoded.frame_crc_ok for decoded in audi.frames) == 314
    segments = [audi.segment(decoded) for decoded in audi.frames]
    assert (segments.count("static"), segments.count("dynamic")) == (272, 42)
    assert sum(decoded.frame.null for decoded in audi.frames) == 86
    assert {decoded.frame.cycle_count for decoded in audi.frames} == set(range(28, 36))
    assert audi.rejected == {}
    assert (audi.channel, audi.inverted, audi.bit_rate_mbps) == ("A", False, 10.0)
    assert audi.static_slots == 51


def test_the_recorded_checksums_are_those_of_long_division(audi: Decoding):
    for decoded in audi.frames[::20]:
        bits = binary(encode(decoded.frame))
        assert int(bits[23:34], 2) == long_division(bits[3:23], 0x385, 11, 0x01A)
        assert int(bits[-24:], 2) == long_division(bits[:-24], 0x5D6DCB, 24, 0xFEDCBA)


def test_encoding_every_recorded_frame_gives_back_the_sampled_wave(
    audi: Decoding, capture: Waveform
):
    """Looks at the recorded levels itself: bits of 100 ns from each BSS edge on."""
    for decoded in audi.frames:
        assert reencodes(decoded, audi.channel)
        data = encode(decoded.frame)
        rise = round(1e3 * (decoded.start_us + decoded.start_sequence_us))
        edge = rise + 200
        for byte in data:
            falls = capture.times_ns[(capture.levels == 0) & (abs(capture.times_ns - edge) < 50)]
            assert len(falls) == 1
            middles = falls[0] + 150 + 100 * np.arange(8)
            levels = capture.levels[np.searchsorted(capture.times_ns, middles, "right") - 1]
            assert int("".join(map(str, levels)), 2) == byte
            edge = falls[0] + 1000


def test_the_inverted_recording_is_recognised(capture: Waveform, audi: Decoding):
    turned = decode_waveform(capture.inverted())
    assert turned.inverted
    assert [f.frame for f in turned.frames] == [f.frame for f in audi.frames]


@settings(max_examples=10)
@given(data=st.data())
def test_a_truncated_recording_loses_only_what_is_cut(data: st.DataObject, capture, audi):
    first = data.draw(st.integers(0, len(capture.times_ns) // 2))
    last = data.draw(st.integers(first + 4000, len(capture.times_ns)))
    part = Waveform(capture.times_ns[first:last], capture.levels[first:last])
    decoding = decode_waveform(part)
    start, end = part.times_ns[0] / 1e3, part.times_ns[-1] / 1e3
    # A frame is found if the idle bus before it was recorded, and itself to the last edge.
    whole = [f.frame for f in audi.frames if start < f.start_us - 2 and f.end_us < end]
    found = [f.frame for f in decoding.frames]
    assert len(whole) <= len(found) <= len(whole) + 2
    assert all(frame in found for frame in whole)
    assert sum(decoding.rejected.values()) <= 2


def test_a_noisy_recording_is_counted_not_believed(capture: Waveform, audi: Decoding):
    """Flipping levels for 60..300 ns at 400 random places spoils frames, and each is noticed."""
    random = np.random.default_rng(5)
    starts = np.sort(random.integers(0, capture.times_ns[-1], 400))
    edges = np.ravel(np.column_stack((starts, starts + random.integers(60, 300, 400))))
    times = np.unique(np.concatenate((capture.times_ns, edges)))
    plain = capture.levels[np.searchsorted(capture.times_ns, times, "right") - 1]
    flips = np.searchsorted(np.sort(edges), times, "right") % 2
    noisy = from_samples(times.tolist(), (plain ^ flips).tolist())
    decoding = decode_waveform(noisy)
    sound = [f for f in decoding.frames if f.header_crc_ok and f.frame_crc_ok]
    true_frames = [f.frame for f in audi.frames]
    assert all(decoded.frame in true_frames for decoded in sound)
    assert 150 < len(sound) < 314
    lost = len(decoding.frames) - len(sound) + sum(decoding.rejected.values())
    assert lost > 0


IDS_AND_PAYLOADS = st.lists(
    st.tuples(st.integers(1, 2047), st.binary(max_size=20).map(lambda half: half + half)),
    min_size=2,
    max_size=6,
)


@quick
@given(IDS_AND_PAYLOADS, st.sampled_from([100, 200, 400]), st.sampled_from("AB"), st.booleans())
def test_made_signals_decode_at_every_rate_channel_and_polarity(
    contents, bit_ns, channel, inverted
):
    frames = [Frame(frame_id, 5, payload) for frame_id, payload in contents]
    starts = [20 * bit_ns + 700 * bit_ns * place for place in range(len(frames))]
    bits = [encode_bits(encode(frame, channel), 9) for frame in frames]
    signal = from_bits(zip(starts, bits, strict=True), bit_ns)
    decoding = decode_waveform(signal.inverted() if inverted else signal)
    assert [decoded.frame for decoded in decoding.frames] == frames
    assert all(decoded.header_crc_ok and decoded.frame_crc_ok for decoded in decoding.frames)
    assert (decoding.channel, decoding.inverted) == (channel, inverted)
    assert decoding.bit_rate_mbps == 1000 / bit_ns
    for decoded, start, sent in zip(decoding.frames, starts, bits, strict=True):
        assert decoded.start_us == start / 1e3
        assert decoded.start_sequence_us == pytest.approx(9 * bit_ns / 1e3)
        assert decoded.end_us == pytest.approx((start + len(sent) * bit_ns) / 1e3)
        assert np.array_equal(decoded.bits, sent[9:])


@quick
@given(st.integers(1, 20), st.integers(1, 20), st.integers(2, 70))
def test_trailing_sequences_tell_the_segments_apart(static: int, dynamic: int, trailing: int):
    ids = range(1, static + dynamic + 1)
    signal = from_bits(
        [
            (
                5000.0 + 30000 * frame_id,
                encode_bits(encode(Frame(frame_id, 0, b"ab")), 9, trailing * (frame_id > static)),
            )
            for frame_id in ids
        ],
        100.0,
    )
    decoding = decode_waveform(signal)
    assert [decoded.frame.frame_id for decoded in decoding.frames] == list(ids)
    assert decoding.static_slots == static
    assert decoding.frames[-1].trailing_us == pytest.approx(trailing * 0.1)


@quick
@given(st.lists(st.integers(-15, 15), min_size=100, max_size=400), st.floats(-0.0015, 0.0015))
def test_jitter_of_edges_and_drift_of_clocks_are_borne(jitter: list[int], drift: float):
    """Edges 15 ns early or late, clocks off by the 1500 ppm that FlexRay allows."""
    frames = [Frame(7, 1, bytes(range(254))), Frame(9, 1, b"\x00\xff" * 60)]
    signal = from_bits(
        [
            (2000.0, encode_bits(encode(frames[0]), 5)),
            (400000.0, encode_bits(encode(frames[1]), 5)),
        ],
        100.0 * (1 + drift),
    )
    times = signal.times_ns.copy()
    times[1:] += np.resize(np.array(jitter), len(times) - 1)
    decoding = decode_waveform(Waveform(times, signal.levels))
    assert [decoded.frame for decoded in decoding.frames] == frames


@quick
@given(st.data())
def test_a_wrong_bit_in_a_byte_is_shown_not_hidden(data: st.DataObject):
    good = encode_bits(encode(Frame(7, 1, bytes(range(20)))), 5)
    byte, bit = data.draw(st.integers(3, 27)), data.draw(st.integers(0, 7))
    bad = good.copy()
    bad[6 + 10 * byte + 2 + bit] ^= 1
    decoding = decode_waveform(from_bits([(2000.0, bad), (90000.0, good)], 100.0))
    damaged, sound = decoding.frames
    assert not damaged.frame_crc_ok
    assert not reencodes(damaged, "A")
    assert np.array_equal(damaged.bits, bad[5:])
    assert sound.header_crc_ok
    assert sound.frame_crc_ok


def test_faults_of_coding_and_length_are_counted_by_reason():
    good = encode_bits(encode(Frame(7, 1, bytes(20))), 5)
    no_start = good.copy()
    no_start[6 + 10 * 4] = 0
    longer = np.concatenate((good[:5], byte_bits(encode(Frame(7, 1, bytes(20))) + b"x")))
    endless = encode_bits(bytes(300), 5)
    signal = from_bits(
        [(2e3 + 4e5 * place, bits) for place, bits in enumerate((no_start, longer, endless, good))],
        100.0,
    )
    decoding = decode_waveform(signal)
    assert len(decoding.frames) == 1
    assert decoding.rejected == {"coding": 1, "length": 1, "too-long": 1}


@pytest.mark.parametrize(
    "signal",
    [
        from_samples([0], [1]),
        from_samples(range(0, 100000, 2000), [0, 1] * 25),
        from_samples(range(0, 40000, 100), [0, 1] * 200),
    ],
    ids=["flat", "slow clock", "fast clock"],
)
def test_signals_that_are_not_flexray_are_refused(signal: Waveform):
    with pytest.raises(WaveformError, match=r"FlexRay frame|level change"):
        decode_waveform(signal)


@settings(max_examples=150)
@given(st.lists(st.integers(1, 3000), max_size=300), st.booleans())
def test_any_signal_is_decoded_or_refused(pulses: list[int], high: bool):
    levels = [(place + high) % 2 for place in range(len(pulses))]
    try:
        decoding = decode_waveform(from_samples(np.cumsum(pulses).tolist(), levels))
    except WaveformError:
        return
    assert decoding.frames


@settings(max_examples=100)
@given(st.data())
def test_a_mangled_frame_is_decoded_or_refused(data: st.DataObject):
    """Near misses reach deeper than random pulses."""
    bits = [
        (2e3 + 6e4 * i, encode_bits(encode(Frame(7 + i, 1, bytes(20))), 5, 4)) for i in range(3)
    ]
    signal = from_bits(bits, 100.0)
    times, levels = signal.times_ns.tolist(), signal.levels.tolist()
    for _ in range(data.draw(st.integers(1, 6))):
        place = data.draw(st.integers(0, len(times) - 1))
        if data.draw(st.booleans()):
            del times[place], levels[place]
        else:
            times[place] += data.draw(st.integers(-200, 200))
    order = np.argsort(times, kind="stable")
    try:
        mangled = from_samples(np.array(times)[order].tolist(), np.array(levels)[order].tolist())
        decoding = decode_waveform(mangled)
    except WaveformError:
        return
    assert decoding.frames


def late(signal: Waveform, level: int, delay_ns: int) -> Waveform:
    """A signal whose edges to one level come late, as unequal delays of a driver make them."""
    times = signal.times_ns + delay_ns * (signal.levels == level)
    return Waveform(times, signal.levels)


@pytest.mark.parametrize("level", [0, 1])
@pytest.mark.parametrize("bit_ns", [100, 200, 400])
def test_late_edges_refuse_no_frame(level: int, bit_ns: int):
    frames = [Frame(i, 9, bytes(range(7 * i, 7 * i + 20))) for i in range(1, 9)]
    bits = [encode_bits(encode(frame), 9) for frame in frames]
    starts = [20_000 + 700 * bit_ns * place for place in range(len(frames))]
    signal = from_bits(zip(starts, bits, strict=True), bit_ns)
    for delay_ns in (26, 40):
        decoding = decode_waveform(late(signal, level, delay_ns))
        assert decoding.bit_rate_mbps == 1000 / bit_ns
        assert [decoded.frame for decoded in decoding.frames] == frames
        assert all(decoded.frame_crc_ok for decoded in decoding.frames)


def test_late_falling_edges_leave_every_frame_of_the_car(capture: Waveform):
    decoding = decode_waveform(late(capture, 0, 26))
    assert len(decoding.frames) == 314
    assert all(decoded.frame_crc_ok for decoded in decoding.frames)


def test_a_stated_bit_rate_is_the_only_one_tried(capture: Waveform):
    with pytest.raises(WaveformError, match="at 5 Mbit/s, upright"):
        decode_waveform(capture, 5.0)
    assert len(decode_waveform(capture, 10.0).frames) == 314


def test_symbols_are_named_and_are_no_glitches():
    """Low pulses on an idle bus: a collision avoidance symbol, two wake-up patterns, a glitch."""
    frame = encode_bits(encode(Frame(3, 0, b"ab")), 9)
    pulses_us = [(50, 3.9), (100, 2.0)]
    pulses_us += [(200 + 24 * place, 6.0) for place in range(5)]
    pulses_us += [(600 + 24.5 * place, 5.9) for place in range(2)]
    sent = [
        (1e3 * start, np.zeros(round(10 * length), dtype=np.uint8)) for start, length in pulses_us
    ]
    decoding = decode_waveform(from_bits([*sent, (900e3, frame)], 100.0))
    assert [symbol[0] for symbol in decoding.symbols] == ["CAS or MTS", *["wake-up pattern"] * 2]
    assert [(s.start_us, s.end_us, s.pulses) for s in decoding.symbols] == [
        (50, pytest.approx(53.9), 1),
        (200, pytest.approx(302.0), 5),
        (600, pytest.approx(630.4), 2),
    ]
    assert decoding.glitches == 1
    assert [decoded.frame.frame_id for decoded in decoding.frames] == [3]
