"""Test scans over a bus: tracks are a function of the records that a node holds."""

import dataclasses
from typing import Any

import msgspec
import numpy as np
import pytest

from concord.bus.flexray.flexray_bus import FlexRayBus
from concord.features.several_targets.results import TrackingFigures, tracking_figures
from concord.features.several_targets.scan_flooding import (
    KeptTracks,
    Reached,
    ScanContent,
    ScanFlooding,
    StepRecords,
    reported_tracks,
)
from concord.features.several_targets.swarm_scans import new_tracker
from concord.features.several_targets.swarm_tracking import plant_of
from concord.features.several_targets.tracking import tracker
from concord.features.several_targets.tracking.tracker import Tracked
from concord.features.several_targets.tracking.tracks import Tracks, no_tracks
from concord.features.several_targets.tracks_trace import TracksTrace
from concord.filters.gaussian import Gaussian
from concord.nodes.estimator import Rejected
from concord.nodes.messages import MalformedMessage, Measured, decode
from concord.nodes.node_state import NodeConfig
from concord.nodes.rules.labelled.frame import LabelledShare
from concord.results.records.trace import Trace, read_trace
from concord.runtime import in_process
from concord.runtime.drivers import in_memory
from concord.runtime.recording import MemoryRecorder
from concord.scenarios.build import build_bus, build_environment, build_node
from concord.scenarios.preparation import prepare, setup_of_run
from concord.scenarios.script import script_of
from concord.scenarios.setup import Setup, generator
from concord.studies.monte_carlo.simulate import OPTIONAL, simulate
from tests.experiments.support import scenario
from tests.test_batched_agreement import check_run

SMALL: dict[str, Any] = {
    "nodes": 6, "targets": 3, "steps": 12, "clutter": 3, "rounds": 1, "window_steps": 4
}  # fmt: skip
SCARCE = {**SMALL, "occupancy": 0.5, "loss": 0.2}


def setup_of(options: dict[str, Any], **others: Any) -> Setup:
    return prepare(scenario("target-swarm", **{**options, **others}))


def nodes_of(setup: Setup) -> list[NodeConfig]:
    return [build_node(setup, node) for node in range(setup.scenario.nodes)]


def estimator_of(setup: Setup, node: int = 0) -> ScanFlooding:
    estimator = build_node(setup, node).estimator
    assert isinstance(estimator, ScanFlooding)
    return estimator


def alone(setup: Setup) -> list[NodeConfig]:
    """Nodes that share no result, and read scans and detections in an order of their own."""
    window = estimator_of(setup).flooding.frames.window_steps
    found = []
    for node in nodes_of(setup):
        assert isinstance(node.estimator, ScanFlooding)
        arrival = generator(setup.scenario, "arrival", node.index)
        own = new_tracker(setup.scenario, window, arrival)
        found.append(
            dataclasses.replace(node, estimator=dataclasses.replace(node.estimator, track=own))
        )
    return found


def messages_of(
    setup: Setup, nodes: list[NodeConfig], seed: int | None = None
) -> list[tuple[str, bytes]]:
    """The messages of a run; `seed` draws which waiting message is delivered next."""
    recorder, picks = MemoryRecorder(), np.random.default_rng(seed)
    in_process.run(
        build_environment(setup),
        nodes,
        recorder,
        pick=(lambda waiting: 0) if seed is None else (lambda n: int(picks.integers(n))),
        script=script_of(setup.scenario),
    )
    return recorder.messages


def trace_of(setup: Setup, nodes: list[NodeConfig] | None = None) -> Trace:
    return read_trace(setup, in_memory(setup) if nodes is None else messages_of(setup, nodes))


def figures_of(setup: Setup, nodes: list[NodeConfig] | None = None) -> TrackingFigures:
    trace = trace_of(setup, nodes)
    assert isinstance(trace.extra, TracksTrace)
    return tracking_figures(setup, trace.extra, trace.readings)


def by_topic(messages: list[tuple[str, bytes]]) -> dict[str, list[Any]]:
    found: dict[str, list[Any]] = {}
    for name, data in messages:
        said = data if name.startswith("share/") else msgspec.json.decode(data)
        found.setdefault(name, []).append(said)
    return found


