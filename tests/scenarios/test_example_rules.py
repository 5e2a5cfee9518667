"""The rules of examples/rules, each against a case that is computed by hand."""

import importlib.util
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

import concord as cc
from concord.filters.gaussian import Gaussian

FOLDER = Path(__file__).resolve().parents[2] / "examples" / "rules"
RULES = {
    "largest_ellipsoid": "largest_ellipsoid",
    "inverse_intersection": "inverse",
    "split_intersection": "SPLIT",
    "event_triggered": "EVENTS",
    "few_directions": "DIRECTIONS",
    "diagonal_shares": "DIAGONAL",
}
# Two beliefs whose axes are those of the states.
ONE = Gaussian(np.array([0.0, 0.0]), np.diag([1.0, 4.0]))
OTHER = Gaussian(np.array([3.0, 2.0]), np.diag([4.0, 1.0]))


def module(name: str) -> ModuleType:
    found = importlib.util.spec_from_file_location(name, FOLDER / f"{name}.py")
    assert found is not None and found.loader is not None
    made = importlib.util.module_from_spec(found)
    found.loader.exec_module(made)
    return made


def both() -> Gaussian:
    return Gaussian(np.stack([ONE.mean, OTHER.mean]), np.stack([ONE.cov, OTHER.cov]))


def test_there_are_six_and_each_is_tested():
    assert {file.stem for file in FOLDER.glob("*.py")} == set(RULES)


def test_largest_ellipsoid_takes_the_sharper_belief_of_each_axis():
    fused = module("largest_ellipsoid").largest_ellipsoid(both(), np.array([0.5, 0.5]))
    assert fused.mean == pytest.approx([0.0, 2.0])
    assert fused.cov == pytest.approx(np.eye(2))


def test_inverse_intersection_of_two_beliefs_that_mirror_each_other():
    # By symmetry w = 1/2: the common part is 2.5 in both axes, and 1 + 1/4 - 1/2.5 = .85.
    fused = module("inverse_intersection").inverse(both(), np.array([0.5, 0.5]))
    assert fused.cov == pytest.approx(np.eye(2) / 0.85)
    # Gains (1/4 - .2) / .85 = 1/17 of the wide belief and 16/17 of the sharp one.
    assert fused.mean == pytest.approx([3.0 / 17, 2.0 * 16 / 17])


def test_a_belief_of_weight_zero_is_not_heard():
    for name in ("largest_ellipsoid", "inverse_intersection"):
        rule = getattr(module(name), RULES[name])
        assert rule(both(), np.array([1.0, 0.0])).mean == pytest.approx(ONE.mean)


def test_split_intersection_of_independent_and_of_shared_errors():
    split = module("split_intersection")
    zero = np.zeros((1, 1))
    # Independent errors: the sum of information, 1 / (1 + 1/3) at weights 3/4 and 1/4.
    mean, shared, own = split.pair(
        (np.array([0.0]), zero, np.array([[1.0]])), (np.array([4.0]), zero, np.array([[3.0]]))
    )
    assert (mean.item(), shared.item(), own.item()) == pytest.approx((1.0, 0.0, 0.75))
    # Shared errors of equal size: covariance intersection, which gains nothing.
    one = np.array([[2.0]])
    mean, shared, own = split.pair((np.array([0.0]), one, zero), (np.array([2.0]), one, zero))
    assert (shared + own).item() == pytest.approx(2.0)
    # A share begins with (1 - K)^2 P and K^2 R: prior 1, reading 1, so K = 1/2.
    begun = split.Split().begin(
        np.array(0),
        Gaussian(np.zeros(1), np.eye(1)),
        Gaussian(np.zeros(1), np.eye(1) / 2),
    )
    assert begun == pytest.approx([0.0, 0.25, 0.25])


