"""The batched driver gives the numbers of the in-process driver, whatever the scenario.

Every run of a Monte Carlo is compared with the run of that number, message by message. Estimates
and covariances agree to 1e-10 of their scale; bids, bytes by sender, ages and counters agree
exactly. Where the wire carries float32, a number between two float32 values may be rounded to
either, so the tolerance there is their spacing.
"""

from functools import partial

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from concord.results.records.runs import Runs
from concord.results.records.trace import Trace, read_trace
from concord.runtime.batched.build import without_array_form
from concord.runtime.drivers import in_memory
from concord.scenarios.catalogue import definition_named
from concord.scenarios.preparation import prepare, setup_of_run
from concord.scenarios.scenario import Scenario
from concord.scenarios.setup import Setup
from concord.scenarios.types.rules import NumberRule
from concord.studies.monte_carlo.simulate import COV, OPTIONAL, simulate
from concord.studies.near_agreement import scale_of_cov, scale_of_mean
from tests.changing_networks import changing
from tests.experiments.support import scenario

pytestmark = pytest.mark.slow

TOLERANCES = {
    "float64": 1e-10,
    "float32": 8 * float(np.finfo(np.float32).eps),
    "float16": 2.0**-4,
}
RUNS = (0, 3)
PLANTS = ("oscillator", "target-crossing", "dc-motor-position", "cruise-control")
FRESH = ("hcmci", "icf", "diffusion", "kcf")
NOVELTIES = ("diffusion", "kcf")
CLOCKS_LOST = "kills that leave clocks without sync frames (--changes)"
RULES = ("ci", "wac", "local", "trimmed-ci", *FRESH)
HOLDS = ("decayed", "predict", "raw", "drop", "renormalise", "in-step")
WEIGHTS = ("metropolis", "maximum-degree", "equal-neighbour")  # the last leads to no average
ARBITERS = ("wtod", "minislot", "round-robin")
SET = (
    "rounds=1", "rounds=3", "hold=drop", "decay=0.9 trigger=0.5", "arbiter=round-robin", "rule=ci",
    "rule=hcmci", "rule=kcf", "schedule=hybrid occupancy=0.5",
)  # fmt: skip


def check_agreement(asked: Scenario, runs: tuple[int, ...] = RUNS) -> None:
    setup = prepare(asked)
    assert without_array_form(asked) is None
    histories = simulate(setup, runs, keep=OPTIONAL)
    for place, run in enumerate(runs):
        check_run(histories, place, setup_of_run(setup, run))


def check_changing(asked: Scenario) -> None:
    """Where kills cost clocks their sync frames there are no arrays to compare."""
    assume(without_array_form(asked) != CLOCKS_LOST)
    check_agreement(asked)


def check_run(histories: Runs, place: int, setup: Setup) -> Trace:
    """Compare a run with that of messages, whose trace is returned."""
    trace = read_trace(setup, in_memory(setup))
    sd = np.sqrt(np.diagonal(trace.cov, axis1=-2, axis2=-1))
    assert histories.cov is not None and histories.ages is not None
    # Checkpoints of labelled records are float32, whatever other numbers are.
    rounded = any("checkpoint-fused" in counters for counters in trace.counters)
    rule = setup.scenario.rule
    number = rule.number if isinstance(rule, NumberRule) else "float64"
    near = partial(check_near, TOLERANCES["float32" if rounded else number])
    near(histories.truth[place], trace.truth, np.abs(trace.truth))
    near(histories.readings[place], trace.readings, np.abs(trace.readings))  # type: ignore[index]
    near(histories.mean[place], trace.mean, scale_of_mean(setup, trace.mean, sd))
    near(histories.cov[place], trace.cov, scale_of_cov(setup, trace.mean, sd))
    if trace.control is not None:
        assert histories.control is not None
        near(histories.control[place], trace.control, np.abs(trace.control))
    np.testing.assert_array_equal(histories.payload_bytes[place], trace.payload_bytes)
    np.testing.assert_array_equal(histories.asked[place], trace.asked)
    first = 0
    for node, heard in enumerate(setup.neighbours):
        links = slice(first, first := first + len(heard))
        np.testing.assert_array_equal(
            histories.ages[place][:, links], trace.ages[:, node, heard], err_msg=f"ages of {node}"
        )
    names = {name for counters in trace.counters for name in counters}
    assert names == {name for name, counts in histories.counters.items() if counts[place].any()}
    for name in names:
        expected = [counters.get(name, 0) for counters in trace.counters]
        assert histories.counters[name][place].tolist() == expected, name
    return trace


