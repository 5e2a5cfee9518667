import json

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from concord.nodes.changes import (
    Event,
    Gone,
    Joined,
    Left,
    Loss,
    PaceChange,
    Set,
    Standing,
    Welcome,
)
from concord.nodes.messages import (
    Bid,
    Estimate,
    Grant,
    MalformedMessage,
    Measured,
    ShareSent,
    Start,
    Timing,
    Truth,
    Unreachable,
    decode,
    encode,
    from_wire,
    message_types,
    to_wire,
    topic,
)

# Every float64 that a measurement or an estimate can be: NaN is "missing", infinities are not sent.
NUMBERS = st.floats(allow_nan=True, allow_infinity=False, width=64)
ARRAYS = hnp.arrays(
    np.float64, hnp.array_shapes(min_dims=1, max_dims=3, min_side=0, max_side=4), elements=NUMBERS
)


@given(ARRAYS)
def test_arrays_keep_their_bits(array: np.ndarray):
    text = msgspec.json.encode(to_wire(array))
    back = from_wire(msgspec.json.decode(text))
    if array.size:
        assert back.shape == array.shape
    known = ~np.isnan(array.ravel())
    assert back.ravel()[known].tobytes() == array.ravel()[known].tobytes()
    assert np.isnan(back.ravel()[~known]).all()


def test_missing_is_null_on_the_wire():
    message = Measured(2, 7, to_wire(np.array([[np.nan, 1.5]])))
    assert json.loads(encode(message))["readings"] == [[None, 1.5]]
    assert np.isnan(from_wire(decode("measured/2", encode(message)).readings)[0, 0])


MESSAGES = [
    (Measured(3, 5, [[1.0, None]], [0.5]), "measured/3"),
    (Bid(1, 9, None, 24), "bid/1"),
    (Grant(9, [1, 4]), "grant"),
    (Truth(5, [None, 2.0]), "truth"),
    (Estimate(2, 5, [1.0], [2.0], [-1, 0], {"missed": 3}), "estimate/2"),
    (Measured(3, 5, [[1.0]], None, (Left(2), Set({"rounds": 2}, 9))), "measured/3"),
    (Event(5, Joined(1, [1.0, None], [2.0])), "event"),
    (Event(5, Loss(0.5, 1, 2)), "event"),
    (Event(5, PaceChange(True, 20.0)), "event"),
    (Gone(4), "gone"),
    (Start(12345.678), "start"),
    (Timing(2, 5, 0.001, [0.002, 1e-5], 1, 0), "timing/2"),
    (Unreachable(2, 5), "unreachable/2"),
    (
        Welcome(
            2,
            7,
            Standing(((1, 4),), {"rule": "ci"}, 0.5, ((1, 2, 0.1),), ((0, 1),), 3, 9),
            Joined(2),
        ),
        "welcome/2",
    ),
]


@pytest.mark.parametrize(("message", "where"), MESSAGES)
def test_a_message_comes_back_from_its_topic(message, where: str):
    assert topic(message) == where
    assert decode(where, encode(message)) == message


def test_a_share_travels_as_its_frame():
    share = ShareSent(4, 11, b"\x00frame")
    assert topic(share) == "share/4"
    assert encode(share) == b"\x00frame"


def test_every_type_of_message_has_a_topic():
    assert {type(message) for message, _ in MESSAGES} == set(message_types().values())


@given(
    st.sampled_from([*sorted(message_types()), "share", "", "weather"]),
    st.one_of(
        st.binary(max_size=80),
        st.recursive(
            st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=3),
            lambda inner: (
                st.lists(inner, max_size=3)
                | st.dictionaries(st.sampled_from(["node", "step", "cycle", "bid"]), inner)
            ),
        ).map(msgspec.json.encode),
    ),
)
def test_any_bytes_are_a_message_or_malformed(kind: str, data: bytes):
    try:
        message = decode(f"{kind}/1", data)
    except MalformedMessage as error:
        assert kind in str(error)
    else:
        assert type(message) is message_types()[kind]
