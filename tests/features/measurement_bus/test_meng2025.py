"""The measurement bus as a network of nodes: the same as arrays over steps, in every driver."""

from pathlib import Path

import numpy as np
import pytest

from concord.features.measurement_bus import meng2025_plant as meng2025
from concord.features.measurement_bus.gaussian_receiver import GaussianReceiver
from concord.features.measurement_bus.measured import bus_of, receiver_of
from concord.features.measurement_bus.measurement_runs import estimate, first_received, slots_of
from concord.features.measurement_bus.meng2025 import SYSTEM, plant_on_bus
from concord.features.measurement_bus.stochastic_ukf import MeasurementFilter
from concord.filters.gaussian import Gaussian
from concord.papers.meng2025.filter_as_printed import PAPER_LITERAL, PAPER_LITERAL_R
from concord.papers.meng2025.runs import from_step_0
from concord.results.records.trace import Trace, read_trace
from concord.runtime.drivers import in_memory
from concord.scenarios.baselines import centralised, local_only
from concord.scenarios.build import build_bus
from concord.scenarios.preparation import prepare
from concord.scenarios.scenario import Scenario
from concord.scenarios.setup import Setup
from tests.experiments.support import scenario, summary_of
from tests.nodes import changing
from tests.test_agreement import assert_agreement

AS_PRINTED = "concord.papers.meng2025.filter_as_printed"
STAR: dict = {"steps": 41}
NETWORK: dict = {"nodes": 4, "steps": 25}


def run(setup: Setup) -> Trace:
    return read_trace(setup, in_memory(setup))


def star(**changes) -> Setup:
    return prepare(scenario("meng2025", **{**STAR, **changes}))


def network(**changes) -> Setup:
    return prepare(scenario("meng2025-network", **{**NETWORK, **changes}))


def as_arrays(setup: Setup, trace: Trace) -> tuple[Gaussian, np.ndarray]:
    """The same bus and filter over all steps at once: beliefs (steps,), senders (steps, N)."""
    asked: Scenario = setup.scenario
    bus = bus_of(plant_on_bus(), asked)
    received = first_received(SYSTEM, meng2025.PRIOR_MEAN)
    slots = slots_of(bus, trace.readings[:, 1:, 0, 0], received)
    prior = Gaussian(meng2025.PRIOR_MEAN, meng2025.PRIOR_COV)
    receiver = receiver_of(plant_on_bus(), asked, prior, None)
    return estimate(receiver, from_step_0(slots)), slots.sent


# --- the star ------------------------------------------------------------------------------------


def test_the_first_cycles():
    trace = run(star())
    senders = [np.flatnonzero(sent[0]).tolist() for sent in trace.published[:11]]
    assert senders[0] == []
    turns = [sender for (sender,) in senders[1:]]
    assert turns[:4] == turns[5:9] == [1, 2, 3, 4]
    assert {turns[4], turns[9]} <= {5, 6}


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"static_slots": 2},
        {"hold": "zero-input", "schedule": "dynamic", "arbiter": "wtod"},
        {"schedule": "round-robin"},
        {"schedule": "full", "run": 3},
        {"filter": "ekf", "bid_weights": "1 1 1 1 9 1; 1 1 1 1 1 9"},
        {"filter": f"{AS_PRINTED}:PAPER_LITERAL"},
        {"filter": f"{AS_PRINTED}:PAPER_LITERAL_R"},
    ],
    ids=str,
)
def test_nodes_do_what_the_arrays_do(changes: dict):
    setup = star(steps=16, **changes)
    trace = run(setup)
    beliefs, sent = as_arrays(setup, trace)
    np.testing.assert_array_equal(trace.published[1:, 0, 1:], sent)
    np.testing.assert_allclose(trace.mean[:, 0], beliefs.mean, rtol=1e-10, atol=1e-10)
    np.testing.assert_allclose(trace.cov[:, 0], beliefs.cov, rtol=1e-10, atol=1e-10)


@pytest.mark.parametrize(
    ("name", "filter"),
    [
        (f"{AS_PRINTED}:PAPER_LITERAL", PAPER_LITERAL),
        (f"{AS_PRINTED}:PAPER_LITERAL_R", PAPER_LITERAL_R),
    ],
)
def test_the_filters_as_printed_are_found_by_their_module(name: str, filter: MeasurementFilter):
    prior = Gaussian(meng2025.PRIOR_MEAN, meng2025.PRIOR_COV)
    receiver = receiver_of(plant_on_bus(), star(filter=name).scenario, prior, None)
    assert isinstance(receiver, GaussianReceiver)
    assert receiver.filter is filter


def test_nobody_on_the_bus_is_prediction_alone():
    trace = run(star(schedule="none"))
    assert not trace.published.any()
    mean = meng2025.PRIOR_MEAN
    for step in range(40):
        mean = meng2025.transition(mean, None, step)
    np.testing.assert_allclose(trace.mean[-1, 0], mean, atol=1e-12)


