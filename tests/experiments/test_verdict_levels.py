"""Causes planted one by one: the level, the first cause, and a cure after which it is gone."""

from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import pytest

import concord as cc
from concord.filters.gaussian import Gaussian
from concord.nodes.history import AbsentSteps, Epoch, History
from concord.results.figures.summary import Summary, summarise
from concord.results.records.runs import runs_of_trace
from concord.results.records.trace import read_trace
from concord.runtime.drivers import in_memory
from concord.scenarios.preparation import prepare
from concord.scenarios.scenario import Scenario
from concord.studies.monte_carlo.simulate import AGES, INNOVATIONS, READINGS, simulate

pytestmark = pytest.mark.slow

STEP_S = 0.1
WALL = 6.0


def move(x: np.ndarray) -> np.ndarray:
    return np.stack((x[..., 0] + STEP_S * x[..., 1], x[..., 1]), axis=-1)


def until_the_wall(x: np.ndarray) -> np.ndarray:
    """A model that knows no state beyond a wall."""
    return np.where(x[..., :1] < WALL, move(x), np.nan)


def position(x: np.ndarray) -> np.ndarray:
    return x[..., :1]


def hidden(x: np.ndarray) -> np.ndarray:
    """The position as far as a wall."""
    return np.where(x[..., :1] < WALL, x[..., :1], np.nan)


def plant(f: Callable[[np.ndarray], np.ndarray] = move, **changes: Any) -> cc.OwnPlant:
    law = {"Q": [1e-4, 1e-3], "mean": [0.0, 1.0], "cov": [0.1, 0.1], "time_step_s": STEP_S}
    return cc.OwnPlant(f=f, **(law | changes))


def sensor(h: Callable[[np.ndarray], np.ndarray] = position, **changes: Any) -> cc.OwnSensor:
    known: dict[str, Any] = {"R": 0.25} | changes
    return cc.OwnSensor(h=h, **known)


def own(*sensors: cc.OwnSensor, of: cc.OwnPlant | None = None, **options: Any) -> Scenario:
    usual = {"graph": "ring", "rule": "hcmci", "steps": 200}
    return cc.own_scenario(of or plant(), list(sensors), nodes=4).with_(**(usual | options))


def sharpened(beliefs: Gaussian, weights: np.ndarray) -> Gaussian:
    """A rule that takes off more than is there as soon as nodes know the position."""
    mean = (weights[..., None] * beliefs.mean).sum(-2)
    cov = (weights[..., None, None] * beliefs.cov).sum(-3)
    return Gaussian(mean, cov - 0.05 * np.eye(2))


def too_sure(beliefs: Gaussian, weights: np.ndarray) -> Gaussian:
    """A rule that takes neighbours for independent."""
    information = np.linalg.inv(beliefs.cov)
    cov = np.linalg.inv(information.sum(-3))
    mean = (cov @ (information @ beliefs.mean[..., None]).sum(-3))[..., 0]
    return Gaussian(mean, cov)


def tracking(**options: Any) -> Scenario:
    """The network of `make demo`, but for these options."""
    bus = {"schedule": "dynamic", "occupancy": 0.25}
    demo = {"nodes": 12, "rule": "sharp-ci", "number": "float16"}
    if "rule" in options:
        del demo["number"]
    return cc.scenario("target-tracking", **(demo | bus | options))


class Planted(NamedTuple):
    """A scenario, the level and cause of its verdict, the node that it names, and a scenario in
    which the cure was followed; None where only a process can show it."""

    asked: Scenario
    level: str
    cause: str
    node: int | None = None
    cured: Scenario | None = None


