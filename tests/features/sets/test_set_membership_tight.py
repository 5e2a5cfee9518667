"""Filters that cut with the data, ellipsoidal and zonotopic: guarantee, limits, tightness."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from concord.features.sets import liu2021_plant as liu2021
from concord.features.sets.bounded import BoundedSystem
from concord.features.sets.filters.bus_readings import (
    MeasuredPlant,
    augmented,
    cycle_evidence,
    step_evidence,
)
from concord.features.sets.filters.criterion import plain_trace
from concord.features.sets.filters.ellipsoid import (
    Ellipsoid,
    half_widths,
    image,
    moved,
    shape_matrix,
    squared_radius,
    sum_factor,
)
from concord.features.sets.filters.ellipsoid_intersection import strip_intersection
from concord.features.sets.filters.evidence import (
    BoundedMotion,
    Readings,
    StepReadings,
    no_readings,
)
from concord.features.sets.filters.lifted_cycle import DeliveredValues
from concord.features.sets.filters.recursive_estimator import optimal_step
from concord.features.sets.filters.tight_estimator import conditioned, conditioned_step
from concord.features.sets.filters.zonotope import Zonotope, around, gauge
from concord.features.sets.filters.zonotope import half_widths as zonotope_half_widths
from concord.features.sets.filters.zonotope_filter import zonotope_step
from concord.papers.liu2021.runs import simulate
from tests.features.sets.bounded_systems import Sizes, on_the_sphere, random_plant, run_of, sizes

pytestmark = pytest.mark.slow

SEEDS = st.integers(0, 2**32 - 1)
EXAMPLE = MeasuredPlant(liu2021.SYSTEM, liu2021.STATIC_OUTPUTS, liu2021.weights)


def unit_ball(lanes: tuple[int, ...], n: int) -> Ellipsoid:
    return Ellipsoid(np.zeros((*lanes, n)), np.broadcast_to(np.eye(n), (*lanes, n, n)))


def by_cycle(plant: MeasuredPlant[BoundedSystem], states: np.ndarray, received: DeliveredValues):
    """Squared radii of the truth after each cycle, and the ellipsoids."""
    n, g = states.shape[-1], plant.length
    kept, radii, sets = unit_ball(states.shape[:1], n), [], []
    for cycle in range(received.values.shape[-2]):
        full = conditioned_step(kept, cycle_evidence(plant, received, cycle))
        block = states[:, cycle * g + 1 : (cycle + 1) * g + 1]
        radii.append(squared_radius(full, block.reshape(len(states), -1)))
        sets.append(full)
        kept = image(full, np.eye(g * n)[(g - 1) * n :])
    return np.array(radii), sets


def by_step(
    plant: MeasuredPlant[BoundedSystem], states: np.ndarray, received: DeliveredValues
) -> np.ndarray:
    kept, radii = unit_ball(states.shape[:1], states.shape[-1]), []
    for cycle in range(received.values.shape[-2]):
        for evidence in step_evidence(plant, received, cycle):
            kept = conditioned_step(kept, evidence)
            radii.append(squared_radius(kept, states[:, len(radii) + 1]))
    return np.array(radii)


@settings(max_examples=20)
@given(of=sizes(), seed=SEEDS)
def test_no_noise_within_the_bounds_gets_out(of: Sizes, seed: int):
    rng = np.random.default_rng(seed)
    plant = random_plant(rng, of, steps=20)
    states, received = run_of(rng, plant, lanes=3, cycles=3)
    radii, _ = by_cycle(plant, states, received)
    assert (radii <= 1).all()
    assert (by_step(plant, states, received) <= 1).all()


@settings(max_examples=20)
@given(of=sizes(), seed=SEEDS)
def test_nor_out_of_a_zonotope(of: Sizes, seed: int):
    rng = np.random.default_rng(seed)
    plant = random_plant(rng, of, steps=20)
    states, received = run_of(rng, plant, lanes=2, cycles=2)
    kept, step = around(unit_ball((2,), of.states)), 0
    for cycle in range(2):
        for evidence in step_evidence(plant, received, cycle):
            kept, step = zonotope_step(kept, evidence, generators=of.states + 4), step + 1
            for lane in range(2):
                own = Zonotope(kept.centre[lane], kept.generators[lane])
                assert gauge(own, states[lane, step]) <= 1 + 1e-6
            assert kept.generators.shape[-1] <= of.states + 4


def test_long_runs_of_the_unstable_plant_stay_inside():
    rng = np.random.default_rng(7)
    states, received = run_of(rng, EXAMPLE, lanes=3, cycles=60)
    radii, _ = by_cycle(EXAMPLE, states, received)
    assert (radii <= 1).all()
    assert radii.max() > 0.5  # it is tight: vertex noise comes near the edge
    assert (by_step(EXAMPLE, states, received) <= 1).all()


@settings(max_examples=15)
@given(of=sizes(), seed=SEEDS)
def test_cutting_is_never_worse_than_the_paper_from_the_same_ellipsoid(of: Sizes, seed: int):
    # The paper's step from a known held value; the tight one may use all that it uses.
    rng = np.random.default_rng(seed)
    plant = random_plant(rng, of, steps=20)
    _, received = run_of(rng, plant, lanes=3, cycles=1)
    n, g, held = of.states, plant.length, of.outputs - of.static
    size, first = g * n + held, (g - 1) * n
    factor = np.zeros((3, size, n))
    factor[:, first : first + n] = np.eye(n)
    before = Ellipsoid(np.zeros((3, size)), factor)
    values, evidence = received.values[:, 0], cycle_evidence(plant, received, 0)
    paper = optimal_step(before, augmented(plant, received, 0), values, plain_trace).after
    tight = conditioned_step(unit_ball((3,), n), evidence, plain_trace)
    of_paper = np.trace(shape_matrix(paper), axis1=-2, axis2=-1)
    of_tight = np.trace(shape_matrix(tight), axis1=-2, axis2=-1)
    assert (of_tight <= of_paper * (1 + 1e-5)).all()


def test_on_the_example_it_is_much_tighter():
    # Specification of the paper, section 5: always at most 0.91 of the trace after 12 cycles.
    rng = np.random.default_rng(0)
    states, received = run_of(rng, EXAMPLE, lanes=10, cycles=12)
    _, sets = by_cycle(EXAMPLE, states, received)
    kept = unit_ball((10,), 14)
    for cycle in range(12):
        model = augmented(EXAMPLE, received, cycle)
        kept = optimal_step(kept, model, received.values[:, cycle]).after
    of_paper = np.trace(shape_matrix(kept), axis1=-2, axis2=-1)
    of_tight = np.trace(shape_matrix(sets[-1]), axis1=-2, axis2=-1)
    assert (of_tight <= 0.91 * of_paper).all()


@pytest.mark.parametrize(("seed", "cycle", "sequence"), [(0, 13, 2), (2, 20, 11)])
def test_sets_far_thinner_than_their_balls_are_as_small_as_can_be_proved(
    seed: int, cycle: int, sequence: int
):
    """The sum of the multipliers is above 10^6 there, and its cap made the trace 1.3 to 1.9 times
    as large."""
    batch = simulate(seed, sequence, cycle)
    received = batch.received
    n = batch.states.shape[-1]
    kept, last = unit_ball((batch.sequences,), n), np.eye(EXAMPLE.length * n)[-n:]
    gaps = []
    for number in range(cycle):
        found = conditioned(kept, cycle_evidence(EXAMPLE, received, number))
        gaps.append(found.gap[sequence])
        kept = image(found.after, last)
    assert max(gaps) < 0.01


# --- limits --------------------------------------------------------------------------------------


def nothing_read(n: int, q: int) -> Readings:
    return Readings(np.zeros((0, n)), np.zeros((0, 1, q)), np.zeros(0), np.zeros(0))


def test_without_readings_it_is_the_sum_of_ellipsoids():
    rng = np.random.default_rng(1)
    before = Ellipsoid(rng.standard_normal(3), rng.standard_normal((3, 3)))
    transition, noise = rng.standard_normal((3, 3)), rng.standard_normal((3, 2))
    nothing = nothing_read(3, 2)
    evidence = StepReadings(BoundedMotion(transition, noise[:, None]), nothing, nothing)
    after = conditioned_step(before, evidence)
    closed = sum_factor(transition @ before.factor, noise)
    np.testing.assert_allclose(shape_matrix(after), closed @ closed.T, rtol=1e-3, atol=1e-4)
    assert np.trace(shape_matrix(after)) == pytest.approx((closed**2).sum(), rel=1e-5)
    np.testing.assert_allclose(after.centre, transition @ before.centre, atol=1e-4)
    zonotope = zonotope_step(around(before), evidence)
    widths = np.abs(transition @ before.factor).sum(-1) + np.abs(noise).sum(-1)
    np.testing.assert_allclose(zonotope_half_widths(zonotope), widths, rtol=1e-9)


@settings(max_examples=15)
@given(seed=SEEDS, n=st.integers(1, 3))
def test_one_sensor_is_the_classical_filter(seed: int, n: int):
    # A reading whose noise is its own is a strip: the filters of Schweppe and of Fogel and Huang,
    # here by a search over one weight.
    rng = np.random.default_rng(seed)
    before = Ellipsoid(rng.standard_normal(n), rng.standard_normal((n, n)) + np.eye(n))
    row, half_width = rng.standard_normal(n), rng.uniform(0.05, 2.0)
    truth = before.centre + before.factor @ (0.9 * on_the_sphere(rng, n))
    value = row @ truth + half_width * rng.uniform(-1, 1)
    still = BoundedMotion(np.eye(n), np.zeros((n, 1, 1)))
    reading = Readings(row[None], np.array([[[half_width]]]), np.array([value]), np.zeros(1))
    as_noise = conditioned_step(before, StepReadings(still, reading, nothing_read(n, 1)))
    strip = Readings(row[None], np.zeros((1, 1, 1)), np.array([value]), np.array([half_width]))
    as_strip = conditioned_step(before, StepReadings(still, nothing_read(n, 1), strip))
    classical = strip_intersection(before, row, np.array(value), np.array(half_width))
    expected = _relative_size(classical, before)
    # It is never larger than the strip's; noise as an unknown of its own cuts no less.
    assert _relative_size(as_strip, before) == pytest.approx(expected, rel=1e-4)
    assert _relative_size(as_noise, before) == pytest.approx(expected, rel=1e-4)


def _relative_size(one: Ellipsoid, before: Ellipsoid) -> float:
    """The trace in units of the half-widths before."""
    return float(((half_widths(one) / half_widths(before)) ** 2).sum())


def test_exact_readings_of_everything_leave_a_point():
    rng = np.random.default_rng(3)
    truth = np.array([0.3, -0.4])
    rows = rng.standard_normal((2, 2))
    reading = Readings(rows, np.zeros((2, 1, 1)), rows @ truth, np.zeros(2))
    still = BoundedMotion(np.eye(2), np.zeros((2, 1, 1)))
    evidence = StepReadings(still, reading, no_readings(reading))
    after = conditioned_step(unit_ball((), 2), evidence)
    assert half_widths(after).max() < 1e-6
    assert squared_radius(after, truth) <= 1
    zonotope = zonotope_step(around(unit_ball((), 2)), evidence)
    assert zonotope_half_widths(zonotope).max() < 1e-6
    assert gauge(zonotope, truth) <= 1 + 1e-6


def test_a_reading_that_was_not_taken_is_no_reading():
    rng = np.random.default_rng(4)
    before = Ellipsoid(np.zeros((2, 3)), np.broadcast_to(np.eye(3), (2, 3, 3)))
    motion = BoundedMotion(rng.standard_normal((3, 3)), 0.3 * rng.standard_normal((3, 1, 2)))
    rows, noise = rng.standard_normal((2, 3)), 0.3 * rng.standard_normal((2, 1, 2))
    values = np.array([[0.2, np.nan], [0.2, 0.1]])
    exact = Readings(rows, noise, values, np.zeros((2, 2)))
    strips = Readings(rows, noise, np.array([[np.nan, 0.1], [0.3, 0.1]]), np.full((2, 2), 0.5))
    both = conditioned_step(before, StepReadings(motion, exact, strips))
    fewer = Readings(rows[:1], noise[:1], values[:1, :1], np.zeros((1, 1)))
    strip = Readings(rows[1:], noise[1:], np.array([[0.1]]), np.full((1, 1), 0.5))
    first = Ellipsoid(before.centre[:1], before.factor[:1])
    alone = conditioned_step(first, StepReadings(motion, fewer, strip))
    np.testing.assert_allclose(shape_matrix(both)[0], shape_matrix(alone)[0], rtol=1e-3, atol=1e-4)
    np.testing.assert_allclose(both.centre[0], alone.centre[0], atol=1e-4)
    wide, narrow = (
        zonotope_step(around(one), evidence)
        for one, evidence in (
            (before, StepReadings(motion, exact, strips)),
            (first, StepReadings(motion, fewer, strip)),
        )
    )
    np.testing.assert_allclose(wide.centre[0], narrow.centre[0], atol=1e-12)


def test_readings_that_contradict_the_bounds_lose_their_lane_alone():
    before = Ellipsoid(np.zeros((2, 2)), np.broadcast_to(np.eye(2), (2, 2, 2)))
    still = BoundedMotion(np.eye(2), np.zeros((2, 1, 1)))
    values = np.array([[1.5], [0.5]])
    strip = Readings(np.array([[1.0, 0.0]]), np.zeros((1, 1, 1)), values, np.full((2, 1), 0.1))
    after = conditioned_step(before, StepReadings(still, no_readings(strip), strip))
    assert np.isnan(after.factor[0]).all()
    assert np.isfinite(after.factor[1]).all()
    again = conditioned_step(after, StepReadings(still, no_readings(strip), strip))
    assert np.isnan(again.centre[0]).all()
    np.testing.assert_allclose(again.centre[1, 0], 0.5, atol=0.05)


def test_prediction_agrees_with_the_networks_closed_form():
    rng = np.random.default_rng(8)
    before = Ellipsoid(rng.standard_normal(3), rng.standard_normal((3, 3)))
    transition, noise = rng.standard_normal((3, 3)), rng.standard_normal((3, 1))
    nothing = nothing_read(3, 1)
    evidence = StepReadings(BoundedMotion(transition, noise[:, None]), nothing, nothing)
    after = conditioned_step(before, evidence)
    closed = moved(before, transition @ before.centre, transition, noise)
    assert np.trace(shape_matrix(after)) == pytest.approx(np.trace(shape_matrix(closed)), rel=1e-5)
