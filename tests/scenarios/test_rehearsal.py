"""Plants and sensors that say nothing: found when they are made, or before the first step."""

import numpy as np
import pytest

import concord as cc
from concord.scenarios.preparation import prepare
from concord.scenarios.scenario_options import scenario_of


def drift(x):
    return x + 0.1


def network(h, f=drift, steps=60, **fields):
    plant = cc.OwnPlant(f=f, Q=[1e-4], mean=[0.0], cov=[0.01], **fields)
    sensors = [cc.OwnSensor(h=lambda x: x, R=0.1), cc.OwnSensor(h=h, R=0.1)]
    return cc.own_scenario(plant, sensors, steps=steps)


def test_a_sensor_that_reads_infinity_is_refused_with_step_and_node():
    asked = network(lambda x: np.where(x > 2.05, np.inf, x))
    with pytest.raises(
        ValueError, match=r"node 1: its sensor reads inf at step \d+, where the state is \[2"
    ):
        cc.simulate(asked)
    cc.simulate(asked.with_(steps=15))


def test_a_network_in_which_no_sensor_reads_anything_is_refused():
    plant = cc.OwnPlant(f=drift, Q=[1e-4], mean=[0.0], cov=[0.01])
    never = cc.OwnSensor(h=lambda x: np.full_like(x, np.nan), R=0.1)
    late = cc.OwnSensor(h=lambda x: np.where(x > 3, x, np.nan), R=0.1)
    with pytest.raises(ValueError, match="no sensor ever reads anything in the 60 steps"):
        cc.simulate(cc.own_scenario(plant, [never, None], steps=60))
    with pytest.raises(ValueError, match="in the 20 steps of run 0; correct h, or use more steps"):
        cc.simulate(cc.own_scenario(plant, [late], steps=20))
    assert cc.simulate(cc.own_scenario(plant, [late], steps=60)).sizes["run"] == 1


def test_sites_from_which_nothing_is_seen_are_refused():
    near = [[0, 0], [200, 0], [400, 0]]
    far = (np.array(near) + 5e6).tolist()
    prepare(scenario_of("target-tracking", placement=near, graph="path", steps=20))
    with pytest.raises(ValueError, match=r"no sensor ever reads anything .*move the sites"):
        prepare(scenario_of("target-tracking", placement=far, graph="path", steps=20))


def test_a_sensor_of_one_value_is_refused():
    with pytest.raises(ValueError, match=r"h\(x\) is \[3.0\] for every state"):
        network(lambda x: np.full_like(x, 3.0))
    network(lambda x: np.where(x > 0, 1.0, 0.0))
    known = cc.OwnPlant(f=drift, Q=[1e-4], mean=[0.0], cov=[0.0])
    cc.own_scenario(known, [cc.OwnSensor(h=lambda x: x, R=0.1)])


def test_a_plant_that_is_not_finite_near_its_beginning_is_refused():
    for f in (np.sqrt, np.log, lambda x: np.exp(1e5 * x)):
        with pytest.raises(
            ValueError, match=r"f\(x\) is \[(nan|inf)\] where x is .* of 200 states"
        ):
            network(lambda x: x, f=f)


def test_what_only_the_run_can_tell_is_left_to_it():
    """A truth that is not finite from some step on, and a function that fails there."""
    prepare(network(lambda x: x, f=lambda x: np.where(x > 2, np.nan, x + 0.1)))

    def fails(x):
        if (np.asarray(x) > 2).all():
            raise KeyError("no road")
        return x + 0.1

    prepare(network(lambda x: x, f=fails))
