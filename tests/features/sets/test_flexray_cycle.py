"""The plant over a FlexRay cycle: round robin, try once discard, lifted and augmented, exactly."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from concord.features.sets import liu2021_plant as liu2021
from concord.features.sets.bounded import BoundedSystem
from concord.features.sets.filters.bus_readings import MeasuredPlant
from concord.features.sets.filters.histories import sets_over
from concord.features.sets.filters.lifted_cycle import augment, lift
from tests.features.sets.bounded_systems import Sizes, on_the_sphere, random_plant, sizes, transmit

EXAMPLE = MeasuredPlant(liu2021.SYSTEM, liu2021.STATIC_OUTPUTS, liu2021.weights)


def rolled_out(plant: MeasuredPlant[BoundedSystem], noise: np.ndarray, start: np.ndarray):
    states, outputs = plant.system.simulate(start, noise)
    return states, outputs, transmit(outputs, plant.static_outputs, plant.weights)


@settings(max_examples=40)
@given(of=sizes(), seed=st.integers(0, 2**32 - 1))
def test_augmented_cycles_are_the_plant_and_the_bus_exactly(of: Sizes, seed: int):
    rng = np.random.default_rng(seed)
    plant = random_plant(rng, of, steps=20)
    cycles, length, n = 3, plant.length, of.states
    noise = on_the_sphere(rng, 5, cycles * length, of.noises)
    states, outputs, received = rolled_out(plant, noise, rng.standard_normal((5, n)))
    static = of.static
    first = np.zeros((5, (length - 1) * n))
    z = np.concatenate([first, states[:, 0], np.zeros((5, of.outputs - static))], axis=-1)
    for cycle in range(cycles):
        lifted = lift(plant.system, static, plant.weights, cycle)
        model = augment(lifted, received.winner[:, cycle], np.zeros(5))
        v = noise[:, cycle * length : (cycle + 1) * length]
        change = z @ model.candidates.T + np.einsum("rgq,bgq->br", model.candidates_noise, v)
        last = outputs[:, (cycle + 1) * length - 1, static:]
        np.testing.assert_allclose(change, last - received.held[:, cycle], atol=1e-12)
        ybar = np.einsum("bmn,bn->bm", model.output, z)
        ybar += np.einsum("bmgq,bgq->bm", model.output_noise, v)
        np.testing.assert_allclose(ybar, received.values[:, cycle], atol=1e-12)
        z = np.einsum("bmn,bn->bm", model.transition, z)
        z += np.einsum("bmgq,bgq->bm", model.noise, v)
        block = states[:, cycle * length + 1 : (cycle + 1) * length + 1].reshape(5, -1)
        np.testing.assert_allclose(z[:, : length * n], block, atol=1e-12)
        np.testing.assert_allclose(z[:, length * n :], received.values[:, cycle, static:])


def test_lifted_matrices_are_products_of_the_steps():
    # Lemma 1 by its printed products, for the example: Phi_i and what noise of sample j leaves.
    cycle = 2
    lifted = lift(EXAMPLE.system, 2, liu2021.weights, cycle)
    a = [liu2021.transition(3 * cycle + i) for i in range(3)]
    b = [liu2021.noise_input(3 * cycle + i) * liu2021.NOISE_BOUND for i in range(3)]
    zero = np.zeros((4, 1))
    np.testing.assert_allclose(lifted.states, np.vstack([a[0], a[1] @ a[0], a[2] @ a[1] @ a[0]]))
    rows = [
        [b[0], zero, zero],
        [a[1] @ b[0], b[1], zero],
        [a[2] @ a[1] @ b[0], a[2] @ b[1], b[2]],
    ]
    np.testing.assert_allclose(lifted.states_noise[..., 0], np.block(rows))


def test_static_outputs_are_of_their_own_step_and_losers_are_held():
    outputs = np.arange(24.0).reshape(6, 4)
    received = transmit(outputs, 2, lambda _: np.array([1.0, 1.0]))
    np.testing.assert_array_equal(received.values[0], [outputs[0, 0], outputs[1, 1], 0.0, 11.0])
    # Held are 0 and 11; now they measure 22 and 23: output 3 has changed more.
    np.testing.assert_array_equal(received.held[1], [0.0, 11.0])
    np.testing.assert_array_equal(received.values[1], [outputs[3, 0], outputs[4, 1], 22.0, 11.0])
    np.testing.assert_array_equal(received.winner, [1, 0])


def test_an_output_without_a_value_is_not_received():
    outputs = np.arange(24.0).reshape(6, 4)
    outputs[3, 0] = outputs[5, 2:] = np.nan
    received = transmit(outputs, 2, lambda _: np.ones(2))
    # Nothing contends in the second cycle: both sides go on holding 0 and 11.
    np.testing.assert_array_equal(received.values[1], [np.nan, outputs[4, 1], 0.0, 11.0])
    np.testing.assert_array_equal(received.winner, [1, -1])
    found = sets_over(EXAMPLE._replace(weights=lambda _: np.ones(2)), received,
                      np.zeros(4), 1e6 * np.eye(4), "paper")  # fmt: skip
    assert np.isfinite(found.sets[-1].centre).all()


def test_weights_decide_and_the_first_wins_among_equals():
    for outputs, weights, winner in (
        ([2.0, -2.0, 2.0], [1.0, 1.0, 1.0], 0),
        ([2.0, -2.0, 1.0], [1.0, 1.0, 5.0], 2),
    ):
        received = transmit(np.array([outputs]), 0, lambda _, own=weights: np.array(own))
        assert received.winner == [winner]


@settings(max_examples=200)
@given(
    changes=st.lists(st.floats(-1e9, 1e9), min_size=2, max_size=5),
    scale=st.integers(-6, 6),
    seed=st.integers(0, 2**32 - 1),
)
def test_no_loser_has_changed_more_than_the_limit(changes: list[float], scale: int, seed: int):
    # Changes of which some are as near to each other as numbers can be.
    outputs = np.array([changes]) * 10.0**scale
    outputs[0, -1] = np.nextafter(outputs[0, 0], np.inf)
    weights = np.random.default_rng(seed).uniform(0.5, 2.0, outputs.shape[-1])
    weights[-1] = weights[0]
    received = transmit(outputs, 0, lambda _: weights)
    squares = weights * outputs[0] ** 2
    assert squares.max() <= received.limit[0]
    # The resolution of the bus is all that is added.
    assert received.limit[0] <= squares.max() * (1 + 2e-9) + 1e-300


def test_the_rule_gives_the_known_winners_on_the_papers_noise():
    # spec of the paper, A9: 4,3,3,3,4,4,3,3,3,4,3,3,3.
    noise = liu2021.printed_noise(liu2021.STEPS)
    _, _, received = rolled_out(EXAMPLE, noise, liu2021.INITIAL_STATE)
    winners = [4, 3, 3, 3, 4, 4, 3, 3, 3, 4, 3, 3, 3]
    np.testing.assert_array_equal(received.winner + 3, winners)


def test_the_example_is_unstable_and_as_large_as_reported():
    noise = liu2021.printed_noise(liu2021.STEPS)
    states, _ = liu2021.SYSTEM.simulate(liu2021.INITIAL_STATE, noise)
    np.testing.assert_allclose(np.abs(states[-1, 0]), 41.8, atol=0.05)


def test_a_bus_that_cannot_be_is_refused():
    with pytest.raises(ValueError, match="5 static slots for 4 sensors; take 0 to 4"):
        transmit(np.zeros((6, 4)), 5, lambda _: np.ones(0))
    with pytest.raises(ValueError, match="cycles of 3"):
        transmit(np.zeros((7, 4)), 2, lambda _: np.ones(2))
