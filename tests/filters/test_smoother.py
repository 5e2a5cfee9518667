"""The smoother against batch least squares over the whole history, and its invariants."""

from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from concord.filters import ukf
from concord.filters.filter import Affine
from concord.filters.gaussian import Gaussian
from concord.filters.smoother import (
    Backward,
    backward,
    backward_affine,
    smooth,
    smooth_with_lags,
)
from tests.filters import kalman
from tests.filters.support import RULE_NAMES, random_belief, random_spd, rules, turn

STEPS = 7


class Linear(NamedTuple):
    """A linear system of one lane with its readings, each step by the same matrices."""

    prior: Gaussian
    F: np.ndarray
    Q: np.ndarray
    H: np.ndarray
    R: np.ndarray
    readings: np.ndarray


def system(seed: int, n: int = 3, m: int = 2) -> Linear:
    draw = np.random.default_rng(seed)
    readings = 3 * draw.standard_normal((STEPS, m))
    readings[2] = np.nan
    return Linear(
        random_belief(draw, (), n),
        0.6 * draw.standard_normal((n, n)) + 0.5 * np.eye(n),
        random_spd(draw, (), n),
        draw.standard_normal((m, n)),
        random_spd(draw, (), m),
        readings,
    )


def filtered(of: Linear, rule: str) -> tuple[Gaussian, list[Backward]]:
    """The Kalman filter's history, and the way from each step to the one before."""
    belief, history, ways = of.prior, [], []
    for step, reading in enumerate(of.readings):
        if step > 0:
            points = rules(len(of.F))[rule]
            ways.append(backward(belief, lambda states: states @ of.F.T, of.Q, points))
            belief = kalman.predict(belief, of.F, of.Q)
        belief = kalman.update(belief, reading, of.H, of.R).belief
        history.append(belief)
    return Gaussian(*(np.stack(values) for values in zip(*history, strict=True))), ways


def least_squares(of: Linear, steps: int) -> Gaussian:
    """All states (steps, n) by one weighted least-squares problem: no recursion at all."""
    n = len(of.F)
    rows, right = [], []

    def add(matrix: dict[int, np.ndarray], value: np.ndarray, cov: np.ndarray) -> None:
        whitener = np.linalg.inv(np.linalg.cholesky(cov))
        block = np.zeros((len(value), n * steps))
        for step, part in matrix.items():
            block[:, n * step : n * (step + 1)] = part
        rows.append(whitener @ block)
        right.append(whitener @ value)

    add({0: np.eye(n)}, of.prior.mean, of.prior.cov)
    for step in range(steps):
        if step > 0:
            add({step - 1: -of.F, step: np.eye(n)}, np.zeros(n), of.Q)
        if not np.isnan(of.readings[step]).any():
            add({step: of.H}, of.readings[step], of.R)
    left = np.vstack(rows)
    states = np.linalg.lstsq(left, np.concatenate(right))[0]
    cov = np.linalg.inv(left.T @ left)
    blocks = [cov[n * k : n * (k + 1), n * k : n * (k + 1)] for k in range(steps)]
    return Gaussian(states.reshape(steps, n), np.stack(blocks))


@pytest.mark.parametrize("rule", RULE_NAMES)
@pytest.mark.parametrize("seed", range(5))
def test_on_linear_models_it_is_least_squares_over_the_whole_history(rule: str, seed: int):
    of = system(seed)
    found = smooth(*filtered(of, rule))
    expected = least_squares(of, STEPS)
    np.testing.assert_allclose(found.mean, expected.mean, rtol=1e-8, atol=1e-9)
    np.testing.assert_allclose(found.cov, expected.cov, rtol=1e-8, atol=1e-9)


@pytest.mark.parametrize("seed", range(5))
def test_the_smoother_of_affine_models_is_least_squares_too(seed: int):
    of = system(seed)
    history, _ = filtered(of, "unscented")
    found = smooth(history, affine_ways(of, history))
    expected = least_squares(of, STEPS)
    np.testing.assert_allclose(found.mean, expected.mean, rtol=1e-8, atol=1e-9)
    np.testing.assert_allclose(found.cov, expected.cov, rtol=1e-8, atol=1e-9)


def affine_ways(of: Linear, history: Gaussian) -> list[Backward]:
    nothing = np.zeros_like(of.Q)
    return [
        backward_affine(Gaussian(mean, cov), Affine(of.F @ mean, of.F, nothing), of.Q)
        for mean, cov in zip(history.mean[:-1], history.cov[:-1], strict=True)
    ]