def check_near(
    tolerance: float, value: np.ndarray, expected: np.ndarray, scale: np.ndarray
) -> None:
    assert value.shape == expected.shape
    np.testing.assert_array_equal(np.isnan(value), np.isnan(expected))
    # A number that is zero up to rounding has the scale of its neighbours.
    least = 1e-3 * np.nanmax(scale, initial=0.0)
    worst = np.nanmax(np.abs(value - expected) / np.maximum(scale, least + 1e-300), initial=0.0)
    assert worst < tolerance, worst


@st.composite
def scenarios(draw: st.DrawFn) -> Scenario:
    """Small scenarios that concord runs, of every rule, hold, arbiter, graph, ..."""
    rule = draw(st.sampled_from(RULES))
    schedule = draw(st.sampled_from(["full", "round-robin", "hybrid", "hybrid-leaves", "dynamic"]))
    name = draw(st.sampled_from(PLANTS))
    asked = {
        "nodes": draw(st.integers(1, 6)),
        "graph": draw(st.sampled_from(["ring", "path", "star", "complete"])),
        "weights": draw(st.sampled_from(WEIGHTS[: 2 if rule == "icf" else 3])),
        "rule": rule,
        "rounds": draw(st.integers(1, 3)),
        "steps": draw(st.integers(1, 7)),
        "seed": draw(st.integers(0, 99)),
        "schedule": schedule,
        "occupancy": 1.0 if schedule == "full" else draw(st.sampled_from([0.2, 0.5, 0.9])),
        "arbiter": draw(st.sampled_from(ARBITERS)),
        "trigger": draw(st.sampled_from([0.0, 0.5])),
        "number": draw(
            st.sampled_from(["float64", "float32", "float16"][: 2 if rule in NOVELTIES else 3])
        ),
        "loss": draw(st.sampled_from([0.0, 0.0, 0.3])),
        # The time of the bus is not what is compared here.
        "stretch": 100.0,
    }
    if rule == "trimmed-ci":
        # Every node must hear two for each liar.
        asked["nodes"] = draw(st.integers(3, 6))
        asked["graph"] = draw(st.sampled_from(["ring", "complete"]))
    if rule in ("ci", "wac", "trimmed-ci"):
        asked["hold"] = draw(st.sampled_from(HOLDS))
        asked["decay"] = draw(st.sampled_from([0.0, 0.5, 1.0]))
        asked["determinant_weights"] = draw(st.booleans())
    if name in ("dc-motor-position", "cruise-control"):
        asked["control"] = draw(st.sampled_from(["open", "truth", "0"]))
    # Options of other rules and schedules than those that were drawn are left out.
    return definition_named(name).defaults.with_known(**asked)[0]


@given(scenarios())
@settings(max_examples=40)
def test_random_scenarios_agree(asked: Scenario):
    check_agreement(asked)


@given(changing(scenarios(), SET))
@settings(max_examples=40)
def test_random_scenarios_with_random_changes_agree(asked: Scenario):
    check_changing(asked)