GOOD = sensor()
PLANTED = {
    "a rule that fails": lambda: Planted(
        own(GOOD, rule=sharpened), "FAILED", "fusion failed", None, own(GOOD, rule="ci")
    ),
    "a sensor function without a value": lambda: Planted(
        own(GOOD, sensor(hidden)), "FAILED", "filter failed", 1, own(GOOD, GOOD)
    ),
    "a model without a value": lambda: Planted(
        own(GOOD, of=plant(until_the_wall)), "FAILED", "truth not finite", None, own(GOOD)
    ),
    "a truth that overflows": lambda: Planted(
        own(
            GOOD,
            of=plant(lambda x: x + 0.05 * x**2, mean=[2.0, 2.0], cov=[0.01, 0.01]),
            steps=60,
        ),
        "FAILED",
        "truth not finite",
        None,
        own(GOOD, of=plant(lambda x: 0.99 * x, mean=[2.0, 2.0], cov=[0.01, 0.01])),
    ),
    "a gate that refuses all": lambda: Planted(
        own(sensor(lambda x: x[..., :1] + 900, gate=3.84), GOOD, changes=("0 bias 0 1000",)),
        "FAILED",
        "readings refused",
        0,
        own(sensor(lambda x: x[..., :1] + 900), GOOD),
    ),
    "a gate behind which the filter is lost": lambda: Planted(
        own(sensor(gate=3.84), changes=("0 outlier 0 .5 30", "0 outlier 1 .5 30")),
        "CHECK",
        "gate locked",
        0,
        own(sensor(gate=3.84)),
    ),
    "an offset": lambda: Planted(
        own(GOOD, GOOD, GOOD, changes=("0 bias 2 3",)),
        "CHECK",
        "offset of a sensor",
        2,
        own(GOOD, GOOD, GOOD),
    ),
    "outliers": lambda: Planted(
        own(GOOD, GOOD, GOOD, changes=("0 outlier 1 .2 12",)),
        "CHECK",
        "outliers of a sensor",
        1,
        own(GOOD, GOOD, GOOD),
    ),
    "an overconfident rule": lambda: Planted(
        own(GOOD, GOOD, GOOD, GOOD, rule=too_sure),
        "CHECK",
        "overconfident",
        None,
        own(GOOD, GOOD, GOOD, GOOD, rule="ci"),
    ),
    "too few steps": lambda: Planted(
        own(GOOD, steps=26), "CHECK", "too short", None, own(GOOD, steps=200)
    ),
    "readings of no node": lambda: Planted(
        own(GOOD, changes=tuple(f"0 dropout {node} 1" for node in range(4))),
        "FAILED",
        "no readings",
        None,
        own(GOOD),
    ),
    "an offset in the demo": lambda: Planted(
        tracking(changes=("0 bias 3 3",)), "CHECK", "offset of a sensor", 3, tracking()
    ),
    "outliers in the demo": lambda: Planted(
        tracking(changes=("0 outlier 8 .2 6",)),
        "CHECK",
        "noise of a sensor too small",
        8,
        tracking(),
    ),
    "a rule that diverges in the demo": lambda: Planted(
        tracking(rule="icf", rounds=1), "CHECK", "overconfident", None, tracking(rule="ci")
    ),
    "a demo that is too short": lambda: Planted(
        tracking(steps=25), "CHECK", "too short", None, tracking()
    ),
    "a demo that sees nothing": lambda: Planted(
        tracking(changes=tuple(f"0 dropout {node} 1" for node in range(12))),
        "FAILED",
        "no readings",
        None,
        tracking(),
    ),
    "nothing, with a gate": lambda: Planted(own(sensor(gate=3.84), sensor(gate=2.71)), "WORKS", ""),
    "nothing, on a bad link": lambda: Planted(tracking(loss=0.3), "WORKS", ""),
    "nothing but a node that is killed": lambda: Planted(
        own(GOOD, changes=("50 kill 2", "80 restart 2")), "WORKS", ""
    ),
    "nothing": lambda: Planted(own(GOOD, GOOD), "WORKS", ""),
}


@cache
def judged(asked: Scenario) -> Summary:
    setup = prepare(asked)
    with np.errstate(all="ignore"):
        return summarise(runs_of_trace(setup, read_trace(setup, in_memory(setup))))


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize("name", PLANTED)
def test_a_planted_cause_is_the_first_and_its_cure_helps(name: str):
    planted = PLANTED[name]()
    verdict = judged(planted.asked).verdict
    said = f"{verdict.level} {verdict.cause}: {verdict.said}"
    assert verdict.level == planted.level, said
    if planted.cause:
        assert verdict.cause == planted.cause, said
    if planted.node is not None:
        assert verdict.findings[0].node == planted.node, said
    if planted.cured is not None:
        after = judged(planted.cured).verdict
        assert planted.cause not in [one.cause for one in after.findings], after


