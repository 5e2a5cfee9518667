"""The oscillator: exact discretisation, stationary law, and sensors that are dealt in turn."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm

from concord.plants.oscillator import POSITION, VELOCITY, Oscillation, Oscillator, Output
from tests.plants.test_targets import assert_covariance


@given(
    frequency=st.floats(0.1, 5),
    ratio=st.floats(0.01, 0.98),
    std=st.floats(0.1, 10),
    dt=st.floats(0.02, 3),
)
@settings(deadline=None)
def test_the_discretisation_is_exact(frequency, ratio, std, dt):
    """Against a matrix exponential of motion and noise together (Van Loan 1978)."""
    damping = 2 * ratio * frequency
    model = Oscillation(dt, frequency, damping, std)
    drift = np.array([[0, 1], [-(frequency**2), -damping]])
    density = np.diag([0, 2 * damping * std**2])
    transition = expm(drift * dt)
    np.testing.assert_allclose(model.transition_matrix, transition, rtol=1e-9, atol=1e-12)
    # The integral of exp(A t) L L' exp(A' t), by quadrature: no inverse, no difference.
    nodes, weights = np.polynomial.legendre.leggauss(60)
    times = (nodes + 1) * dt / 2
    integrand = [expm(drift * t) @ density @ expm(drift * t).T for t in times]
    noise = np.tensordot(weights * dt / 2, integrand, axes=1)
    np.testing.assert_allclose(model.process_noise_cov(0), noise, rtol=1e-5, atol=1e-10 * std**2)


def streams(purpose, node):
    number = ("initial", "process", "measurement").index(purpose)
    return np.random.default_rng([number, node])


def test_nodes_see_position_velocity_position_nothing_in_turn():
    plant = Oscillator(nodes=8)
    delivered = plant.observe(np.array([3.0, -7.0]), np.zeros((8, 1, 1)), 0)
    nan = math.nan
    np.testing.assert_array_equal(delivered[:, 0, 0], [3, -7, 3, nan, 3, -7, 3, nan])


def test_outputs_are_dealt_as_asked():
    plant = Oscillator(nodes=3, outputs=(None, Output((2.0, 1.0), 0.1)))
    noise = np.full((3, 1, 1), 10.0)
    delivered = plant.observe(np.array([3.0, -7.0]), noise, 0)
    np.testing.assert_allclose(delivered[:, 0, 0], [math.nan, -1.0 + 10 * 0.1, math.nan])
    value, noise_cov = plant.sensors.interpret(delivered[:, 0])
    np.testing.assert_array_equal(value, delivered[:, 0])
    assert noise_cov.shape == (3, 1, 1) and np.isfinite(noise_cov).all()
    assert noise_cov[1, 0, 0] == pytest.approx(0.01)


@pytest.mark.parametrize("batch", [(), (6,), (5, 2)])
def test_all_nodes_at_once_are_each_node_alone(batch):
    plant = Oscillator(nodes=4)
    state = np.random.default_rng(1).normal(size=(*batch, 4, 2))
    everyone = plant.sensors.measure(state, 0)
    _, noise_cov = plant.sensors.interpret(everyone)
    assert everyone.shape == (*batch, 4, 1) and noise_cov.shape == (*batch, 4, 1, 1)
    for node in range(4):
        alone = plant.sensor(node)
        value = alone.measure(state[..., node, :], 0)
        np.testing.assert_array_equal(everyone[..., node, :], value)
        np.testing.assert_array_equal(noise_cov[..., node, :, :], alone.interpret(value)[1])
        assert (alone.residual(value, value) == 0).all()


def test_draws_belong_to_their_node():
    few, many = Oscillator(nodes=3).draw(streams, 5), Oscillator(nodes=8).draw(streams, 9)
    assert many.measurement.shape == (9, 8, 1, 1)
    np.testing.assert_array_equal(few.measurement, many.measurement[:5, :3])
    np.testing.assert_array_equal(few.process, many.process[:5])


def test_the_truth_moves_with_the_noise_of_the_model():
    plant, rng = Oscillator(), np.random.default_rng(5)
    start = np.tile([2.0, -1.0], (4000, 1))
    after = plant.advance(start, None, rng.standard_normal((4000, 2)), 0)
    assert_covariance(
        after - plant.model.transition(start, None, 0), plant.model.process_noise_cov(0)
    )


def test_the_truth_keeps_its_stationary_law():
    plant, rng = Oscillator(), np.random.default_rng(2)
    state, mean, cov = plant.initial(rng.standard_normal((4000, 2)))
    assert not mean.any()
    np.testing.assert_allclose(cov, np.eye(2))
    for step in range(40):
        assert_covariance(state, cov)
        state = plant.advance(state, None, rng.standard_normal((4000, 2)), step)


@pytest.mark.parametrize("batch", [(), (6,), (3, 4)])
def test_a_model_keeps_lanes_and_layout(batch):
    model = Oscillation()
    state = np.moveaxis(np.random.default_rng(4).normal(size=(2, *batch)), 0, -1)
    after = model.transition(state, None, 0)
    assert after.strides == state.strides
    np.testing.assert_allclose(after, state @ model.transition_matrix.T, atol=1e-15)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: Oscillator(nodes=0), "0 nodes and 4 outputs: give at least one"),
        (lambda: Oscillator(outputs=()), "8 nodes and 0 outputs"),
        (lambda: Oscillator(outputs=(VELOCITY._replace(noise_std=0.0),)), "noise_std is 0.0"),
        (lambda: Oscillator(outputs=(POSITION._replace(noise_std=math.nan),)), "noise_std is nan"),
        (lambda: Oscillation(damping_1_s=2.0), "damping_1_s is 2, .*lower the damping"),
        (lambda: Oscillation(frequency_rad_s=0.0), "frequency_rad_s is 0.0"),
        (lambda: Oscillation(velocity_std_m_s=0.0), "velocity_std_m_s is 0.0"),
    ],
)
def test_impossible_oscillators_are_refused(call, message):
    with pytest.raises(ValueError, match=message):
        call()
