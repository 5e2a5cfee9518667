"""Fragments: any data, any order, and every way to be incomplete."""

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from concord.bus.fragments import FragmentError, fragment_count, join, payload_sizes, split
from tests.bus.support import quick


@quick
@given(st.binary(max_size=2000), st.integers(6, 254), st.randoms(), st.integers(0, 20))
def test_data_survives_in_any_order_and_padded(data: bytes, limit: int, random, padding: int):
    if len(data) > 255 * (limit // 2 * 2 - 4):
        return
    payloads = split(data, limit)
    assert tuple(map(len, payloads)) == payload_sizes(len(data), limit)
    assert all(len(payload) <= limit and len(payload) % 2 == 0 for payload in payloads)
    assert {fragment_count(payload) for payload in payloads} == {len(payloads)}
    shuffled = [*payloads[:-1], payloads[-1] + bytes(padding)]
    random.shuffle(shuffled)
    assert join(shuffled) == data


@pytest.mark.parametrize(
    ("states", "bytes_per_number", "frames"),
    [(6, 8, 1), (7, 8, 2), (9, 4, 1), (10, 4, 2)],
)
def test_limits_of_one_frame_are_those_of_the_design(states, bytes_per_number, frames):
    # Step number, mean and upper triangle: n <= 6 in float64 and n <= 9 in float32 in one frame.
    share = 4 + bytes_per_number * (states + states * (states + 1) // 2)
    assert len(payload_sizes(share, 254)) == frames


def test_each_lost_repeated_or_foreign_fragment_is_noticed():
    payloads = split(bytes(700), 254)
    assert len(payloads) == 3
    for kept in itertools.chain(
        itertools.combinations(payloads, 1), itertools.combinations(payloads, 2)
    ):
        with pytest.raises(FragmentError) as refused:
            join(kept)
        assert refused.value.reason == "incomplete"
    for wrong, reason in (
        ([], "empty"),
        ([*payloads, payloads[0]], "repeated"),
        ([*payloads[:2], split(bytes(701), 254)[2]], "mixed"),
        ([*payloads[:2], split(bytes(100), 254)[0]], "mixed"),
        ([*payloads[:2], payloads[2][:50]], "length"),
        ([b"abc"], "too-short"),
    ):
        with pytest.raises(FragmentError) as refused:
            join(wrong)
        assert refused.value.reason == reason


@quick
@given(st.lists(st.binary(max_size=20), max_size=4))
def test_any_payloads_are_data_or_a_fragment_error(payloads: list[bytes]):
    try:
        data = join(payloads)
    except FragmentError as error:
        assert error.reason
    else:
        assert len(data) == int.from_bytes(payloads[0][2:4], "little")


@pytest.mark.parametrize(("size", "limit", "said"), [(10, 4, "no room"), (9999, 16, "834 frames")])
def test_impossible_splits_are_refused(size: int, limit: int, said: str):
    with pytest.raises(ValueError, match=said):
        split(bytes(size), limit)
