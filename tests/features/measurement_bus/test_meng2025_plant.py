"""The example of Meng et al. (2025) and systems with stochastic nonlinearities in general."""

import numpy as np
import pytest

from concord.features.measurement_bus import meng2025_plant as meng2025
from concord.features.measurement_bus.sensed import SensedPlant, clusters, sensors_on_a_bus
from concord.features.measurement_bus.stochastic import (
    StochasticNonlinearity,
    StochasticSystem,
    Term,
)

U_2 = 0.01 * np.array(
    [
        [9, 6, 3, 3, 6, 9],
        [6, 4, 2, 2, 4, 6],
        [3, 2, 1, 1, 2, 3],
        [3, 2, 1, 1, 2, 3],
        [6, 4, 2, 2, 4, 6],
        [9, 6, 3, 3, 6, 9],
    ]
)


def streams(purpose: str, node: int) -> np.random.Generator:
    return np.random.default_rng([sum(purpose.encode()), node])


def random_nonlinearity(seed: int) -> StochasticNonlinearity:
    """Three terms of different shapes, for 3 components of a function of 2 states."""
    generator = np.random.default_rng(seed)
    shapes = [(1, 2), (2, 1), (3, 3)]
    terms = tuple(
        Term(generator.standard_normal((3, p)), generator.standard_normal((q, 2)))
        for p, q in shapes
    )
    return StochasticNonlinearity(3, 2, terms)


# --- the example ---------------------------------------------------------------------------------


def test_f_at_times_worked_out_by_hand():
    x = np.array([2.0, -1.0])
    for step, cosine, sine in ((0, 1.0, 0.0), (3, -0.9899924966, 0.1411200081)):
        expected = [
            0.58 * 2 + 0.3 * cosine * 2 - 0.39,
            0.28 * 2 + 0.2 * sine * 2 - 0.52,
        ]
        np.testing.assert_allclose(meng2025.transition(x, None, step), expected, atol=1e-9)


def test_h_at_times_worked_out_by_hand():
    x = np.array([2.0, -1.0])
    for step, cosine, sine in ((0, 1.0, 0.0), (3, -0.9899924966, 0.1411200081)):
        expected = [
            0.72 + 1,
            -2 - 0.16,
            1.6 * cosine - 0.36,
            1 - 2,
            1.4 * cosine - 0.8,
            0.6 - 0.8 * sine,
        ]
        np.testing.assert_allclose(meng2025.measure(x, step), expected, atol=1e-9)


def test_second_moments_are_those_printed():
    process, sensing = meng2025.SYSTEM.process_moment(7), meng2025.SYSTEM.measurement_moment(7)
    np.testing.assert_allclose(process.pi, [[[0.09, 0.06], [0.06, 0.04]]], atol=1e-15)
    np.testing.assert_allclose(sensing.pi, U_2[None], atol=1e-15)
    for moment in (process, sensing):
        np.testing.assert_allclose(moment.gamma, [np.diag([0.04, 0.09])], atol=1e-15)


def test_g_is_the_printed_product():
    x, eta = np.array([2.0, -1.0]), np.array([0.7, 0.4])
    expected = np.array([0.3, 0.2]) * (0.2 * 2.0 * 0.7 + 0.3 * -1.0 * 0.4)
    np.testing.assert_allclose(meng2025.SYSTEM.process(0).value(x, eta), expected)


def test_noise_covariances_of_the_example():
    np.testing.assert_array_equal(meng2025.SYSTEM.process_noise_cov(3), 0.05 * np.eye(2))
    np.testing.assert_array_equal(meng2025.SYSTEM.measurement_noise_cov(3), 0.01 * np.eye(6))


# --- stochastic nonlinearities -------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(3))
def test_samples_have_the_second_moment(seed: int):
    nonlinearity = random_nonlinearity(seed)
    generator = np.random.default_rng(100 + seed)
    x, samples = generator.standard_normal(2), 200_000
    values = nonlinearity.value(x, generator.standard_normal((samples, nonlinearity.numbers)))
    moment = nonlinearity.second_moment
    expected = sum(pi * (x @ gamma @ x) for pi, gamma in zip(*moment, strict=True))
    measured = values.T @ values / samples
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    # A product of two normals has a standard deviation of at most sqrt 2 in these units.
    assert (np.abs(measured - expected) < 5 * np.sqrt(2 / samples) * scale).all()
    assert (np.abs(values.mean(axis=0)) < 5 * np.sqrt(np.diag(expected) / samples)).all()


