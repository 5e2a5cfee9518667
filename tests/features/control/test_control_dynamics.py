"""The paper's plants against their own equations, written a second time and differently."""

import numpy as np
import pytest
from scipy.integrate import quad_vec, solve_ivp
from scipy.linalg import expm

from concord.features.control import cruise, motor, pitch, suspension
from concord.features.control.continuous import ContinuousPlant, van_loan, zero_order_hold
from concord.features.control.design import controllability_rank, observability_rank
from concord.features.control.transfer_functions import Rational

PLANTS = [
    pytest.param(cruise.dynamics(), cruise.transfer_function(), id="cruise"),
    pytest.param(suspension.dynamics(), suspension.transfer_functions()[0], id="suspension"),
    pytest.param(pitch.dynamics(), pitch.transfer_function(), id="pitch"),
    pytest.param(motor.speed_dynamics(), motor.speed_transfer_function(), id="speed"),
    pytest.param(motor.position_dynamics(), motor.position_transfer_function(), id="position"),
]
DYNAMICS = [pytest.param(parameter.values[0], id=parameter.id) for parameter in PLANTS]


def response(plant: ContinuousPlant, inputs: np.ndarray, s: complex) -> complex:
    n = len(plant.state_matrix)
    return (plant.output_row @ np.linalg.solve(s * np.eye(n) - plant.state_matrix, inputs))[0, 0]


def points(count: int = 40) -> np.ndarray:
    generator = np.random.default_rng(3)
    return generator.uniform(0.05, 60, count) + 1j * generator.uniform(-60, 60, count)


@pytest.mark.parametrize(("plant", "printed"), PLANTS)
def test_transfer_function_equals_the_state_space(plant: ContinuousPlant, printed: Rational):
    for s in points():
        assert response(plant, plant.control_matrix, s) == pytest.approx(printed(s), rel=1e-10)


def test_transfer_functions_have_the_printed_coefficients():
    assert pitch.transfer_function().numerator == pytest.approx((1.15101, 0.17742), abs=5e-6)
    assert pitch.transfer_function().denominator == pytest.approx((1, 0.739, 0.92147, 0), abs=5e-6)
    speed = np.array(motor.speed_transfer_function().denominator)
    assert speed / speed[0] == pytest.approx([1, 12, 20.02])
    assert motor.speed_transfer_function().numerator[0] / speed[0] == pytest.approx(2)
    det = np.array(suspension.transfer_functions()[0].denominator)
    assert det / det[0] == pytest.approx([1, 48.17, 1851, 1721, 5e4], rel=3e-4)


def test_eigenvalues_are_the_printed_ones():
    assert np.sort_complex(np.linalg.eigvals(suspension.dynamics().state_matrix)) == pytest.approx(
        np.array([-23.98 - 35.19j, -23.98 + 35.19j, -0.11 - 5.25j, -0.11 + 5.25j]), abs=6e-3
    )
    assert np.sort_complex(np.linalg.eigvals(pitch.dynamics().state_matrix)) == pytest.approx(
        np.array([-0.3695 - 0.886j, -0.3695 + 0.886j, 0]), abs=5e-4
    )


def newton() -> tuple[np.ndarray, np.ndarray]:
    """(4) in the states x1, dx1/dt, x2 and w = dx2/dt - (b2/M2) gamma; inputs u and gamma."""
    m1, m2, k1, k2, b1, b2 = (
        getattr(suspension, name) for name in ("M1", "M2", "K1", "K2", "B1", "B2")
    )
    wheel_speed = np.array([0, 0, 0, 1, 0, b2 / m2])
    x1, v1, x2, _, u, gamma = np.eye(6)
    between = b1 * (v1 - wheel_speed) + k1 * (x1 - x2)
    rates = [
        v1,
        (u - between) / m1,
        wheel_speed,
        (between - b2 * wheel_speed + k2 * (gamma - x2) - u) / m2,
    ]
    return np.array(rates)[:, :4], np.array(rates)[:, 4:]


def test_bus_matrix_9_is_newtons_law_4():
    plant = suspension.dynamics()
    state, inputs = newton()
    travel = np.array([[1.0, 0, -1, 0]])
    printed = suspension.transfer_functions()
    ours = (plant.control_matrix, plant.disturbance_matrix)
    for s in points():
        resolvent = travel @ np.linalg.inv(s * np.eye(4) - state) @ inputs
        for column in (0, 1):
            assert response(plant, ours[column], s) == pytest.approx(resolvent[0, column], rel=1e-9)
            assert printed[column](s) == pytest.approx(resolvent[0, column], rel=1e-9)