def test_the_direction_of_a_share_is_that_of_the_reading():
    few = module("few_directions")
    prior = Gaussian(np.zeros(2), np.diag([4.0, 9.0]))
    # The second state was read with variance 1: 9 becomes .9, and the first stays.
    belief = Gaussian(np.array([0.0, 5.0]), np.diag([4.0, 0.9]))
    u1, u2, value, variance = few.share(prior, belief)
    assert (u1, abs(u2)) == pytest.approx((0.0, 1.0))
    assert (value * u2, variance) == pytest.approx((5.0, 0.9))


def test_covariance_intersection_with_one_direction():
    few = module("few_directions")
    heard = np.array([0.0, 1.0, 2.0, 1.0])  # the second state is 2, with variance 1
    fused = few.with_direction(Gaussian(np.zeros(2), np.diag([4.0, 9.0])), heard)
    grid = np.append(np.linspace(0.02, 0.98, 25), 1.0)
    w = max(grid, key=lambda w: (w / 4) * (w / 9 + (1 - w)))
    second = 1 / (w / 9 + 1 - w)
    assert fused.cov == pytest.approx(np.diag([4 / w, second]))
    assert fused.mean == pytest.approx([0.0, second * (1 - w) * 2])


def test_a_diagonal_share_bounds_the_covariance():
    diagonal = module("diagonal_shares")
    cov = np.array([[1.0, 1.2], [1.2, 4.0]])  # correlation .6: largest eigenvalue 1.6
    share = diagonal.share(Gaussian(np.array([1.0, 2.0]), cov))
    assert share == pytest.approx([1.0, 2.0, 1.6, 6.4])
    assert np.linalg.eigvalsh(np.diag(share[2:]) - cov)[0] == pytest.approx(0.0, abs=1e-12)


def test_diagonal_shares_are_fused_by_covariance_intersection():
    rule = module("diagonal_shares").Diagonal()
    own = Gaussian(np.zeros(1), np.array([[2.0]]))
    shares = np.array([[0.0, 2.0], [3.0, 1.0], [np.nan, np.nan]])
    weights = np.array([0.25, 0.25, 0.5])
    known, fused = rule.fuse(0, weights, own, shares[0], own, shares)
    # Half of 1/2 and half of 1: information 3/4; mean (1/2 x 1 x 3) / (3/4).
    assert fused.cov.item() == pytest.approx(4 / 3)
    assert fused.mean.item() == pytest.approx(2.0)
    assert known == pytest.approx([2.0, 4 / 3])


def test_events_send_less_than_covariance_intersection_for_little_error():
    scenario = cc.scenario("oscillator", steps=60, rounds=1, schedule="dynamic", occupancy=1.0)
    found = cc.sweep(
        scenario, rule=["ci", f"{FOLDER}/event_triggered.py:EVENTS"], runs=20
    ).mean("run")  # fmt: skip
    ci, events = (found.isel(rule=place) for place in range(2))
    assert events["bytes_per_step"] < 0.5 * ci["bytes_per_step"]
    assert events["rmse"] < 1.5 * ci["rmse"]


@pytest.mark.parametrize("name", RULES)
def test_each_runs_by_the_door_of_the_user(name: str):
    scenario = cc.scenario("oscillator", steps=30, rule=f"{FOLDER}/{name}.py:{RULES[name]}")
    if name == "event_triggered":
        scenario = scenario.with_(schedule="dynamic", occupancy=1.0)
    error = cc.sweep(scenario, runs=5)["rmse"]
    alone = cc.sweep(scenario, rule="local", runs=5)["rmse"]
    assert float((error**2).mean()) < float((alone**2).mean())


@pytest.mark.parametrize("name", ["split_intersection", "few_directions", "diagonal_shares"])
def test_rules_of_files_have_exact_errors(name: str):
    rule = f"{FOLDER}/{name}.py:{RULES[name]}"
    scenario = cc.scenario("oscillator", steps=30, rule=rule, schedule="full")
    exact = cc.exact(scenario)
    squares = cc.sweep(scenario, runs=300)["rmse"] ** 2
    half = 4 * float(squares.std()) / np.sqrt(300)
    assert abs(float(squares.mean()) - exact.rmse.value**2) < half