def test_terms_that_do_not_fit_are_refused():
    with pytest.raises(ValueError, match=r"term 0 .* must have A \(3, p\) and B \(q, 2\)"):
        StochasticNonlinearity(3, 2, (Term(np.ones((2, 1)), np.ones((1, 2))),))


def varying_system() -> StochasticSystem:
    """Everything varies with time, sensors measure vectors, and a control drives it."""
    return StochasticSystem(
        transition=lambda x, u, s: (0.5 + 0.1 * s) * x + (0.0 if u is None else u),
        measure=lambda x, s: np.concatenate([x, s * x[..., :1]], axis=-1),
        sizes=(2, 1),
        process_noise_cov=lambda s: (1.0 + s) * np.array([[2.0, 0.5], [0.5, 1.0]]),
        measurement_noise_cov=lambda s: (1.0 + s) * np.diag([1.0, 4.0, 9.0]),
        process=lambda s: StochasticNonlinearity(2, 2, (Term(s * np.eye(2), np.eye(2)),)),
        measurement=lambda s: StochasticNonlinearity(3, 2),
    )


def test_a_system_that_varies_with_time():
    system, x = varying_system(), np.array([1.0, 2.0])
    quiet = system.advance(x, np.array([3.0, 0.0]), np.zeros(6), 2)
    np.testing.assert_allclose(quiet, [0.7 + 3.0, 1.4])
    np.testing.assert_array_equal(system.process_moment(2).pi, [4 * np.eye(2)])
    assert system.measurement_moment(2).pi.shape == (0, 3, 3)
    noise = np.random.default_rng(3).standard_normal((100_000, 3))
    spread = np.cov((system.observe(x, noise, 3) - system.measure(x, 3)).T)
    np.testing.assert_allclose(spread, 4 * np.diag([1.0, 4.0, 9.0]), atol=0.5)


# --- as a plant ----------------------------------------------------------------------------------


def placed(placement) -> SensedPlant:
    system = varying_system()
    return SensedPlant(system, np.zeros(2), np.eye(2), ("a", "b"), ("1", "1"), placement)


def test_each_node_reads_its_sensor_and_the_receiver_nothing():
    plant = placed(sensors_on_a_bus(2))
    draws = plant.draw(streams, 4)
    x = np.array([1.0, 2.0])
    delivered = plant.observe(x, draws.measurement[3], 3)
    measured = plant.system.observe(x, draws.measurement[3], 3)
    assert delivered.shape == (3, 1, 2)
    assert np.isnan(delivered[0]).all()
    np.testing.assert_array_equal(delivered[1, 0], measured[:2])
    np.testing.assert_array_equal(delivered[2, 0], [measured[2], np.nan])


@pytest.mark.parametrize("placement", [sensors_on_a_bus(2), clusters(3)])
def test_nothing_is_measured_at_step_zero(placement):
    plant = placed(placement)
    draws = plant.draw(streams, 2)
    assert np.isnan(plant.observe(np.ones(2), draws.measurement[0], 0)).all()
    assert not np.isnan(plant.observe(np.ones(2), draws.measurement[1], 1)).all()


@pytest.mark.parametrize("placement", [sensors_on_a_bus(2), clusters(3)])
def test_noise_does_not_depend_on_how_long_the_run_is(placement):
    short, long = (placed(placement).draw(streams, steps) for steps in (5, 9))
    np.testing.assert_array_equal(short.process, long.process[:5])
    np.testing.assert_array_equal(short.measurement, long.measurement[:5])


def test_clusters_differ_and_the_first_is_the_one_on_the_bus():
    one, three = (meng2025.plant(p).draw(streams, 5) for p in (sensors_on_a_bus(6), clusters(3)))
    np.testing.assert_array_equal(three.measurement[:, 0], one.measurement)
    assert len(np.unique(three.measurement)) == three.measurement.size


def test_plants_in_batches():
    plant = meng2025.plant(clusters(2))
    generator = np.random.default_rng(4)
    states, noise = generator.standard_normal((5, 2)), generator.standard_normal((5, 2, 8))
    together = plant.observe(states, noise, 3)
    assert together.shape == (5, 2, 1, 6)
    for run in range(5):
        np.testing.assert_allclose(together[run], plant.observe(states[run], noise[run], 3))


def test_truth_starts_in_the_prior():
    plant = meng2025.plant(clusters(1))
    state, mean, cov = plant.initial(np.array([1.0, -1.0]))
    np.testing.assert_array_equal(mean, [5.0, -2.0])
    np.testing.assert_array_equal(cov, np.eye(2))
    np.testing.assert_array_equal(state, [6.0, -3.0])
    with pytest.raises(ValueError, match="0 nodes"):
        clusters(0)
