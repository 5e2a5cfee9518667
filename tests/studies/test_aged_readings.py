"""Error covariances with late readings, against the joint law of all states and readings."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import solve_discrete_are

from concord.studies.exact.aged_readings import aged_cov, steady_cov
from concord.studies.exact.averaged_errors import LinearNetwork


def drawn(seed: int, sensors: int = 3, n: int = 2) -> tuple[LinearNetwork, np.ndarray]:
    """A stable plant and rows (sensors, n) of sensors with unit noise."""
    draws = np.random.default_rng(seed)
    transition = draws.normal(size=(n, n))
    transition *= 0.95 / np.abs(np.linalg.eigvals(transition)).max()
    root = draws.normal(size=(n, n))
    rows = draws.normal(size=(sensors, n))
    information = np.einsum("ki,kj->kij", rows, rows)
    noise_cov = root @ root.T + 0.1 * np.eye(n)
    return LinearNetwork(transition, noise_cov, information, np.eye(n)), rows


@settings(max_examples=20)
@given(st.integers(0, 10**6))
def test_the_steady_covariance_solves_the_riccati_equation(seed: int):
    network, rows = drawn(seed)
    prior = solve_discrete_are(network.transition_matrix.T, rows.T, network.noise_cov, np.eye(3))
    posterior = np.linalg.inv(np.linalg.inv(prior) + rows.T @ rows)
    assert np.allclose(steady_cov(network), posterior, rtol=1e-8)


@settings(max_examples=20)
@given(
    seed=st.integers(0, 10**6),
    ages=st.lists(st.integers(0, 4), min_size=3, max_size=3),
)
def test_late_readings_against_the_joint_law(seed: int, ages: list[int]):
    """Condition the last of many states on all readings that have come, at once."""
    network, rows = drawn(seed)
    F, steps, n = network.transition_matrix, 60, 2
    joint = np.zeros((n * steps, n * steps))
    cov = np.eye(n)
    for k in range(steps):
        at = slice(n * k, n * k + n)
        joint[at, at] = cov
        for later in range(k + 1, steps):
            ahead = np.linalg.matrix_power(F, later - k) @ cov
            joint[n * later : n * later + n, at] = ahead
            joint[at, n * later : n * later + n] = ahead.T
        cov = F @ cov @ F.T + network.noise_cov
    seen = [(k, i) for i, age in enumerate(ages) for k in range(steps - age)]
    H = np.zeros((len(seen), n * steps))
    for line, (k, i) in enumerate(seen):
        H[line, n * k : n * k + n] = rows[i]
    cross = joint @ H.T
    last = slice(n * (steps - 1), n * steps)
    gain = np.linalg.solve(H @ cross + np.eye(len(seen)), cross[last].T).T
    wanted = joint[last, last] - gain @ cross[last].T
    found = aged_cov(network, steady_cov(network), np.array(ages))
    assert np.allclose(found, wanted, rtol=1e-5, atol=1e-9)


def test_lanes_are_those_of_single_calls_and_error_grows_with_age():
    network, _ = drawn(4)
    steady = steady_cov(network)
    ages = np.array([[0, 0, 0], [1, 0, 3], [2, 2, 3]])
    lanes = aged_cov(network, steady, ages)
    for lane, each in zip(lanes, ages, strict=True):
        assert np.allclose(lane, aged_cov(network, steady, each), rtol=1e-10)
    assert np.allclose(lanes[0], steady, rtol=1e-10)
    growth = np.linalg.eigvalsh(np.diff(lanes, axis=0))
    assert growth.min() > -1e-9


def test_a_plant_that_no_sensor_sees_is_refused():
    unseen = LinearNetwork(
        np.diag([1.2, 0.5]), np.eye(2), np.array([np.diag([0.0, 1.0])]), np.eye(2)
    )
    with pytest.raises(ValueError, match="does not settle"):
        steady_cov(unseen)
