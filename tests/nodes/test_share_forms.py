"""Forms of shares that round to the safe side: the promise for any belief, units, bad codes."""

import warnings

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from concord.features.sets.set_shapes import Ellipsoids, set_form
from concord.filters.fusion import hybrid_consensus
from concord.filters.fusion.packed import pack, packed_length, unpack
from concord.filters.gaussian import Gaussian, Information, to_information
from concord.filters.linalg import unpack_upper
from concord.nodes.share_forms import (
    MEAN_REACH,
    InformationPair,
    ShareForm,
    SingleBelief,
    TwoByteBelief,
    TwoByteHybrid,
)
from concord.nodes.vector_codec import belief_numbers, belief_of
from concord.scenarios.catalogue import definition_named
from concord.scenarios.preparation import prepare

SEEDS = st.integers(0, 2**32 - 1)
SIZES = st.integers(1, 9)
FORMS = [SingleBelief, TwoByteBelief]
DEFAULTS = definition_named("target-tracking").defaults


def random_belief(rng: np.random.Generator, n: int, farthest: float, sharpest: float) -> Gaussian:
    """A belief in units of its own for each state; its correlations may be nearly singular."""
    units = 10.0 ** rng.uniform(-5, 5, n)
    axes, _ = np.linalg.qr(rng.normal(size=(n, n)))
    factor = units[:, None] * axes * 10.0 ** rng.uniform(sharpest, 0, n)
    cov = factor @ factor.T
    mean = rng.normal(size=n) * np.sqrt(np.diagonal(cov)) * 10.0 ** rng.uniform(-2, farthest)
    return Gaussian(mean, 0.5 * (cov + cov.T))


def through(form: ShareForm, belief: Gaussian) -> Gaussian:
    return belief_of(form.numbers(form.codes(belief_numbers(belief))), belief.mean.shape[-1])


def least_eigenvalue(matrix: np.ndarray, cov: np.ndarray) -> float:
    """In units of the deviations, so that rounding of doubles is of one size."""
    deviations = np.sqrt(np.diagonal(cov))
    return float(np.linalg.eigvalsh(matrix / np.outer(deviations, deviations))[0])


@pytest.mark.parametrize("kind", FORMS)
@given(SIZES, SEEDS)
def test_the_decoded_covariance_bounds_the_error_of_the_decoded_mean(kind, n: int, seed: int):
    """P_decoded >= P + d d' for every belief, near singular ones and far means included."""
    before = random_belief(np.random.default_rng(seed), n, farthest=9, sharpest=-6)
    after = through(kind(n), before)
    moved = after.mean - before.mean
    spare = after.cov - before.cov - np.outer(moved, moved)
    assert least_eigenvalue(spare, after.cov) > -1e-13


@given(SIZES, SEEDS)
def test_two_bytes_cost_little_near_the_origin(n: int, seed: int):
    before = random_belief(np.random.default_rng(seed), n, farthest=2, sharpest=-1)
    after = through(TwoByteBelief(n), before)
    ratio = np.diagonal(after.cov) / np.diagonal(before.cov)
    assert (ratio < 1 + 2.0**-8 + n * 2.0**-11).all()
    # Half a step of a 32nd of the deviation.
    moved = np.abs(after.mean - before.mean) / np.sqrt(np.diagonal(after.cov))
    assert (moved <= 2.0**-6 + 1e-12).all()


def test_means_beyond_the_reach_enlarge_the_covariance():
    far = Gaussian(np.array([5e6, 0.0]), np.eye(2))
    after = through(TwoByteBelief(2), far)
    deviation = np.sqrt(after.cov[0, 0])
    assert 5e6 / MEAN_REACH <= deviation < 1.01 * 5e6 / MEAN_REACH
    assert abs(after.mean[0] - 5e6) <= deviation / 64
    assert after.cov[1, 1] < 1.01


@given(SIZES, SEEDS, st.data())
def test_units_in_powers_of_two_change_nothing(n: int, seed: int, data: st.DataObject):
    belief = random_belief(np.random.default_rng(seed), n, farthest=4, sharpest=-3)
    units = 2.0 ** np.array(data.draw(st.lists(st.integers(-30, 30), min_size=n, max_size=n)))
    other = Gaussian(belief.mean * units, belief.cov * np.outer(units, units))
    here, there = through(TwoByteBelief(n), belief), through(TwoByteBelief(n), other)
    np.testing.assert_array_equal(here.mean * units, there.mean)
    np.testing.assert_array_equal(here.cov * np.outer(units, units), there.cov)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e300, -1.0])
@pytest.mark.parametrize("place", [0, 2])
def test_what_is_no_belief_cannot_be_read(bad: float, place: int):
    if bad == -1.0 and place == 0:
        return
    numbers = belief_numbers(Gaussian(np.zeros(2), np.eye(2)))
    numbers[place] = bad
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        back = TwoByteBelief(2).numbers(TwoByteBelief(2).codes(numbers))
    assert not np.isfinite(back).all()


