import numpy as np
import pytest

from concord.filters import ukf
from concord.filters.gaussian import Gaussian
from concord.filters.sigma_points import cubature, scaled_unscented
from tests.filters import kalman
from tests.filters.support import (
    BATCHES,
    RANGE_BEARING_NOISE_COV,
    RULE_NAMES,
    TURN_NOISE_COV,
    TURN_START,
    bearing_residual,
    random_belief,
    random_spd,
    range_bearing,
    rules,
    turn,
    wrap,
)

RULE = scaled_unscented(5)


def linear_system(seed: int, n: int = 3, m: int = 2):
    """F (n, n), H (m, n), Q, R: a random linear model."""
    generator = np.random.default_rng(seed)
    transition, observation = generator.standard_normal((n, n)), generator.standard_normal((m, n))
    return transition, observation, random_spd(generator, (), n), random_spd(generator, (), m)


def scattered_turns(lanes: tuple[int, ...], seed: int = 1) -> tuple[Gaussian, np.ndarray]:
    """Beliefs about coordinated turns and one measurement for each."""
    generator = np.random.default_rng(seed)
    spread = generator.multivariate_normal(np.zeros(5), TURN_START.cov, lanes)
    scale = generator.uniform(0.5, 2.0, (*lanes, 1, 1))
    measurement = range_bearing(TURN_START.mean + spread)
    measurement += generator.multivariate_normal(np.zeros(2), RANGE_BEARING_NOISE_COV, lanes)
    return Gaussian(TURN_START.mean + 0.5 * spread, scale * TURN_START.cov), measurement


def update_turn(belief, measurement, gate=None):
    return ukf.update(
        belief,
        measurement,
        range_bearing,
        RANGE_BEARING_NOISE_COV,
        RULE,
        residual=bearing_residual,
        gate=gate,
    )


