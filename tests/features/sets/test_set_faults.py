"""The guarantee under faults: a lost frame widens a set, and no set survives a contradiction."""

import numpy as np
import pytest

from concord.features.measurement_bus.measurement_bus import (
    BID_RESOLUTION,
    MeasurementBus,
    round_robin,
)
from concord.features.sets import liu2021_plant as liu2021
from concord.features.sets.bounded import BoundedSystem
from concord.features.sets.filters.bus_readings import (
    MeasuredPlant,
    augmented,
    cycle_evidence,
    step_evidence,
)
from concord.features.sets.filters.closed_form import closed_form_step
from concord.features.sets.filters.criterion import plain_trace
from concord.features.sets.filters.ellipsoid import Ellipsoid, squared_radius
from concord.features.sets.filters.evidence import BoundedMotion, Readings, bus_evidence
from concord.features.sets.filters.histories import sets_over
from concord.features.sets.filters.lifted_cycle import DeliveredValues
from concord.features.sets.filters.recursive_estimator import optimal_step
from concord.features.sets.filters.tight_estimator import conditioned
from concord.features.sets.filters.zonotope import Zonotope, gauge, half_widths
from concord.features.sets.filters.zonotope_filter import zonotope_step
from tests.features.sets.bounded_systems import on_the_sphere, run_of, transmit
from tests.features.sets.set_units import METHODS, Units, in_units

pytestmark = pytest.mark.slow

EXAMPLE = MeasuredPlant(liu2021.SYSTEM, liu2021.STATIC_OUTPUTS, liu2021.weights)
LANES = 200
ONE = Units(np.ones(liu2021.STATES), np.ones(liu2021.OUTPUTS))
STATIC = liu2021.STATIC_OUTPUTS
METHOD = pytest.mark.parametrize("method", METHODS)
STEPS = pytest.mark.parametrize("step", [optimal_step, closed_form_step])


def losing(rng: np.random.Generator, received: DeliveredValues, share: float) -> DeliveredValues:
    """Static frames that are lost at random, each in its lane."""
    values = received.values.copy()
    gone = rng.uniform(size=values.shape) < share
    gone[..., STATIC:] = False
    values[gone] = np.nan
    return received._replace(values=values)


@METHOD
def test_a_lost_frame_costs_width_and_no_lane(method: str):
    rng = np.random.default_rng(1)
    states, received = run_of(rng, EXAMPLE, lanes=40, cycles=8)
    whole = METHODS[method](EXAMPLE, received, ONE)
    less = METHODS[method](EXAMPLE, losing(rng, received, 0.3), ONE)
    assert np.isfinite(less.half_widths).all()
    assert less.half_widths.sum() > whole.half_widths.sum()
    # The half-widths hold the state after each step, or after each cycle.
    spacing = 24 // len(less.centre)
    truth = states[:, spacing::spacing].swapaxes(0, 1)
    assert (np.abs(truth - less.centre) <= less.half_widths * (1 + 1e-9)).all()


@STEPS
def test_ellipsoids_hold_the_whole_state_while_frames_are_lost(step):
    rng = np.random.default_rng(2)
    states, received = run_of(rng, EXAMPLE, lanes=60, cycles=8)
    heard = losing(rng, received, 0.3)
    size = 3 * liu2021.STATES + 2
    kept = _ball(60, size)
    for cycle in range(8):
        kept = step(kept, augmented(EXAMPLE, heard, cycle), heard.values[:, cycle]).after
        block = states[:, cycle * 3 + 1 : cycle * 3 + 4].reshape(60, -1)
        truth = np.concatenate([block, received.values[:, cycle, STATIC:]], axis=-1)
        assert (squared_radius(kept, truth) <= 1).all()


def _ball(lanes: int, size: int) -> Ellipsoid:
    return Ellipsoid(np.zeros((lanes, size)), np.broadcast_to(np.eye(size), (lanes, size, size)))


