"""The option `--filter`: what it refuses before the start, and what the baselines make of it."""

from typing import Any

import numpy as np
import pytest

from concord.entries import summaries
from concord.filters import ukf
from concord.filters.gaussian import Gaussian
from concord.filters.sigma_points import scaled_unscented
from concord.plants.own_plant import OwnPlant
from concord.plants.own_sensor import OwnSensor
from concord.results.records.trace import read_trace
from concord.results.smoothing import check_smoothing
from concord.runtime.drivers import in_memory
from concord.scenarios.baselines import centralised, local_only
from concord.scenarios.catalogue import definition_of
from concord.scenarios.definitions.own import own_scenario
from concord.scenarios.preparation import prepare
from concord.scenarios.rule_table.rules import share_size
from concord.scenarios.scenario import Scenario
from concord.scenarios.scenario_options import scenario_of
from concord.scenarios.warnings import warnings_of
from concord.studies.monte_carlo.simulate import simulate


def known(
    cov: float = 1.0, R: Any = 1.0, Q: float = 0.1, mean: float = 0.0, nodes: int = 3
) -> Scenario:
    """Two states, the first of which may be known at the start or read sharply."""
    plant = OwnPlant(f=lambda x: 0.9 * x, Q=[Q, 0.1], mean=[mean, 0], cov=[cov, 1.0])
    entries = [0, 1] if np.ndim(R) else [0]
    return own_scenario(plant, [OwnSensor(h=lambda x: x[..., entries], R=R)], nodes=nodes, steps=30)


FILTERS = [name for name in summaries("FILTERS") if name != "imm"]


@pytest.mark.parametrize("name", FILTERS)
def test_a_singular_prior_runs_or_is_refused(name: str):
    asked = known(cov=0.0).with_(filter=name, rule="local")
    if name in ("ekf", "kf", "iekf"):
        trace = read_trace(prepare(asked), in_memory(prepare(asked)))
        assert np.isfinite(trace.mean).all()
        names = {word for counters in trace.counters for word in counters}
        assert not names & {"predict-failed", "update-failed"}
        with pytest.raises(ValueError, match="Q never changes that"):
            prepare(known(cov=0.0, Q=0.0).with_(filter=name))
    else:
        with pytest.raises(ValueError, match=r"prior is singular.*--filter ekf"):
            prepare(asked)


@pytest.mark.parametrize("name", FILTERS)
def test_a_noise_that_is_singular_or_lost_in_the_digits_is_refused(name: str):
    for R in (0.0, [[1.0, 1.0], [1.0, 1.0]]):
        with pytest.raises(ValueError, match="R of a sensor is singular"):
            prepare(known(R=R).with_(filter=name))
    with pytest.raises(ValueError, match="lost in the last digits of readings near 5e"):
        prepare(known(R=1e-20, mean=5e6).with_(filter=name))


@pytest.mark.parametrize("rule", ["ci", "hcmci", "icf", "sharp-ci"])
@pytest.mark.parametrize("name", ["ukf", "srckf", "ekf", "iplf"])
def test_the_advice_for_a_sharp_sensor_works(name: str, rule: str):
    """Where a filter refuses a sharp reading, the one that it names is consistent with it."""
    for R in (1e-12, 1e-18, 1e-26):
        asked = known(R=R, nodes=4).with_(filter=name, rule=rule)
        if name in ("ekf", "iplf") and R < 1e-14:
            with pytest.raises(ValueError, match="use --filter ukf"):
                prepare(asked)
            continue
        found = simulate(prepare(asked), range(10))
        assert np.isfinite(found.nees).all() and 0.3 < found.nees[:, 10:].mean() / 2 < 1.5


@pytest.mark.parametrize("name", ["target-tracking", "target-crossing", "vehicle-network"])
def test_the_kalman_filter_refuses_what_is_not_linear(name: str):
    with pytest.raises(ValueError, match=r"not linear .*; use --filter ekf or ukf"):
        prepare(scenario_of(name, filter="kf"))


@pytest.mark.parametrize("name", ["oscillator", "dc-motor-speed", "cruise-control", "suspension"])
def test_the_kalman_filter_runs_on_linear_plants_as_the_unscented_one(name: str):
    found = {
        one: read_trace(prepared, in_memory(prepared))
        for one in ("kf", "ukf", "iplf")
        for prepared in [prepare(scenario_of(name, filter=one, steps=15))]
    }
    for one in ("ukf", "iplf"):
        scale = np.sqrt(np.diagonal(found["kf"].cov, axis1=-2, axis2=-1)).max()
        np.testing.assert_allclose(found[one].mean, found["kf"].mean, rtol=1e-6, atol=1e-6 * scale)


@pytest.mark.slow
@pytest.mark.parametrize("rule", ["ci", "hcmci", "diffusion"])
@pytest.mark.parametrize("name", [name for name in summaries("FILTERS") if name != "kf"])
def test_batches_give_the_numbers_of_messages(name: str, rule: str):
    """With a node that dies and begins anew, which forgets, and sensors that see at times."""
    if name == "imm" and rule != "ci":
        pytest.skip("refused: its shares carry no beliefs")
    options = {"nodes": 5, "graph": "complete", "steps": 14, "changes": ("4 kill 2", "8 restart 2")}
    asked = scenario_of("target-tracking", filter=name, rule=rule, **options)
    setup = prepare(asked)
    trace = read_trace(setup, in_memory(setup))
    histories = simulate(setup, [asked.run])
    np.testing.assert_allclose(histories.mean[0], trace.mean, rtol=1e-9, atol=1e-9)
    alone = local_only(setup, trace.readings, None)
    assert np.isfinite(alone.mean).all()