def test_kills_that_leave_one_sync_node_run_message_by_message():
    """The clocks of a node that hears no sync frame fail, and then it sends nothing."""
    pair = scenario("oscillator", nodes=2, steps=2, rule="local", changes=("0 kill 0",))
    assert without_array_form(pair) == CLOCKS_LOST
    assert without_array_form(pair.with_(bus="ideal")) is None
    three = scenario(
        "oscillator", nodes=4, steps=4, changes=("0 kill 0", "1 restart 0", "2 kill 1")
    )
    assert without_array_form(three) is None
    assert (
        without_array_form(three.with_(changes=("0 kill 0", "1 kill 1", "2 kill 2"))) == CLOCKS_LOST
    )


def test_a_rule_that_is_set_back_has_the_options_of_the_original_scenario():
    """Frames of CAN FD carry 64 bytes: a share of 60 takes one, and the usual share several."""
    asked = scenario(
        "oscillator", nodes=4, steps=8, rule="labelled", bus="can-fd", payload_bytes=60,
        changes=("2 set rule=ci", "4 set rule=labelled"),
    )  # fmt: skip
    check_agreement(asked)


EVENTFUL = (
    "0 kill 4", "2 kill 3", "2 cut 0 1", "3 loss 0.3", "4 restart 3", "5 kill 1",
    "5 cut 2 0 one-way", "6 heal 0 1", "6 restart 4", "7 restart 1", "8 loss 0.5 0 5", "9 kill 2",
    "10 set rounds=2", "11 restart 2", "12 set schedule=hybrid occupancy=0.5",
)  # fmt: skip


@pytest.mark.parametrize("graph", ["ring", "complete"])
@pytest.mark.parametrize("rule", RULES)
def test_every_rule_agrees_through_kills_restarts_cuts_losses_and_settings(rule: str, graph: str):
    bus = {"schedule": "hybrid", "occupancy": 0.7, "stretch": 100.0}
    changes = [line for line in EVENTFUL if graph == "complete" or "2 0" not in line]
    asked = {"nodes": 6, "steps": 14, "graph": graph, "changes": tuple(changes), **bus}
    check_agreement(scenario("oscillator", rule=rule, **asked))


@pytest.mark.parametrize("rule", RULES)
def test_rules_that_follow_each_other_agree(rule: str):
    changes = (f"3 set rule={rule}", "5 kill 2", "6 set rounds=1", "7 set rule=ci", "8 restart 2")
    check_agreement(scenario("oscillator", nodes=5, steps=10, rule="wac", changes=changes))


@pytest.mark.parametrize("rule", ["ci", "kcf", "labelled"])
def test_the_node_that_closes_the_loop_may_be_out(rule: str):
    """The actuator stays where it was, and before the first control there is none."""
    again = () if rule == "labelled" else ("4 restart 0", "6 kill 0", "7 kill 2", "8 restart 0")
    asked = scenario("dc-motor-position", nodes=4, steps=10, rule=rule, stretch=100.0)
    for first in (0, 1, 3):
        changes = (f"{first} kill 0", *again)
        check_agreement(asked.with_(control="0", changes=changes))


@pytest.mark.parametrize("rule", ["ci", "hcmci", "kcf"])
def test_who_comes_back_asks_as_one_that_never_sent(rule: str):
    """No change is large enough for another slot; a restarted node needs none."""
    bus = {"schedule": "dynamic", "occupancy": 0.5, "trigger": 1e6, "stretch": 100.0}
    changes = ("4 kill 2", "6 restart 2")
    asked = scenario("oscillator", nodes=4, steps=9, rule=rule, changes=changes, **bus)
    check_agreement(asked)
    times = np.any(simulate(prepare(asked), [0]).asked[0, :, :, 2], axis=1)
    assert times[0] and times[6] and not times[7:].any() and not times[3:6].any()


