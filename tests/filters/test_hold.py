import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from concord.filters.fusion.hold import (
    drop,
    full,
    held_weights,
    in_step,
    inverse_volume,
    renormalise,
    times_inverse_volume,
)
from tests.filters.support import BATCHES, random_spd

BASE = np.array([0.4, 0.3, 0.2, 0.1])
AGES = np.array([0, 0, 2, -1])
COVS = np.array([[[1.0]], [[4.0]], [[0.25]], [[np.nan]]])


@st.composite
def rows(draw):
    """A weight row, ages (self first, some never heard) and covariances, with leading axes."""
    lanes, count = draw(st.sampled_from(BATCHES)), draw(st.integers(1, 6))
    generator = np.random.default_rng(draw(st.integers(0, 2**16)))
    base = generator.dirichlet(np.ones(count), lanes)
    ages = generator.integers(-1, 5, (*lanes, count))
    ages[..., 0] = 0
    return base, ages, random_spd(generator, (*lanes, count), 3)


@given(row=rows(), decay=st.floats(0, 1), determinant=st.booleans())
def test_every_variant_gives_an_average(row, decay, determinant):
    base, ages, covs = row
    for weights in (
        held_weights(base, ages, decay, inverse_volume(covs) if determinant else 1.0),
        full(base, ages),
        renormalise(base, ages),
        in_step(base, ages, 2),
        drop(base, ages),
    ):
        assert weights.shape == base.shape
        assert (weights >= 0).all()
        np.testing.assert_allclose(weights.sum(axis=-1), 1.0, rtol=1e-12)
        assert (weights[ages < 0] == 0).all()


@given(row=rows(), decay=st.floats(0, 1))
def test_weights_by_age_can_be_sharpened_afterwards(row, decay):
    """So that they need be worked out once for every pattern of ages."""
    base, ages, covs = row
    covs[..., -1, :, :] = np.where(
        (ages[..., -1] < 0)[..., None, None], np.nan, covs[..., -1, :, :]
    )
    by_age = held_weights(base, ages, decay)
    at_once = held_weights(base, ages, decay, inverse_volume(covs))
    # Weights that are no normal number any more keep few digits, whichever way they come about.
    np.testing.assert_allclose(
        times_inverse_volume(by_age, inverse_volume(covs)), at_once, rtol=1e-12, atol=1e-300
    )


@given(row=rows())
def test_limits_of_the_decay(row):
    base, ages, _ = row
    none = held_weights(base, ages, 0.0)
    np.testing.assert_allclose(none, renormalise(base, ages), rtol=1e-12)
    everything = held_weights(base, ages, 1.0)
    np.testing.assert_allclose(everything, full(base, ages), rtol=1e-12)


@given(row=rows(), cycles=st.integers(0, 5))
def test_within_the_step_a_share_counts_until_its_age_reaches_back_before_it(row, cycles):
    base, ages, _ = row
    weights = in_step(base, ages, cycles)
    assert ((weights > 0) == ((ages >= 0) & (ages <= cycles))).all()
    np.testing.assert_array_equal(in_step(base, ages, 0), renormalise(base, ages))
    np.testing.assert_array_equal(in_step(base, ages, 5), full(base, ages))


def test_formula_by_hand():
    """n = 1: 0.4 / 1, 0.3 / 4, 0.2 * 0.5^2 / 0.25, 0; and without determinants."""
    worth = np.array([0.4, 0.075, 0.2, 0.0])
    np.testing.assert_allclose(
        held_weights(BASE, AGES, 0.5, inverse_volume(COVS)), worth / worth.sum()
    )
    worth = np.array([0.4, 0.3, 0.05, 0.0])
    np.testing.assert_allclose(held_weights(BASE, AGES, 0.5), worth / worth.sum())


def test_variants_by_hand():
    np.testing.assert_allclose(full(BASE, AGES), np.array([4, 3, 2, 0]) / 9)
    np.testing.assert_allclose(renormalise(BASE, AGES), np.array([4, 3, 0, 0]) / 7)
    np.testing.assert_allclose(drop(BASE, AGES), [0.7, 0.3, 0.0, 0.0])


@given(row=rows(), exponents=st.lists(st.integers(-150, 150), min_size=3, max_size=3))
def test_determinant_weights_do_not_depend_on_units(row, exponents):
    base, ages, covs = row
    units = 10.0 ** np.array(exponents)  # scaled determinants reach 1e+-900: beyond a float
    scaled = covs * units[:, None] * units
    expected = held_weights(base, ages, 0.5, inverse_volume(covs))
    np.testing.assert_allclose(
        held_weights(base, ages, 0.5, inverse_volume(scaled)), expected, rtol=1e-8
    )


def test_a_lane_with_nothing_else_keeps_its_own_belief():
    base, ages = np.array([0.0, 0.5, 0.5]), np.array([0, -1, 3])
    expected = [1.0, 0.0, 0.0]
    covs = np.broadcast_to(np.eye(2), (3, 2, 2))
    for weights in (
        renormalise(base, ages),
        in_step(base, ages, 1),
        drop(base, ages),
        held_weights(base, ages, 0.0, inverse_volume(covs)),
    ):
        np.testing.assert_array_equal(weights, expected)


def test_a_covariance_that_is_not_definite_spoils_its_lane_alone():
    covs = np.broadcast_to(np.eye(2), (2, 3, 2, 2)).copy()
    covs[0, 1] = -np.eye(2)  # of positive determinant
    weights = held_weights(np.full(3, 1 / 3), np.zeros((2, 3)), 0.5, inverse_volume(covs))
    assert np.isnan(weights[0]).all()
    np.testing.assert_allclose(weights[1], 1 / 3)


@pytest.mark.parametrize("decay", [-0.1, 1.1, np.nan])
def test_a_decay_beyond_its_range_is_refused(decay):
    with pytest.raises(ValueError, match="decay is"):
        held_weights(BASE, AGES, decay)


@pytest.mark.parametrize("rule", [full, renormalise])
def test_a_lane_without_weight_keeps_its_own_whatever_the_others_have(rule):
    base = np.array([[0.5, 0.5], [0.0, 1.0]])
    ages = np.array([[0, 0], [0, -1]])
    lanes = rule(base, ages)
    for lane, weights, of_lane in zip(lanes, base, ages, strict=True):
        np.testing.assert_array_equal(lane, rule(weights, of_lane))
    np.testing.assert_array_equal(lanes[1], [1.0, 0.0])
