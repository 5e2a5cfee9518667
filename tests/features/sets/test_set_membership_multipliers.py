"""The convex problem behind the ellipsoids: its certificate, its optimum, its lanes."""

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog

from concord.features.sets.filters.barrier_path import least_cost
from concord.features.sets.filters.criterion import plain_trace
from concord.features.sets.filters.ellipsoid import sum_factor
from concord.features.sets.filters.multipliers import (
    ACCURACY,
    Problem,
    certified_bound,
    optimal_multipliers,
    smallest_bound,
)

SEEDS = st.integers(0, 2**32 - 1)


def random_problem(rng: np.random.Generator, balls: int = 2, strips: int = 2) -> Problem:
    """Balls over parts of p, strips and a difference of squares through it, something to hold."""
    widths = rng.integers(1, 3, balls)
    size = 1 + int(widths.sum())
    terms, first = [], 1
    for width in widths:
        diagonal = np.zeros(size)
        diagonal[first : first + width] = 1.0
        diagonal[0] = -1.0
        terms.append(np.diag(diagonal))
        first += width
    for _ in range(strips):
        row = rng.standard_normal(size) * np.r_[0.3, np.ones(size - 1)]
        term = np.outer(row, row)
        term[0, 0] -= rng.uniform(0.3, 1.5) ** 2
        terms.append(term)
    loser, winner = rng.standard_normal((2, size))
    terms.append(np.outer(loser, loser) - np.outer(winner, winner))
    image = rng.standard_normal((3, size)) * np.r_[0.0, np.ones(size - 1)]
    known = np.vstack([np.eye(size)[0], rng.standard_normal(size)])
    return Problem(np.array(terms), balls, image, known)


def largest_excess(problem: Problem, theta: np.ndarray) -> np.ndarray:
    """max theta' T theta (k,) over the terms: at most 0 where theta (k, d) is possible."""
    return np.einsum("ki,cij,kj->kc", theta, problem.terms, theta).max(-1)


@settings(max_examples=40)
@given(seed=SEEDS)
def test_the_matrix_inequality_holds_and_with_it_every_possible_point(seed: int):
    rng = np.random.default_rng(seed)
    problem = random_problem(rng)
    bound = smallest_bound(problem)
    size = problem.image.shape[-1]
    points = rng.uniform(-1.2, 1.2, (4000, size))
    points[:, 0] = 1.0
    possible = points[largest_excess(problem, points) <= 0]
    if np.isnan(bound.multipliers).any():
        assert not len(possible)
        return
    matrix = np.einsum("c,cij->ij", bound.multipliers, problem.terms)
    matrix[0, 0] += 1.0
    gamma = problem.image - bound.gain @ problem.known
    shape = bound.factor @ bound.factor.T
    whole = np.block([[matrix, gamma.T], [gamma, shape]])
    assert np.linalg.eigvalsh(whole).min() >= -1e-9 * np.abs(whole).max()
    # The proof in numbers: whatever meets the terms is inside.
    errors = possible @ gamma.T
    # Inside means: not beyond the support in any direction; P itself may be singular.
    directions = rng.standard_normal((60, 3))
    support = np.sqrt(np.einsum("ki,ij,kj->k", directions, shape, directions))
    assert (errors @ directions.T <= support * (1 + 1e-9) + 1e-12).all()


@settings(max_examples=25)
@given(seed=SEEDS)
@example(seed=2_285_437_232)
@example(seed=2_097_151)
def test_any_feasible_multipliers_prove_an_ellipsoid_but_none_a_smaller_one(seed: int):
    rng = np.random.default_rng(seed)
    problem = random_problem(rng)
    best, below = optimal_multipliers(problem)
    least = (certified_bound(problem, best).factor ** 2).sum()
    assume(np.isfinite(least))
    # The last barrier is relative to the trace of the one before, which may be some times larger.
    assert least * (1 - 4 * ACCURACY) <= below <= least
    for _ in range(30):
        other = best * np.exp(rng.normal(0.0, 0.3, best.shape))
        bound = certified_bound(problem, other)
        trace = (bound.factor**2).sum()
        assert np.isnan(trace) or trace >= least * (1 - 1e-5)