@st.composite
def bounded_scenarios(draw: st.DrawFn) -> Scenario:
    """Small networks of sets, of every hold policy that keeps the truth inside."""
    schedule = draw(st.sampled_from(["full", "round-robin", "hybrid", "dynamic"]))
    asked = definition_named("liu2021-network").defaults.with_known(
        rule=draw(st.sampled_from(["ellipsoid", "zonotope"])),
        nodes=draw(st.integers(1, 5)),
        graph=draw(st.sampled_from(["ring", "path", "complete"])),
        rounds=draw(st.integers(1, 2)),
        steps=draw(st.integers(1, 6)),
        seed=draw(st.integers(0, 99)),
        schedule=schedule,
        occupancy=1.0 if schedule == "full" else draw(st.sampled_from([0.2, 0.5])),
        trigger=draw(st.sampled_from([0.0, 0.5])),
        hold=draw(st.sampled_from(["predict", "drop"])),
        loss=draw(st.sampled_from([0.0, 0.3])),
        control=draw(st.sampled_from(["open", "0"])),
        stretch=100.0,
    )
    return asked[0]


@given(bounded_scenarios())
@settings(max_examples=15)
def test_random_networks_of_sets_agree(asked: Scenario):
    check_agreement(asked)


@pytest.mark.parametrize("rule", ["ellipsoid", "zonotope"])
def test_sets_agree_through_kills_restarts_cuts_and_losses(rule: str):
    changes = ("2 kill 3", "3 loss 0.3", "4 restart 3", "5 cut 0 1", "6 heal 0 1")
    check_agreement(scenario("liu2021-network", nodes=4, steps=8, rule=rule, changes=changes))


LARGER = {
    "a graph of unequal degrees": {"graph": "geometric", "steps": 8},
    "half of the bus": {"schedule": "hybrid", "occupancy": 0.5, "steps": 8},
    "what the dynamic segment holds hangs on who wins": {
        "schedule": "dynamic",
        "occupancy": 0.5,
        "cluster": "bosch",
        "graph": "ring",
        "steps": 6,
        "rounds": 1,
    },
    "lossy links and a share of two frames": {
        "loss": 0.2,
        "cluster": "bosch",
        "nodes": 6,
        "graph": "ring",
        "steps": 6,
        "rounds": 1,
    },
}


@pytest.mark.parametrize("what", LARGER)
def test_tracking_agrees(what: str):
    check_agreement(scenario("target-tracking", **{"stretch": 100.0, **LARGER[what]}))


def test_runs_do_not_hang_on_which_are_asked_for_or_on_what_is_kept():
    setup = prepare(scenario("oscillator", nodes=4, steps=6, schedule="hybrid", occupancy=0.5))
    several = simulate(setup, range(5), keep=OPTIONAL)
    (alone,) = (simulate(setup, [3], keep=[COV]),)
    np.testing.assert_allclose(several.mean[3], alone.mean[0], rtol=1e-12, atol=1e-12)
    np.testing.assert_array_equal(several.payload_bytes[3], alone.payload_bytes[0])
    assert alone.readings is None and alone.ages is None


def test_rules_without_an_array_form_run_message_by_message():
    only = {"rule": "labelled", "cluster": "bosch", "loss": 0.1, "stretch": 100.0}
    setup = prepare(scenario("target-tracking", nodes=5, graph="ring", steps=3, rounds=1, **only))
    assert "--cluster bosch" in (without_array_form(setup.scenario) or "")
    histories = simulate(setup, RUNS, keep=OPTIONAL)
    for place, run in enumerate(RUNS):
        check_run(histories, place, setup_of_run(setup, run))


@pytest.mark.parametrize(
    ("runs", "keep", "says"),
    [([], [], "at least one"), ([1, 1], [], "once"), ([0], ["covariances"], "choose from")],
)
def test_impossible_wishes_are_refused(runs: list[int], keep: list[str], says: str):
    setup = prepare(scenario("oscillator", nodes=3, steps=2))
    with pytest.raises(ValueError, match=says):
        simulate(setup, runs, keep=keep)


def test_a_setup_of_another_run_is_the_same_network():
    asked = scenario("target-tracking", nodes=6, steps=3)
    third = prepare(asked.with_(run=3))
    assert setup_of_run(prepare(asked), 3) == third
