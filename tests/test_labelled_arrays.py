"""Labelled records in the batched driver: the numbers of the in-process driver."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from concord.results.records.record_spread import figures_of
from concord.results.records.trace import read_trace
from concord.runtime.batched.build import build_network, without_array_form
from concord.runtime.drivers import in_memory
from concord.scenarios.catalogue import definition_named
from concord.scenarios.preparation import prepare, setup_of_run
from concord.scenarios.scenario import Scenario
from concord.scenarios.scenario_options import scenario_of
from concord.studies.monte_carlo.simulate import simulate
from concord.studies.near_agreement import departures
from tests.changing_networks import changing
from tests.test_batched_agreement import check_agreement, check_changing

pytestmark = pytest.mark.slow

RUNS = (0, 3)
# A node that returns has a window of its own, which has no array form.
FINAL = ("kill", "cut", "heal", "loss", "loss on")
SET_TO = ("rounds=2", "occupancy=0.5", "rule=ci", "rule=labelled")


def labelled(name: str = "target-tracking", **options: Any) -> Scenario:
    # The time of the bus is not what is compared here.
    usual = definition_named(name).defaults.with_(rule="labelled", stretch=100.0)
    # An arbiter of a schedule without contenders is left out.
    return usual.with_known(**options)[0]


def check(asked: Scenario) -> None:
    """Beliefs, bytes, ages, counters; and how records spread."""
    check_agreement(asked, RUNS)
    setup = prepare(asked)
    spreads = simulate(setup, RUNS, keep=()).spreads
    for spread, run in zip(spreads, RUNS, strict=True):
        own = setup_of_run(setup, run)
        expected = read_trace(own, in_memory(own)).spread
        assert expected is not None
        for name, value in spread._asdict().items():
            np.testing.assert_array_equal(value, getattr(expected, name), err_msg=name)


@st.composite
def scenarios(draw: st.DrawFn) -> Scenario:
    """Small networks; of every schedule, relaying or not, with windows that are too short, frames
    that are, links that lose some, gates and record sizes."""
    schedule = draw(st.sampled_from(["full", "round-robin", "hybrid", "hybrid-leaves", "dynamic"]))
    name = draw(st.sampled_from(["target-tracking", "target-crossing", "oscillator"]))
    loss = draw(st.sampled_from([0.0, 0.0, 0.3]))
    window = draw(st.sampled_from([None, 2, 4]))
    return labelled(
        name,
        nodes=draw(st.integers(1, 9)),
        graph=draw(st.sampled_from(["ring", "path", "star", "complete"])),
        rounds=draw(st.integers(1, 3)),
        steps=draw(st.integers(1, 9)),
        seed=draw(st.integers(0, 99)),
        schedule=schedule,
        occupancy=1.0 if schedule == "full" else draw(st.sampled_from([0.1, 0.3, 0.6])),
        relay=draw(st.booleans()),
        arbiter=draw(st.sampled_from(["urgency", "wtod", "minislot", "round-robin"])),
        loss=loss,
        window_steps=window,
        digest_steps=draw(st.sampled_from([None, 0, 2])),
        repeat_above=draw(st.sampled_from([0.0, 0.12, 0.5])),
        repeat_bytes=draw(st.sampled_from([0, 10, 48, 254])),
        record_number=draw(st.sampled_from(["int12", "int16", "float32", "float64"])),
        gate_probability=draw(st.sampled_from([0.0, 0.2])),
        withhold_below=draw(st.sampled_from([0.0, 0.0, 0.05, 0.5])),
        payload_bytes=draw(st.sampled_from([120, 254])),
    )


@given(scenarios())
@settings(max_examples=25)
def test_random_networks_agree(asked: Scenario):
    check(asked)


@given(changing(scenarios(), set_to=SET_TO, verbs=FINAL))
@settings(max_examples=25)
def test_random_networks_that_change_agree(asked: Scenario):
    check_changing(asked)


@pytest.mark.parametrize("relay", [False, True])
def test_the_study_agrees(relay: bool):
    check(labelled(nodes=20, steps=5, schedule="hybrid", occupancy=0.25, relay=relay))


def test_frames_that_are_short_and_checkpoints_agree():
    """Twelve sources share frames of few records, and what is late leaves the window."""
    asked = labelled(
        nodes=12, graph="path", steps=10, rounds=1, window_steps=3, payload_bytes=100,
        schedule="dynamic", occupancy=0.3, record_number="float64",
    )  # fmt: skip
    check(asked)
    counters = simulate(prepare(asked), RUNS, keep=()).counters
    assert counters["checkpoint-fused"].sum() > 0


def test_a_neighbour_that_was_long_unheard_is_sent_a_checkpoint():
    """Nothing leaves the window in so few steps, so nothing else asks for one."""
    asked = labelled(nodes=4, graph="ring", steps=28, rounds=1, loss=0.9, schedule="full")
    check(asked)
    counters = simulate(prepare(asked), RUNS, keep=()).counters
    assert sum(counters[name].sum() for name in counters if name.startswith("checkpoint")) > 0


def test_loss_makes_frames_no_longer_than_their_cap_of_repetitions():
    """At a tenth of the bus, where without a cap all frames grow full."""

    def bytes_per_share(**options: Any) -> float:
        asked = labelled(
            nodes=20, steps=30, loss=0.3, relay=True, schedule="dynamic", occupancy=0.1, **options
        )
        spread = simulate(prepare(asked), range(3), keep=()).spreads
        figures = [figures_of(one) for one in spread]
        return float(np.mean([one.body_bytes_per_step for one in figures])) / 6

    none, usual, everything = (
        bytes_per_share(**options)
        for options in (
            {"repeat_bytes": 0}, {}, {"repeat_above": 0.0, "repeat_bytes": 254},
        )
    )  # fmt: skip
    assert none < usual < none + 48
    assert everything > none + 48


@pytest.mark.parametrize("name", ["dc-motor-position", "cruise-control"])
def test_driven_plants_agree(name: str):
    bus = {"schedule": "hybrid", "occupancy": 0.4}
    check(labelled(name, nodes=4, graph="ring", steps=6, control="0", **bus))


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("liu2021-network", {"occupancy": 0.5, "record_number": "float32"}),
        ("meng2025-network", {"occupancy": 0.5}),
        ("vehicle-network", {"filter": "ukf", "cluster": "fitted"}),
    ],
)
def test_sensors_that_are_unlike_or_noisier_with_the_state_agree(name: str, options: dict):
    check(labelled(name, steps=6, **options))


def test_sightings_of_recorded_robots_agree(mrclam_folder: Path):
    check(labelled("mrclam", data=str(mrclam_folder), target=4, steps=60))


@pytest.mark.parametrize(
    ("name", "options", "says"),
    [
        ("target-tracking", {"cluster": "bosch", "loss": 0.1}, "--cluster bosch"),
        ("oscillator", {"changes": ("3 kill 1", "4 restart 1")}, "--changes restart"),
    ],
)
def test_what_has_no_array_form_is_named(name: str, options: dict[str, Any], says: str):
    asked = labelled(name, **options)
    lacking = without_array_form(asked)
    assert lacking is not None and says in lacking
    if name == "target-tracking":
        with pytest.raises(ValueError, match="use --driver in-process"):
            build_network(prepare(labelled(nodes=4, graph="ring", steps=2, **options)), [0])


@pytest.mark.parametrize(("cluster", "nodes"), [("audi", 12), ("flexray-adapter", 5)])
@pytest.mark.parametrize("arbiter", ["urgency", "wtod", "minislot"])
def test_shares_that_compete_for_minislots_have_their_own_lengths(
    arbiter: str, cluster: str, nodes: int
):
    """On a cluster that does not hold the longest shares of all winners, lengths decide."""
    options = scenario_of(
        scenario="target-tracking", nodes=nodes, rule="labelled", schedule="dynamic",
        occupancy=0.75, cluster=cluster, arbiter=arbiter, steps=12, payload_bytes=100,
        **({"urgency_classes": 2} if arbiter == "urgency" else {}),
    )  # fmt: skip
    assert without_array_form(options) is None
    setup = prepare(options)
    trace = read_trace(setup, in_memory(setup))
    assert not departures(setup, trace)
    histories = simulate(setup, [0])
    for name, counts in histories.counters.items():
        assert [one.get(name, 0) for one in trace.counters] == counts[0].tolist(), name
    assert trace.classes.any() == (arbiter == "urgency")