@given(hnp.arrays(np.uint16, 30))
def test_any_codes_are_numbers_or_not_finite(codes: np.ndarray):
    states, nodes = 3, 11
    found = [
        TwoByteBelief(states).numbers(codes[:9]),
        InformationPair(TwoByteBelief(states)).numbers(codes[:9]),
        TwoByteHybrid(states, nodes).numbers(codes),
    ]
    assert [len(numbers) for numbers in found] == [9, 9, 2 * 9 + nodes]
    assert TwoByteHybrid(states, nodes).length == len(codes)


@given(SIZES, SEEDS)
def test_an_information_pair_loses_information(n: int, seed: int):
    belief = random_belief(np.random.default_rng(seed), n, farthest=2, sharpest=-2)
    form = InformationPair(TwoByteBelief(n))
    before = to_information(belief).matrix
    after = unpack(form.numbers(form.codes(pack(to_information(belief))))).matrix
    scale = np.linalg.cholesky(belief.cov)
    assert np.linalg.eigvalsh(scale.T @ (before - after) @ scale)[0] > -1e-9


@given(st.integers(1, 6), st.integers(2, 30), SEEDS)
def test_prior_and_novelty_lose_information_and_the_weights_gain(n: int, nodes: int, seed: int):
    """The loss of the novelty at the largest gain is at most the prior information."""
    rng = np.random.default_rng(seed)
    prior = random_belief(rng, n, farthest=2, sharpest=-1)
    before = to_information(prior)
    rows = rng.normal(size=(2, n)) @ np.linalg.inv(np.linalg.cholesky(prior.cov))
    rows = rows * 10.0 ** rng.uniform(-2, 1, (2, 1))
    seen = rows.T @ rows
    reading = seen @ prior.mean + rows.T @ rng.normal(size=2)
    row = rng.dirichlet(np.ones(nodes))
    numbers = np.concatenate((pack(before), pack(Information(reading, seen)), row))
    form = TwoByteHybrid(n, nodes)
    length = packed_length(n)
    back = form.numbers(form.codes(numbers))
    assert (back[2 * length :] >= row - 1e-9).all() and (back[2 * length :] <= row + 2e-5).all()
    kept = unpack(back[:length])
    added = unpack(back[length : 2 * length])
    scale = np.linalg.cholesky(prior.cov)

    def whitened(matrix: np.ndarray) -> np.ndarray:
        return np.linalg.eigvalsh(scale.T @ matrix @ scale)

    assert whitened(before.matrix - kept.matrix)[0] > -1e-9
    assert whitened(seen - added.matrix)[0] > -1e-9
    # It is exactly sound: the average of such shares is a belief with either gain.
    assert hybrid_consensus.sound(back, n)
    own = scale.T @ seen @ scale
    if np.abs(own).max() < 1.0:
        # No novelty was sent as noisier than it is, so all that is missing was rounded.
        assert whitened(kept.matrix - nodes * (seen - added.matrix))[0] > 0.25


def test_a_node_without_readings_sends_no_novelty():
    prior = Gaussian(np.array([3.0, -4.0]), np.diag([2.0, 9.0]))
    numbers = hybrid_consensus.begin(prior, prior, np.eye(3)[1])
    form = TwoByteHybrid(2, 3)
    back = form.numbers(form.codes(numbers))
    np.testing.assert_array_equal(back[5:10], 0.0)
    np.testing.assert_array_equal(back[10:], np.eye(3)[1])


@given(st.integers(1, 6), SEEDS)
def test_a_decoded_ellipsoid_contains_the_one_that_was_kept(n: int, seed: int):
    rng = np.random.default_rng(seed)
    belief = random_belief(rng, n, farthest=2, sharpest=-1)
    shape = Ellipsoids(n, "<u2")
    form = set_form(n)
    numbers = shape.numbers_of(shape.containing(belief))
    after = belief_of(form.numbers(form.codes(numbers)), n)
    directions = rng.normal(size=(200, n)) / np.sqrt(np.diagonal(belief.cov))

    def reach(one: Gaussian) -> np.ndarray:
        spread = np.einsum("ki,ij,kj->k", directions, one.cov, directions)
        return directions @ one.mean + np.sqrt(spread)

    assert (reach(after) >= reach(belief) - 1e-12 * np.abs(reach(belief))).all()
    assert np.trace(unpack_upper(numbers[n:])) < 1.2 * np.trace(belief.cov)


# --- what is refused -----------------------------------------------------------------------------


@pytest.mark.parametrize("rule", ["diffusion", "kcf"])
def test_shares_without_a_covariance_are_refused(rule: str):
    with pytest.raises(ValueError, match="Valid names are float64, float32; two bytes"):
        prepare(DEFAULTS.with_(rule=rule, number="float16"))


def test_a_beginning_far_from_the_origin_is_refused(monkeypatch: pytest.MonkeyPatch):
    scenario = DEFAULTS.with_(number="float16", nodes=3, graph="path")
    prepare(scenario)
    monkeypatch.setattr("concord.scenarios.preparation.MEAN_REACH", 1e-3)
    with pytest.raises(ValueError, match=r"state 0 begins at .* use --number float32"):
        prepare(scenario)
