"""Test the sensors of each node: the dealing rule, the two presets, and their table."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from concord.features.control import cruise, motor, pitch, suspension
from concord.features.control.networks import PAPER_WARNING, deal_order
from concord.plants.linear import LinearPlant

MAKERS = [
    cruise.cruise,
    suspension.suspension,
    pitch.pitch,
    motor.motor_speed,
    motor.motor_position,
]
each_plant = pytest.mark.parametrize("make", MAKERS)


def test_eight_nodes_are_dealt_as_described():
    assert deal_order(8).tolist() == [0, 1, 2, -1, 4, 5, 3, -1]


@given(st.integers(1, 60))
def test_every_output_index_is_dealt_once(nodes: int):
    order = deal_order(nodes)
    seeing = [node for node in range(nodes) if node % 4 != 3]
    assert np.flatnonzero(order >= 0).tolist() == seeing
    assert sorted(order[seeing]) == list(range(len(seeing)))
    moved = [node for node in seeing if order[node] != node]
    assert all(order[node] % 4 == 3 for node in moved)


@pytest.mark.parametrize("nodes", [0, -1])
def test_a_network_needs_a_node(nodes: int):
    with pytest.raises(ValueError, match="at least 1"):
        motor.motor_speed(nodes=nodes)


@each_plant
def test_unknown_preset_is_refused(make):
    with pytest.raises(
        ValueError, match=r"noise 'loud' is not a preset; choose 'matched'.*'paper'"
    ):
        make(noise="loud")


def seen(plant: LinearPlant) -> list[Any]:
    """State index and variance that each node measures."""
    rows, variances = plant.sensors.rows[:, 0], plant.sensors.noise_std[:, 0] ** 2
    return [
        None if np.isnan(variance) else (int(np.argmax(row)), pytest.approx(variance))
        for row, variance in zip(rows, variances, strict=True)
    ]


def test_variances_of_the_specification():
    assert seen(cruise.cruise()) == [
        (0, 0.5), (0, 1.0), (0, 1.5), None, (0, 2.5), (0, 3.0), (0, 2.0), None
    ]  # fmt: skip
    assert seen(suspension.suspension()) == [
        (2, 4e-6), (0, 25e-6), (1, 25e-4), None, (0, 50e-6), (1, 50e-4), (2, 8e-6), None
    ]  # fmt: skip
    assert seen(pitch.pitch()) == [
        (2, 1e-4), (1, 1.8e-4**2), (0, 4e-4), None, (1, 2 * 1.8e-4**2), (0, 8e-4), (2, 2e-4), None
    ]  # fmt: skip
    assert seen(motor.motor_speed()) == [
        (0, 25e-4), (1, 25e-4), (0, 50e-4), None, (0, 75e-4), (1, 75e-4), (1, 50e-4), None
    ]  # fmt: skip
    assert seen(motor.motor_position()) == [
        (0, 1e-4), (1, 25e-4), (2, 25e-4), None, (1, 50e-4), (2, 50e-4), (0, 2e-4), None
    ]  # fmt: skip


@each_plant
def test_paper_preset_is_the_printed_table_and_says_so(make):
    plant: LinearPlant = make(noise="paper")
    assert plant.warning == PAPER_WARNING
    assert make().warning == ""
    assert plant.prior_cov == pytest.approx(50 * np.eye(len(plant.prior_cov)))
    assert plant.noise_factor.shape[1] == 0
    variance = {"cruise": 0.5, "suspension": 0.05}.get(plant.name, 1.0)
    assert plant.sensors.noise_std[[0, 5], 0] ** 2 == pytest.approx(variance)
    assert np.array_equal(np.flatnonzero(np.isnan(plant.sensors.noise_std[:, 0])), [3, 7])
    assert np.all(plant.sensors.rows[[0, 1, 2, 4, 5, 6]] == plant.sensors.rows[0])


@pytest.mark.parametrize("make", [pitch.pitch, motor.motor_speed, motor.motor_position])
def test_paper_weights_leave_hidden_states_uncorrected(make):
    # Erratum 19: gain .981 on the measured output, 0 on the others.
    plant: LinearPlant = make(noise="paper")
    transition, row = plant.model.transition_matrix, plant.sensors.rows[0, 0]
    cov = plant.prior_cov
    gain = np.zeros(len(row))
    for _ in range(3000):
        gain = cov @ row / (row @ cov @ row + 1.0)
        cov = cov - np.outer(gain, row @ cov)
        cov = transition @ cov @ transition.T + plant.model.noise_cov
    measured = int(np.argmax(row))
    assert gain[measured] == pytest.approx(0.981, abs=1e-3)
    assert np.delete(gain, measured) == pytest.approx(0, abs=1e-5)
