"""Every filter of `--filter`: Kalman on linear models, and its own theory elsewhere."""

from typing import get_args

import numpy as np
import pytest
from scipy.optimize import minimize

from concord.entries import summaries
from concord.features.vehicle.adaptive import correntropy
from concord.features.vehicle.options import MaximumCorrentropy
from concord.filters.extended import ExtendedFilter
from concord.filters.filter import Filter, Linearising
from concord.filters.gaussian import Gaussian
from concord.filters.iterated import IteratedFilter
from concord.filters.sigma_point_filter import SigmaPointFilter
from concord.filters.sigma_points import scaled_unscented
from concord.scenarios.filter_table.filters import build_filter
from concord.scenarios.scenario import FilterChoice
from concord.scenarios.types.option import name_of
from tests.filters import kalman
from tests.filters.support import (
    BATCHES,
    RANGE_BEARING_NOISE_COV,
    SENSOR_POSITION_M,
    TURN_START,
    bearing_residual,
    random_belief,
    random_spd,
    range_bearing,
    turn,
)

# Beliefs of imm are mixtures: test_interacting_models.py.
CHOICES = {
    name_of(one): one
    for one in get_args(FilterChoice)
    if name_of(one) in summaries("FILTERS") and name_of(one) != "imm"
}


def built(name: str, states: int) -> Filter:
    if name == "mcukf":
        return build_filter(MaximumCorrentropy(bandwidth=1e6), states)
    return build_filter(CHOICES[name](), states)


@pytest.mark.parametrize("lanes", BATCHES)
@pytest.mark.parametrize("name", CHOICES)
def test_linear_models_give_the_kalman_filter(name: str, lanes: tuple[int, ...]):
    generator = np.random.default_rng(3)
    belief = random_belief(generator, lanes, 4)
    F, H = generator.standard_normal((4, 4)), generator.standard_normal((3, 4))
    Q, R = random_spd(generator, lanes, 4), random_spd(generator, (), 3)
    z = generator.standard_normal((*lanes, 3))
    z[..., 1] = np.nan
    found = built(name, 4).predict(belief, lambda x: x @ F.T, Q)
    for ours, theirs in zip(found, kalman.predict(belief, F, Q), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-9)
    update = built(name, 4).update(belief, z, lambda x: x @ H.T, R)
    expected = kalman.update(belief, z, H, R)
    for ours, theirs in zip(update.belief, expected.belief, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-7, atol=1e-8)
    np.testing.assert_allclose(
        update.normalised_innovation_squared, expected.normalised_innovation_squared, rtol=1e-7
    )


