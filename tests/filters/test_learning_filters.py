"""Filters that learn the noise of a sensor: every one of the table against theory."""

from functools import cache
from typing import NamedTuple, get_args

import numpy as np
import pytest
from scipy.stats import chi2

from concord.entries import summaries
from concord.filters.filter import Filter, LearningFilter
from concord.filters.gaussian import Gaussian
from concord.scenarios.filter_table.filters import build_filter
from concord.scenarios.scenario import FilterChoice
from concord.scenarios.types.filters import NoiseLearningFilter
from concord.scenarios.types.option import name_of
from tests.filters.support import (
    RANGE_BEARING_NOISE_COV,
    TURN_START,
    bearing_residual,
    range_bearing,
    turn,
)

CHOICES = {
    name_of(one): one for one in get_args(FilterChoice) if name_of(one) in summaries("FILTERS")
}
LEARNING = [name for name, one in CHOICES.items() if issubclass(one, NoiseLearningFilter)]
F = np.array([[1.0, 0.1], [0.0, 1.0]])
Q = np.diag([1e-3, 1e-2])
R = np.array([[0.25, 0.05], [0.05, 1.0]])


def learning(name: str, **options: float) -> LearningFilter:
    found = build_filter(CHOICES[name](**options), 2)
    assert isinstance(found, LearningFilter)
    return found


class Runs(NamedTuple):
    """Errors (steps, R, n), covariances (steps, R, n, n) and learnt factors (steps, R, m)."""

    error: np.ndarray
    cov: np.ndarray
    factors: np.ndarray


def simulated(own: LearningFilter, runs: int, steps: int, true_noise: np.ndarray) -> Runs:
    """Runs of a linear plant; the noise (steps,) is so many times the variance that is declared."""
    generator = np.random.default_rng(5)
    truth = generator.standard_normal((runs, 2))
    belief = Gaussian(np.zeros((runs, 2)), np.broadcast_to(np.eye(2), (runs, 2, 2)))
    memory, kept = own.begin((runs, 2)), []
    factor_q, factor_r = np.linalg.cholesky(Q), np.linalg.cholesky(R)
    for step in range(steps):
        truth = truth @ F.T + generator.standard_normal((runs, 2)) @ factor_q.T
        noise = generator.standard_normal((runs, 2)) @ factor_r.T
        z = truth + np.sqrt(true_noise[step]) * noise
        belief = own.predict(belief, lambda x: x @ F.T, Q)
        update, memory = own.update_and_learn(belief, memory, z, lambda x: x, R)
        belief = update.belief
        kept.append((belief.mean - truth, belief.cov, memory.variances))
    return Runs(*(np.array(part) for part in zip(*kept, strict=True)))


def anees(runs: Runs) -> float:
    """Of the last steps, over the number of states."""
    error, cov = runs.error[-50:], runs.cov[-50:]
    squared = np.vecdot(error, np.linalg.solve(cov, error[..., None])[..., 0])
    return float(squared.mean()) / 2


@pytest.mark.parametrize("name", LEARNING)
def test_the_right_noise_stays_and_the_filter_is_consistent(name: str):
    """The steps of a run are correlated, so the interval is that of runs alone, and of the fading
    average: a factor learnt from 50 readings has a deviation of a fifth."""
    found = simulated(learning(name, least_noise=0.01), 400, 200, np.ones(200))
    low, high = chi2.ppf([0.0005, 0.9995], 2 * 400) / (2 * 400)
    assert low - 0.05 < anees(found) < high + 0.05
    assert abs(np.log(found.factors[-50:]).mean()) < 0.1


@pytest.mark.parametrize("name", LEARNING)
@pytest.mark.parametrize("true", [1 / 16, 16.0])
def test_a_wrong_noise_is_replaced_by_the_right_one(name: str, true: float):
    found = simulated(learning(name, least_noise=1e-4), 200, 350, np.full(350, true))
    np.testing.assert_allclose(found.factors[-50:].mean(axis=(0, 1)), true, rtol=0.15)
    assert 0.8 < anees(found) < 1.25


GROWS = np.where(np.arange(400) < 150, 1.0, 9.0)


@cache
def anees_without_learning() -> float:
    """Return the consistency of a filter that believes in the first noise throughout."""
    return anees(simulated(Deaf(build_filter(CHOICES["ukf"](), 2)), 200, 400, GROWS))


@pytest.mark.parametrize("name", LEARNING)
def test_a_noise_that_grows_is_followed(name: str):
    found = simulated(learning(name), 200, 400, GROWS)
    np.testing.assert_allclose(found.factors[-50:].mean(axis=(0, 1)), 9.0, rtol=0.15)
    assert 0.8 < anees(found) < 1.25 < anees_without_learning() / 2


class Deaf(NamedTuple):
    """A filter as one that learns and never does."""

    own: Filter

    def predict(self, *arguments):
        return self.own.predict(*arguments)

    def update(self, *arguments, **options):
        return self.own.update(*arguments, **options)

    def begin(self, shape):
        return NoFactors(np.ones(shape))

    def update_and_learn(self, belief, memory, *arguments, **options):
        return self.own.update(belief, *arguments, **options), memory


class NoFactors(NamedTuple):
    variances: np.ndarray


# --- invariants ----------------------------------------------------------------------------------