@settings(max_examples=40)
@given(seed=SEEDS)
def test_the_least_cost_of_two_variables_is_that_of_a_linear_programme(seed: int):
    rng = np.random.default_rng(seed)
    rows = rng.standard_normal((4, 6, 2))
    rows[:, 3] = -2.0 * rows[:, 2]  # Parallel rows, which meet nowhere.
    rows[:, 4], rows[:, 5] = (-1.0, 0.0), (0.0, -1.0)
    most, cost = rng.standard_normal((4, 6)), rng.uniform(0.1, 2.0, (4, 2))
    most[:, 4:] = 0.0
    for lane, least in enumerate(least_cost(rows, most, cost)):
        solved = linprog(cost[lane], rows[lane], most[lane])
        expected = solved.fun if solved.status == 0 else np.inf
        assert least == pytest.approx(expected, rel=1e-6, abs=1e-6)


@settings(max_examples=25)
@given(seed=SEEDS)
def test_two_balls_give_the_sum_of_two_ellipsoids(seed: int):
    rng = np.random.default_rng(seed)
    balls = np.array([np.diag([-1.0, 1, 1, 0, 0, 0]), np.diag([-1.0, 0, 0, 1, 1, 1])])
    image = np.hstack([np.zeros((3, 1)), rng.standard_normal((3, 5))])
    bound = smallest_bound(Problem(balls, 2, image, np.eye(6)[:1]), plain_trace)
    closed = sum_factor(image[:, 1:3], image[:, 3:], plain_trace)
    assert (bound.factor**2).sum() == pytest.approx((closed**2).sum(), rel=1e-5)


def test_against_a_semidefinite_solver():
    pytest.importorskip("cvxpy")
    pytest.importorskip("clarabel")
    from concord.papers.liu2021.solver import matrix_inequality

    rng = np.random.default_rng(0)
    for _ in range(8):
        problem = random_problem(rng)
        solution = matrix_inequality(problem)(problem)
        assert solution.status == "optimal"
        ours = (smallest_bound(problem, plain_trace).factor ** 2).sum()
        assert ours == pytest.approx(np.trace(solution.shape), rel=1e-5)


def test_terms_that_contradict_each_other_lose_their_lane_and_no_other():
    ball = np.diag([-1.0, 1.0])
    apart = np.array([[3.0**2 - 1.0, -3.0], [-3.0, 1.0]])  # |p - 3| <= 1
    beside = np.array([[1.5**2 - 1.0, -1.5], [-1.5, 1.0]])  # |p - 1.5| <= 1
    terms = np.array([[ball, apart], [ball, beside]])
    image, known = np.array([[0.0, 1.0]]), np.array([[1.0, 0.0]])
    bound = smallest_bound(Problem(terms, 2, image, known))
    assert np.isnan(bound.factor[0]).all()
    # Of [-1, 1] and [0.5, 2.5] half the one and half the other: (p - 0.75)^2 <= 1 - 1.5^2 / 4.
    assert bound.gain[1, 0, 0] == pytest.approx(0.75, abs=1e-3)
    assert np.linalg.norm(bound.factor[1]) == pytest.approx(np.sqrt(1 - 1.5**2 / 4), abs=1e-5)


@settings(max_examples=10)
@given(seed=SEEDS)
def test_lanes_do_not_know_of_each_other(seed: int):
    rng = np.random.default_rng(seed)
    one = random_problem(rng)
    noise = rng.uniform(0.9, 1.1, (4, 1, 1, 1))
    terms = (
        one.terms * np.where(np.arange(len(one.terms)) < 2, 1.0, noise[..., 0, 0])[..., None, None]
    )
    together = smallest_bound(one._replace(terms=terms))
    for lane in range(4):
        alone = smallest_bound(one._replace(terms=terms[lane]))
        np.testing.assert_allclose(
            (together.factor[lane] ** 2).sum(), (alone.factor**2).sum(), rtol=1e-6
        )


def test_nothing_to_hold_is_held_by_a_point():
    terms = np.array([np.diag([-1.0, 1.0])])
    bound = smallest_bound(Problem(terms, 1, np.zeros((2, 2)), np.eye(2)[:1]))
    np.testing.assert_array_equal(bound.factor, 0.0)
