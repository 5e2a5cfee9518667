"""States that are angles: equal to the same plant unwrapped, in every rule and driver."""

import numpy as np
import pytest

import concord as cc
from concord.plants.own_plant import OwnPlant
from concord.plants.own_sensor import OwnSensor
from concord.scenarios.definitions.own import own_scenario, portable
from concord.scenarios.preparation import prepare
from concord.scenarios.scenario import Scenario
from concord.studies.agree import agreement

STEP_S = 0.1
RULES = {
    "ci": {}, "sharp-ci": {}, "wac": {}, "local": {}, "hcmci": {}, "icf": {"rounds": 3},
    "trimmed-ci": {"graph": "complete"}, "diffusion": {"rounds": 2}, "kcf": {"rounds": 2},
    "centralised": {"graph": "complete", "rounds": 1}, "labelled": {},
}  # fmt: skip
FILTERS = [
    *(("ukf", rule) for rule in RULES),
    *((name, rule) for name in ("ekf", "srckf", "iplf") for rule in ("ci", "hcmci", "labelled")),
]
"""Every rule, and every filter in rules that send beliefs, novelties and records."""


def wrap(angle):
    return (angle + np.pi) % (2 * np.pi) - np.pi


def steady(x):
    return np.stack((x[..., 0] + STEP_S * x[..., 1], x[..., 1]), axis=-1)


def wrapping(x):
    return np.stack((wrap(x[..., 0] + STEP_S * x[..., 1]), x[..., 1]), axis=-1)


def network(wraps: bool, rate: float = 1.5, std: float = 0.2) -> Scenario:
    plant = OwnPlant(
        f=wrapping if wraps else steady, Q=[1e-4, 1e-4], mean=[3.1, rate], cov=[std**2, 0.01],
        time_step_s=STEP_S, angles=(0,) if wraps else (),
    )  # fmt: skip
    compass = OwnSensor(h=lambda x: wrap(x[..., :1]), R=0.02, angles=(0,))
    rose = OwnSensor(h=lambda x: np.stack((np.cos(x[..., 0]), x[..., 1]), axis=-1), R=[0.1, 0.2])
    return own_scenario(plant, [compass, rose, None], nodes=5, steps=45)


WRAPPED, UNWRAPPED = network(True), network(False)


@pytest.mark.parametrize(("filter", "rule"), FILTERS)
def test_a_plant_that_wraps_has_the_numbers_of_the_one_that_does_not(filter: str, rule: str):
    options = {"rule": rule, "filter": filter, **RULES[rule]}
    if rule == "labelled":
        options["record_number"] = "float64"
    wrapped, unwrapped = (
        cc.simulate(one.with_(**options), runs=2, covariances=True) for one in (WRAPPED, UNWRAPPED)
    )
    assert float(wrapped["truth"][..., 0].max()) > 9  # more than a turn
    for name in ("truth", "mean", "cov", "nees"):
        np.testing.assert_allclose(wrapped[name], unwrapped[name], rtol=1e-7, atol=1e-9)


@pytest.mark.zenoh
@pytest.mark.parametrize("rule", RULES)
def test_drivers_agree_on_a_plant_that_wraps(rule: str):
    asked = portable(WRAPPED.with_(rule=rule, steps=40, **RULES[rule]))
    found = agreement(prepare(asked))
    assert found.near and found.differences == ()


# The first reading puts nodes on turns of their own.
UNKNOWN = network(True, std=3.0)


@pytest.mark.parametrize("rule", RULES)
def test_nodes_on_different_turns_average_the_same_angle(rule: str):
    runs = cc.simulate(UNKNOWN.with_(rule=rule, **RULES[rule]), runs=12)
    errors = (runs["mean"] - runs["truth"]).to_numpy()[:, 30:, :, 0]
    seeing = errors[:, :, ::3] if rule == "local" else errors
    assert float(np.quantile(np.abs(seeing), 0.99)) < 0.5


@pytest.mark.zenoh
@pytest.mark.parametrize("rule", ["ci", "hcmci", "diffusion", "kcf", "labelled"])
def test_drivers_agree_on_nodes_on_different_turns(rule: str):
    asked = portable(UNKNOWN.with_(rule=rule, steps=30, **RULES[rule]))
    found = agreement(prepare(asked))
    assert found.near and found.differences == ()