def test_tracks_are_those_of_the_records_that_a_node_held_last():
    # The oracle keeps all records by step and computes the tracks from the start, once.
    setup = setup_of(SCARCE)
    nodes = nodes_of(setup)
    held: list[dict[int, dict[int, bytes]]] = [{} for _ in nodes]
    last: dict[int, ScanContent] = {}

    def watch(config, event, state) -> None:
        windows, index = state.content.flooded.windows, config.index
        last[index] = state.content
        for place in range(windows.first, len(state.content.flooded.kept.records)):
            held[index][windows.step_at(place)] = dict(state.content.flooded.kept.records[place])

    # One step at a time, so that the watch sees the end of each.
    environment = dataclasses.replace(build_environment(setup), lead=1)
    in_process.run(environment, nodes, MemoryRecorder(), watch=watch)
    late = 0
    for node, config in enumerate(nodes):
        estimator = config.estimator
        assert isinstance(estimator, ScanFlooding)
        tracked = estimator.begin
        for step in range(setup.scenario.steps):
            records = held[node][step]
            late += 0 < len(records) < setup.scenario.nodes
            tracked = estimator.track(tracked, step, tuple(sorted(records.items())))
        reached = reported_tracks(tracked.tracks, b"", estimator.moments)
        assert reached.bits == estimator.tracks(last[node]).bits
        assert len(tracked.tracks.existence) > 0
    assert late > 10


def test_the_order_of_delivery_changes_no_message():
    setup = setup_of(SCARCE)
    usual = by_topic(messages_of(setup, nodes_of(setup)))
    assert by_topic(messages_of(setup, nodes_of(setup), 1)) == usual


@pytest.mark.parametrize("filter", ["ukf", "imm"])
def test_nodes_with_equal_records_have_equal_bits_though_each_computes_alone(filter: str):
    scarce, plenty = (
        setup_of(options, filter=filter, steps=8) for options in (SCARCE, {**SMALL, "rounds": 4})
    )
    assert figures_of(scarce, alone(scarce)) == figures_of(scarce)
    found = figures_of(plenty, alone(plenty))
    assert found.equal_records > 100 and found.differing == 0


