"""The single-track model against forces as complex numbers, and against steady cornering."""

import numpy as np
import pytest
from msgspec.structs import replace

from concord.features.vehicle.plant.model import (
    Axles,
    SingleTrack,
    axles_of,
    linear_tyre,
    single_track,
    tanh_tyre,
)
from concord.features.vehicle.plant.parameters import BMW_320I
from concord.papers.adlukf.study import small_angles

CAR = BMW_320I
MODEL = single_track(CAR, linear_tyre, 0.01, np.eye(3))
SATURATING = single_track(CAR, tanh_tyre, 0.01, np.eye(3))


def planar(car, tyre, state, control):
    """Derivatives of the state and a_y, from forces and velocities as complex numbers.

    The driven axle adds the force along its wheels that the logged acceleration asks for.
    """
    yaw_rate, side_slip, speed = state
    steering, ahead = control
    velocity = complex(speed, speed * np.tan(side_slip))
    axles, forces = axles_of(car), []
    for arm, angle, stiffness, limit in (
        (car.front_axle_m, steering, axles.front_stiffness, axles.front_limit),
        (-car.rear_axle_m, 0.0, axles.rear_stiffness, axles.rear_limit),
    ):
        hub = velocity + 1j * yaw_rate * arm
        slip = np.angle(hub * np.exp(-1j * angle))
        forces.append((arm, 1j * tyre(slip, stiffness, limit) * np.exp(1j * angle)))
    missing = car.mass_kg * ahead - sum(force.real for _, force in forces)
    arm, angle = (
        (car.front_axle_m, steering) if car.driven_axle == "front" else (-car.rear_axle_m, 0.0)
    )
    forces.append((arm, missing / np.cos(angle) * np.exp(1j * angle)))
    felt = sum(force for _, force in forces) / car.mass_kg
    assert felt.real == pytest.approx(ahead)
    changing = felt - 1j * yaw_rate * velocity
    turning = sum(arm * force.imag for arm, force in forces) / car.yaw_inertia_kg_m2
    return np.array([turning, (changing / velocity).imag, changing.real]), felt.imag


@pytest.mark.parametrize("driven", ["front", "rear"])
@pytest.mark.parametrize("seed", range(5))
def test_it_is_newton_in_the_plane(driven, seed):
    """Road wheels at up to 40 degrees, side slip of up to 30, and a drive or brake force."""
    car = replace(CAR, driven_axle=driven)
    generator = np.random.default_rng(seed)
    state = np.array([*generator.uniform(-0.5, 0.5, 2), generator.uniform(2.0, 25.0)])
    control = np.array([generator.uniform(-0.7, 0.7), generator.uniform(-4.0, 4.0)])
    for tyre in (linear_tyre, tanh_tyre):
        model = single_track(car, tyre, 0.01)
        derivative, lateral = planar(car, tyre, state, control)
        moved = model.transition(state, control, 0)
        np.testing.assert_allclose(moved, state + 0.01 * derivative, rtol=1e-10)
        expected = [lateral, state[0], state[2]]
        np.testing.assert_allclose(model.measure(state, control), expected, rtol=1e-10)


def test_small_angles_leave_an_error_of_the_third_order():
    """Without acceleration ahead: a tenth of the angles, a thousandth of the difference."""
    paper = small_angles(CAR, linear_tyre, 0.01)
    state, control = np.array([0.3, 0.1, 20.0]), np.array([0.2, 0.0])
    far, near = (
        MODEL.accelerations(size * state + small, size * control)[0]
        - paper.accelerations(size * state + small, size * control)[0]
        for size, small in ((1.0, 0.0), (0.1, np.array([0.0, 0.0, 18.0])))
    )
    assert abs(far) > 0.1
    assert near == pytest.approx(far / 1000, rel=0.1)


def test_steady_cornering_is_ackermann_with_the_understeer_gradient():
    """omega = v delta / (L + K v^2), K = m (b C_r - a C_f) / (L C_f C_r)."""
    v, delta = 18.0, 1e-4
    front, rear = CAR.front_stiffness_n_rad, CAR.rear_stiffness_n_rad
    understeer = CAR.mass_kg * (CAR.rear_axle_m * rear - CAR.front_axle_m * front)
    understeer /= CAR.wheelbase_m * front * rear
    state = np.array([0.0, 0.0, v])
    for _ in range(2000):
        state = MODEL.transition(state, np.array([delta, 0.0]), 0)
        state[2] = v
    assert state[0] == pytest.approx(v * delta / (CAR.wheelbase_m + understeer * v**2), rel=1e-6)


def test_small_slips_feel_the_same_stiffness_and_large_ones_the_friction():
    slip = np.array([1e-5, 10.0, -10.0])
    force = tanh_tyre(slip, 1e5, 4e3)
    np.testing.assert_allclose(force[0], linear_tyre(slip[:1], 1e5, 4e3)[0], rtol=1e-6)
    np.testing.assert_allclose(force[1:], [-4e3, 4e3])


def test_no_friction_is_exceeded_whatever_the_steering():
    state = np.array([0.2, -0.1, 25.0])
    for delta in (-1.0, 1.0):
        limit = CAR.friction * 9.81
        assert abs(SATURATING.measure(state, np.array([delta, 0.0]))[0]) <= limit * (1 + 1e-12)


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
