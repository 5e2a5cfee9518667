"""Units do not matter: the sets of every filter are the same in any unit of states and outputs."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from concord.features.sets import liu2021_plant as liu2021
from concord.features.sets.filters import zonotope
from concord.features.sets.filters.bus_readings import MeasuredPlant
from concord.features.sets.filters.ellipsoid import Ellipsoid, half_widths, moved
from concord.features.sets.filters.zonotope import Zonotope
from tests.features.sets.bounded_systems import Sizes, random_plant, run_of
from tests.features.sets.set_units import METHODS, Units, apart, in_units

# The optimum is flat. Noise on its bound may leave next to nothing of some states, and the solver
# ends early there: its result differs by a percent with the rounding on the way.
TOLERANCE = 2e-2
METHOD = pytest.mark.parametrize("method", METHODS)


def draw_of(seed: int, lanes: int):
    """A plant with noise on its bound, and units from 1e-6 to 1e6."""
    rng = np.random.default_rng(seed)
    n, m = rng.integers(1, 4, 2)
    of = Sizes(int(n), int(m), int(rng.integers(0, m + 1)), int(rng.integers(1, 3)))
    plant = random_plant(rng, of, steps=20)
    _, received = run_of(rng, plant, lanes=lanes, cycles=3)
    units = Units(10.0 ** rng.uniform(-6, 6, n), 10.0 ** rng.uniform(-6, 6, m))
    return plant, received, units


@METHOD
@settings(max_examples=8)
@given(seed=st.integers(0, 2**32 - 1))
def test_sets_scale_with_the_units(method: str, seed: int):
    assert (apart(method, *draw_of(seed, lanes=2)) <= TOLERANCE).all()


@pytest.mark.slow
@METHOD
def test_sets_scale_with_the_units_in_a_thousand_draws(method: str):
    worst = np.concatenate([apart(method, *draw_of(seed, lanes=200)) for seed in range(5)])
    assert worst.shape == (1_000,)
    assert (worst <= TOLERANCE).all()


@METHOD
def test_states_in_units_from_one_hundred_thousandth_to_one_hundred_thousand(method: str):
    # Margins as large as the largest state's doubled a half-width at 10^3, made sets 10^5 times too
    # wide at 10^4, and contradicted themselves at 10^5.
    example = MeasuredPlant(liu2021.SYSTEM, liu2021.STATIC_OUTPUTS, liu2021.weights)
    _, received = run_of(np.random.default_rng(1), example, lanes=2, cycles=8)
    for exponent in (2, 4, 5):
        scale = 10.0**exponent
        units = Units(np.array([1 / scale, 1.0, 1.0, scale]), np.ones(liu2021.OUTPUTS))
        assert (apart(method, example, received, units) <= TOLERANCE).all()


@pytest.mark.parametrize("turn", [0.0, 1e-3])
def test_a_yaw_rate_beside_a_large_position_does_not_grow(turn: float):
    # A position of 5e6 m within 1 m, a yaw rate within 1e-3 1/s, and no noise.
    centre, widths = np.array([5e6, 0.01]), np.array([1.0, 1e-3])
    transition, noise = np.array([[1.0, turn], [0.0, 1.0]]), np.zeros((2, 1))
    ball, box = Ellipsoid(centre, np.diag(widths)), Zonotope(centre, np.diag(widths))
    for _ in range(100):
        ball = moved(ball, transition @ ball.centre, transition, noise)
        box = zonotope.moved(box, transition @ box.centre, transition, noise)
    assert half_widths(ball)[1] <= 1e-3 * (1 + 1e-4)
    assert zonotope.half_widths(box)[1] <= 1e-3 * (1 + 1e-9)


def test_the_plant_in_other_units_is_the_same_plant():
    plant, _, units = draw_of(3, lanes=1)
    other = in_units(plant, units)
    rng = np.random.default_rng(0)
    state = rng.standard_normal(len(units.states))
    noise = rng.uniform(-1, 1, (6, plant.system.noise_input(0).shape[-1]))
    states, outputs = plant.system.simulate(state, noise)
    moved_states, moved_outputs = other.system.simulate(units.states * state, noise)
    np.testing.assert_allclose(moved_states / units.states, states, atol=1e-9)
    np.testing.assert_allclose(moved_outputs / units.outputs, outputs, atol=1e-9)
