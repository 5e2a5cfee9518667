import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from concord.filters.fusion.packed import (
    average,
    from_packed_information,
    pack,
    packed_inverse_volume,
    packed_length,
    to_packed_information,
    unpack,
)
from concord.filters.gaussian import Gaussian, Information
from tests.filters.support import BATCHES, random_spd

SEEDS = st.integers(0, 2**16)
LANES = st.sampled_from(BATCHES)


@given(lanes=LANES, n=st.integers(1, 6), seed=SEEDS)
def test_what_is_packed_is_unpacked(lanes, n, seed):
    generator = np.random.default_rng(seed)
    pair = Information(generator.standard_normal((*lanes, n)), random_spd(generator, lanes, n))
    numbers = pack(pair)
    assert numbers.shape == (*lanes, packed_length(n))
    again = unpack(numbers)
    np.testing.assert_array_equal(again.vector, pair.vector)
    np.testing.assert_array_equal(again.matrix, pair.matrix)


def test_a_cut_vector_is_refused():
    with pytest.raises(ValueError, match=r"length 4, .*its last axis uncut"):
        unpack(np.zeros((2, 4)))


@given(lanes=LANES, count=st.integers(1, 5), seed=SEEDS)
def test_the_average_is_the_sum_over_those_heard(lanes, count, seed):
    generator = np.random.default_rng(seed)
    numbers = generator.standard_normal((*lanes, count, 3))
    weights = generator.dirichlet(np.ones(count), lanes)
    silent = generator.random((*lanes, count)) < 0.5
    silent[..., 0] = False
    garbled = numbers.copy()
    garbled[silent, generator.integers(3)] = np.nan
    mixed = average(garbled, weights)
    for lane in np.ndindex(lanes):
        heard = [j for j in range(count) if not silent[lane][j]]
        total = sum(weights[lane][j] for j in heard)
        expected = sum(weights[lane][j] / total * numbers[lane][j] for j in heard)
        np.testing.assert_allclose(mixed[lane], expected, rtol=1e-12, atol=1e-13)


def test_who_knows_nothing_itself_is_a_failed_lane_and_no_other():
    numbers = np.ones((2, 3, 2))
    numbers[0, 0, 1] = np.nan
    mixed = average(numbers, np.full(3, 1 / 3))
    assert np.isnan(mixed[0, 1])
    np.testing.assert_allclose(mixed[1], 1.0)


@pytest.mark.parametrize("weights", [[0.6, 0.6], [1.5, -0.5]])
def test_weights_that_do_not_average_are_refused(weights):
    with pytest.raises(ValueError, match="sum to 1"):
        average(np.ones((2, 2)), np.array(weights))


@given(lanes=LANES, n=st.integers(1, 9), scale=st.sampled_from([1e-150, 1.0, 1e150]), seed=SEEDS)
def test_sharpness_is_the_root_of_the_determinant_however_small_or_large(lanes, n, scale, seed):
    generator = np.random.default_rng(seed)
    covs = scale * random_spd(generator, lanes, n)
    numbers = pack(Information(np.zeros((*lanes, n)), covs))
    expected = np.exp(-np.linalg.slogdet(covs).logabsdet / n)
    np.testing.assert_allclose(packed_inverse_volume(numbers), expected, rtol=1e-11)
    _, inverse_volume = to_packed_information(Gaussian(np.zeros((*lanes, n)), covs))
    np.testing.assert_allclose(inverse_volume, expected, rtol=1e-11)


@pytest.mark.parametrize("bad", [0.0, -1.0, np.nan])
@pytest.mark.parametrize("count", [3, 100])
def test_what_is_not_positive_definite_has_no_sharpness_and_fails_alone(count, bad):
    belief = Gaussian(np.ones((count, 3)), np.tile(np.diag([2.0, 3.0, 4.0]), (count, 1, 1)))
    belief.cov[1, 2, 2] = bad
    triangles = np.ascontiguousarray(pack(Information(*belief)).T).T
    failed = np.arange(count) == 1
    np.testing.assert_array_equal(np.isnan(packed_inverse_volume(triangles)), failed)
    numbers, inverse_volume = to_packed_information(belief)
    np.testing.assert_array_equal(np.isnan(inverse_volume), failed)
    np.testing.assert_array_equal(np.isnan(numbers).any(axis=-1), failed)
    back = from_packed_information(numbers)
    np.testing.assert_array_equal(np.isnan(back.cov).any(axis=(-1, -2)), failed)
    np.testing.assert_allclose(back.mean[~failed], belief.mean[~failed], rtol=1e-14)
