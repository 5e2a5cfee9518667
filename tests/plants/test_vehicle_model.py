"""The single-track model against its equations in coefficients, and against steady cornering."""

import numpy as np
import pytest

from concord.plants.vehicle.model import (
    Axles,
    SingleTrack,
    axles_of,
    linear_tyre,
    single_track,
    tanh_tyre,
)
from concord.plants.vehicle.parameters import BMW_320I

CAR = BMW_320I
MODEL = single_track(CAR, linear_tyre, 0.01, np.eye(3))
SATURATING = single_track(CAR, tanh_tyre, 0.01, np.eye(3))


def coefficients(state, control):
    """Derivatives and a_y as the literature writes them, k1, k2 < 0: equation 1 of the docs."""
    omega, beta, vx = state
    delta, ax = control
    k1, k2 = -CAR.front_stiffness_n_rad, -CAR.rear_stiffness_n_rad
    a, b, m, inertia = CAR.front_axle_m, CAR.rear_axle_m, CAR.mass_kg, CAR.yaw_inertia_kg_m2
    domega = (
        (a**2 * k1 + b**2 * k2) / (inertia * vx) * omega
        + (a * k1 - b * k2) / inertia * beta
        - a * k1 / inertia * delta
    )
    dbeta = (
        ((a * k1 - b * k2) / (m * vx**2) - 1) * omega
        + (k1 + k2) / (m * vx) * beta
        - k1 / (m * vx) * delta
    )
    ay = (a * k1 - b * k2) / (m * vx) * omega + (k1 + k2) / m * beta - k1 / m * delta
    return np.array([domega, dbeta, omega * beta * vx + ax]), ay


@pytest.mark.parametrize("seed", range(5))
def test_it_is_the_equation_in_coefficients(seed):
    generator = np.random.default_rng(seed)
    state = np.array([0.3, 0.05, 20.0]) * generator.uniform(0.5, 1.5, 3)
    control = generator.normal(0, [0.05, 1.0])
    derivative, ay = coefficients(state, control)
    moved = MODEL.transition(state, control, 0)
    np.testing.assert_allclose(moved, state + 0.01 * derivative, rtol=1e-12)
    np.testing.assert_allclose(MODEL.measure(state, control), [ay, state[0], state[2]], rtol=1e-12)


def test_steady_cornering_is_ackermann_with_the_understeer_gradient():
    """omega = v delta / (L + K v^2), K = m (b C_r - a C_f) / (L C_f C_r)."""
    v, delta = 18.0, 0.02
    front, rear = CAR.front_stiffness_n_rad, CAR.rear_stiffness_n_rad
    understeer = CAR.mass_kg * (CAR.rear_axle_m * rear - CAR.front_axle_m * front)
    understeer /= CAR.wheelbase_m * front * rear
    state = np.array([0.0, 0.0, v])
    for _ in range(2000):
        state = MODEL.transition(state, np.array([delta, 0.0]), 0)
        state[2] = v
    assert state[0] == pytest.approx(v * delta / (CAR.wheelbase_m + understeer * v**2), rel=1e-9)


def test_small_slips_feel_the_same_stiffness_and_large_ones_the_friction():
    slip = np.array([1e-5, 10.0, -10.0])
    force = tanh_tyre(slip, 1e5, 4e3)
    np.testing.assert_allclose(force[0], linear_tyre(slip[:1], 1e5, 4e3)[0], rtol=1e-6)
    np.testing.assert_allclose(force[1:], [-4e3, 4e3])


def test_no_friction_is_exceeded_whatever_the_steering():
    state = np.array([0.2, -0.1, 25.0])
    for delta in (-1.0, 1.0):
        limit = CAR.friction * 9.81
        assert abs(SATURATING.lateral_acceleration(state, np.array(delta))) <= limit * (1 + 1e-12)


def test_leading_axes_and_candidates_are_lanes():
    generator = np.random.default_rng(1)
    states = np.array([0.2, 0.02, 20.0]) + generator.normal(0, 0.01, (7, 4, 3))
    controls = generator.normal(0, [0.05, 0.5], (4, 2))
    together = MODEL.transition(states, controls, 0)
    assert together.shape == (7, 4, 3)
    for point, lane in np.ndindex(7, 4):
        np.testing.assert_array_equal(
            together[point, lane], MODEL.transition(states[point, lane], controls[lane], 0)
        )
    candidates = Axles(*(np.array([1.0, 1.3]) * value for value in axles_of(CAR)))
    both = SingleTrack(CAR, candidates, tanh_tyre, 0.01, np.eye(3))
    first = both.transition(np.stack([states[0, 0]] * 2), controls[0], 0)
    np.testing.assert_array_equal(first[0], SATURATING.transition(states[0, 0], controls[0], 0))
    assert (first[1, :2] != first[0, :2]).all()


def test_a_car_that_stands_is_finite():
    assert np.isfinite(MODEL.transition(np.zeros(3), np.array([0.1, 0.0]), 0)).all()


def test_a_step_that_does_not_go_on_is_refused():
    with pytest.raises(ValueError, match="positive"):
        single_track(CAR, linear_tyre, 0.0, np.eye(3))
