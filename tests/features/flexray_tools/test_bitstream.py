"""Bits on the wire against a text-by-text construction, and decoding of any bits."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from concord.bus.flexray.presets import AUDI
from concord.features.flexray_tools.recordings.bitstream import BitError, decode_bits
from tests.bus.support import quick
from tests.features.flexray_tools.signals import encode_bits


def text(bits: np.ndarray) -> str:
    return "".join(map(str, bits))


@quick
@given(st.binary(min_size=8, max_size=262), st.integers(1, 15), st.integers(0, 80))
def test_sequence_is_tss_fss_bytes_with_bss_fes_dts(data: bytes, start: int, trailing: int):
    coded = "".join("10" + f"{byte:08b}" for byte in data)
    dts = "0" * trailing + "1" if trailing else ""
    bits = encode_bits(data, start, trailing)
    assert text(bits) == "0" * start + "1" + coded + "01" + dts
    assert decode_bits(bits) == data


def test_length_is_that_of_the_cluster():
    for payload in (0, 34, 254):
        bits = encode_bits(bytes(payload + 8), AUDI.transmission_start_bits)
        assert len(bits) == AUDI.frame_bits(payload)


@pytest.mark.parametrize("start", [0, 16])
def test_start_sequences_out_of_range_are_refused(start: int):
    with pytest.raises(ValueError, match=r"1\.\.15"):
        encode_bits(bytes(8), start)


@quick
@given(st.lists(st.integers(0, 1), max_size=200))
def test_any_bits_are_bytes_or_a_bit_error(bits: list[int]):
    array = np.array(bits, dtype=np.uint8)
    try:
        data = decode_bits(array)
    except BitError as error:
        assert error.reason in ("start", "coding", "truncated")
    else:
        start = bits.index(1)
        assert text(array).startswith("0" * start + text(encode_bits(data, 1))[1:])


@quick
@given(st.binary(min_size=8, max_size=40), st.data())
def test_a_wrong_byte_start_and_a_cut_are_found(data: bytes, drawn: st.DataObject):
    bits = encode_bits(data, 5)
    broken = bits.copy()
    byte = drawn.draw(st.integers(0, len(data) - 1))
    broken[6 + 10 * byte + 1] = 1
    with pytest.raises(BitError) as refused:
        decode_bits(broken)
    assert refused.value.reason == "coding"
    with pytest.raises(BitError) as refused:
        decode_bits(bits[: drawn.draw(st.integers(6, len(bits) - 1))])
    assert refused.value.reason == "truncated"