@pytest.mark.parametrize("rule", ["hcmci", "icf", "diffusion", "labelled"])
def test_models_are_refused_where_shares_are_no_beliefs_or_nothing_turns(rule: str):
    with pytest.raises(ValueError, match=f"rule {rule} with --filter imm: .* use rule ci, wac or"):
        prepare(scenario_of("target-tracking", filter="imm", rule=rule))
    with pytest.raises(ValueError, match="has no rate of turn; use --scenario target-tracking"):
        prepare(scenario_of("target-crossing", filter="imm"))
    with pytest.raises(ValueError, match="as float64 or float32"):
        prepare(scenario_of("target-tracking", filter="imm", number="float16"))
    with pytest.raises(ValueError, match="--smooth with --filter imm: the smoother has one model"):
        check_smoothing(prepare(scenario_of("target-tracking", filter="imm")))


@pytest.mark.parametrize("number", ["float64", "float32"])
@pytest.mark.parametrize("rule", ["ci", "wac", "local", "trimmed-ci"])
def test_models_give_the_same_numbers_in_arrays_and_messages(rule: str, number: str):
    few = {"nodes": 7, "graph": "complete", "steps": 9, "filter": "imm", "rule": rule}
    asked = scenario_of("target-tracking", **few, number=number, occupancy=0.5, loss=0.2)
    setup = prepare(asked)
    trace = read_trace(setup, in_memory(setup))
    histories = simulate(setup, [asked.run])
    # Sums in another order may round a float32 to its other neighbour.
    exact = number == "float64"
    near = 1e-9 if exact else 1e-5
    np.testing.assert_allclose(histories.mean[0], trace.mean, rtol=near, atol=near)
    # Means of two models, the ratio of their odds, two triangles, and the variance of the odds.
    numbers = 2 * 5 + 1 + 2 * 15 + 1
    assert share_size(setup.scenario, 5) == numbers * (8 if exact else 4)


@pytest.mark.parametrize("name", ["aukf", "faukf", "adlukf"])
def test_records_are_refused_to_a_filter_that_learns(name: str):
    with pytest.raises(ValueError, match=rf"rule labelled with --filter {name}: .* --filter ukf"):
        prepare(scenario_of("oscillator", filter=name, rule="labelled"))
    with pytest.raises(ValueError, match="at least 1"):
        prepare(scenario_of("oscillator", filter=name, most_noise=0.5))


def test_a_filter_of_a_measurement_bus_is_refused_elsewhere():
    with pytest.raises(ValueError, match="--filter recommended: it is for the receiver of a meas"):
        prepare(scenario_of("oscillator", filter="recommended"))


@pytest.mark.parametrize(
    ("option", "value", "says"),
    [
        ("iterations", 1, "--iterations 1: must be at least 2"),
        ("bandwidth", 0.0, "--bandwidth 0.0: must be above 0"),
        ("bandwidth", float("inf"), "must be above 0, and finite"),
    ],
)
def test_options_of_a_filter_are_checked(option: str, value: float, says: str):
    with pytest.raises(ValueError, match=says):
        prepare(scenario_of("oscillator", filter="mcukf", **{option: value}))
    with pytest.raises(ValueError, match=f"--{option} .*: belongs to --filter"):
        scenario_of("oscillator", filter="ukf", **{option: value})


def test_the_centralised_filter_takes_readings_one_by_one_in_the_order_of_the_nodes():
    setup = prepare(scenario_of("target-tracking", nodes=6, steps=25))
    trace = read_trace(setup, in_memory(setup))
    found = centralised(setup, trace.readings, None)
    definition, rule = definition_of(setup.scenario), scaled_unscented(5)
    model = definition.model(setup.scenario)
    belief = Gaussian(np.array(setup.prior_mean), np.array(setup.prior_cov))
    for step in range(25):
        if step:
            noise = model.process_noise_cov(step - 1)
            belief = ukf.predict(belief, lambda x: model.transition(x, None, 0), noise, rule)
        for node in range(6):
            sensor = definition.sensor(setup.scenario, node)
            assert sensor is not None
            value, noise = sensor.interpret(trace.readings[step, node, 0])
            belief = ukf.update(
                belief, value, lambda x, h=sensor: h.measure(x, 0), noise, rule,
                residual=sensor.residual,
            ).belief  # fmt: skip
        np.testing.assert_allclose(found.mean[step], belief.mean, rtol=1e-10)
        np.testing.assert_allclose(found.cov[step], belief.cov, rtol=1e-9, atol=1e-12)


def test_baselines_use_the_filter_of_the_scenario():
    """Where a node hears nobody it is its own baseline, whatever its filter."""
    for name in ("ukf", "srukf", "iplf", "mcukf", "aukf", "faukf", "imm"):
        asked = scenario_of("target-tracking", nodes=4, steps=20, filter=name, rule="local")
        setup = prepare(asked)
        trace = read_trace(setup, in_memory(setup))
        alone = local_only(setup, trace.readings, None)
        np.testing.assert_allclose(alone.mean, trace.mean, rtol=1e-9, err_msg=name)


def test_a_rule_of_sets_warns_of_a_filter_that_has_no_effect():
    asked = scenario_of("liu2021-network", rule="ellipsoid", steps=5)
    assert not any("--filter" in one for one in warnings_of(prepare(asked)))
    found = warnings_of(prepare(asked.with_(filter="ekf")))
    assert any("--filter ekf changes nothing here" in one for one in found)
