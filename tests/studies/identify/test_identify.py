"""Planted errors are found, what nothing tells is left, and equal seeds give equal bits."""

from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.stats import binom

import concord as cc
from concord.scenarios.types.identified_values import in_one_word, in_toml, values_in, word_of
from concord.studies.identify import fit
from concord.studies.identify.fit import FoundValue
from concord.studies.identify.identify import Identification, identify
from concord.studies.identify.likelihood import DIFFERENCE, likelihood
from concord.studies.identify.readings import HeardReadings, readings_of
from tests.studies.identify.planted import PLANTS, cart, pendulum, spring


def _ignore(*_: int) -> None:
    """No progress."""


def _by_name(result: Identification) -> dict[str, FoundValue]:
    return {one.name: one for one in result.found}


def _holds(found: FoundValue, right: Mapping[str, float]) -> bool:
    return found.told and found.low <= right[found.name] <= found.high


def small() -> cc.Scenario:
    """A walk of two states that two sensors read, and a state that only its prior tells."""
    plant = cc.OwnPlant(
        f=lambda x: x,
        Q=[0.01, 0.04, 1e-12],
        mean=[0.0, 0.0, 0.0],
        cov=[1.0, 1.0, 1.0],
        state_names=("east", "north", "hidden"),
    )
    sensors = [
        cc.OwnSensor(h=lambda x: x[..., :1], R=0.04, name="left"),
        cc.OwnSensor(h=lambda x: x[..., :2], R=[0.09, 0.09], name="right", missing=0.2),
    ]
    return cc.own_scenario(plant, sensors, steps=60)


def test_the_likelihood_is_that_of_all_readings_at_once():
    """The density of the whole vector of readings of a linear model, written without a filter."""
    log, factor = readings_of(small()), 1.7
    found = likelihood(log, {"R.left": factor, "Q.north": 0.6}, 1, _ignore, slopes=False)
    steps = np.arange(log.steps)
    shared = np.minimum(steps[:, None], steps)
    prior = {0: 1 + 0.01 * shared, 1: 1 + 0.04 * 0.36 * shared}
    rows = [(k, 0, 0.04 * factor**2, log.values[k, 0, 0, 0]) for k in steps]
    rows += [(k, entry, 0.09, log.values[k, 1, 0, entry]) for k in steps for entry in (0, 1)]
    rows = [row for row in rows if np.isfinite(row[3])]
    cov = np.array(
        [
            [
                (prior[one[1]][one[0], other[0]] if one[1] == other[1] else 0.0)
                + (one[2] if one is other else 0.0)
                for other in rows
            ]
            for one in rows
        ]
    )
    values = np.array([row[3] for row in rows])
    halves = np.log(np.diagonal(np.linalg.cholesky(cov))).sum()
    whole = halves + 0.5 * values @ np.linalg.solve(cov, values)
    assert found.value == pytest.approx(whole, rel=1e-9)


def test_slopes_are_those_of_the_likelihood():
    log, names = readings_of(small()), ("R.left", "R.right", "Q.north")
    lanes = np.ones((4, 3))
    lanes[1 + np.arange(3), np.arange(3)] *= np.exp(DIFFERENCE)
    here = likelihood(log, dict(zip(names, lanes.T, strict=True)), 4, _ignore)
    for place, name in enumerate(names):
        sides = likelihood(log, {name: np.exp([1e-4, -1e-4])}, 2, _ignore, slopes=False).lanes
        assert here.slopes[place] == pytest.approx((sides[0] - sides[1]) / 2e-4, rel=1e-3, abs=1e-3)


def test_planted_errors_are_found_and_the_verdict_is_consistent():
    planted = cart(1)
    result = identify(planted.scenario, list(planted.right))
    assert all(_holds(one, planted.right) for one in result.found)
    assert result.before.nis is not None and result.before.nis > 5
    assert result.after is not None and result.after.nis_interval is not None
    assert result.after.nis_interval[0] < 1 < result.after.nis_interval[1]
    assert result.ended and "consistent" in result.after.said


@pytest.mark.study
def test_intervals_hold_in_95_of_100():
    """Three errors in each plant, two logs each; a count below the bound has a chance of 0.001."""
    held, total = 0, 0
    for make in PLANTS.values():
        for seed in range(1001, 1003):
            planted = make(seed)
            result = identify(planted.scenario, list(planted.right))
            held += sum(_holds(one, planted.right) for one in result.found)
            total += len(planted.right)
    assert held >= binom.ppf(0.001, total, 0.95)


def test_what_the_log_cannot_tell_is_left_and_said():
    result = identify(small(), ["R.left", "Q.hidden"])
    hidden = _by_name(result)["Q.hidden"]
    assert not hidden.told and hidden.value == hidden.before == 1.0
    assert "Q.hidden" not in result.values and "R.left" in result.values


def test_noise_that_is_not_there_has_a_bound_above_alone():
    """Readings of a plant that never moves: Q of 1 is refused, and no least value is told."""
    plant = cc.OwnPlant(f=lambda x: x, Q=[1.0], mean=[0.0], cov=[1.0])
    sensor = cc.OwnSensor(h=lambda x: x[..., :1], R=0.04, name="left")
    still = cc.own_scenario(plant, [sensor], truth=cc.Truth(Q=[0.0]), steps=200)
    found = _by_name(identify(still, ["Q.x0"]))["Q.x0"]
    assert found.told and found.low == 0.0 and found.high <= 1.0 and found.value < 0.1


def test_equal_seeds_give_equal_bits():
    first, again = (identify(small(), ["R.left", "Q.north"]) for _ in range(2))
    assert first == again