@METHOD
def test_a_cycle_in_which_no_contending_output_is_heard(method: str):
    # The bus tells the sensors: what is held stays, on both sides.
    rng = np.random.default_rng(3)
    lanes, cycles = 20, 6
    noise = on_the_sphere(rng, lanes, 3 * cycles, 1)
    states, outputs = liu2021.SYSTEM.simulate(on_the_sphere(rng, lanes, liu2021.STATES), noise)
    gone = rng.uniform(size=(lanes, cycles)) < 0.4
    held = np.zeros((lanes, 2))
    values, before, winners, limits = [], [], [], []
    for cycle in range(cycles):
        now = outputs[:, 3 * cycle + 2, STATIC:]
        change = liu2021.weights(0) * (now - held) ** 2
        winner = np.where(gone[:, cycle], -1, change.argmax(-1))
        before.append(held)
        winners.append(winner)
        limits.append(change.max(-1) * (1 + BID_RESOLUTION))
        held = np.where(np.arange(2) == winner[:, None], now, held)
        turns = [outputs[:, 3 * cycle + output, output] for output in range(STATIC)]
        values.append(np.concatenate([np.stack(turns, -1), held], -1))
    parts = values, before, winners, limits
    received = DeliveredValues(*(np.stack(part, 1) for part in parts))
    found = METHODS[method](EXAMPLE, received, ONE)
    spacing = 3 * cycles // len(found.centre)
    truth = states[:, spacing::spacing].swapaxes(0, 1)
    assert (np.abs(truth - found.centre) <= found.half_widths * (1 + 1e-9)).all()


@METHOD
def test_a_contradiction_leaves_no_set(method: str):
    # The state begins a hundred radii outside of the ball that is said to hold it.
    rng = np.random.default_rng(4)
    start = 100.0 * on_the_sphere(rng, 20, liu2021.STATES)
    noise = on_the_sphere(rng, 20, 24, 1)
    _, outputs = liu2021.SYSTEM.simulate(start, noise)
    received = transmit(outputs, STATIC, liu2021.weights)
    found = METHODS[method](EXAMPLE, received, ONE)
    assert np.isnan(found.half_widths[-1]).all()
    # A lost lane stays alone: the paper's own sequence beside it is untouched.
    _, outputs = liu2021.SYSTEM.simulate(np.concatenate([start[:1], start[1:2] / 100]), noise[:2])
    received = transmit(outputs, STATIC, liu2021.weights)
    found = METHODS[method](EXAMPLE, received, ONE)
    assert np.isnan(found.half_widths[-1, 0]).all()
    assert np.isfinite(found.half_widths[:, 1]).all()


def test_zonotopes_hold_the_state_while_frames_are_lost():
    rng = np.random.default_rng(5)
    states, received = run_of(rng, EXAMPLE, lanes=3, cycles=4)
    heard = losing(rng, received, 0.4)
    kept, step = Zonotope(*_ball(3, liu2021.STATES)), 0
    for cycle in range(4):
        for evidence in step_evidence(EXAMPLE, heard, cycle):
            kept, step = zonotope_step(kept, evidence), step + 1
            for lane in range(3):
                own = Zonotope(kept.centre[lane], kept.generators[lane])
                assert gauge(own, states[lane, step]) <= 1 + 1e-6
    assert step == 12


def test_the_gap_of_a_step_bounds_how_far_its_trace_is_from_the_least():
    rng = np.random.default_rng(6)
    _, received = run_of(rng, EXAMPLE, lanes=5, cycles=1)
    evidence, before = cycle_evidence(EXAMPLE, received, 0), _ball(5, liu2021.STATES)
    best = conditioned(before, evidence, plain_trace)
    least = (best.after.factor**2).sum((-1, -2))
    assert (best.gap <= 1e-5).all()
    for accuracy in (0.5, 1e-2):
        found = conditioned(before, evidence, plain_trace, accuracy)
        trace = (found.after.factor**2).sum((-1, -2))
        assert (found.gap <= 1.5 * accuracy).all()
        assert (least < trace).all()
        assert (trace * (1 - found.gap) <= least * (1 + 1e-9)).all()
    paper = optimal_step(_ball(5, 14), augmented(EXAMPLE, received, 0), received.values[:, 0])
    assert (paper.gap <= 1e-5).all()


