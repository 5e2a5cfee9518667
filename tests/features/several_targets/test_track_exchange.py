"""Test nodes that share tracks: two with fields of view apart, and networks in every order."""

import numpy as np
import pytest

from concord.features.several_targets.scan_codec import ScanCodec
from concord.features.several_targets.scanned_swarm import write_scan
from concord.features.several_targets.scanning import ScanningSensor
from concord.features.several_targets.track_exchange import TrackContent, TrackExchange
from concord.features.several_targets.tracking.tracker import Scan
from concord.features.several_targets.tracks_trace import TracksTrace
from concord.nodes.messages import Measured, to_wire
from concord.plants.range_bearing import RangeBearing
from concord.results.records.trace import read_trace
from concord.runtime.drivers import in_memory
from concord.scenarios.build import build_bus, build_node
from concord.scenarios.preparation import prepare, share_bytes
from concord.scenarios.scenario_options import scenario_of
from tests.features.several_targets.test_swarm_network import (
    by_topic,
    figures_of,
    messages_of,
    nodes_of,
    setup_of,
)

SHARED = {"nodes": 6, "targets": 3, "steps": 12, "clutter": 3, "rounds": 2, "rule": "track-ci"}
APART_M = 800.0
SENSORS = tuple(
    ScanningSensor(RangeBearing(np.array([x_m, 0.0])), detection=0.95, clutter=2.0)
    for x_m in (0.0, APART_M)
)


def pair() -> list[TrackExchange]:
    """Two nodes that hear each other, and whose fields of view of 350 m have nothing in common."""
    setup = prepare(
        scenario_of("target-swarm", nodes=2, graph="complete", rule="track-ci", rounds=1)
    )
    found = []
    for node in range(2):
        estimator = build_node(setup, node).estimator
        assert isinstance(estimator, TrackExchange)
        codec = estimator.codec.scans

        def scan(source: int, record: bytes, codec: ScanCodec = codec) -> Scan:
            return Scan(source, SENSORS[source], codec.detections(record))

        found.append(TrackExchange(**{**vars(estimator), "scan": scan}))
    return found


def followed(
    nodes: list[TrackExchange], steps: int, last: int, silent: bool = False
) -> list[TrackContent]:
    """The nodes' knowledge after some steps. One target moves near each node; that of node 0 is
    gone after the step `last`. With `silent` no share arrives."""
    generator, contents = np.random.default_rng(4), [node.start() for node in nodes]
    for step in range(steps):
        truth = np.array([[100 + 4.0 * step, 4, 50, 0], [APART_M + 90, 0, 60 + 3.0 * step, 3]])
        truth[0] = np.nan if step > last else truth[0]
        for place, node in enumerate(nodes):
            rows = np.full((40, 2), np.nan)
            write_scan(rows, SENSORS[place].scan(truth, generator))
            contents[place], _ = node.begin_step(
                contents[place], Measured(place, step, to_wire(rows))
            )
        said = [node.compose(content) for node, content in zip(nodes, contents, strict=True)]
        for place, node in enumerate(nodes):
            body = None if silent else node.accept(said[1 - place][1])
            contents[place], _ = node.fuse(said[place][0], (body,))
    return contents


def test_nodes_with_fields_of_view_apart_both_have_both_targets_with_equal_labels():
    nodes = pair()
    rows = [
        np.array(node.tracks(content).rows)
        for node, content in zip(nodes, followed(nodes, 15, 99), strict=True)
    ]
    assert [len(one) for one in rows] == [2, 2]
    np.testing.assert_array_equal(rows[0][:, :3], rows[1][:, :3])
    for one in rows:
        places = one[np.argsort(one[:, 4])][:, [4, 6]]
        np.testing.assert_allclose(places, [[156, 50], [APART_M + 90, 102]], atol=25)
        # A node that never saw a target does not vote it down.
        assert (one[:, 3] > 0.95).all()
    alone = followed(nodes, 15, 99, silent=True)
    assert [
        len(node.tracks(one).rows) for node, one in zip(nodes, alone, strict=True)
    ] == [1, 1]  # fmt: skip


def test_the_end_of_a_target_reaches_a_node_that_cannot_see_it():
    nodes = pair()
    contents = followed(nodes, 25, 14)
    for node, content in zip(nodes, contents, strict=True):
        rows = np.array(node.tracks(content).rows)
        assert len(rows) == 1 and rows[0, 4] > APART_M


def test_a_node_that_no_longer_hears_keeps_what_it_cannot_see():
    nodes = pair()
    content = followed(nodes, 10, 99)[1]
    nothing = np.full((40, 2), np.nan)
    nothing[0, 0] = 0.0
    before = content.known.tracks.existence.max()
    content, _ = nodes[1].begin_step(content, Measured(1, 10, to_wire(nothing)))
    places = content.known.tracks.belief.mean[:, 0]
    existence = content.known.tracks.existence
    unseen = existence[(places < 400) & content.known.tracks.confirmed]
    assert len(unseen) == 1 and unseen[0] == pytest.approx(0.99 * before, rel=0.02)
    assert existence[places > 400].max() < 0.7


def test_a_node_speaks_twice_in_a_step_and_the_second_time_if_it_has_heard_of_something():
    node = pair()[0]
    nothing = np.full((40, 2), np.nan)
    nothing[0, 0] = 0.0
    content, _ = node.begin_step(node.start(), Measured(0, 0, to_wire(nothing)))
    first = node.bid(content)
    content, body = node.compose(content)
    assert node.bid(content) is None
    content, _ = node.fuse(content, (node.accept(body),))
    second = node.bid(content)
    assert first is not None and second is not None and first > second
    content, _ = node.compose(content)
    assert node.bid(node.fuse(content, (node.accept(body),))[0]) is None


def test_the_order_of_delivery_changes_no_message():
    setup = setup_of(SHARED, occupancy=0.5, loss=0.2)
    usual = by_topic(messages_of(setup, nodes_of(setup)))
    for seed in range(2):
        assert by_topic(messages_of(setup, nodes_of(setup), seed)) == usual


def test_a_network_that_shares_tracks_is_better_than_its_nodes_alone():
    shared, alone = (
        figures_of(setup_of(SHARED, steps=20, **options)) for options in ({}, {"loss": 0.97})
    )
    assert shared.network.gospa_m < 0.9 * alone.network.gospa_m
    assert shared.equal_records == 0


def test_tracks_without_room_are_counted_and_a_killed_node_begins_anew():
    setup = setup_of(SHARED, most_tracks=1, changes=("4 kill 2", "7 restart 2"))
    trace = read_trace(setup, in_memory(setup))
    assert sum(counters.get("track-room", 0) for counters in trace.counters) > 0
    assert isinstance(trace.extra, TracksTrace)
    assert trace.extra.logs[2].steps == [0, 1, 2, 3, *range(7, 12)]


def test_a_full_cycle_holds_the_shares_of_twenty_nodes():
    setup = prepare(scenario_of("target-swarm", rule="track-ci", rounds=2))
    assert setup.scenario.nodes == 20 and share_bytes(setup) < 500
    assert build_bus(setup).schedule.static_senders(0) == tuple(range(20))


def test_the_rule_is_refused_where_targets_have_names():
    with pytest.raises(ValueError, match="rule track-ci: nodes share tracks of several targets"):
        prepare(scenario_of("target-tracking", rule="track-ci"))
    with pytest.raises(ValueError, match="labelled or track-ci"):
        prepare(scenario_of("target-swarm", rule="ci"))