def test_bus_fourth_state_is_not_the_derivative_of_the_travel():
    # Both descriptions on a smooth road; dy1/dt comes from Newton's states, y2 from (9).
    plant = suspension.dynamics()
    state, inputs = newton()

    def road(t: float) -> float:
        return 0.05 * (1 - np.cos(5 * t))

    span, options = (0.0, 1.3), {"rtol": 1e-10, "atol": 1e-12, "method": "Radau"}
    physical = solve_ivp(
        lambda t, x: state @ x + inputs[:, 1] * road(t), span, np.zeros(4), **options
    ).y[:, -1]
    ours = solve_ivp(
        lambda t, x: plant.state_matrix @ x + plant.disturbance_matrix[:, 0] * road(t),
        span,
        np.zeros(4),
        **options,
    ).y[:, -1]
    x1, v1, x2, w = physical
    damping = suspension.B2 / suspension.M2
    derivative = v1 - (w + damping * road(span[1]))
    expected = derivative - damping * x1 + suspension.DAMPING_SUM * (x1 - x2)
    assert ours[:3] == pytest.approx([x1, v1, x1 - x2], rel=1e-6)
    assert ours[3] == pytest.approx(expected + damping * road(span[1]), rel=1e-6)
    assert abs(ours[3] - derivative) > 0.2 * abs(derivative)


@pytest.mark.parametrize("plant", DYNAMICS)
def test_held_input_equals_integrating_the_equation(plant: ContinuousPlant):
    time_step_s = 0.01
    transition, control_matrix = plant.sampled(time_step_s)
    state = np.random.default_rng(0).standard_normal(len(transition))
    exact = solve_ivp(
        lambda t, x: plant.state_matrix @ x + plant.control_matrix[:, 0] * 0.7,
        (0, time_step_s),
        state,
        rtol=1e-11,
        atol=1e-13,
    ).y[:, -1]
    assert transition @ state + control_matrix[:, 0] * 0.7 == pytest.approx(exact, rel=1e-8)


def test_cruise_sampled_matrices_are_the_printed_ones():
    transition, control_matrix = cruise.dynamics().sampled(0.01)
    assert transition == pytest.approx(np.array([[0.9995001]]), abs=5e-8)
    assert control_matrix == pytest.approx(np.array([[9.9975e-6]]), abs=5e-11)


@pytest.mark.parametrize("plant", DYNAMICS)
def test_van_loan_is_the_integral(plant: ContinuousPlant):
    n = len(plant.state_matrix)
    half = np.random.default_rng(1).standard_normal((n, n))
    density = half @ half.T

    def integrand(s: float) -> np.ndarray:
        return expm(plant.state_matrix * s) @ density @ expm(plant.state_matrix * s).T

    integral, _ = quad_vec(integrand, 0, 0.01, epsrel=1e-10)
    assert van_loan(plant.state_matrix, density, 0.01) == pytest.approx(integral, rel=1e-7)


@pytest.mark.parametrize("time_step_s", [0.0, -0.01, np.nan])
def test_time_step_must_be_positive(time_step_s: float):
    with pytest.raises(ValueError, match=r"time step .* must be positive"):
        zero_order_hold(np.eye(1), np.eye(1), time_step_s)


def hautus_observable(state_matrix: np.ndarray, row: np.ndarray) -> bool:
    """No eigenvector is invisible: a second test of observability, in balanced coordinates."""
    _, vectors = np.linalg.eig(state_matrix)
    scale = np.linalg.norm(row)
    return bool(np.all(np.abs(row @ vectors) > 1e-9 * scale))


@pytest.mark.parametrize("plant", DYNAMICS)
def test_controllable_and_observable_from_the_controlled_output(plant: ContinuousPlant):
    n = len(plant.state_matrix)
    assert controllability_rank(plant.state_matrix, plant.control_matrix) == n
    assert observability_rank(plant.state_matrix, plant.output_row) == n
    assert hautus_observable(plant.state_matrix, plant.output_row)


@pytest.mark.parametrize(
    ("plant", "ranks"),
    [
        pytest.param(pitch.dynamics(), (2, 2, 3), id="pitch: not from alpha, not from q"),
        pytest.param(motor.position_dynamics(), (3, 2, 2), id="position: from position only"),
        pytest.param(motor.speed_dynamics(), (2, 2), id="speed: from either"),
        pytest.param(suspension.dynamics(), (4, 4, 4, 4), id="bus: from any state"),
    ],
)
def test_rank_of_each_single_state(plant: ContinuousPlant, ranks: tuple[int, ...]):
    for row, rank in zip(np.eye(len(ranks)), ranks, strict=True):
        assert observability_rank(plant.state_matrix, row[None]) == rank
        assert hautus_observable(plant.state_matrix, row) == (rank == len(ranks))