def test_a_state_that_is_known_at_the_start_is_the_limit_of_a_small_variance():
    """The points of the unscented form need a factor of the covariance, which a zero has not."""
    of = system(1)
    known, nearly = (
        of._replace(prior=Gaussian(of.prior.mean, np.diag([variance, 1.0, 2.0])))
        for variance in (0.0, 1e-10)
    )
    exact, unscented = (filtered_by_hand(one) for one in (known, nearly))
    found = smooth(exact, affine_ways(known, exact))
    expected = least_squares(nearly, STEPS)
    np.testing.assert_allclose(found.mean, expected.mean, atol=1e-6)
    np.testing.assert_allclose(found.cov, expected.cov, atol=1e-6)
    assert np.isnan(
        backward(
            Gaussian(exact.mean[0], known.prior.cov), lambda x: x, of.Q, rules(3)["cubature"]
        ).predicted.cov
    ).all()
    np.testing.assert_allclose(unscented.mean, exact.mean, atol=1e-6)


def filtered_by_hand(of: Linear) -> Gaussian:
    """The Kalman filter's history."""
    belief, history = of.prior, []
    for step, reading in enumerate(of.readings):
        if step > 0:
            belief = kalman.predict(belief, of.F, of.Q)
        belief = kalman.update(belief, reading, of.H, of.R).belief
        history.append(belief)
    return Gaussian(*(np.stack(values) for values in zip(*history, strict=True)))


@pytest.mark.parametrize("seed", range(3))
def test_each_lag_is_least_squares_over_the_readings_until_then(seed: int):
    of, most = system(seed), STEPS + 2
    found = smooth_with_lags(*filtered(of, "unscented"), most)
    assert found.mean.shape == (most + 1, STEPS, 3)
    for lag, step in np.ndindex(most + 1, STEPS):
        if step < lag:
            assert np.isnan(found.mean[lag, step]).all() and np.isnan(found.cov[lag, step]).all()
            continue
        expected = least_squares(of, step + 1)
        np.testing.assert_allclose(found.mean[lag, step], expected.mean[step - lag], atol=1e-8)
        np.testing.assert_allclose(found.cov[lag, step], expected.cov[step - lag], atol=1e-8)


def test_a_history_of_one_step_is_its_own_past():
    belief = random_belief(np.random.default_rng(0), (1, 2), 3)
    for found in (smooth(belief, []), smooth_with_lags(belief, [], 0)):
        np.testing.assert_array_equal(found.mean.reshape(belief.mean.shape), belief.mean)


@given(st.integers(0, 10**6))
def test_later_readings_never_take_knowledge_away(seed: int):
    """The covariance shrinks, in every direction, and stays positive definite."""
    history, ways = filtered(system(seed), "unscented")
    cov = smooth(history, ways).cov
    scale = np.linalg.eigvalsh(history.cov)[:, -1:]
    assert (np.linalg.eigvalsh(history.cov - cov) > -1e-9 * scale).all()
    assert (np.linalg.eigvalsh(cov) > 0).all()
    np.testing.assert_array_equal(cov[-1], history.cov[-1])


def test_a_lane_is_smoothed_as_if_it_were_alone_and_fails_alone():
    draw, rule = np.random.default_rng(1), rules(5)["unscented"]
    belief = random_belief(draw, (3, 2), 5)
    belief.cov[1, 1] = -np.eye(5)
    noise_cov = random_spd(draw, (), 5)
    ahead = ukf.predict(belief, turn, noise_cov, rule)
    way = backward(belief, turn, noise_cov, rule)
    history = Gaussian(*(np.stack(pair) for pair in zip(belief, ahead, strict=True)))
    together = smooth(history, [way])
    np.testing.assert_array_equal(way.predicted.mean, ahead.mean)
    for lane in np.ndindex(3, 2):
        one = Gaussian(belief.mean[lane], belief.cov[lane])
        alone = Gaussian(*(part[(slice(None), *lane)] for part in history))
        found = smooth(alone, [backward(one, turn, noise_cov, rule)])
        np.testing.assert_allclose(together.mean[(0, *lane)], found.mean[0], rtol=1e-12)
        assert np.isnan(found.cov[0]).any() == (lane == (1, 1))
