import warnings

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from concord.bus.flexray.share_frames import payload_lengths
from concord.filters.gaussian import Gaussian
from concord.nodes.estimator import Rejected
from concord.nodes.vector_codec import BeliefCodec
from tests.nodes.networks import random_priors

SEEDS = st.integers(0, 2**32 - 1)
SIZES = st.integers(1, 12)


@given(SIZES, SEEDS, st.floats(-120, 120))
def test_a_belief_keeps_its_bits(n: int, seed: int, exponent: float):
    """Numbers of any size, as long as the covariance stays positive definite in float64."""
    (prior,) = random_priors(np.random.default_rng(seed), 1, n)
    scale = 10.0**exponent
    belief = Gaussian(prior.mean * scale, prior.cov * scale)
    codec = BeliefCodec(n)
    body = codec.encode(belief)
    assert len(body) == codec.size == 8 * (n + n * (n + 1) // 2)
    back = codec.decode(body)
    assert back.mean.tobytes() == belief.mean.tobytes()
    assert np.triu(back.cov).tobytes() == np.triu(belief.cov).tobytes()
    assert back.cov.tobytes() == back.cov.T.copy().tobytes()


@given(SIZES, SEEDS)
def test_float32_rounds_once(n: int, seed: int):
    (belief,) = random_priors(np.random.default_rng(seed), 1, n)
    codec = BeliefCodec(n, "<f4")
    back = codec.decode(codec.encode(belief))
    np.testing.assert_array_equal(back.mean, belief.mean.astype(np.float32))
    np.testing.assert_array_equal(np.triu(back.cov), np.triu(belief.cov.astype(np.float32)))
    again = codec.decode(codec.encode(back))
    assert again.mean.tobytes() == back.mean.tobytes()
    assert again.cov.tobytes() == back.cov.tobytes()
    assert back.mean.dtype == np.float64


@given(
    hnp.arrays(np.float64, 5, elements=st.floats(allow_nan=True, allow_infinity=True)),
    st.sampled_from(["<f8", "<f4"]),
)
def test_any_numbers_are_a_belief_or_rejected(values: np.ndarray, number: str):
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        data = values.astype(number).tobytes()
    codec = BeliefCodec(2, number)
    if np.isfinite(np.frombuffer(data, number)).all():
        # Whether it is a covariance is for the fusion rule to judge.
        assert codec.decode(data).cov[0, 1] == codec.decode(data).cov[1, 0]
    else:
        with pytest.raises(Rejected):
            codec.decode(data)


@pytest.mark.parametrize(
    ("values", "reason"),
    [
        ([0.0, 0.0, 1.0, 0.0], "belief-length"),
        ([np.nan, 0.0, 1.0, 0.0, 1.0], "belief-not-finite"),
        ([0.0, 0.0, np.inf, 0.0, 1.0], "belief-not-finite"),
        ([0.0, 0.0, 1.0, 0.0, -np.inf], "belief-not-finite"),
    ],
)
def test_what_no_sound_peer_would_send_is_rejected_by_name(values: list[float], reason: str):
    with pytest.raises(Rejected) as rejected:
        BeliefCodec(2).decode(np.array(values).tobytes())
    assert rejected.value.reason == reason


def test_padding_of_a_slot_is_ignored():
    belief = Gaussian(np.array([1.0]), np.array([[2.0]]))
    codec = BeliefCodec(1)
    assert codec.decode(codec.encode(belief) + b"\0" * 6) == belief


@pytest.mark.parametrize(("number", "most"), [("<f8", 6), ("<f4", 9)])
def test_so_many_states_fit_in_one_frame(number: str, most: int):
    """The design's figures: 6 states in float64, 9 in float32."""
    assert len(payload_lengths(BeliefCodec(most, number).size)) == 1
    assert len(payload_lengths(BeliefCodec(most + 1, number).size)) == 2
