"""Test scans over a bus: tracks are a function of the records that a node holds."""

import dataclasses
from typing import Any

import msgspec
import numpy as np
import pytest

from concord.experiments.tracking.equal_records import bits_of
from concord.experiments.tracking.swarm_network import START, SwarmNetwork, swarm_network
from concord.experiments.tracking.swarm_run import run_swarm
from concord.filters.gaussian import Gaussian
from concord.filters.tracking.tracker import Tracked
from concord.filters.tracking.tracks import Tracks
from concord.nodes.estimator import Rejected
from concord.nodes.messages import Measured, ShareSent, topic
from concord.nodes.rules.labelled_frame import LabelledShare
from concord.nodes.tracking.scan_flooding import KeptTracks, ScanContent, ScanFlooding
from concord.runtime import in_process
from concord.runtime.recording import MemoryRecorder
from concord.scenarios.definitions.target_swarm import TargetSwarm
from concord.scenarios.script import script_of

SMALL = TargetSwarm(nodes=6, targets=3, steps=12, clutter=3, rounds=1, window_steps=4)
SCARCE = dataclasses.replace(SMALL, occupancy=0.5, loss=0.2)


def network_of(swarm: TargetSwarm, alone: bool = False) -> SwarmNetwork:
    truth = swarm.truth()
    return swarm_network(swarm, truth, swarm.scans(truth), swarm.settings(), alone)


def estimator_of(swarm: TargetSwarm, node: int = 0) -> ScanFlooding:
    estimator = network_of(swarm).nodes[node].estimator
    assert isinstance(estimator, ScanFlooding)
    return estimator


def messages_of(swarm: TargetSwarm, seed: int | None = None) -> dict[str, list[Any]]:
    """The messages of a run by topic; `seed` draws which waiting message is delivered next."""
    network, recorder = network_of(swarm), MemoryRecorder()
    picks = np.random.default_rng(seed)
    in_process.run(
        network.environment,
        network.nodes,
        recorder,
        pick=(lambda waiting: 0) if seed is None else (lambda n: int(picks.integers(n))),
        script=script_of(swarm.network()),
    )
    found: dict[str, list[Any]] = {}
    for name, data in recorder.messages:
        message = data if name.startswith("share/") else msgspec.json.decode(data)
        found.setdefault(name, []).append(message)
    return found


def test_tracks_are_those_of_the_records_that_a_node_held_last():
    # The oracle keeps all records by step and computes the tracks from the start, once.
    network = network_of(SCARCE)
    held: list[dict[int, dict[int, bytes]]] = [{} for _ in network.nodes]
    last: dict[int, ScanContent] = {}

    def watch(config, event, state) -> None:
        windows, index = state.content.flooded.windows, config.index
        last[index] = state.content
        for place in range(windows.first, SCARCE.window_steps):
            held[index][windows.step_at(place)] = dict(state.content.flooded.records[place])

    in_process.run(network.environment, network.nodes, MemoryRecorder(), watch=watch)
    late = 0
    for node, config in enumerate(network.nodes):
        estimator, tracked = config.estimator, START
        assert isinstance(estimator, ScanFlooding)
        for step in range(SCARCE.steps):
            records = held[node][step]
            late += 0 < len(records) < SCARCE.nodes
            tracked = estimator.track(tracked, step, tuple(sorted(records.items())))
        assert bits_of(tracked) == bits_of(last[node].reached)
        assert len(tracked.tracks.existence) > 0
    assert late > 10


def test_the_order_of_delivery_changes_no_message():
    usual = messages_of(SCARCE)
    for seed in range(2):
        assert messages_of(SCARCE, seed) == usual


def test_nodes_with_equal_records_have_equal_bits_though_each_computes_alone():
    alone, shared = run_swarm(SCARCE, alone=True), run_swarm(SCARCE)
    assert msgspec.structs.replace(alone, compared=None) == shared
    plenty = run_swarm(dataclasses.replace(SMALL, rounds=4), alone=True)
    assert plenty.compared is not None
    assert plenty.compared.pairs > 100 and plenty.compared.different == 0