@pytest.mark.parametrize("name", RULE_NAMES)
@pytest.mark.parametrize("lanes", BATCHES)
def test_it_is_the_kalman_filter_on_linear_models(name, lanes):
    F, H, Q, R = linear_system(1)
    generator = np.random.default_rng(2)
    belief = expected = random_belief(generator, lanes, 3)
    rule = rules(3)[name]
    control = generator.standard_normal(3)
    for _ in range(3):
        measurement = generator.standard_normal((*lanes, 2))
        belief = ukf.predict(belief, lambda x: x @ F.T + control, Q, rule)
        expected = kalman.predict(expected, F, Q, control)
        np.testing.assert_allclose(belief.cov, expected.cov, rtol=1e-12, atol=1e-12)
        update = ukf.update(belief, measurement, lambda x: x @ H.T, R, rule)
        reference = kalman.update(expected, measurement, H, R)
        for ours, theirs in zip(update[1:], reference[1:], strict=True):
            np.testing.assert_allclose(ours, theirs, rtol=1e-12, atol=1e-12)
        belief, expected = update.belief, reference.belief
        np.testing.assert_allclose(belief.mean, expected.mean, rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(belief.cov, expected.cov, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("lanes", [(1,), (7,), (3, 1, 2)])
def test_a_batch_is_its_lanes_one_by_one(lanes):
    belief, measurement = scattered_turns(lanes)
    measurement[0] = np.nan  # some lanes with nothing taken
    measurement[-1, ..., 0] = np.nan  # and some with one row
    predicted = ukf.predict(belief, turn, TURN_NOISE_COV, RULE)
    update = update_turn(predicted, measurement)
    for lane in np.ndindex(lanes):
        alone = Gaussian(belief.mean[lane], belief.cov[lane])
        alone = update_turn(ukf.predict(alone, turn, TURN_NOISE_COV, RULE), measurement[lane])
        np.testing.assert_allclose(update.belief.mean[lane], alone.belief.mean, rtol=1e-12)
        np.testing.assert_allclose(
            update.belief.cov[lane], alone.belief.cov, rtol=1e-10, atol=1e-12
        )
        np.testing.assert_allclose(update.innovation[lane], alone.innovation, rtol=1e-10)


@pytest.mark.parametrize("broken", [np.diag([1.0, -1, 1, 1, 1]), np.full((5, 5), np.nan)])
def test_a_lane_that_is_not_definite_is_nan_alone(broken):
    belief, measurement = scattered_turns((4,))
    healthy = update_turn(ukf.predict(belief, turn, TURN_NOISE_COV, RULE), measurement).belief
    belief.cov[2] = broken
    predicted = ukf.predict(belief, turn, TURN_NOISE_COV, RULE)
    assert np.isnan(predicted.mean[2]).all()
    assert np.isnan(predicted.cov[2]).all()
    for prior in (predicted, belief):
        posterior = update_turn(prior, measurement).belief
        assert np.isnan(posterior.mean[2]).all()
        assert np.isnan(posterior.cov[2]).all()
        assert np.isfinite(posterior.mean[[0, 1, 3]]).all()
    recovered = update_turn(predicted, measurement).belief
    np.testing.assert_allclose(recovered.mean[[0, 1, 3]], healthy.mean[[0, 1, 3]], rtol=1e-12)


def test_an_innovation_covariance_that_is_not_definite_is_nan_in_its_lane():
    belief, measurement = scattered_turns((2,))
    noise = np.stack([np.diag([-1e9, 1.0]), RANGE_BEARING_NOISE_COV])
    posterior = ukf.update(belief, measurement, range_bearing, noise, RULE).belief
    assert np.isnan(posterior.mean[0]).all()
    assert np.isfinite(posterior.mean[1]).all()


@pytest.mark.parametrize("missing", [(0,), (2,), (0, 1), (0, 2)])
def test_a_missing_row_is_a_deleted_row(missing):
    _, H, _, R = linear_system(3, n=4, m=3)
    generator = np.random.default_rng(4)
    belief, rule = random_belief(generator, (5,), 4), scaled_unscented(4)
    measurement = generator.standard_normal((5, 3))
    taken = [row for row in range(3) if row not in missing]

    def bend(points):
        return np.sin(points @ H.T) + points[..., :3]

    expected = ukf.update(
        belief, measurement[:, taken], lambda x: bend(x)[..., taken], R[np.ix_(taken, taken)], rule
    )
    measurement[:, list(missing)] = np.nan
    update = ukf.update(belief, measurement, bend, R, rule)
    np.testing.assert_allclose(update.belief.mean, expected.belief.mean, rtol=1e-13, atol=1e-13)
    np.testing.assert_allclose(update.belief.cov, expected.belief.cov, rtol=1e-13, atol=1e-13)
    np.testing.assert_allclose(
        update.normalised_innovation_squared, expected.normalised_innovation_squared, rtol=1e-12
    )
    np.testing.assert_allclose(update.innovation[:, taken], expected.innovation, rtol=1e-13)
    np.testing.assert_allclose(
        update.innovation_cov[np.ix_(range(5), taken, taken)], expected.innovation_cov, rtol=1e-12
    )
    assert np.isnan(update.innovation[:, list(missing)]).all()
    assert np.isnan(update.innovation_cov[:, list(missing)]).all()
    assert np.isnan(update.innovation_cov[..., list(missing)]).all()


def test_a_missing_row_may_be_predicted_as_anything():
    belief, measurement = scattered_turns((3,))
    measurement[:, 1] = np.nan

    def blind_bearing(points):
        values = range_bearing(points)
        values[..., 1] = np.nan
        return values

    update = ukf.update(belief, measurement, blind_bearing, RANGE_BEARING_NOISE_COV, RULE)
    expected = update_turn(belief, measurement)
    np.testing.assert_array_equal(update.belief.mean, expected.belief.mean)
    assert np.isfinite(update.belief.cov).all()


@pytest.mark.parametrize("gate", [None, 9.0])
def test_nothing_taken_leaves_every_bit(gate):
    belief, measurement = scattered_turns((4,))
    belief.mean[0, 1] = -0.0
    belief.cov[0, 0, 1] = 1e-30  # not even symmetric: returned all the same
    belief.cov[1] = -np.eye(5)
    measurement[:3] = np.nan
    update = update_turn(belief, measurement, gate)
    assert update.belief.mean[:3].tobytes() == belief.mean[:3].tobytes()
    assert update.belief.cov[:3].tobytes() == belief.cov[:3].tobytes()
    assert (update.normalised_innovation_squared[:3] == 0).all()
    assert (update.belief.mean[3, [0, 2]] != belief.mean[3, [0, 2]]).all()


def test_the_gate_is_the_normalised_innovation_squared():
    belief, measurement = scattered_turns((50,), seed=3)
    update = update_turn(belief, measurement)
    solved = np.linalg.solve(update.innovation_cov, update.innovation[..., None])[..., 0]
    squared = (update.innovation * solved).sum(axis=-1)
    np.testing.assert_allclose(update.normalised_innovation_squared, squared, rtol=1e-10)
    gate = float(np.median(squared))
    kept = (update_turn(belief, measurement, gate).belief.mean == belief.mean).all(axis=-1)
    np.testing.assert_array_equal(kept, squared > gate)


@pytest.mark.parametrize("range_taken", [True, False])
def test_an_innovation_across_the_wrap_is_the_short_way_round(range_taken):
    belief, measurement = scattered_turns(())
    if not range_taken:
        measurement[0] = np.nan
    expected = update_turn(belief, measurement)
    # A heading that puts the cut between the predicted and the measured bearing.
    heading = measurement[1] - 0.5 * expected.innovation[1] + np.pi

    def headed(points):
        values = range_bearing(points)
        values[..., 1] = wrap(values[..., 1] - heading)
        return values

    measurement[1] = wrap(measurement[1] - heading)
    noise = RANGE_BEARING_NOISE_COV
    update = ukf.update(belief, measurement, headed, noise, RULE, residual=bearing_residual)
    np.testing.assert_allclose(update.innovation, expected.innovation, rtol=1e-9)
    np.testing.assert_allclose(update.belief.mean, expected.belief.mean, rtol=1e-9)


def test_a_state_angle_at_the_wrap_needs_its_residual():
    def difference(a, b):
        return wrap(a - b)

    def advance(points):
        return wrap(points + 0.2)

    belief = Gaussian(np.array([np.pi - 0.1]), np.array([[0.09]]))
    rule, noise = cubature(1), np.array([[0.01]])
    predicted = ukf.predict(belief, advance, noise, rule, residual=difference)
    assert wrap(predicted.mean - (np.pi + 0.1)) == pytest.approx(0.0, abs=1e-12)
    assert predicted.cov == pytest.approx(0.10)
    update = ukf.update(
        predicted,
        np.array([-np.pi + 0.2]),
        lambda x: wrap(x),
        noise,
        rule,
        residual=difference,
        state_residual=difference,
    )
    assert wrap(update.belief.mean - (np.pi + 0.1 + 0.1 * 10 / 11)) == pytest.approx(0.0, abs=1e-12)
    assert update.belief.cov == pytest.approx(0.10 * 0.01 / 0.11)


def test_a_point_beyond_half_a_turn_counts_as_the_angle_it_is():
    """Otherwise the state would move away from the measurement."""

    def difference(a, b):
        return wrap(a - b)

    rule, noise, seen = scaled_unscented(1), np.array([[0.01]]), np.array([0.5])
    belief = Gaussian(np.zeros(1), np.array([[3.5**2 / 3]]))  # points at 0 and +-3.5 rad
    update = ukf.update(
        belief, seen, wrap, noise, rule, residual=difference, state_residual=difference
    )
    nearer = (2 * np.pi - 3.5) ** 2 / 3
    np.testing.assert_allclose(update.belief.mean, 0.5 * nearer / (nearer + 0.01))


def test_models_may_return_any_strides_and_keep_their_arrays():
    belief, measurement = scattered_turns((6,))
    kept = []

    def remember(model, order):
        def remembering(points):
            values = np.array(model(points), order=order)
            values.flags.writeable = False
            kept.append((values, values.copy()))
            return values

        return remembering

    results = []
    for order in "CF":
        predicted = ukf.predict(belief, remember(turn, order), TURN_NOISE_COV, RULE)
        update = ukf.update(
            predicted, measurement, remember(range_bearing, order), RANGE_BEARING_NOISE_COV, RULE
        )
        results.append(update.belief)
    np.testing.assert_allclose(results[0].mean, results[1].mean, rtol=1e-13)
    for values, before in kept:
        np.testing.assert_array_equal(values, before)


def test_inputs_are_left_alone():
    belief, measurement = scattered_turns((2,))
    measurement[0, 0] = np.nan
    for array in (*belief, measurement):
        array.flags.writeable = False
    update_turn(ukf.predict(belief, turn, TURN_NOISE_COV, RULE), measurement, gate=9.0)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda b: ukf.predict(b, lambda x: x[0], TURN_NOISE_COV, RULE),
            r"transition returned shape \(5,\)",
        ),
        (
            lambda b: ukf.predict(b, lambda x: x[:5], TURN_NOISE_COV, RULE),
            r"transition returned shape \(5, 5\)",
        ),
        (lambda b: ukf.predict(b, lambda x: x.T, TURN_NOISE_COV, RULE), "transition returned"),
        (lambda b: ukf.predict(b, turn, np.array(1.0), RULE), "process noise covariance has shape"),
        (lambda b: ukf.predict(b, turn, np.ones(5), RULE), r"must end in \(5, 5\)"),
        (
            lambda b: ukf.update(b, np.zeros(1), range_bearing, np.eye(1), RULE),
            r"measure returned shape \(11, 2\)",
        ),
        (
            lambda b: ukf.update(b, np.zeros(2), range_bearing, np.eye(1), RULE),
            "measurement noise covariance",
        ),
    ],
)
def test_what_does_not_fit_is_named(call, message):
    with pytest.raises(ValueError, match=message):
        call(TURN_START)