@METHOD
@pytest.mark.parametrize("scale", [1e-6, 1e-3, 1.0, 1e3, 1e6])
def test_the_arbitration_of_the_bus_keeps_the_guarantee_in_any_unit_of_the_outputs(
    method: str, scale: float
):
    units = Units(np.ones(liu2021.STATES), np.full(liu2021.OUTPUTS, scale))
    plant = in_units(EXAMPLE, units)._replace(weights=liu2021.weights)
    rng = np.random.default_rng(7)
    noise = on_the_sphere(rng, LANES, 39, 1)
    states, outputs = plant.system.simulate(on_the_sphere(rng, LANES, liu2021.STATES), noise)
    received = transmit(outputs, STATIC, plant.weights)
    found = sets_over(plant, received, np.zeros(liu2021.STATES), np.eye(liu2021.STATES), method)
    steps, outside = 39 // len(found.sets), 0
    for number, one in enumerate(found.sets):
        block = states[:, steps * number + 1 : steps * (number + 1) + 1].reshape(LANES, -1)
        if isinstance(one, Zonotope):
            outside += int((~(np.abs(block - one.centre) <= half_widths(one)).all(-1)).sum())
            continue
        if method in ("paper", "fast"):
            # Their ellipsoid holds the values of the contending outputs too.
            block = np.hstack([block, received.values[:, number, STATIC:]])
        outside += int((~(squared_radius(one, block) <= 1.0)).sum())
    assert (len(found.sets) * LANES) in (2600, 7800)
    assert outside == 0


def test_two_changes_that_tie_in_the_bus_are_within_the_strip():
    # The loser's change is the larger one, by less than the resolution of bids.
    change = np.array([1.0, np.sqrt(1 + 0.9 * BID_RESOLUTION)])
    received = transmit(change[None], 0, lambda _: np.ones(2))
    assert received.winner == [0]
    rows = Readings(np.eye(2), np.zeros((2, 1, 1)), change, np.zeros(2))
    still = BoundedMotion(np.eye(2), np.zeros((2, 1, 1)))
    limit = received.limit[0]
    evidence = bus_evidence(still, rows, 0, np.ones(2), np.zeros(2), np.array(0), limit)
    assert evidence.bounded.half_widths[0] >= change[1]


# --- refusals ------------------------------------------------------------------------------------


def test_sizes_and_weights_that_do_not_fit_are_refused_in_a_sentence():
    _, received = run_of(np.random.default_rng(8), EXAMPLE, lanes=1, cycles=1)
    model, values = augmented(EXAMPLE, received, 0), received.values[:, 0]
    for step in (optimal_step, closed_form_step):
        with pytest.raises(ValueError, match="for 14 augmented states"):
            step(_ball(1, 13), model, values)
        with pytest.raises(ValueError, match="3 received values for 4 outputs"):
            step(_ball(1, 14), model, values[:, :3])
    with pytest.raises(ValueError, match="an ellipsoid of 3 states for a plant of 4"):
        conditioned(_ball(1, 3), cycle_evidence(EXAMPLE, received, 0))
    for weights in ([2.0, -1.0], [1.0]):
        wrong = EXAMPLE._replace(weights=lambda _, given=weights: np.array(given))
        with pytest.raises(ValueError, match="of 2 contending outputs; give one positive"):
            augmented(wrong, received, 0)


@pytest.mark.parametrize(
    ("centre", "shape", "says"),
    [
        (np.zeros(3), np.eye(4), "for a plant of 4 states"),
        (np.zeros(4), np.eye(3), "for a plant of 4 states"),
        (np.zeros(4), -np.eye(4), "without a negative eigenvalue"),
        (np.zeros(4), np.full((4, 4), np.nan), "finite"),
        (np.zeros(4), np.triu(np.ones((4, 4))), "symmetric"),
    ],
)
def test_a_first_set_that_is_no_ellipsoid_of_the_states_is_refused(
    centre: np.ndarray, shape: np.ndarray, says: str
):
    _, received = run_of(np.random.default_rng(8), EXAMPLE, lanes=1, cycles=1)
    with pytest.raises(ValueError, match=says):
        sets_over(EXAMPLE, received, centre, shape)


def test_a_singular_noise_shape_is_a_bound_and_an_indefinite_one_is_refused():
    flat = np.array([[4.0, 2.0], [2.0, 1.0]])
    root = _with_shape(flat).noise_factor(0)
    np.testing.assert_allclose(root @ root.T, flat, atol=1e-12)
    with pytest.raises(ValueError, match="least eigenvalue -1"):
        _with_shape(np.diag([1.0, -1.0])).noise_factor(0)


def _with_shape(shape: np.ndarray) -> BoundedSystem:
    nothing = np.zeros((1, 1))
    return BoundedSystem(
        lambda _: nothing, lambda _: nothing, lambda _: nothing, lambda _: nothing, lambda _: shape
    )


def test_a_weight_with_a_negative_eigenvalue_is_refused():
    with pytest.raises(ValueError, match="weight of sensor 1 has the eigenvalue -1"):
        MeasurementBus((1,), round_robin(1, [1]), (-np.eye(1),))
