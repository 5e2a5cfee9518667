"""Readings with the noise that drives the plant: sound, free of units, and as tight as they can."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from concord.features.sets.filters.criterion import plain_trace
from concord.features.sets.filters.ellipsoid import Ellipsoid, half_widths, squared_radius
from concord.features.sets.filters.evidence import (
    BoundedMotion,
    Readings,
    StepReadings,
    no_readings,
    taken,
)
from concord.features.sets.filters.joint_noise import LinearReadings
from concord.features.sets.filters.tight_estimator import conditioned_step
from concord.features.sets.set_membership import predict_sets, take_readings
from concord.features.sets.set_shapes import Ellipsoids
from concord.nodes.rules.lane_rule import LocalStep
from concord.nodes.rules.local_filter import LocalFilters

SEEDS = st.integers(0, 2**32 - 1)
STATES = 3


class Linear:
    """x' = A x + B v."""

    def __init__(self, transition: np.ndarray, noise: np.ndarray) -> None:
        self.matrices = transition, noise

    def transition(self, state, control, step):
        return state @ self.matrices[0].T

    def motion(self, step):
        return self.matrices


def drawn(seed: int, rows: int, samples: int, units: np.ndarray):
    """A plant, a set, a state in it, noise on its bound, and readings, in these units."""
    rng = np.random.default_rng(seed)
    inverse = np.diag(1.0 / units)
    transition = np.diag(units) @ rng.standard_normal((STATES, STATES)) @ inverse
    noise = units[:, None] * rng.standard_normal((STATES, samples))
    state, through = rng.standard_normal((rows, STATES)), rng.standard_normal((rows, samples))
    centre, factor = rng.standard_normal(STATES), rng.standard_normal((STATES, STATES))
    u, v = rng.standard_normal(STATES), rng.standard_normal(samples)
    x = centre + factor @ (u / np.linalg.norm(u) * rng.uniform() ** 0.3)
    v /= np.linalg.norm(v)
    values = state @ x + through @ v
    own = Ellipsoid(units * centre, units[:, None] * factor)
    readings = LinearReadings(state @ inverse, through, np.zeros(rows), values)
    return Linear(transition, noise), own, readings, units * x, v


def stepped(plant: Linear, own: Ellipsoid, readings: LinearReadings) -> tuple[Ellipsoid, Ellipsoid]:
    """The sets of a step and of the next one."""
    shape = Ellipsoids(STATES)
    kept, joint, wrong = take_readings(shape, own, readings, plant.matrices)
    assert not wrong.any()
    now = LocalStep(LocalFilters(plant, (), None), np.empty(0), None, 1)  # type: ignore[arg-type]
    return kept, predict_sets(shape, kept, now, joint)


@settings(max_examples=300)
@given(
    seed=SEEDS,
    rows=st.integers(1, 5),
    samples=st.integers(1, 3),
    powers=st.tuples(*[st.integers(-6, 6)] * STATES),
    lost=st.integers(0, 31),
)
def test_states_stay_inside_in_any_unit(seed: int, rows: int, samples: int, powers, lost: int):
    plant, own, readings, x, v = drawn(seed, rows, samples, 10.0 ** np.array(powers))
    untaken = np.array([lost >> row & 1 for row in range(rows)], dtype=bool)
    readings = readings._replace(values=np.where(untaken, np.nan, readings.values))
    now, then = stepped(plant, own, readings)
    transition, noise = plant.matrices
    assert squared_radius(now, x) <= 1
    assert squared_radius(then, transition @ x + noise @ v) <= 1


@settings(max_examples=100)
@given(
    seed=SEEDS,
    rows=st.integers(1, 3),
    samples=st.integers(1, 2),
    powers=st.tuples(*[st.integers(-20, 20)] * STATES),
)
def test_a_state_in_another_unit_has_the_same_set_in_that_unit(seed, rows, samples, powers):
    units = 2.0 ** np.array(powers)
    one = stepped(*drawn(seed, rows, samples, np.ones(STATES))[:3])
    other = stepped(*drawn(seed, rows, samples, units)[:3])
    for first, second in zip(one, other, strict=True):
        np.testing.assert_allclose(half_widths(second) / units, half_widths(first), rtol=1e-6)


def test_one_reading_of_one_noise_is_nearly_as_tight_as_the_programme():
    ratios = []
    for seed in range(30):
        plant, own, readings, _, _ = drawn(seed, 1, 1, np.ones(STATES))
        exact = Readings(
            readings.state, readings.noise[:, None, :], readings.values, readings.half_widths
        )
        transition, noise = plant.matrices
        still = BoundedMotion(np.eye(STATES), np.zeros((STATES, 1, 1)))
        moving = BoundedMotion(transition, noise[:, None, :])
        evidence = [StepReadings(one, exact, no_readings(exact)) for one in (still, moving)]
        best = [conditioned_step(own, one, plain_trace) for one in evidence]
        pairs = zip(stepped(plant, own, readings), best, strict=True)
        ratios.append([np.sqrt((a.factor**2).sum() / (b.factor**2).sum()) for a, b in pairs])
    # The programme proves the least trace there is, to 5e-6.
    assert np.min(ratios) > 1 - 1e-4
    assert (np.median(ratios, axis=0) < 1.2).all()


def test_enough_readings_determine_the_state_and_the_next():
    plant, own, readings, _, _ = drawn(5, STATES + 1, 1, np.ones(STATES))
    now, then = stepped(plant, own, readings)
    assert half_widths(now).max() < 1e-4
    assert half_widths(then).max() < 1e-4
    # To take readings twice is sound, and the second time they cut a set that is nearly flat.
    again, after = stepped(plant, now, readings)
    assert half_widths(again).max() < 1e-9
    assert half_widths(after).max() < 1e-9


def test_readings_with_noise_of_their_own_are_strips_and_narrow_no_noise():
    plant, own, readings, x, _ = drawn(7, 1, 1, np.ones(STATES))
    readings = readings._replace(half_widths=np.array([0.5]))
    kept, joint, _ = take_readings(Ellipsoids(STATES), own, readings, plant.matrices)
    assert squared_radius(kept, x) <= 1
    np.testing.assert_allclose(joint.transition, plant.matrices[0])
    np.testing.assert_allclose(np.abs(joint.noise[:, 0]), np.abs(plant.matrices[1][:, 0]))


def test_readings_that_contradict_are_left_out_together():
    plant, own, readings, _, _ = drawn(7, 2, 1, np.ones(STATES))
    readings = readings._replace(values=readings.values + np.array([0.0, 1e3]))
    kept, joint, wrong = take_readings(Ellipsoids(STATES), own, readings, plant.matrices)
    assert wrong
    assert kept.factor.tobytes() == own.factor.tobytes()
    assert not joint.known


def test_a_reading_that_was_not_taken_says_nothing():
    """Its row holds for every state, and the other rows stay as they are."""
    rng = np.random.default_rng(4)
    values = np.array([0.3, np.nan, -1.0])
    before = Readings(
        rng.standard_normal((3, 2)), rng.standard_normal((3, 1, 2)), values, np.full(3, 0.2)
    )
    after = taken(before)
    for one, other in zip(before[:4], after[:4], strict=True):
        np.testing.assert_array_equal(other[[0, 2]], one[[0, 2]])
    state = 1e6 * rng.standard_normal(2)
    assert abs(after.values[1] - after.state[1] @ state) <= after.half_widths[1]
    assert not after.noise[1].any()