def test_noise_that_belongs_together_has_one_name():
    names = readings_of(spring(1).scenario).known.names
    assert "Q.place+speed" in names
    assert readings_of(spring(1).scenario).known.found("Q.speed") == "Q.place+speed"


def test_the_file_is_what_filters_believe(tmp_path):
    scenario = pendulum(2).scenario.with_(steps=300)
    file = tmp_path / "found.toml"
    result = cc.identify(scenario, "R.encoder,theta.length", out=file)
    told = scenario.with_(identified=str(file))
    assert values_in(told.identified) == result.values
    believed, before = (cc.simulate(one.with_(steps=100))["mean"] for one in (told, scenario))
    assert not np.allclose(believed, before)
    assert identify(told, ["R.encoder"]).values["theta.length"] == result.values["theta.length"]


@pytest.mark.zenoh
@pytest.mark.slow
def test_drivers_agree_on_what_was_identified(tmp_path):
    source = tmp_path / "carts.py"
    source.write_text(
        "from tests.studies.identify.planted import cart\nSCENARIO = cart(1).scenario\n"
    )
    asked = cc.scenario(
        f"{source}:SCENARIO", steps=40, identified="R.gps=2;Q.speed=0.5;delay.gps=0.3"
    )
    assert cc.agree(asked) == ()


def test_an_interrupt_keeps_the_best_so_far(monkeypatch):
    passes, whole = [0], fit.likelihood

    def interrupted(*arguments, **options):
        passes[0] += 1
        if passes[0] == 4:
            raise KeyboardInterrupt
        return whole(*arguments, **options)

    monkeypatch.setattr(fit, "likelihood", interrupted)
    result = identify(pendulum(1).scenario.with_(steps=400), ["R.encoder", "Q.rate"])
    assert not result.ended and result.after is None
    assert result.values["R.encoder"] < 0.8


def test_a_long_log_is_fitted_to_its_beginning_first(monkeypatch):
    monkeypatch.setattr(fit, "COARSE_STEPS", 100)
    scenario, told = pendulum(1).scenario.with_(steps=400), []
    result = identify(scenario, ["R.encoder"], lambda done, most: told.append((done, most)))
    # The work that is announced grows by whole passes alone, and is never passed.
    usual = fit.usual_steps(400)
    assert all(done <= most and (most - usual) % 400 == 0 for done, most in told)
    monkeypatch.undo()
    again = identify(scenario, ["R.encoder"])
    assert result.found[0].value == pytest.approx(again.found[0].value, rel=1e-2)
    assert told == sorted(told) and told[-1][0] == told[-1][1]


@pytest.mark.parametrize(
    ("word", "says"),
    [
        ("R.gps", "write NAME=NUMBER"),
        ("R.gps=0", "factors above 0"),
        ("S.gps=1", "write NAME=NUMBER"),
        ("R.gps=nan", "write NAME=NUMBER"),
        ("nowhere.toml", "nowhere.toml"),
    ],
)
def test_values_that_are_none_are_refused(word: str, says: str):
    with pytest.raises(ValueError, match=says):
        in_one_word(word)


def test_a_name_that_a_scenario_lacks_is_refused_before_a_run():
    with pytest.raises(ValueError, match=r"unknown parameter 'R.gps'.*R.left, R.right"):
        cc.simulate(small().with_(identified="R.gps=2"))


def test_a_file_says_what_it_holds(tmp_path):
    values = {"R.gps": 1 / 3, "Q.x+vx": 0.5, "delay.imu": -0.02, "theta.mass": 1450.0}
    file = tmp_path / "values.toml"
    file.write_text(in_toml(values, {"R.gps": "0.3 to 0.4", "Q.w": "the log does not tell it"}))
    assert values_in(in_one_word(str(file))) == values
    assert in_one_word(word_of(values)) == word_of(values)
    assert '# "w"  # the log does not tell it' in file.read_text()


@pytest.mark.parametrize(
    ("parameters", "says"),
    [
        ({"mass": 1.0}, "must be \\(value, low, high\\)"),
        ({"mass": (3.0, 1.0, 2.0)}, "between the others"),
        ({}, "parameters={'mass': \\(value, low, high\\)}"),
    ],
)
def test_a_plant_refuses_parameters_that_are_none(parameters: dict, says: str):
    with pytest.raises(ValueError, match=says):
        cc.OwnPlant(
            f=lambda x, *, mass: x / mass, Q=[1.0], mean=[0.0], cov=[1.0], parameters=parameters
        )


def test_delays_of_many_lanes_are_those_of_each():
    generator = np.random.default_rng(6)
    values = generator.standard_normal((12, 2, 1, 2))
    setup: Any = SimpleNamespace(time_step_s=0.5)
    known: Any = SimpleNamespace(kinds=[["gps", "gps"], ["imu"]])
    log = HeardReadings(setup, known, values, np.zeros((12, 1)))
    gps, imu = np.array([0.0, 1.0, -2.0, 30.0]), np.array([0.5, 0.0, 1.5, -30.0])
    lanes = np.stack(list(log.by_step({"delay.gps": gps, "delay.imu": imu}, 4)))
    for lane, (one, other) in enumerate(zip(gps, imu, strict=True)):
        alone = np.stack(list(log.by_step({"delay.gps": one, "delay.imu": other}, 1)))
        np.testing.assert_array_equal(lanes[:, lane], alone[:, 0])
    assert np.isnan(lanes[:, 3, 0]).all() and np.isfinite(lanes[:, 0, 0]).all()