@pytest.mark.parametrize("bus", ["flexray", "plca", "can-fd", "ideal"])
def test_every_bus_carries_scans(bus: str):
    full = run_swarm(dataclasses.replace(SMALL, bus=bus, rounds=4, steps=8))
    assert full.held == full.alike == 1
    scarce = run_swarm(dataclasses.replace(SMALL, bus=bus, occupancy=0.34, steps=8))
    assert scarce.held < 0.9
    # Two nodes of six publish in the one cycle of a step, in frames of their own.
    sending = scarce.frames / full.frames
    assert sending < 0.2 and scarce.bytes < 0.5 * full.bytes
    assert (full.bus_time > 0) == (bus != "ideal")


def test_bytes_are_those_of_the_frames_that_were_sent():
    run, messages = run_swarm(SMALL), messages_of(SMALL)
    frames = [
        frame for name, sent in messages.items() if name.startswith("share/") for frame in sent
    ]
    assert topic(ShareSent(3, 0, b"")) == "share/3"
    assert run.frames == len(frames) / SMALL.steps == SMALL.nodes
    assert run.bytes == sum(map(len, frames)) / SMALL.steps


def test_a_dead_node_is_no_longer_scored_and_a_returned_one_tracks_again():
    killed = dataclasses.replace(SMALL, rounds=3, changes=("4 kill 2",))
    back = dataclasses.replace(killed, changes=("4 kill 2", "7 restart 2"))
    assert len(messages_of(killed)["estimate/2"]) == 4
    told = messages_of(back)["estimate/2"]
    assert [one["step"] for one in told] == [0, 1, 2, 3, *range(7, 12)]
    assert told[-1]["mean"][0] > 0.5
    # From step 7 on, all four steps of the window lack its scan: 1 in 6.
    run = run_swarm(killed)
    parts = [1, 1, 1, 1, *(1 - min(step - 3, 4) / 4 / 6 for step in range(4, 12))]
    nodes = [6] * 4 + [5] * 8
    assert run.held == pytest.approx(np.average(parts, weights=nodes))
    assert run.nodes.gospa_m < 1.3 * run.centre.gospa_m


def test_an_empty_scan_lowers_the_existence_and_a_missing_one_does_not():
    estimator = estimator_of(SMALL)
    place = SMALL.positions()[1] + 50
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


@pytest.mark.slow
def test_scans_that_a_record_does_not_hold_are_shortened_and_counted():
    crowded = dataclasses.replace(SMALL, clutter=90, payload_bytes=98, rounds=3, steps=6)
    run = run_swarm(crowded)
    assert run.shortened == crowded.nodes * crowded.steps
    assert run_swarm(dataclasses.replace(crowded, clutter=20)).shortened == 0


def test_a_share_with_a_checkpoint_is_rejected():
    estimator = estimator_of(SMALL)
    belief = Gaussian(np.zeros(1), np.eye(1))
    share = LabelledShare(False, belief, (), ())
    with pytest.raises(Rejected, match="labelled-checkpoint"):
        estimator.accept(estimator.flooding.frames.encode(share))


def test_the_estimate_is_the_number_of_targets():
    estimator = estimator_of(SMALL)
    content = estimator.start()
    tracks = START.tracks._replace(
        belief=Gaussian(np.zeros((3, 4)), np.stack([np.eye(4)] * 3)),
        existence=np.array([0.8, 0.9, 0.4]),
        identity=np.zeros((3, 3), dtype=int),
        confirmed=np.array([True, True, True]),
    )
    mean, cov = estimator.belief(content._replace(reached=Tracked(tracks, 0)))
    assert mean == pytest.approx([1.7]) and cov.ravel() == pytest.approx([0.8 * 0.2 + 0.9 * 0.1])


def test_a_node_without_readings_sends_no_record():
    estimator = estimator_of(SMALL)
    nothing = Measured(0, 0, [[None, None]] * 4)
    content, _ = estimator.begin_step(estimator.start(), nothing)
    assert estimator.bid(content) is None


def test_results_are_kept_for_equal_tracks_and_records_alone():
    asked = []

    def after(before: Tracked, step: int, records: tuple) -> Tracked:
        asked.append(step)
        return Tracked(START.tracks, len(asked))

    kept = KeptTracks(after, 2)
    first = kept(START, 0, ((1, b"a"),))
    assert kept(START, 0, ((1, b"a"),)) is first
    assert kept(START, 0, ((2, b"a"),)) is not first and kept(first, 0, ((1, b"a"),)) is not first
    assert asked == [0, 0, 0]
    kept(START, 2, ())
    kept(START, 0, ((1, b"a"),))
    assert asked == [0, 0, 0, 2, 0]