def test_a_tracker_that_keeps_the_order_of_arrival_is_found_out(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(tracker, "in_order", lambda detections: detections)
    setup = setup_of(SMALL, rounds=4)
    assert figures_of(setup, alone(setup)).differing > 0


@pytest.mark.parametrize("bus", ["flexray", "plca", "can-fd", "ideal"])
def test_every_bus_carries_scans(bus: str):
    full = trace_of(setup_of(SMALL, bus=bus, rounds=4, steps=8))
    scarce = trace_of(setup_of(SMALL, bus=bus, occupancy=0.34, steps=8))
    assert full.extra is not None and scarce.extra is not None
    digests = full.extra.digest_numbers()
    assert (digests == digests[:, :1]).all()
    digests = scarce.extra.digest_numbers()
    assert (digests != digests[:, :1]).any()
    # Two nodes of six publish in the one cycle of a step, in frames of their own.
    assert 4 * scarce.published.sum() < full.published.sum()


def test_contenders_with_scans_are_old_after_one_turn_of_all():
    bus = build_bus(setup_of(SCARCE))
    assert isinstance(bus, FlexRayBus)
    least, waits = np.array([1]), np.array([SMALL["nodes"] - 1])
    assert bus.classes.of(least, waits) > 0 and bus.classes.of(least, waits + 1) == 0


def test_a_dead_node_is_no_longer_scored_and_a_returned_one_tracks_again():
    killed = setup_of(SMALL, rounds=3, changes=("4 kill 2",))
    back = setup_of(SMALL, rounds=3, changes=("4 kill 2", "7 restart 2"))
    assert len(by_topic(messages_of(killed, nodes_of(killed)))["estimate/2"]) == 4
    trace = trace_of(back)
    assert isinstance(trace.extra, TracksTrace)
    assert trace.extra.logs[2].steps == [0, 1, 2, 3, *range(7, 12)]
    assert trace.mean[-1, 2, 0] > 0.5
    found = figures_of(killed)
    assert found.network.gospa_m < 1.3 * found.centre.gospa_m


def test_an_empty_scan_lowers_the_existence_and_a_missing_one_does_not():
    setup = setup_of(SMALL)
    estimator = estimator_of(setup)
    place = plant_of(setup.scenario).positions(0)[1] + 50
    tracks = Tracks(
        Gaussian(np.array([[place[0], 0, place[1], 0]]), np.eye(4)[None]),
        np.array([0.9]),
        np.zeros((1, 3), dtype=int),
        np.array([True]),
    )
    missing = estimator.track(Tracked(tracks, 0), 1, ())
    empty = estimator.track(Tracked(tracks, 0), 1, ((1, b"\x00"),))
    assert missing.tracks.existence[0] == pytest.approx(0.9 * 0.99)
    assert empty.tracks.existence[0] < 0.5


LARGE = {"clutter": 60, "payload_bytes": 98, "loss": 0.0, "steps": 4}


@pytest.mark.parametrize(
    ("changed", "runs"),
    [
        ({}, (0, 3)),
        ({"filter": "imm", "occupancy": 1.0, "steps": 6}, (3,)),
        ({"association": "nearest", "rounds": 3, "changes": ("3 kill 2", "5 loss 0.5")}, (3,)),
        (LARGE, (3,)),
    ],
    ids=["loss", "several models", "changes", "clusters and records too large"],
)
def test_arrays_have_the_bits_of_the_tracks_of_messages(
    changed: dict[str, Any], runs: tuple[int, ...]
):
    setup = setup_of({**SCARCE, "steps": 8, **changed})
    histories = simulate(setup, runs, keep=OPTIONAL)
    for place, run in enumerate(runs):
        trace = check_run(histories, place, setup_of_run(setup, run))
        counted = {name for counters in trace.counters for name in counters}
        assert (counted >= {"record-range", "approximated-cluster"}) == (changed is LARGE)
        assert isinstance(trace.extra, TracksTrace)
        found, expected = histories.extras[place], trace.extra
        assert isinstance(found, TracksTrace)
        np.testing.assert_array_equal(found.digest_numbers(), expected.digest_numbers())
        np.testing.assert_array_equal(found.paths, expected.paths)
        for one, other in zip(found.logs, expected.logs, strict=True):
            assert one.steps == other.steps and one.scores() == other.scores()


@pytest.mark.slow
def test_scans_that_a_record_does_not_hold_are_shortened_and_counted():
    crowded = {**SMALL, "payload_bytes": 98, "rounds": 3, "steps": 6}
    counters = trace_of(setup_of(crowded, clutter=90)).counters
    assert [one["record-range"] for one in counters] == [6] * 6
    assert not any("record-range" in one for one in trace_of(setup_of(crowded)).counters)


def test_clusters_beyond_the_exact_sum_are_counted_in_each_step():
    setup = setup_of(SMALL, steps=4)

    def crowded(before: Tracked, step: int, records: StepRecords) -> Tracked:
        return before._replace(approximated=2)

    nodes = [
        dataclasses.replace(
            node, estimator=dataclasses.replace(estimator_of(setup, node.index), track=crowded)
        )
        for node in nodes_of(setup)
    ]
    recorder = MemoryRecorder()
    states = in_process.run(build_environment(setup), nodes, recorder)
    assert [state.counters["approximated-cluster"] for state in states] == [2 * 4] * 6


def test_a_share_with_a_checkpoint_is_rejected():
    estimator = estimator_of(setup_of(SMALL))
    belief = Gaussian(np.zeros(1), np.eye(1))
    share = LabelledShare(False, belief, (), ())
    with pytest.raises(Rejected, match="labelled-checkpoint"):
        estimator.accept(estimator.flooding.frames.encode(share))


def test_the_belief_is_the_number_of_targets_and_the_tracks_are_those_confirmed():
    estimator = estimator_of(setup_of(SMALL))
    tracks = estimator.begin.tracks._replace(
        belief=Gaussian(np.zeros((3, 4)), np.stack([np.eye(4)] * 3)),
        existence=np.array([0.8, 0.9, 0.4]),
        identity=np.zeros((3, 3), dtype=int),
        confirmed=np.array([True, False, True]),
    )
    content = estimator.start()
    window = content.window._replace(reached=(Reached(0, Tracked(tracks, 0), (), b""),))
    content = content._replace(window=window)
    mean, cov = estimator.belief(content)
    assert mean == pytest.approx([2.1 + 0.1])
    assert cov.ravel() == pytest.approx([0.8 * 0.2 + 0.9 * 0.1 + 0.4 * 0.6 + 0.1])
    assert [row[3] for row in estimator.tracks(content).rows] == [0.8]


def test_a_node_without_readings_sends_no_record():
    estimator = estimator_of(setup_of(SMALL))
    nothing = Measured(0, 0, [[None, None]] * 4)
    content, _ = estimator.begin_step(estimator.start(), nothing)
    assert estimator.bid(content) is None


def test_results_are_kept_for_equal_tracks_and_records_alone():
    asked = []

    def after(before: Tracked, step: int, records: tuple) -> Tracked:
        asked.append(step)
        return Tracked(no_tracks(4), len(asked))

    begin = Tracked(no_tracks(4), 0)
    kept = KeptTracks(after, 2)
    first = kept(begin, 0, ((1, b"a"),))
    assert kept(begin, 0, ((1, b"a"),)) is first
    assert kept(begin, 0, ((2, b"a"),)) is not first and kept(first, 0, ((1, b"a"),)) is not first
    assert asked == [0, 0, 0]
    kept(begin, 2, ())
    kept(begin, 0, ((1, b"a"),))
    assert asked == [0, 0, 0, 2, 0]


def test_a_message_with_a_broken_track_is_refused():
    setup = setup_of(SMALL, steps=3)
    said = by_topic(messages_of(setup, nodes_of(setup)))["estimate/0"][-1]
    said["tracks"]["rows"] = [[1.0] * 12]
    assert decode("estimate/0", msgspec.json.encode(said)).tracks is not None
    said["tracks"]["rows"] = [[1.0] * 11]
    with pytest.raises(MalformedMessage, match="length >= 12"):
        decode("estimate/0", msgspec.json.encode(said))