def on_a_turn(
    own: LearningFilter, z: np.ndarray, scale: np.ndarray, start: Gaussian = TURN_START
) -> tuple[Gaussian, np.ndarray]:
    """The last belief and factors after readings (steps, ..., 2) in units of their own (2,)."""
    R, belief = RANGE_BEARING_NOISE_COV * np.outer(scale, scale), start
    memory = own.begin(z.shape[1:])
    for reading in z * scale:
        belief = own.predict(belief, turn, np.diag([1.0, 0.1, 1.0, 0.1, 1e-6]))
        update, memory = own.update_and_learn(
            belief,
            memory,
            reading,
            lambda x: range_bearing(x) * scale,
            R,
            residual=lambda a, b: bearing_residual(a / scale, b / scale) * scale,
            gate=1e3,
        )
        belief = update.belief
    return belief, memory.variances


def turn_readings(lanes: tuple[int, ...]) -> np.ndarray:
    generator = np.random.default_rng(8)
    truth, taken = TURN_START.mean, []
    for _ in range(60):
        truth = turn(truth)
        taken.append(range_bearing(truth) + generator.standard_normal((*lanes, 2)) * [20.0, 0.05])
    return np.array(taken)


@pytest.mark.parametrize("name", LEARNING)
@pytest.mark.parametrize("scale", [(1e-3, 1e3), (1e3, 1e-3), (1e-6, 1e-6)])
def test_the_unit_of_a_channel_changes_nothing(name: str, scale: tuple[float, float]):
    own, z = build_filter(CHOICES[name](), 5), turn_readings(())
    assert isinstance(own, LearningFilter)
    usual, factors = on_a_turn(own, z, np.ones(2))
    found, scaled = on_a_turn(own, z, np.array(scale))
    np.testing.assert_allclose(found.mean, usual.mean, rtol=1e-6)
    np.testing.assert_allclose(found.cov, usual.cov, rtol=1e-5, atol=1e-9)
    np.testing.assert_allclose(scaled, factors, rtol=1e-6)


@pytest.mark.parametrize("name", LEARNING)
def test_lanes_are_filtered_as_alone_and_fail_alone(name: str):
    own, z = build_filter(CHOICES[name](), 5), turn_readings((5,))
    assert isinstance(own, LearningFilter)
    z[::3, 1, 0], z[20:30, 2], z[40, 3] = np.nan, np.nan, 1e8
    mean, cov = np.repeat(TURN_START.mean[None], 5, 0), np.repeat(TURN_START.cov[None], 5, 0)
    cov[4] = np.nan
    together, factors = on_a_turn(own, z, np.ones(2), Gaussian(mean, cov))
    for lane in range(4):
        alone, own_factors = on_a_turn(own, z[:, lane], np.ones(2))
        np.testing.assert_allclose(together.mean[lane], alone.mean, rtol=1e-9)
        np.testing.assert_allclose(factors[lane], own_factors, rtol=1e-9)
    assert np.isnan(together.mean[4]).all() and np.isfinite(together.mean[:4]).all()
    assert np.isfinite(factors).all()


@pytest.mark.parametrize("name", [name for name in CHOICES if name != "imm"])
def test_one_wild_reading_does_not_end_a_filter_with_a_gate(name: str):
    """1e8 in both channels at step 30: what follows is nearly what would have followed."""
    if name == "kf":
        pytest.skip("refuses models that are not linear")
    own, z = build_filter(CHOICES[name](), 5), turn_readings(())
    usual = own if isinstance(own, LearningFilter) else Deaf(own)
    wild = z.copy()
    wild[30] = 1e8, 1.0
    expected, _ = on_a_turn(usual, z, np.ones(2))
    found, factors = on_a_turn(usual, wild, np.ones(2))
    assert np.isfinite(found.mean).all() and np.isfinite(found.cov).all()
    deviation = np.sqrt(np.diagonal(expected.cov))
    assert (np.abs(found.mean - expected.mean) / deviation).max() < 1.5
    assert (factors < 20).all()


@pytest.mark.parametrize("name", LEARNING)
def test_a_gated_reading_still_teaches_the_noise(name: str):
    """Else a filter that starts with too small an R would shut its sensor out for good."""
    own, belief = learning(name), Gaussian(np.zeros(2), 0.01 * np.eye(2))
    memory = own.begin((2,))
    reading = np.array([30.0, -30.0])
    first, _ = own.update_and_learn(belief, memory, reading, lambda x: x, R, gate=16.0)
    np.testing.assert_array_equal(first.belief.mean, belief.mean)
    for _ in range(150):
        memory = own.update_and_learn(belief, memory, reading, lambda x: x, R, gate=16.0)[1]
    then, _ = own.update_and_learn(belief, memory, reading, lambda x: x, R, gate=16.0)
    assert (memory.variances > 50).all() and then.belief.mean[0] > 0


@pytest.mark.parametrize("name", LEARNING)
def test_learnt_noise_stays_within_its_bounds(name: str):
    own = learning(name, least_noise=0.5, most_noise=2.0)
    for size, bound in ((0.0, 0.5), (50.0, 2.0)):
        memory, belief = own.begin((2,)), Gaussian(np.zeros(2), 0.01 * np.eye(2))
        for step in range(200):
            reading = np.full(2, size * (-1) ** step)
            memory = own.update_and_learn(belief, memory, reading, lambda x: x, R)[1]
        np.testing.assert_allclose(memory.variances, bound)
