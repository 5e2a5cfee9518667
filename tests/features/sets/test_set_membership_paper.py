"""The paper's estimator, exact and in closed form: optimum, guarantee, limits, published traces."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from concord.features.sets import liu2021_plant as liu2021
from concord.features.sets.bounded import BoundedSystem
from concord.features.sets.delivered import delivered
from concord.features.sets.filters.bus_readings import MeasuredPlant, augmented
from concord.features.sets.filters.closed_form import closed_form_step
from concord.features.sets.filters.criterion import plain_trace
from concord.features.sets.filters.cycle import turned
from concord.features.sets.filters.ellipsoid import Ellipsoid, shape_matrix, squared_radius
from concord.features.sets.filters.lifted_cycle import AugmentedCycle
from concord.features.sets.filters.multipliers import smallest_bound
from concord.features.sets.filters.recursive_estimator import optimal_step, problem
from concord.filters.linalg import multiply
from concord.papers.liu2021.comparisons import by_value as bus_by_value
from concord.papers.liu2021.runs import BUS
from tests.features.sets.bounded_systems import (
    Sizes,
    on_the_sphere,
    random_plant,
    run_of,
    sizes,
    transmit,
)

pytestmark = pytest.mark.slow

SEEDS = st.integers(0, 2**32 - 1)
STEPS = pytest.mark.parametrize("step", [optimal_step, closed_form_step])
# The trace as the paper writes it.
printed_step = partial(optimal_step, criterion=plain_trace)
printed_fast_step = partial(closed_form_step, criterion=plain_trace)
PRINTED = pytest.mark.parametrize("step", [printed_step, printed_fast_step])
EXAMPLE = MeasuredPlant(liu2021.SYSTEM, liu2021.STATIC_OUTPUTS, liu2021.weights)


def unit_ball(lanes: tuple[int, ...], size: int) -> Ellipsoid:
    return Ellipsoid(np.zeros((*lanes, size)), np.broadcast_to(np.eye(size), (*lanes, size, size)))


def starting_ball(plant: MeasuredPlant[BoundedSystem], lanes: int) -> Ellipsoid:
    n, held = len(plant.system.transition(0)), len(plant.weights(plant.static_outputs))
    return unit_ball((lanes,), plant.length * n + held)


def followed(step, plant: MeasuredPlant[BoundedSystem], states, received, before=None):
    """Squared radii (cycles, lanes) of the truth, and the ellipsoids after each cycle."""
    cycles, lanes = received.values.shape[-2], len(states)
    kept = before or starting_ball(plant, lanes)
    radii, sets = [], []
    for cycle in range(cycles):
        kept = step(kept, augmented(plant, received, cycle), received.values[:, cycle]).after
        block = states[:, cycle * plant.length + 1 : (cycle + 1) * plant.length + 1]
        held = received.values[:, cycle, plant.static_outputs :]
        truth = np.concatenate([block.reshape(lanes, -1), held], axis=-1)
        radii.append(squared_radius(kept, truth))
        sets.append(kept)
    return np.array(radii), sets


def example_run(cycles: int = 13):
    noise = liu2021.printed_noise(3 * cycles)[None]
    states, outputs = liu2021.SYSTEM.simulate(liu2021.INITIAL_STATE[None], noise)
    return states, transmit(outputs, liu2021.STATIC_OUTPUTS, liu2021.weights)


def test_traces_on_the_papers_noise_are_the_known_ones():
    # An independent implementation of corollary 1; see the specification of the paper, section 4.
    known = [
        16.83, 13.05, 13.81, 22.89, 31.46, 14.37, 10.33, 13.31, 29.05, 16.06, 8.97, 9.38, 10.91,
    ]  # fmt: skip
    _, sets = followed(printed_step, EXAMPLE, *example_run())
    traces = [np.trace(shape_matrix(one)[0]) for one in sets]
    np.testing.assert_allclose(traces, known, rtol=1e-3)


def test_the_printed_matrix_inequality_holds():
    # (20) with Omega, Xi, Sigma and W as printed, and P, L and multipliers that were found.
    _, received = example_run()
    kept = starting_ball(EXAMPLE, 1)
    for cycle in range(6):
        model = augmented(EXAMPLE, received, cycle)
        bound = smallest_bound(problem(kept, model, turned(kept.factor, model)), plain_trace)
        step = printed_step(kept, model, received.values[:, cycle])
        e1, e2, rho = bound.multipliers[0]
        a, b, c, d, candidates, candidates_noise = _printed(model)
        r, w_inverse = kept.factor[0], np.eye(3) / 10.0
        sigma = np.hstack(
            [(candidates @ kept.centre[0])[:, None], candidates @ r, candidates_noise]
        )
        winner = int(model.winner[0])
        q = np.diag(liu2021.weights(0))
        select = np.zeros((2, 2))
        select[1 - winner, 1 - winner], select[winner, winner] = 1.0, -1.0
        xi = rho * sigma.T @ (q @ select) @ sigma
        omega = np.zeros_like(xi)
        omega[0, 0] = -1 + e1 + 3 * e2
        omega[1:15, 1:15] = -e1 * np.eye(14)
        omega[15:, 15:] = -e2 * w_inverse
        gain = step.gain[0]
        gamma = np.hstack([np.zeros((14, 1)), (a - gain @ c) @ r, b - gain @ d])
        whole = np.block([[omega - xi, gamma.T], [gamma, -shape_matrix(step.after)[0]]])
        assert np.linalg.eigvalsh(whole).max() <= 1e-8
        kept = step.after


def _printed(model: AugmentedCycle):
    """Matrices of (16) on noise w as printed, not in units of its bound."""
    bound = liu2021.NOISE_BOUND
    return (
        model.transition[0], model.noise[0, :, :, 0] / bound,
        model.output[0], model.output_noise[0, :, :, 0] / bound,
        model.candidates, model.candidates_noise[..., 0] / bound,
    )  # fmt: skip


@STEPS
@settings(max_examples=20)
@given(of=sizes(), seed=SEEDS)
def test_no_noise_within_the_bounds_gets_out(step, of: Sizes, seed: int):
    rng = np.random.default_rng(seed)
    plant = random_plant(rng, of, steps=20)
    states, received = run_of(rng, plant, lanes=4, cycles=3)
    radii, _ = followed(step, plant, states, received)
    assert (radii <= 1).all()


@STEPS
def test_an_adversary_gets_to_the_edge_and_not_beyond(step):
    # Noise of each cycle chosen as the worst for the gain that the closed form will have.
    rng = np.random.default_rng(4)
    noise = []
    start = on_the_sphere(rng, 1, 4)
    for _ in range(8):
        ends = [np.append(np.ravel(noise), signs) for signs in _all_ends(3)]
        values = []
        for trial in ends:
            states, outputs = liu2021.SYSTEM.simulate(start, trial.reshape(1, -1, 1))
            received = transmit(outputs, 2, liu2021.weights)
            radii, _ = followed(closed_form_step, EXAMPLE, states, received)
            values.append(radii[-1, 0])
        noise.append(ends[int(np.argmax(values))][-3:])
    states, outputs = liu2021.SYSTEM.simulate(start, np.array(noise).reshape(1, -1, 1))
    received = transmit(outputs, 2, liu2021.weights)
    radii, _ = followed(step, EXAMPLE, states, received)
    assert 0.5 < radii.max() <= 1


def _all_ends(count: int) -> np.ndarray:
    return np.stack(np.meshgrid(*[[-1.0, 1.0]] * count), -1).reshape(-1, count)


@settings(max_examples=15)
@given(of=sizes(), seed=SEEDS)
def test_with_nobody_to_lose_the_closed_form_is_the_optimum(of: Sizes, seed: int):
    rng = np.random.default_rng(seed)
    of = of._replace(static=max(of.static, of.outputs - 1))
    plant = random_plant(rng, of, steps=20)
    _, received = run_of(rng, plant, lanes=2, cycles=1)
    before = starting_ball(plant, 2)
    model = augmented(plant, received, 0)
    exact = printed_step(before, model, received.values[:, 0])
    fast = printed_fast_step(before, model, received.values[:, 0])
    traces = [np.trace(shape_matrix(s.after), axis1=-2, axis2=-1) for s in (exact, fast)]
    np.testing.assert_allclose(*traces, rtol=1e-5)
    np.testing.assert_allclose(exact.gain, fast.gain, atol=1e-2 * np.abs(fast.gain).max())


@settings(max_examples=15)
@given(of=sizes(contending=2), seed=SEEDS)
def test_what_the_losers_say_only_helps(of: Sizes, seed: int):
    rng = np.random.default_rng(seed)
    plant = random_plant(rng, of, steps=20)
    _, received = run_of(rng, plant, lanes=3, cycles=1)
    before, model = starting_ball(plant, 3), augmented(plant, received, 0)
    exact = printed_step(before, model, received.values[:, 0])
    fast = printed_fast_step(before, model, received.values[:, 0])
    traces = [np.trace(shape_matrix(s.after), axis1=-2, axis2=-1) for s in (exact, fast)]
    assert (traces[0] <= traces[1] * (1 + 1e-5)).all()


@PRINTED
@settings(max_examples=15)
@given(of=sizes(), seed=SEEDS, wider=st.floats(1.0, 3.0))
def test_wider_bounds_never_give_a_smaller_ellipsoid(step, of: Sizes, seed: int, wider: float):
    rng = np.random.default_rng(seed)
    plant = random_plant(rng, of, steps=20)
    _, received = run_of(rng, plant, lanes=2, cycles=1)
    before = starting_ball(plant, 2)
    loose = MeasuredPlant(_with_wider_noise(plant.system, wider), *plant[1:])
    values = received.values[:, 0]
    tight = step(before, augmented(plant, received, 0), values).after
    wide_noise = step(before, augmented(loose, received, 0), values).after
    wide_prior = before._replace(factor=wider * before.factor)
    wide_start = step(wide_prior, augmented(plant, received, 0), values).after
    trace = np.trace(shape_matrix(tight), axis1=-2, axis2=-1)
    for other in (wide_noise, wide_start):
        assert (trace <= np.trace(shape_matrix(other), axis1=-2, axis2=-1) * (1 + 1e-5)).all()


def _with_wider_noise(system: BoundedSystem, factor: float) -> BoundedSystem:
    return BoundedSystem(
        system.transition,
        system.noise_input,
        system.output,
        system.feedthrough,
        lambda k: factor**2 * system.noise_shape(k),
    )


@STEPS
@settings(max_examples=15)
@given(of=sizes(), seed=SEEDS, rank=st.integers(0, 2))
def test_flat_ellipsoids_need_no_inverse(step, of: Sizes, seed: int, rank: int):
    # The state is known exactly but in a few directions, and the held values are known.
    rng = np.random.default_rng(seed)
    plant = random_plant(rng, of, steps=20)
    size = starting_ball(plant, 1).centre.shape[-1]
    n, first = of.states, (plant.length - 1) * of.states
    factor = np.zeros((3, size, max(rank, 1)))
    factor[:, first : first + n, :rank] = rng.standard_normal((3, n, rank))
    centre = np.zeros((3, size))
    centre[:, first : first + n] = rng.standard_normal((3, n))
    u = on_the_sphere(rng, 3, max(rank, 1))
    start = centre[:, first : first + n] + multiply(factor[:, first : first + n], u)
    noise = on_the_sphere(rng, 3, 2 * plant.length, of.noises)
    states, outputs = plant.system.simulate(start, noise)
    received = transmit(outputs, plant.static_outputs, plant.weights)
    radii, _ = followed(step, plant, states, received, Ellipsoid(centre, factor))
    assert (radii <= 1).all()


@PRINTED
def test_long_runs_of_the_unstable_plant_stay_inside(step):
    rng = np.random.default_rng(7)
    states, received = run_of(rng, EXAMPLE, lanes=4, cycles=100)
    assert np.abs(states).max() > 1e18
    radii, sets = followed(step, EXAMPLE, states, received)
    assert (radii <= 1).all()
    # As long as rounding is small, the sets do not grow with the state: spec, section 4.
    traces = np.array([np.trace(shape_matrix(one), axis1=-2, axis2=-1) for one in sets])
    assert traces[14:40].max() < 60


def test_a_wrong_sign_and_a_wrong_rule_are_found_out():
    rng = np.random.default_rng(1)
    states, received = run_of(rng, EXAMPLE, lanes=100, cycles=13)

    def flipped(before, model, values):
        return optimal_step(before, model._replace(weights=-model.weights), values)

    radii, _ = followed(flipped, EXAMPLE, states, received)
    assert (radii > 1).any()
    states, outputs = liu2021.SYSTEM.simulate(states[:, 0], on_the_sphere(rng, 100, 39, 1))
    by_value = delivered(bus_by_value(BUS), 2, outputs)
    radii, _ = followed(optimal_step, EXAMPLE, states, by_value)
    assert (radii > 1).any()
    # Without the terms of the losers it does not matter who won.
    radii, _ = followed(closed_form_step, EXAMPLE, states, by_value)
    assert (radii <= 1).all()


@STEPS
def test_a_lost_lane_hurts_nobody(step):
    rng = np.random.default_rng(2)
    _, received = run_of(rng, EXAMPLE, lanes=3, cycles=2)
    before = starting_ball(EXAMPLE, 3)
    centre = before.centre.copy()
    centre[1, 0] = np.nan
    model = augmented(EXAMPLE, received, 0)
    hurt = step(Ellipsoid(centre, before.factor), model, received.values[:, 0]).after
    whole = step(before, model, received.values[:, 0]).after
    assert np.isnan(hurt.factor[1]).all()
    # Not the factors: rounding decides the sign of a column that is nearly zero.
    alone, beside = shape_matrix(whole)[[0, 2]], shape_matrix(hurt)[[0, 2]]
    np.testing.assert_allclose(beside, alone, atol=1e-9)


@settings(max_examples=20)
@given(seed=st.integers(0, 2**32 - 1), thin=st.integers(0, 16), noise=st.integers(-10, 0))
@example(seed=30, thin=14, noise=-10)
@example(seed=25, thin=14, noise=-8)
def test_the_programme_is_never_larger_than_the_closed_form(seed: int, thin: int, noise: int):
    """From an ellipsoid that is flat in all directions but one, 10^-thin wide, with noise as small:
    the programme was up to 3e4 times as large."""
    rng = np.random.default_rng(seed)
    plant = random_plant(rng, Sizes(int(rng.integers(2, 5)), int(rng.integers(2, 4)), 1, 1))
    system, small = plant.system, 10.0**noise
    quiet = replace(
        system,
        noise_input=lambda k: small * system.noise_input(k),
        feedthrough=lambda k: small * system.feedthrough(k),
    )
    plant = plant._replace(system=quiet)
    states, received = run_of(rng, plant, lanes=2, cycles=1)
    n, held = states.shape[-1], system.output(0).shape[0] - plant.static_outputs
    size, first = plant.length * n + held, (plant.length - 1) * n
    factor, centre = np.zeros((2, size, n)), np.zeros((2, size))
    widths = np.where(np.arange(n) == 0, 1.0, 10.0**-thin)
    factor[:, first : first + n] = np.linalg.qr(rng.normal(size=(n, n)))[0] * widths
    centre[:, first : first + n] = states[:, 0]
    model, values = augmented(plant, received, 0), received.values[:, 0]
    paper, closed = (
        (step(Ellipsoid(centre, factor), model, values, plain_trace).after.factor ** 2).sum((1, 2))
        for step in (optimal_step, closed_form_step)
    )
    assert (paper <= closed * 1.0011).all()
