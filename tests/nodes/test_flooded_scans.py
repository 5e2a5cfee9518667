"""Test flooded scans: they spread by hops, and equal scans give equal tracks in any order."""

import networkx
import numpy as np
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st

from concord.filters.tracking.tracker import Scan, Tracked, track
from concord.filters.tracking.tracks import Tracks, no_tracks
from concord.nodes.tracking.flooded_scans import WindowTracks, flooded
from tests.filters.tracking.position_sensor import PositionSensor, settings

NODES, STEPS, WINDOW = 4, 6, 3
START = Tracked(no_tracks(4), 0)


@given(st.integers(0, 2**32 - 1), st.integers(1, 4))
def test_a_scan_reaches_the_nodes_within_as_many_hops_as_rounds(seed: int, rounds: int):
    graph = networkx.gnp_random_graph(7, 0.3, seed=seed)
    heard = networkx.to_numpy_array(graph) > 0
    held = np.eye(7, dtype=bool)[None]
    for _ in range(rounds):
        held = flooded(held, heard)
    hops = dict(networkx.all_pairs_shortest_path_length(graph, cutoff=rounds))
    for node in range(7):
        assert set(np.flatnonzero(held[0, node])) == set(hops[node])


def scans_of(seed: int) -> list[list[Scan]]:
    rng = np.random.default_rng(seed)
    targets = rng.uniform(-30, 30, (2, 2))
    sensor = PositionSensor(density=1e-4)
    return [
        [
            Scan(
                node,
                sensor,
                np.concatenate(
                    (targets + 2 * rng.standard_normal((2, 2)), rng.uniform(-50, 50, (2, 2)))
                ),
            )
            for node in range(NODES)
        ]
        for _ in range(STEPS)
    ]


def bits(tracks: Tracks) -> list[bytes]:
    return [part.tobytes() for part in (*tracks.belief, *tracks[1:])]


@hypothesis_settings(max_examples=20)
@given(st.integers(0, 2**32 - 1))
def test_equal_scans_give_equal_tracks_however_late_they_come(seed: int):
    rng = np.random.default_rng(seed)
    scans, usual = scans_of(seed), settings()

    def after(before: Tracked, step: int, held: bytes) -> Tracked:
        taken = np.flatnonzero(np.frombuffer(held, dtype=bool))
        # A node reads its records in the order of their arrival.
        return track(before.tracks, [scans[step][n] for n in rng.permutation(taken)], usual, step)

    # Each node computes alone here, so that nothing but its scans can make tracks equal.
    nodes = [WindowTracks(START, 1, WINDOW, after) for _ in range(NODES)]
    delays = rng.integers(0, WINDOW, (STEPS, NODES, NODES)) * ~np.eye(NODES, dtype=bool)
    reached: list[Tracked] = [START] * NODES
    held = np.zeros((1, NODES, NODES), dtype=bool)
    for step in range(STEPS):
        first = max(0, step - WINDOW + 1)
        ages = (step - np.arange(first, step + 1))[:, None, None]
        held = delays[first : step + 1] <= ages
        reached = [nodes[n].at(step, held[:, n : n + 1])[0] for n in range(NODES)]
    # Scans of the last steps may be missing; where two nodes hold the same, so they believe.
    for one in range(NODES):
        for other in range(NODES):
            if (held[:, one] == held[:, other]).all():
                assert bits(reached[one].tracks) == bits(reached[other].tracks)
    # With the last step all scans of the window come, so each node has what a centre has.
    centre = START
    for step in range(STEPS):
        centre = track(centre.tracks, scans[step], usual, step)
    full = np.ones((WINDOW, 1, NODES), dtype=bool)
    late = [node.at(STEPS - 1, full)[0] for node in _again(nodes, delays, after)]
    assert all(bits(one.tracks) == bits(centre.tracks) for one in late)


def _again(nodes: list[WindowTracks], delays: np.ndarray, after) -> list[WindowTracks]:
    """Nodes as they were before the last step: a node settles a step once."""
    fresh = [WindowTracks(START, 1, WINDOW, after) for _ in nodes]
    for step in range(STEPS - 1):
        first = max(0, step - WINDOW + 1)
        ages = (step - np.arange(first, step + 1))[:, None, None]
        held = delays[first : step + 1] <= ages
        for n, node in enumerate(fresh):
            node.at(step, held[:, n : n + 1])
    return fresh


def test_nodes_with_equal_scans_share_one_computation():
    asked = []

    def after(before: Tracked, step: int, held: bytes) -> Tracked:
        asked.append((step, held))
        return Tracked(no_tracks(4), len(asked))

    window = WindowTracks(START, 3, 2, after)
    held = np.array([[[1, 1, 0], [1, 1, 0], [1, 1, 1]]], dtype=bool)
    found = window.at(0, held)
    assert len(asked) == 2 and found[0] is found[1] is not found[2]
    # The late scan of node 2 takes its place: the first step is computed with it.
    newest = np.ones((1, 3, 3), dtype=bool)
    found = window.at(1, np.concatenate((newest, newest)))
    assert found[0] is found[1] is found[2] and len(asked) == 3