@pytest.mark.parametrize(("form", "plain"), [("srukf", "ukf"), ("srckf", "ckf")])
def test_the_square_root_forms_are_their_filters(form: str, plain: str):
    """Over 200 steps of a turn, with readings that are partly or wholly missing."""
    generator = np.random.default_rng(11)
    z = range_bearing(TURN_START.mean) + generator.standard_normal((200, 2)) * [20.0, 0.05]
    z[::7, 0], z[::5] = np.nan, np.nan
    found = {}
    for name in (form, plain):
        own, belief = built(name, 5), TURN_START
        for reading in z:
            belief = own.predict(belief, turn, np.diag([1.0, 0.1, 1.0, 0.1, 1e-6]))
            belief = own.update(
                belief, reading, range_bearing, RANGE_BEARING_NOISE_COV, residual=bearing_residual
            ).belief
        found[name] = belief
    for one, other in zip(found[form], found[plain], strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("name", CHOICES)
def test_a_wild_reading_does_not_pass_a_gate(name: str):
    own = built(name, 5)
    kept = own.update(
        TURN_START, np.array([1e8, 1.0]), range_bearing, RANGE_BEARING_NOISE_COV,
        residual=bearing_residual, gate=13.8,
    )  # fmt: skip
    np.testing.assert_array_equal(kept.belief.mean, TURN_START.mean)
    np.testing.assert_array_equal(kept.belief.cov, TURN_START.cov)
    assert kept.normalised_innovation_squared > 13.8


@pytest.mark.parametrize("own", [SigmaPointFilter(scaled_unscented(5)), ExtendedFilter()])
def test_a_linearisation_does_not_see_where_bearings_jump(own: Linearising):
    """The same scene turned by half a circle about the sensor has the slopes turned with it."""
    turned = np.diag([-1.0, -1.0, -1.0, -1.0, 1.0])
    x, y = SENSOR_POSITION_M
    about = np.array([2 * x, 0.0, 2 * y, 0.0, 0.0])
    east = Gaussian(np.array([x + 300.0, 1.0, y + 2.0, 0.5, 0.01]), TURN_START.cov)
    west = Gaussian(about + turned @ east.mean, turned @ east.cov @ turned)
    one, other = (own.linearise(b, range_bearing, 2, bearing_residual) for b in (east, west))
    np.testing.assert_allclose(other.slope @ turned, one.slope, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(other.error_cov, one.error_cov, rtol=1e-6, atol=1e-9)
    jump = other.predicted - one.predicted
    np.testing.assert_allclose(np.abs(jump), [0.0, np.pi], atol=1e-6)


# --- extended ------------------------------------------------------------------------------------


def bearing_slopes(state: np.ndarray) -> np.ndarray:
    """The Jacobian of `range_bearing` by hand."""
    dx, dy = state[0] - SENSOR_POSITION_M[0], state[2] - SENSOR_POSITION_M[1]
    r = np.hypot(dx, dy)
    return np.array([[dx / r, 0, dy / r, 0, 0], [-dy / r**2, 0, dx / r**2, 0, 0]])


def test_differences_are_the_derivatives_to_their_stated_error():
    affine = ExtendedFilter().linearise(TURN_START, range_bearing, 2, bearing_residual)
    exact = bearing_slopes(TURN_START.mean)
    deviation = np.sqrt(np.diag(TURN_START.cov))
    # Changes over one standard deviation, relative to the largest of each row.
    errors = np.abs(affine.slope - exact) * deviation
    assert (errors / np.abs(exact * deviation).max(axis=1, keepdims=True)).max() < 1e-8


def test_differences_of_an_affine_model_are_exact_however_far_from_the_origin():
    """Over a thousandth of a deviation the rounding of so large a state is 1e-6 of the slope."""
    A = np.array([[1.1, 0.7, 0.0], [-0.3, 0.9, 1.0], [0.2, 0.0, 0.4]])
    belief = Gaussian(np.array([3e4, -2e5, 1e3]), np.diag([1e-4, 4e-4, 0.0]))
    found = ExtendedFilter().predict(belief, lambda x: x @ A.T + 5.0, np.zeros((3, 3)))
    np.testing.assert_allclose(found.cov, A @ belief.cov @ A.T, rtol=2e-8)
    bent = ExtendedFilter().linearise(belief, lambda x: x[..., :1] ** 2, 1, np.subtract)
    np.testing.assert_allclose(bent.slope[0, 0], 2 * belief.mean[0], rtol=1e-6)
    # The secant of a cubic over a deviation is not its tangent.
    near = Gaussian(np.array([1.0]), np.array([[0.25]]))
    cubed = ExtendedFilter().linearise(near, lambda x: x**3, 1, np.subtract)
    np.testing.assert_allclose(cubed.slope, [[3.0]], rtol=1e-6)


@pytest.mark.parametrize("step", [1e-3, 1.0])
def test_the_extended_filter_takes_what_is_known_exactly(step: float):
    """P0 = 0 in one state and R = 0: the limit of small variances."""
    H, own = np.array([[1.0, 2.0]]), ExtendedFilter(step)
    found = own.update(
        Gaussian(np.array([1.0, 0.0]), np.diag([4.0, 0.0])), np.array([5.0]), lambda x: x @ H.T,
        np.zeros((1, 1)),
    ).belief  # fmt: skip
    np.testing.assert_allclose(found.mean, [5.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(found.cov, np.zeros((2, 2)), atol=1e-12)
    moved = own.predict(found, lambda x: x + 1, np.eye(2))
    np.testing.assert_allclose(moved.cov, np.eye(2), atol=1e-12)


# --- iterated ------------------------------------------------------------------------------------

READING = range_bearing(np.array([260.0, 12.0, 190.0, 3.0, 0.048]))


def test_the_iterated_extended_filter_finds_the_most_likely_state():
    """The same optimum by a search that knows the density only."""
    sharp = np.diag([1.0, np.radians(0.2) ** 2])
    own = IteratedFilter(ExtendedFilter(1e-4), 50, 1e-9)
    found = own.update(TURN_START, READING, range_bearing, sharp, residual=bearing_residual).belief
    root, noise_root = np.linalg.cholesky(TURN_START.cov), np.linalg.cholesky(sharp)

    def loss(white: np.ndarray) -> float:
        left = bearing_residual(READING, range_bearing(TURN_START.mean + root @ white))
        return float(white @ white + np.sum(np.linalg.solve(noise_root, left) ** 2))

    best = minimize(loss, np.zeros(5), method="BFGS", options={"gtol": 1e-9})
    np.testing.assert_allclose(found.mean, TURN_START.mean + root @ best.x, atol=1e-4)


def test_posterior_linearisation_ends_where_its_own_linearisation_leads_to_it():
    inner = SigmaPointFilter(scaled_unscented(5))
    own = IteratedFilter(inner, 100, 1e-12)
    found = own.update(
        TURN_START, READING, range_bearing, RANGE_BEARING_NOISE_COV, residual=bearing_residual
    ).belief
    affine = inner.linearise(found, range_bearing, 2, bearing_residual)
    shifted = READING - affine.predicted + affine.slope @ found.mean
    again = kalman.update(
        TURN_START, shifted, affine.slope, affine.error_cov + RANGE_BEARING_NOISE_COV
    ).belief
    np.testing.assert_allclose(again.mean, found.mean, atol=1e-7)
    np.testing.assert_allclose(again.cov, found.cov, atol=1e-6)


@pytest.mark.parametrize("inner", [SigmaPointFilter(scaled_unscented(5)), ExtendedFilter()])
def test_a_lane_iterates_as_it_does_alone(inner: SigmaPointFilter | ExtendedFilter):
    generator = np.random.default_rng(5)
    mean = TURN_START.mean + generator.standard_normal((6, 5)) @ np.sqrt(TURN_START.cov)
    cov = np.repeat(TURN_START.cov[None], 6, axis=0)
    z = range_bearing(mean) + generator.standard_normal((6, 2)) * [30.0, 0.1]
    z[1], z[2, 0], cov[3] = np.nan, np.nan, np.nan
    own = IteratedFilter(inner)

    def update(place: int | slice) -> Gaussian:
        belief = Gaussian(mean[place], cov[place])
        return own.update(
            belief, z[place], range_bearing, RANGE_BEARING_NOISE_COV, residual=bearing_residual
        ).belief

    together = update(slice(None))
    for lane in range(6):
        alone = update(lane)
        np.testing.assert_allclose(together.mean[lane], alone.mean, rtol=1e-10, atol=1e-10)
        np.testing.assert_allclose(together.cov[lane], alone.cov, rtol=1e-9, atol=1e-9)
    assert np.isnan(together.mean[3]).all() and np.isfinite(together.mean[[0, 1, 2, 4, 5]]).all()


def test_a_second_look_is_better_consistent_where_the_reading_is_sharp():
    """Far too large a prior for a linearisation at its mean: 400 runs of one update."""
    generator = np.random.default_rng(7)
    wide = Gaussian(TURN_START.mean, 25 * TURN_START.cov)
    truth = wide.mean + generator.standard_normal((400, 5)) @ np.sqrt(wide.cov)
    sharp = np.diag([1.0, np.radians(0.1) ** 2])
    z = range_bearing(truth) + generator.standard_normal((400, 2)) @ np.sqrt(sharp)
    belief = Gaussian(np.repeat(wide.mean[None], 400, axis=0), np.repeat(wide.cov[None], 400, 0))
    found = {}
    for name in ("ekf", "iekf"):
        after = (
            built(name, 5).update(belief, z, range_bearing, sharp, residual=bearing_residual).belief
        )
        error = (after.mean - truth)[..., [0, 2], None]
        cov = after.cov[..., [0, 2], :][..., [0, 2]]
        found[name] = float(np.median(error.mT @ np.linalg.solve(cov, error)))
    # The median of chi-square with two degrees of freedom is 1.39.
    assert abs(found["iekf"] - 1.39) < 0.4 and found["ekf"] > 10


def test_correntropy_stops_at_its_fixed_point():
    rule = scaled_unscented(5)
    z = READING + np.array([60.0, 0.0])
    arguments = (TURN_START, z, range_bearing, RANGE_BEARING_NOISE_COV, rule)
    stopped = correntropy.update(*arguments, 3.0, residual=bearing_residual).belief
    far = correntropy.update(
        *arguments, 3.0, iterations=2000, tolerance=0.0, residual=bearing_residual
    ).belief
    deviation = np.sqrt(np.diag(far.cov))
    assert (np.abs(stopped.mean - far.mean) / deviation).max() < 1e-4
    few = correntropy.update(*arguments, 3.0, iterations=1, residual=bearing_residual).belief
    assert (np.abs(few.mean - far.mean) / deviation).max() > 1e-2


def test_predictions_of_all_filters_are_near_each_other_on_a_turn():
    found = {name: built(name, 5).predict(TURN_START, turn, np.eye(5)).mean for name in CHOICES}
    deviation = np.sqrt(np.diag(TURN_START.cov))
    for mean in found.values():
        assert (np.abs(mean - found["ukf"]) / deviation).max() < 0.05