def test_nodes_that_nothing_asked_to_lose_fail_a_run():
    setup = prepare(own(GOOD, GOOD))
    runs = runs_of_trace(setup, read_trace(setup, in_memory(setup)))
    lost = History(
        (Epoch(0, 0, 3),),
        (AbsentSteps(2, 60, None, "gone"), AbsentSteps(3, 60, None, "gone")),
        True,
    )
    found = summarise(runs._replace(history=lost))
    assert (found.verdict.level, found.verdict.cause) == ("FAILED", "members lost")
    assert "nodes 2 and 3: lost from step 60 to the end" in found.verdict.said
    (outage,) = found.outages
    assert outage.nodes == (2, 3) and not outage.is_asked


def test_a_run_that_ends_before_its_last_step_says_so():
    setup = prepare(own(GOOD, GOOD))
    messages = in_memory(setup)
    cut = [one for one in messages if b'"step":150' not in one[1]]
    found = summarise(runs_of_trace(setup, read_trace(setup, cut)))
    assert (found.verdict.level, found.verdict.cause) == ("CHECK", "incomplete")
    assert "150 of 200 steps" in found.verdict.said


@pytest.mark.parametrize("gate", [2.71, 3.84, 6.63, None])
def test_a_sound_filter_works_with_each_gate(gate: float | None):
    """The law of NIS behind a gate is cut: .624, .759 and .925 are right for one entry."""
    found = judged(own(sensor(gate=gate), sensor(gate=gate), steps=400))
    assert found.verdict.level == "WORKS", found.verdict.said
    assert found.innovations is not None
    assert found.innovations.centralised.nis == pytest.approx(1, abs=0.15)


def test_a_gate_is_a_probability_below_one_and_a_threshold_above():
    assert sensor(gate=0.95).gate == pytest.approx(3.8415, abs=1e-4)
    assert sensor(gate=3.84).gate == 3.84
    two = {"R": [0.1, 0.1], "h": lambda x: x}
    assert sensor(**two, gate=0.99).gate == pytest.approx(9.2103, abs=1e-4)
    for wrong, says in ((0, "such as 0.99"), (-1, "such as 0.99"), (np.nan, "such as 0.99"),
                        (0.5, "50 % of the sound readings"), (np.inf, "such as 0.99")):  # fmt: skip
        with pytest.raises(ValueError, match=says):
            sensor(gate=wrong)
    with pytest.raises(ValueError, match=r"as a threshold for 2 entries it would refuse 54\.9 %"):
        sensor(**two, gate=1.2)


SOUND = [
    *(("target-tracking", rule) for rule in ("ci", "sharp-ci", "hcmci", "labelled")),
    ("target-crossing", "sharp-ci"),
    ("target-crossing", "labelled"),
    *(("oscillator", rule) for rule in ("ci", "trimmed-ci", "hcmci", "labelled", "local")),
    *(("own", rule) for rule in ("ci", "sharp-ci", "hcmci", "labelled")),
    ("own with a gate", "hcmci"),
    ("own with a gate", "ci"),
    ("lossy", "labelled"),
    ("half a bus", "hcmci"),
    ("killed", "ci"),
]


def sound(name: str, rule: str) -> Scenario:
    if name == "own":
        return own(GOOD, GOOD, rule=rule)
    if name == "own with a gate":
        return own(sensor(gate=6.63), GOOD, rule=rule)
    if name == "lossy":
        return tracking(rule=rule, loss=0.2)
    if name == "half a bus":
        return own(GOOD, GOOD, rule=rule, schedule="hybrid", occupancy=0.5)
    if name == "killed":
        return own(GOOD, GOOD, rule=rule, changes=("60 kill 1",))
    dense = {"graph": "complete", "nodes": 6} if rule == "trimmed-ci" else {}
    return cc.scenario(name, rule=rule, steps=120, **dense)


@pytest.mark.parametrize("count", [3, pytest.param(10, marks=pytest.mark.study)])
@pytest.mark.parametrize(("name", "rule"), SOUND)
def test_sound_runs_are_neither_failed_nor_doubted(name: str, rule: str, count: int):
    """Two hundred runs in `make studies`; none is accused."""
    runs = simulate(prepare(sound(name, rule)), range(count), keep=(READINGS, AGES, INNOVATIONS))
    verdicts = [summarise(runs.of(slice(run, run + 1))).verdict for run in range(count)]
    assert [one.said for one in verdicts if one.level != "WORKS"] == []
