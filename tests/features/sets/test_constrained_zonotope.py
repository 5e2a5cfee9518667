"""Constrained zonotopes: exact cuts, and sets that hold the truth whatever is reduced or solved."""

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.spatial import HalfspaceIntersection

from concord.features.sets.filters import constrained_zonotope as constrained
from concord.features.sets.filters.bus_readings import step_evidence
from concord.features.sets.filters.constrained_zonotope import (
    ConstrainedZonotope,
    around,
    constrained_step,
    joined,
)
from concord.features.sets.filters.evidence import (
    BoundedMotion,
    Readings,
    StepReadings,
    no_readings,
)
from concord.features.sets.filters.lifted_cycle import DeliveredValues
from concord.features.sets.filters.rounding import row_units
from concord.features.sets.filters.zonotope import Zonotope, half_widths
from concord.features.sets.filters.zonotope_filter import zonotope_step
from concord.filters.lanes import join_entries
from tests.features.sets.bounded_systems import Sizes, random_plant, run_of, sizes

SEEDS = st.integers(0, 2**32 - 1)
UNCUT = 10_000


def strips(rows: np.ndarray, values: np.ndarray, widths: np.ndarray) -> StepReadings:
    """|values - rows x| <= widths of a state that stays where it is."""
    m, n = rows.shape
    readings = Readings(rows, np.zeros((m, 1, 0)), values, widths)
    return StepReadings(
        BoundedMotion(np.eye(n), np.zeros((n, 1, 0))), no_readings(readings), readings
    )


def gauge(one: ConstrainedZonotope, point: np.ndarray) -> float:
    """Least max |xi_i| that gives a point (n,); at most 1 inside, inf if none does.

    The solver drops coefficients below 1e-9, so the value is what its multipliers prove.
    """
    centre, generators = one.lifted
    values = join_entries(point, np.zeros(len(centre) - one.states)) - centre
    found = constrained._shortest(generators, values)
    if not found.success:
        return float("inf")
    multipliers = found.eqlin.marginals / row_units(generators)
    return float(abs(multipliers @ values) / np.abs(multipliers @ generators).sum())


def holds(one: ConstrainedZonotope, truth: np.ndarray) -> bool:
    box = one.box
    return bool((np.abs(truth - box.centre) <= half_widths(box)).all())


@settings(max_examples=25, deadline=None)
@given(seed=SEEDS, of=sizes(), generators=st.integers(1, 30), constraints=st.integers(0, 12))
@example(seed=1837, of=Sizes(2, 4, 4, 1), generators=5, constraints=7)
def test_every_set_holds_the_truth(seed: int, of: Sizes, generators: int, constraints: int):
    rng = np.random.default_rng(seed)
    plant = random_plant(rng, of, steps=20)
    states, received = run_of(rng, plant, lanes=1, cycles=4)
    lane = DeliveredValues(*(part[0] for part in received))
    kept, step = around(Zonotope(np.zeros(of.states), np.eye(of.states))), 0
    for cycle in range(4):
        for evidence in step_evidence(plant, lane, cycle):
            kept, step = constrained_step(kept, evidence, generators, constraints), step + 1
            assert holds(kept, states[0, step])
            assert gauge(kept, states[0, step]) <= 1 + 1e-5
            rows, columns = kept.lifted.generators.shape
            assert rows <= of.states + constraints
            assert columns <= max(generators, of.states) + 2 * (rows - of.states)


@settings(max_examples=25, deadline=None)
@given(seed=SEEDS, of=sizes())
def test_a_step_is_never_larger_than_that_of_the_zonotope_filter(seed: int, of: Sizes):
    rng = np.random.default_rng(seed)
    plant = random_plant(rng, of, steps=20)
    _, received = run_of(rng, plant, lanes=1, cycles=2)
    lane = DeliveredValues(*(part[0] for part in received))
    kept = Zonotope(np.zeros(of.states), np.eye(of.states))
    for evidence in step_evidence(plant, lane, 0) + step_evidence(plant, lane, 1):
        exact = joined(around(kept), evidence).box
        kept = zonotope_step(kept, evidence, generators=UNCUT)
        ours, theirs = half_widths(exact), half_widths(kept)
        assert (ours <= theirs * (1 + 1e-9) + 1e-12).all()
        assert (np.abs(exact.centre - kept.centre) + ours <= theirs * (1 + 1e-9) + 1e-9).all()


