"""The rule `labelled` from the command line's options to a run, and what it refuses."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats

from concord.filters.metrics import nees
from concord.nodes.rules.labelled.flooding import LabelledFlooding
from concord.results.bus.bus_times import wire_per_step
from concord.results.bus.sent_shares import SentShares
from concord.results.figures.intervals import Interval, ratio_t
from concord.results.records.trace import Trace, read_trace
from concord.runtime.drivers import in_memory
from concord.scenarios.baselines import centralised, centralised_of_runs
from concord.scenarios.build import build_bus, build_node
from concord.scenarios.bus_table.bus_plan import build_schedule
from concord.scenarios.catalogue import definition_named
from concord.scenarios.preparation import prepare
from concord.scenarios.rule_table.labelled import (
    check_labelled,
    digest_of,
    gates_of,
    latency_steps,
    window_of,
)
from concord.scenarios.scenario import Scenario
from concord.scenarios.scenario_options import scenario_of
from concord.scenarios.setup import Setup
from concord.scenarios.warnings import warnings_of
from concord.studies.monte_carlo.simulate import COV, READINGS, simulate
from tests.scenarios.labelled_cases import HUB, CaseOutcome, FaultCase, runs_of_case
from tests.scenarios.labelled_exact import EVERYTHING, FULL_INFORMATION, audit, full_information
from tests.test_agreement import assert_agreement


def setup_of(**options) -> Setup:
    chosen = {"scenario": "oscillator", "rule": "labelled", "steps": 12, **options}
    return prepare(scenario_of(**chosen))


def trace_of(setup: Setup) -> Trace:
    return read_trace(setup, in_memory(setup))


# --- exactness -----------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("options", FULL_INFORMATION, ids=lambda o: f"{o['scenario']} {o['graph']}")
def test_with_all_records_in_time_every_node_is_the_centralised_filter(options: dict):
    assert full_information(options) <= 1e-9
    # Readings that are rounded are seen.
    rounded = {**options, "record_number": "float32", "steps": 10}
    assert full_information(rounded) > 1e-9


@pytest.mark.parametrize("number", range(4))
def test_records_in_use_are_those_that_a_search_of_the_schedule_finds(number: int):
    found = audit(number)
    assert found.pairs > 0 and (found.missing, found.impossible) == (0, 0)
    assert found.deviation <= 1e-9


@pytest.mark.study
def test_records_in_use_are_those_that_a_search_finds_in_twenty_networks():
    for number in range(4, 20):
        found = audit(number)
        assert (found.missing, found.impossible) == (0, 0), number
        assert found.deviation <= 1e-9, number


def test_a_rule_that_forgets_to_repeat_what_was_lost_is_found(monkeypatch: pytest.MonkeyPatch):
    """Sharing only what neighbours are believed to lack: what is lost comes late, or never."""

    monkeypatch.setitem(EVERYTHING, "repeat_bytes", 0)
    assert any(audit(number).missing for number in range(12))


def test_quantised_records_are_the_centralised_filter_that_knows_of_the_rounding(
    monkeypatch: pytest.MonkeyPatch,
):
    """Readings in steps of a sixteenth of their deviation; R larger by a twelfth of its square."""
    setup = setup_of(
        scenario="target-tracking", nodes=6, graph="complete", rounds=1, schedule="full", steps=30
    )
    trace = trace_of(setup)
    definition = definition_named("target-tracking")
    step = np.array([10.0, np.deg2rad(2.0)]) / 16
    larger = np.sqrt(1 + 1 / (12 * 16**2))

    def noisier(scenario: Scenario, node: int):
        sensor: Any = definition.sensor(scenario, node)
        return replace(
            sensor,
            range_std_m=larger * sensor.range_std_m,
            bearing_std_rad=larger * sensor.bearing_std_rad,
        )

    monkeypatch.setattr(
        "concord.scenarios.baselines.definition_of",
        lambda _: definition._replace(sensor=noisier, sensors=None),
    )
    best = centralised(setup, step * np.round(trace.readings / step), None)
    np.testing.assert_allclose(trace.mean[:, 0], best.mean, rtol=0, atol=1e-8)
    np.testing.assert_allclose(trace.cov[:, 0], best.cov, rtol=1e-9, atol=1e-9)


# --- every plant ---------------------------------------------------------------------------------

PLANTS = {
    "target-tracking": {"occupancy": 0.25},
    "meng2025-network": {"occupancy": 0.5},
    "liu2021-network": {"occupancy": 0.5, "record_number": "float32"},
    "vehicle-network": {"filter": "ukf"},
    "target-crossing": {"occupancy": 0.25, "schedule": "dynamic", "relay": True},
    "oscillator": {"occupancy": 0.5, "schedule": "hybrid-leaves"},
    "cruise-control": {"stretch": 2.0},
    "suspension": {"stretch": 30.0},
    "aircraft-pitch": {"stretch": 2.0, "record_number": "float32"},
    "dc-motor-speed": {"stretch": 2.0, "control": "truth"},
    "dc-motor-position": {"stretch": 2.0, "occupancy": 0.5, "relay": True},
}


@pytest.mark.slow
@pytest.mark.parametrize("name", PLANTS)
def test_every_plant_runs_and_no_record_is_lost(name: str):
    trace = trace_of(setup_of(scenario=name, steps=15, digest_steps=2, **PLANTS[name]))
    assert trace.steps == 15
    assert (np.linalg.eigvalsh(trace.cov) > 0).all()
    assert not any("failed" in event or "rej" in event for c in trace.counters for event in c)


@pytest.mark.zenoh
@pytest.mark.parametrize("relay", [False, True])
def test_processes_give_the_bits_of_one_process(relay: bool, tmp_path: Path):
    options = {"nodes": 4, "window_steps": 3, "relay": relay, "digest_steps": 2}
    assert_agreement(setup_of(occupancy=0.5, steps=5, **options), tmp_path)


# --- gates ---------------------------------------------------------------------------------------


@pytest.mark.study
def test_a_gate_lets_pass_what_is_as_likely_as_it_should_be():
    """Thresholds are for as many entries as were taken."""
    scenario = setup_of(gate_probability=0.01).scenario
    assert gates_of(scenario, 3) == pytest.approx(stats.chi2.ppf(0.99, [1, 2, 3]))
    assert gates_of(setup_of().scenario, 3) == ()
    setup = setup_of(gate_probability=0.01, steps=300)
    trace = trace_of(setup)
    taken = int((~np.isnan(trace.readings)).any(axis=(2, 3)).sum())
    gated = sum(counted.get("gated", 0) for counted in trace.counters)
    # Nothing is wrong here: one in a hundred is refused, within five deviations of a count.
    assert abs(gated - 0.01 * taken) < 5 * np.sqrt(0.01 * taken)


def test_a_wrong_reading_is_used_by_nobody():
    """Behind the gate errors are as without outliers; without it they are many times that."""
    part = {"occupancy": 0.5, "schedule": "hybrid", "steps": 40}
    (clean,) = runs_of_case(FaultCase(part), 1)
    (gated,) = runs_of_case(FaultCase({**part, "gate_probability": 1e-4}, outliers=0.1), 1)
    (open_to_all,) = runs_of_case(FaultCase(part, outliers=0.1), 1)
    assert gated.wrong_refused >= 0.9 * gated.wrong > 0 and gated.right_refused <= 2
    assert open_to_all.wrong_refused == 0
    errors = [np.sqrt(one.squared[20:].mean()) for one in (clean, gated, open_to_all)]
    assert errors[1] < 1.2 * errors[0] and errors[2] > 1.5 * errors[0]


# --- faults, and other rules ----------------------------------------------------------------------


def case(occupancy: float, **options: Any) -> FaultCase:
    ideal = {"schedule": "hybrid", "arbiter": "wtod", "payload_bytes": 254}
    return FaultCase({"occupancy": occupancy, **ideal, **options})


def over_centralised(found: Sequence[CaseOutcome]) -> Interval:
    """RMSE over that of the centralised filter, which loses nothing, from step 20 on."""
    squared = [(one.squared[20:].mean(), one.squared_centralised[20:].mean()) for one in found]
    return ratio_t(*np.array(squared, dtype=np.float64).T)


@pytest.mark.study
@pytest.mark.parametrize(
    ("options", "figure"),
    [
        ({"loss": 0.3}, 1.19),
        ({"loss": 0.3, "digest_steps": 0}, 1.35),
        ({"loss": 0.3, "relay": True}, 1.07),
        ({"graph": "path"}, 1.456),
    ],
)
def test_lost_frames_and_a_long_path_cost_no_more_than_the_study_measured(options, figure: float):
    found = runs_of_case(case(1.0, **options), 4)
    assert over_centralised(found).low <= figure


@pytest.mark.study
def test_a_restarted_hub_has_an_estimate_within_two_steps():
    found = runs_of_case(case(0.25)._replace(hub_dies=True), 2)
    assert np.mean([np.isnan(one.squared[:, HUB]).sum() for one in found]) <= 2.0


@pytest.mark.study
@pytest.mark.parametrize(
    ("options", "figure"),
    [({"schedule": "hybrid"}, 1.254), ({"schedule": "dynamic", "relay": True}, 1.051)],
)
def test_errors_are_those_of_the_study_and_below_those_of_ci(options, figure: float):
    """Every node is as consistent as the centralised filter, to 0.03 of its ANEES."""
    asked = {
        "scenario": "target-tracking", "nodes": 20, "arbiter": "wtod", "occupancy": 0.25
    }  # fmt: skip
    ours, excess = scored(rule="labelled", payload_bytes=254, **asked, **options)
    rival, _ = scored(rule="ci", number="float32", schedule="hybrid", **asked)
    assert ours.low <= figure and ours.value < rival.value
    assert excess <= 0.03


def scored(runs: int = 10, **options: Any) -> tuple[Interval, float]:
    """RMSE over that of the centralised filter, and the worst node's ANEES minus that filter's."""
    setup = prepare(scenario_of(**options))
    found = simulate(setup, range(runs), keep=(READINGS, COV))
    assert found.readings is not None and found.cov is not None
    central = centralised_of_runs(setup, range(runs), found.readings, found.control)
    score = definition_named("target-tracking").score
    squared, consistency = [], []
    for mean, cov in ((found.mean, found.cov), (central.mean[:, :, None], central.cov[:, :, None])):
        errors = (mean - found.truth[:, :, None])[:, score.first_step :]
        states = list(score.nees_states)
        squared.append((errors[..., list(score.states)] ** 2).sum(-1).mean(axis=(1, 2)))
        part = cov[:, score.first_step :][..., states, :][..., states]
        consistency.append(nees(errors[..., states], part).mean(axis=(0, 1)) / len(states))
    return ratio_t(*squared), float(consistency[0].max() - consistency[1].item())


# --- options -------------------------------------------------------------------------------------

REFUSED = [
    ({"relay": True, "rule": "ci"}, "belongs to --rule labelled"),
    ({"relay": True, "bus": "ideal"}, "--relay --bus ideal"),
    ({"relay": True, "latch_delay_us": 50.0}, "leaves 7.8 us"),
    ({"latch_delay_us": 50.0}, "belongs to --relay"),
    ({"window_steps": 0}, "must be 1 to 255"),
    ({"window_steps": 256}, "must be 1 to 255"),
    ({"window_steps": 4, "digest_steps": 5}, "--digest-steps 5"),
    ({"digest_steps": -1}, "0 or more"),
    ({"gate_probability": 1.0}, "at least 0 and below 1"),
    ({"trigger": 0.5, "schedule": "dynamic"}, "use --withhold-below"),
    ({"record_number": "int61"}, "'int16'"),
    ({"payload_bytes": 15}, "even, 16 to 254"),
    ({"payload_bytes": 256}, "even, 16 to 254"),
    ({"hold": "raw"}, "--hold raw: belongs to --rule ci"),
    ({"relay": True, "latch_delay_us": -1.0}, "0 or more"),
]


@pytest.mark.parametrize("options, words", REFUSED)
def test_what_cannot_be_is_refused_with_the_cure(options: dict, words: str):
    with pytest.raises(ValueError) as refused:
        setup_of(**options)
    assert words in str(refused.value)


def test_a_frame_too_short_for_a_checkpoint_is_refused_before_anything_starts():
    with pytest.raises(ValueError, match="raise --payload-bytes"):
        setup_of(payload_bytes=16)


def test_a_directed_graph_is_refused():
    scenario = setup_of().scenario
    with pytest.raises(ValueError, match="which does not hear it"):
        check_labelled(scenario, [[1], [0, 2], []], np.eye(3))


def test_the_window_is_the_latency_and_32_steps_at_least():
    path = [[1], *([i - 1, i + 1] for i in range(1, 19)), [18]]
    scenario = scenario_of(nodes=20, graph="path", rule="labelled", occupancy=0.1)
    # 19 hops, each of at most 20 nodes' turns, 2 a cycle and 3 cycles a step.
    assert latency_steps(scenario, path) == window_of(scenario, path) == -(-19 * 20 // 6)
    assert window_of(scenario.with_(occupancy=1.0), path) == 32
    assert window_of(scenario.with_(window_steps=5), path) == 5


def test_digests_are_said_where_links_lose_frames():
    replaced = scenario_of("oscillator", nodes=5, rule="labelled").with_
    assert [digest_of(replaced(loss=loss)) for loss in (0.0, 0.01, 0.02)] == [0, 0, 3]
    assert digest_of(replaced(loss=0.3, window_steps=2)) == 2
    assert digest_of(replaced(loss=0.3, digest_steps=0)) == 0


def test_a_digest_lasts_for_two_turns_of_a_node():
    lossy = scenario_of(rule="labelled", nodes=20, loss=0.3).with_
    # 20 nodes, three cycles a step, and 1, 2, 4 or 20 shares in each.
    found = [digest_of(lossy(occupancy=part)) for part in (0.05, 0.1, 0.2, 1.0)]
    assert found == [10, 2 * 20 // 6, 2 * 20 // 12, 3]
    # It leaves room in a frame where there are many nodes.
    assert digest_of(lossy(nodes=200, occupancy=0.05)) == 3


def test_leaves_own_the_static_slots():
    star = [[1, 2, 3, 4], [0], [0], [0], [0]]
    scenario = scenario_of(
        "oscillator", nodes=5, graph="star", schedule="hybrid-leaves", occupancy=0.8
    )
    schedule = build_schedule(scenario, star)
    assert {node for row in schedule.static_table for node in row} == {1, 2, 3}
    assert schedule.contender_table == ((0, 4),)
    plain = build_schedule(scenario.with_(schedule="hybrid"), star)
    assert build_schedule(scenario) == plain


def test_shares_stay_within_the_payload_that_was_asked_for():
    setup = setup_of(payload_bytes=40, steps=20, occupancy=0.25, nodes=8)
    trace = trace_of(setup)
    assert 8 < trace.payload_bytes.max() <= 40
    estimator = build_node(setup, 0).estimator
    assert isinstance(estimator, LabelledFlooding) and estimator.share_bytes == 40 - 8


# --- warnings ------------------------------------------------------------------------------------


def test_a_window_below_the_latency_and_relaying_are_said_before_the_run():
    assert warnings_of(setup_of(occupancy=0.5)) == ()
    (short,) = warnings_of(setup_of(nodes=8, graph="path", rounds=1, window_steps=5))
    assert "may need 7" in short and "--window-steps 7" in short
    (static,) = warnings_of(setup_of(relay=True))
    assert "within 5 us" in static
    (awarded,) = warnings_of(setup_of(relay=True, occupancy=0.5))
    assert awarded == static
    (_, ideal) = warnings_of(setup_of(relay=True, occupancy=0.5, arbiter="wtod"))
    assert "wtod is ideal" in ideal


@pytest.mark.parametrize("schedule", ["dynamic", "hybrid"])
def test_slots_awarded_one_by_one_are_no_more_than_the_schedule_has(schedule: str):
    setup = setup_of(schedule=schedule, occupancy=0.5, relay=True, nodes=6, steps=8)
    shares = trace_of(setup).published.sum(axis=2)
    # A node without new records sends no bid: at most three of six send.
    assert shares.max() == 3


@pytest.mark.slow
@pytest.mark.parametrize("occupancy", [0.5, 0.25, 0.1])
def test_an_occupancy_alone_takes_fewer_bytes_than_beliefs(occupancy: float):
    """Static slots are padded to the longest share, so records take dynamic ones; where a schedule
    with static slots is asked for, the slots are as long as a step's records need."""
    asked = {"scenario": "target-tracking", "nodes": 20, "steps": 30, "occupancy": occupancy}
    beliefs = wire_bytes(rule="ci", number="float32", **asked)
    assert wire_bytes(rule="labelled", **asked) < 0.9 * beliefs
    hybrid = wire_bytes(rule="labelled", schedule="hybrid", **asked)
    assert hybrid < 0.9 * wire_bytes(rule="labelled", schedule="hybrid", payload_bytes=254, **asked)


def wire_bytes(**options) -> float:
    setup = prepare(scenario_of(**options))
    histories = simulate(setup, [0])
    sent = SentShares(histories.payload_bytes[0], histories.classes[0])
    return wire_per_step(build_bus(setup), sent)[0]


@pytest.mark.slow
@pytest.mark.parametrize("urgency_classes", [2, 8])
def test_no_contender_asks_in_vain_for_longer_than_two_turns_of_all(urgency_classes: int):
    """With two classes all needs are in one, where the lowest nodes win until others are old."""
    nodes = 8
    setup = setup_of(nodes=nodes, steps=60, graph="complete", schedule="dynamic",
                     occupancy=0.13, urgency_classes=urgency_classes)  # fmt: skip
    trace = trace_of(setup)
    asked = trace.asked.reshape(-1, nodes)
    sent = trace.published.reshape(-1, nodes)
    assert (sent.sum(axis=1) == 1).any() and sent.sum(axis=1).max() == 1
    longest = 0
    for node in range(nodes):
        waits = 0
        for wants, sends in zip(asked[:, node], sent[:, node], strict=True):
            waits = waits + 1 if wants and not sends else 0
            longest = max(longest, waits)
    assert nodes // 2 < longest <= 2 * nodes - 1
