"""The frame codec against long division, catalogue check values, and every damaged bit."""

import anycrc
import msgspec
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from concord.bus.flexray.frame import Frame, FrameError, decode, encode, inspect
from tests.bus.support import binary, frames, long_division, quick

INITIAL = {"A": 0xFEDCBA, "B": 0xABCDEF}


@quick
@given(frames(), st.sampled_from("AB"))
def test_round_trip(frame: Frame, channel):
    data = encode(frame, channel)
    assert len(data) == 8 + len(frame.payload)
    assert decode(data, channel) == frame


@quick
@given(frames(), st.sampled_from("AB"))
def test_layout_and_checksums_by_long_division(frame: Frame, channel):
    bits = binary(encode(frame, channel))
    indicators = (frame.payload_preamble, not frame.null, frame.sync, frame.startup)
    assert bits[:5] == "0" + "".join("01"[flag] for flag in indicators)
    assert int(bits[5:16], 2) == frame.frame_id
    assert int(bits[16:23], 2) == len(frame.payload) // 2
    assert int(bits[23:34], 2) == long_division(bits[3:23], 0x385, 11, 0x01A)
    assert int(bits[34:40], 2) == frame.cycle_count
    assert bits[40:-24] == binary(frame.payload)
    assert int(bits[-24:], 2) == long_division(bits[:-24], 0x5D6DCB, 24, INITIAL[channel])


def test_the_oracle_gives_the_catalogue_check_values():
    digits = binary(b"123456789")
    assert long_division(digits, 0x385, 11, 0x01A) == 0x5A3
    assert long_division(digits, 0x5D6DCB, 24, INITIAL["A"]) == 0x7979BD
    assert long_division(digits, 0x5D6DCB, 24, INITIAL["B"]) == 0x1F23B8


@pytest.mark.parametrize(("channel", "check"), [("A", 0x7979BD), ("B", 0x1F23B8)])
def test_frame_crc_of_the_catalogue_check_message(channel, check: int):
    assert inspect(b"123456789" + check.to_bytes(3, "big"), channel).frame_crc_ok
    assert anycrc.models["CRC24-FLEXRAY-" + channel].check == check


@pytest.mark.parametrize("size", [0, 2, 160, 254])
def test_every_single_bit_error_is_detected(size: int):
    data = encode(Frame(0x155, 28, bytes(range(size % 256)) * (size // max(size % 256, 1))))
    for position in range(8 * len(data)):
        damaged = bytearray(data)
        damaged[position // 8] ^= 0x80 >> position % 8
        with pytest.raises(FrameError):
            decode(bytes(damaged))


@quick
@given(frames(), st.data())
def test_every_burst_of_up_to_24_bits_is_detected(frame: Frame, data: st.DataObject):
    good = encode(frame)
    length = data.draw(st.integers(1, 24))
    start = data.draw(st.integers(0, 8 * len(good) - length))
    # The first and the last bit of a burst are wrong; those between may be.
    burst = 1 << length - 1 | data.draw(st.integers(0, (1 << length - 1) - 1)) | 1
    damaged = int.from_bytes(good, "big") ^ burst << 8 * len(good) - length - start
    with pytest.raises(FrameError):
        decode(damaged.to_bytes(len(good), "big"))


@quick
@given(frames(), st.data())
def test_a_truncated_or_lengthened_frame_is_rejected(frame: Frame, data: st.DataObject):
    good = encode(frame)
    with pytest.raises(FrameError) as short:
        decode(good[: data.draw(st.integers(0, len(good) - 1))])
    assert short.value.reason in ("too-short", "length")
    with pytest.raises(FrameError) as long:
        decode(good + data.draw(st.binary(min_size=1, max_size=9)))
    assert long.value.reason == "length"


@pytest.mark.parametrize(
    ("bit", "reason"),
    [
        (3, "header-crc"),
        (4, "header-crc"),
        (15, "header-crc"),
        (22, "header-crc"),
        (33, "header-crc"),
        (0, "frame-crc"),
        (2, "frame-crc"),
        (39, "frame-crc"),
        (40, "frame-crc"),
        (100, "frame-crc"),
    ],
)
def test_each_checksum_guards_its_bits(bit: int, reason: str):
    """The header CRC guards sync, startup, ID, length and itself; the frame CRC everything."""
    good = encode(Frame(7, 3, bytes(range(8))))
    damaged = int.from_bytes(good, "big") ^ 1 << 8 * len(good) - 1 - bit
    with pytest.raises(FrameError) as refused:
        decode(damaged.to_bytes(len(good), "big"))
    assert refused.value.reason == reason


def test_the_other_channel_is_rejected():
    with pytest.raises(FrameError) as refused:
        decode(encode(Frame(5, 0, b"ab"), "A"), "B")
    assert refused.value.reason == "frame-crc"


def test_reasons_of_frames_with_right_checksums():
    def sealed(first_20_bits: int) -> bytes:
        """A frame of no payload whose checksums are right whatever it says."""
        header_crc = long_division(f"{first_20_bits:020b}", 0x385, 11, 0x01A)
        header = f"001{first_20_bits:020b}{header_crc:011b}000000"
        trailer = long_division(header, 0x5D6DCB, 24, INITIAL["A"])
        return int(f"{header}{trailer:024b}", 2).to_bytes(8, "big")

    assert decode(sealed(1 << 7)).frame_id == 1
    for bits, reason in ((0, "frame-id"), (1 << 18 | 1 << 7, "startup-indicator")):
        with pytest.raises(FrameError) as refused:
            decode(sealed(bits))
        assert refused.value.reason == reason


@quick
@given(st.binary(max_size=300), st.sampled_from("AB"))
@example(b"", "A")
@example(bytes(8), "A")
@example(b"\xff" * 262, "B")
def test_any_bytes_are_a_frame_or_a_frame_error(data: bytes, channel):
    try:
        frame = decode(data, channel)
    except FrameError as error:
        assert error.reason in (
            "too-short",
            "length",
            "header-crc",
            "frame-crc",
            "frame-id",
            "startup-indicator",
        )
    else:
        assert len(encode(frame, channel)) == len(data)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"payload": bytes(255)}, "255 bytes"),
        ({"payload": bytes(256)}, "256 bytes"),
        ({"frame_id": 0}, "frame ID 0"),
        ({"frame_id": 2048}, "frame ID 2048"),
        ({"cycle_count": 64}, "cycle count 64"),
        ({"cycle_count": -1}, "cycle count -1"),
        ({"startup": True}, "sync"),
    ],
)
def test_frames_that_cannot_be_are_refused(changes: dict[str, object], said: str):
    with pytest.raises(ValueError, match=said):
        encode(msgspec.structs.replace(Frame(7, 0, b"ab"), **changes))