@settings(max_examples=20, deadline=None)
@given(seed=SEEDS, count=st.integers(1, 6))
def test_a_cut_is_the_intersection(seed: int, count: int):
    """The corners of the same half-spaces, by another library."""
    rng = np.random.default_rng(seed)
    middle, sides = rng.standard_normal(2), rng.standard_normal((2, 2)) + 2 * np.eye(2)
    point = middle + sides @ rng.uniform(-0.9, 0.9, 2)
    rows, widths = rng.standard_normal((count, 2)), rng.uniform(0.1, 1.0, count)
    values = rows @ point + 0.9 * widths * rng.uniform(-1, 1, count)
    cut = constrained_step(around(Zonotope(middle, sides)), strips(rows, values, widths), 30, 10)
    inverse = np.linalg.inv(sides)
    faces = np.vstack([inverse, -inverse, rows, -rows])
    ends = np.concatenate(
        [1 + inverse @ middle, 1 - inverse @ middle, values + widths, widths - values]
    )
    corners = HalfspaceIntersection(np.column_stack([faces, -ends]), point).intersections
    box = cut.box
    np.testing.assert_allclose(box.centre - half_widths(box), corners.min(0), atol=1e-6)
    np.testing.assert_allclose(box.centre + half_widths(box), corners.max(0), atol=1e-6)
    for inside in rng.uniform(corners.min(0), corners.max(0), (20, 2)):
        slack = (ends - faces @ inside).min()
        if abs(slack) > 1e-6:
            assert (gauge(cut, inside) <= 1) == (slack > 0)


def test_no_accuracy_of_a_solver_is_trusted(monkeypatch: pytest.MonkeyPatch):
    rng = np.random.default_rng(4)
    rows = rng.standard_normal((4, 3))
    point = rng.uniform(-1, 1, 3)
    cut = joined(
        around(Zonotope(np.zeros(3), np.eye(3))), strips(rows, rows @ point, 0.1 * np.ones(4))
    )
    least = half_widths(cut.box)
    wrong = ConstrainedZonotope(3, cut.lifted)
    monkeypatch.setattr(
        constrained, "_of_programme", lambda along, rows, values: [rng.standard_normal(len(rows))]
    )
    assert holds(wrong, point)
    assert (half_widths(wrong.box) >= least * (1 - 1e-9)).all()


def test_readings_that_contradict_leave_no_set():
    square = around(Zonotope(np.zeros(2), np.eye(2)))
    rows = np.array([[1.0, 1.0], [1.0, -1.0]])
    # The corner (0.9, 0.9) is inside, and then (-0.9, -0.9) is not.
    one = constrained_step(square, strips(rows[:1], np.array([1.8]), np.array([0.1])))
    assert np.isfinite(one.box.centre).all()
    none = constrained_step(one, strips(rows[:1], np.array([-1.8]), np.array([0.1])))
    assert np.isnan(none.box.centre).all()
    again = constrained_step(none, strips(rows, np.zeros(2), np.ones(2)))
    assert np.isnan(again.box.generators).all()
    # Together no state explains these three, though each pair has common states.
    three = np.array([[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])
    none = constrained_step(square, strips(three, np.array([0.5, 0.5, 0.0]), 0.3 * np.ones(3)))
    assert np.isnan(none.box.centre).all()


def test_a_lost_reading_says_nothing():
    square = around(Zonotope(np.zeros(2), np.eye(2)))
    found = constrained_step(square, strips(np.eye(2), np.array([np.nan, 0.5]), 0.1 * np.ones(2)))
    np.testing.assert_allclose(half_widths(found.box), [1.0, 0.1], rtol=1e-9)