def test_sensors_believe_nothing_and_the_figures_are_those_of_the_estimator():
    setup = star()
    trace = run(setup)
    assert np.isnan(trace.mean[:, 1:]).all()
    figures = summary_of(setup, trace)
    errors = (trace.mean[:, 0] - trace.truth)[1:]
    expected = np.sqrt((errors**2).sum(-1).mean())
    assert figures.value("rmse") == pytest.approx(expected)
    assert figures.nodes[0]["rmse"].value == pytest.approx(expected)
    worst, central = (figures.value(n) for n in ("worst_node_to_centralised", "rmse_centralised"))
    assert worst == pytest.approx(expected / central)
    assert figures.value("disagreement") == 0
    assert all(np.isnan(node["rmse"].value) for node in figures.nodes[1:])
    # With one of six sensors per step: better than none, not as good as all.
    assert central < figures.value("rmse") < figures.value("rmse_alone")


def test_its_baselines_are_all_sensors_and_none():
    setup = star(steps=12)
    trace = run(setup)
    everything = run(star(steps=12, schedule="full"))
    nothing = run(star(steps=12, schedule="none"))
    central = centralised(setup, trace.readings, trace.control)
    alone = local_only(setup, trace.readings, trace.control)
    np.testing.assert_allclose(central.mean, everything.mean[:, 0], atol=1e-10)
    np.testing.assert_allclose(alone.mean[:, 0], nothing.mean[:, 0], atol=1e-10)


def test_short_numbers_on_the_wire_and_frames_that_get_lost():
    exact, short = run(star()), run(star(number="float32"))
    apart = np.abs(exact.mean[:, 0] - short.mean[:, 0]).max()
    assert 0 < apart < 1e-5
    deaf = changing.run(star(steps=20), link=lambda sender, receiver, frame: ())
    assert deaf.counters[0]["missed"] == 19
    np.testing.assert_allclose(
        deaf.mean[:, 0], run(star(steps=20, schedule="none")).mean[:, 0], atol=1e-12
    )


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"nodes": 6}, "--nodes 6: must be 7"),
        ({"graph": "ring"}, "--graph ring: must be star"),
        ({"rounds": 2}, "--rounds 2: must be 1: a step is one slot"),
        ({"schedule": "dynamic", "trigger": 1.0}, "--trigger 1.0: must be 0"),
        ({"static_slots": 6}, "--static-slots 6: must be in 0..5"),
        ({"rule": "wac", "hold": "decayed"}, "--rule wac: must be reception: meng2025 has no "),
        ({"filter": "ellipsoid"}, "--filter ellipsoid: the noise of meng2025 has no bound"),
        ({"bid_weights": "1 1 1"}, "--bid-weights '1 1 1': must be 6 positive numbers"),
        ({"bid_weights": "1 1 1 1 1 0"}, "must be 6 positive numbers"),
        ({"schedule": "hybrid"}, "unknown schedule for a measurement bus"),
        ({"hold": "decayed"}, "unknown hold 'decayed'.*zero-order"),
    ],
)
def test_what_the_star_cannot_be(changes: dict, says: str):
    with pytest.raises(ValueError, match=says):
        star(**changes)


# --- the network ---------------------------------------------------------------------------------


def test_one_node_alone_is_the_estimator_of_the_star():
    """Same sensors, same bus, same noise; only the path through the house is another."""
    alone, whole = run(network(nodes=1, graph="complete", steps=31)), run(star(steps=31))
    np.testing.assert_array_equal(alone.truth, whole.truth)
    np.testing.assert_allclose(alone.mean[:, 0], whole.mean[:, 0], rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(alone.cov[:, 0], whole.cov[:, 0], rtol=1e-10, atol=1e-12)


def test_a_node_is_delivered_what_its_bus_transmits():
    """One sensor per step, in an order that is `node` slots ahead."""
    readings = run(network()).readings[:, :, 0]
    assert np.isnan(readings[0]).all()
    delivered = ~np.isnan(readings[1:])
    assert (delivered.sum(axis=-1) == 1).all()
    for node in range(4):
        for step in range(1, 25):
            sensor = int(delivered[step - 1, node].argmax()) + 1
            place = (step + node) % 5
            assert sensor == place if place else sensor in (5, 6)


def test_alone_in_the_figures_is_what_rule_local_gives():
    setup = network(rule="local")
    trace = run(setup)
    alone = local_only(setup, trace.readings, trace.control)
    np.testing.assert_allclose(alone.mean, trace.mean, rtol=1e-9, atol=1e-12)


def test_the_network_refuses_a_bus_without_contenders():
    with pytest.raises(ValueError, match="--static-slots 6: must be in"):
        network(static_slots=6)


# --- drivers -------------------------------------------------------------------------------------


@pytest.mark.zenoh
@pytest.mark.parametrize(
    "setup",
    [
        star(),
        star(number="float32", steps=12),
        star(schedule="dynamic", hold="zero-input", steps=12),
        network(steps=8),
    ],
    ids=["star", "literal", "dynamic", "network"],
)
def test_processes_give_the_same_bits(setup: Setup, tmp_path: Path):
    assert_agreement(setup, tmp_path)


def test_the_schedule_of_the_star_fits_a_cluster():
    bus = build_bus(star())
    assert bus.has_time
    assert bus.schedule.period == 5
