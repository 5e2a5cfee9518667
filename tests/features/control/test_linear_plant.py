"""The contract of a plant on the control plants: draws, noise, blindness, shapes, references."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from concord.features.control import cruise, motor, pitch, suspension
from concord.features.control.references import Staircase, constant, square
from concord.plants.linear import LinearPlant

MAKERS = [
    cruise.cruise,
    suspension.suspension,
    pitch.pitch,
    motor.motor_speed,
    motor.motor_position,
]
each_plant = pytest.mark.parametrize("make", MAKERS)


def streams(seed: int):
    """As ARCHITECTURE.md derives them for run 0."""
    purposes = {"initial": 0, "process": 1, "measurement": 2}

    def generator_for(purpose: str, node: int) -> np.random.Generator:
        sequence = np.random.SeedSequence(seed, spawn_key=(0, purposes[purpose], node))
        return np.random.default_rng(sequence)

    return generator_for


@each_plant
def test_draws_have_the_contracts_shapes(make):
    plant: LinearPlant = make()
    draws = plant.draw(streams(1), 7)
    n = len(plant.state_names)
    assert plant.nodes == 8
    assert draws.initial.shape == (n,)
    assert draws.process.shape == (7, plant.noise_factor.shape[1])
    assert draws.measurement.shape == (7, 8, 1, 1)
    assert len(plant.state_units) == n
    assert plant.positions(0) is None


@each_plant
def test_a_longer_run_or_a_further_node_changes_no_number(make):
    short = make(nodes=8).draw(streams(5), 20)
    long = make(nodes=11).draw(streams(5), 35)
    assert np.array_equal(long.initial, short.initial)
    assert np.array_equal(long.process[:20], short.process)
    assert np.array_equal(long.measurement[:20, :8], short.measurement)


def test_each_purpose_and_node_is_asked_for_its_own_stream():
    asked = []

    def generator_for(purpose: str, node: int) -> np.random.Generator:
        asked.append((purpose, node))
        return np.random.default_rng(len(asked))

    motor.motor_speed(nodes=3).draw(generator_for, 4)
    measured = [("measurement", node) for node in range(3)]
    assert sorted(asked) == sorted([("initial", 0), ("process", 0), *measured])


@each_plant
def test_noise_of_the_truth_is_what_the_filter_believes(make):
    plant: LinearPlant = make()
    normals = np.random.default_rng(0).standard_normal((20_000, plant.noise_factor.shape[1]))
    origin = np.zeros(len(plant.initial_state))
    added = plant.advance(origin, None, normals, 0) - plant.advance(origin, None, 0 * normals[0], 0)
    believed = plant.model.process_noise_cov(0)
    assert plant.noise_factor @ plant.noise_factor.T == pytest.approx(believed, rel=1e-12)
    scale = np.sqrt(np.diag(believed))
    # Entries of a correlation from 20 000 draws have a standard error of at most .01.
    correlation = np.cov(added.T, bias=True).reshape(believed.shape) / np.outer(scale, scale)
    assert correlation == pytest.approx(believed / np.outer(scale, scale), abs=0.05)


@each_plant
def test_prior_is_the_truth_with_its_own_covariance(make):
    plant: LinearPlant = make()
    half = np.random.default_rng(9).standard_normal(plant.prior_cov.shape)
    plant = replace(plant, prior_cov=half @ half.T + np.eye(len(half)))
    state, mean, cov = plant.initial(
        np.random.default_rng(1).standard_normal((4000, len(plant.initial_state)))
    )
    assert np.array_equal(state, np.broadcast_to(plant.initial_state, state.shape))
    error = mean - state
    nees = np.einsum("ri,ij,rj->r", error, np.linalg.inv(cov), error).mean() / len(cov)
    assert nees == pytest.approx(1, abs=5 * np.sqrt(2 / (4000 * len(cov))))


@each_plant
def test_measurements_have_the_believed_noise_and_blind_nodes_none(make):
    plant: LinearPlant = make()
    n = len(plant.state_names)
    state = np.random.default_rng(2).standard_normal(n)
    noise = np.random.default_rng(3).standard_normal((4000, 8, 1, 1))
    delivered = plant.observe(state, noise, 0)
    assert delivered.shape == (4000, 8, 1, 1)
    for node in range(8):
        sensor = plant.sensor(node)
        value, noise_cov = sensor.interpret(delivered[:, node, 0])
        assert value.shape == (4000, 1)
        assert noise_cov.shape == (4000, 1, 1)
        if node in (3, 7):
            assert np.all(np.isnan(value))
            assert np.all(np.isfinite(noise_cov))
            continue
        residual = sensor.residual(value, sensor.measure(state, 0))
        assert residual.var() / noise_cov[0, 0, 0] == pytest.approx(1, abs=5 * np.sqrt(2 / 4000))


@settings(max_examples=25, deadline=None)
@given(st.sampled_from(MAKERS), st.sampled_from([(), (1,), (3,), (2, 1, 3)]), st.integers(0, 2**31))
def test_leading_axes_are_free(make, batch: tuple[int, ...], seed: int):
    plant: LinearPlant = make()
    generator = np.random.default_rng(seed)
    state = generator.standard_normal((*batch, len(plant.state_names)))
    control = generator.standard_normal((*batch, 1))
    process = generator.standard_normal((*batch, plant.noise_factor.shape[1]))
    measurement = generator.standard_normal((*batch, 8, 1, 1))
    moved = plant.advance(state, control, process, 3)
    delivered = plant.observe(state, measurement, 3)
    measured = plant.sensors.measure(state[..., None, :], 3)
    assert delivered.shape == (*batch, 8, 1, 1)
    assert measured.shape == (*batch, 8, 1)
    for index in np.ndindex(batch):
        alone = plant.advance(state[index], control[index], process[index], 3)
        assert moved[index] == pytest.approx(alone, rel=1e-12)
        assert delivered[index] == pytest.approx(
            plant.observe(state[index], measurement[index], 3), rel=1e-12, nan_ok=True
        )
        for node in range(8):
            own = plant.sensor(node).measure(state[index], 3)
            assert measured[index][node] == pytest.approx(own, rel=1e-12)


@each_plant
def test_paper_noise_moves_no_truth(make):
    plant: LinearPlant = make(noise="paper")
    draws = plant.draw(streams(1), 4)
    state = np.ones(len(plant.state_names))
    moved = plant.advance(state, np.ones(1), draws.process[2], 2)
    assert np.array_equal(moved, plant.model.transition(state, np.ones(1), 2))
    assert np.isnan(plant.observe(state, draws.measurement[2], 2)).sum() == 2


@settings(max_examples=60, deadline=None)
@given(
    st.lists(st.tuples(st.floats(-5, 5), st.integers(1, 9)), min_size=1, max_size=5),
    st.integers(0, 200),
)
def test_staircase_is_its_levels_written_out(stairs: list[tuple[float, int]], step: int):
    levels, durations = zip(*stairs, strict=True)
    written = [level for level, duration in stairs for _ in range(duration)]
    staircase = Staircase(tuple((level,) for level in levels), durations)
    assert staircase(step) == pytest.approx([written[step % len(written)]])


def test_references_of_the_paper():
    speeds = np.array([cruise.REFERENCE(step)[0] for step in range(5000)])
    assert np.array_equal(speeds, np.repeat([10.0, 7.0], [3000, 2000]))
    turns = np.array([motor.REFERENCE(step)[0] for step in range(300)])
    assert np.array_equal(turns, np.repeat([1.0, -0.5], 150))
    assert np.array_equal(suspension.ROAD_STEP(12_345), [0.1])
    assert square(2.0, 3.0, 4) == Staircase(((2.0,), (3.0,)), (4, 4))


@pytest.mark.parametrize("durations", [(1, 2), (0,), (-3,)])
def test_staircase_refuses_what_it_cannot_climb(durations: tuple[int, ...]):
    with pytest.raises(ValueError, match="duration"):
        Staircase(((1.0,),), durations)


def test_known_road_acts_as_the_papers_second_input():
    # One step of (9) with the road held, integrated; the model's own transition is beside it.
    plant = suspension.suspension(road=constant(0.1))
    bus, state = suspension.dynamics(), np.array([0.02, -0.3, 0.01, 0.4])
    exact = solve_ivp(
        lambda t, x: bus.state_matrix @ x + bus.disturbance_matrix[:, 0] * 0.1,
        (0, plant.time_step_s),
        state,
        rtol=1e-11,
        atol=1e-13,
    ).y[:, -1]
    assert plant.model.transition(state, None, 0) == pytest.approx(exact, rel=1e-8)
    assert plant.advance(state, None, np.zeros(2), 0) == pytest.approx(exact, rel=1e-8)


def test_motor_is_the_scenario_of_the_specification():
    plant = motor.motor_position()
    voltage = plant.model.control_matrix
    expected = voltage @ voltage.T * 0.25 + np.diag([0, 0.02**2, 0]) + 1e-10 * np.eye(3)
    assert plant.model.process_noise_cov(0) == pytest.approx(expected, rel=1e-12)
    assert plant.prior_cov == pytest.approx(0.1 * np.eye(3))
    assert plant.time_step_s == 0.01
    states = plant.sensors.rows[:, 0].argmax(axis=1)
    blind = np.isnan(plant.sensors.noise_std[:, 0])
    assert np.where(blind, -1, states).tolist() == [0, 1, 2, -1, 1, 2, 0, -1]
    assert plant.sensors.noise_std[:3, 0] == pytest.approx([0.01, 0.05, 0.05])
    controller = motor.motor_position_controller()
    assert controller.reference(149)[0] == 1
    assert controller.reference(150)[0] == -0.5


def test_import_of_the_plants_is_light():
    code = (
        "import sys; "
        "from concord.features.control import closed_loop, cruise, motor, pitch, suspension; "
        "print([name for name in ('scipy', 'control', 'matplotlib') if name in sys.modules])"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"
