"""Another graph while the network runs: `set graph=...`."""

import networkx
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from concord.entries import summaries
from concord.nodes.messages import ShareHeard
from concord.results.records.trace import read_trace
from concord.runtime.batched.build import build_network
from concord.runtime.drivers import in_memory
from concord.scenarios.preparation import complete_settings, prepare, with_settings
from concord.scenarios.setup import Setup
from concord.topology.edge_text import edge_text
from tests.experiments.support import scenario, small
from tests.nodes.changing import run, same_bits
from tests.nodes.networks import SEEDS, path, shuffled
from tests.nodes.networks import network as linear_network
from tests.nodes.one_node import PRIORS, ROUNDS, clean_events, estimates, feed, heartbeat, share
from tests.nodes.one_node import STEPS as ONE_STEPS

NODES, STEPS = 5, 10
BEGINNING = "edges:0-1;1-2;2-3;3-4"
SETS = ("ellipsoid", "zonotope", "labelled-ellipsoid")
# Rules for which all nodes hear all others, and those with a network of their own.
ONE_GRAPH = ("centralised", "track-ci", "reception")


@st.composite
def graphs(draw: st.DrawFn) -> str:
    """A connected graph of so many nodes."""
    links = draw(st.sets(st.tuples(st.integers(0, NODES - 1), st.integers(0, NODES - 1))))
    parents = [draw(st.integers(0, node - 1)) for node in range(1, NODES)]
    graph = networkx.Graph([*enumerate(parents, 1), *links])
    graph.remove_edges_from(networkx.selfloop_edges(graph))
    return edge_text(graph)


def network(name: str = "oscillator", **options: object) -> Setup:
    return small(name, **{"nodes": NODES, "graph": BEGINNING, "steps": STEPS, **options})


@settings(max_examples=5)
@given(graphs())
def test_a_graph_that_is_set_at_the_first_step_is_that_of_the_network(graph: str):
    assert same_bits(run(network(), f"0 set graph={graph}"), run(network(graph=graph)))


@pytest.mark.parametrize("rule", summaries("RULES"))
def test_each_rule_takes_another_graph(rule: str):
    name = "liu2021-network" if rule in SETS else "oscillator"
    try:
        one, other = (network(name, rule=rule, graph=graph) for graph in ("ring", "complete"))
        complete_settings(one, {}, {"graph": "complete"})
    except ValueError as refused:
        assert rule in ONE_GRAPH, refused
        return
    # Either way nodes begin anew from what they believe.
    anew = f"0 set rounds={other.scenario.rounds}"
    assert same_bits(run(one, "0 set graph=complete"), run(other, anew))


@settings(max_examples=4)
@given(graphs(), graphs(), SEEDS)
def test_the_order_of_messages_does_not_matter(one: str, other: str, seed: int):
    lines = (f"3 set graph={one}", f"5 set graph={other}", "6 kill 2", "8 restart 2")
    assert same_bits(run(network(), *lines), run(network(), *lines, pick=shuffled(seed)))


@settings(max_examples=4)
@given(graphs())
def test_ages_and_frames_follow_the_links_of_each_step(graph: str):
    setup = prepare(network().scenario.with_(changes=(f"4 set graph={graph}",)))
    trace = read_trace(setup, in_memory(setup))
    later = with_settings(setup, {"graph": graph})
    for step, neighbours in ((3, setup.neighbours), (4, later.neighbours)):
        for node, heard in enumerate(neighbours):
            assert np.flatnonzero(trace.ages[step, node] >= 0).tolist() == sorted([*heard, node])
    rounds = setup.scenario.rounds
    heard = [one["heard"] for one in trace.counters]
    assert heard == [
        rounds * (4 * len(before) + (STEPS - 4) * len(after))
        for before, after in zip(setup.neighbours, later.neighbours, strict=True)
    ]
    assert all(one.get("rejected stranger", 0) == 0 for one in trace.counters)


def test_nodes_agree_on_the_edges_however_a_graph_is_named():
    setup = network()
    told = complete_settings(setup, {}, {"graph": "ring"})
    assert told == {"graph": "edges:0-1;0-4;1-2;2-3;3-4"}
    # Later settings keep it.
    assert complete_settings(setup, told, {"rounds": 2}) == {**told, "rounds": 2}


@pytest.mark.parametrize(
    ("options", "graph", "said"),
    [
        ({}, "edges:0-1;1-2", "3 pieces"),
        ({}, "moebius", "unknown graph"),
        ({}, "file:graph.txt", "reads no files"),
        ({}, "own.py:GRAPH", "reads no files"),
        ({}, "edges:0-1;1-2;2-3;3-4;4-5", "nodes 0 to 4"),
        ({}, "edges:0-1;1-2;2-3;3-4;4>0", "weights metropolis"),
        ({"links": "moving:400"}, "ring", "--links moving:400"),
    ],
)
def test_a_graph_that_cannot_be_is_refused_before_the_start(options: dict, graph: str, said: str):
    asked = {"nodes": NODES, "graph": "path", "steps": STEPS, **options}
    with pytest.raises(ValueError, match=f"^--changes '3 set graph={graph}': .*{said}"):
        prepare(scenario(asked.pop("scenario", "target-tracking"), **asked,
                         changes=(f"3 set graph={graph}",)))  # fmt: skip


def test_a_later_change_may_speak_of_the_new_links():
    prepare(scenario(nodes=NODES, graph="path", steps=STEPS,
                     changes=("3 set graph=complete", "4 cut 0 4")))  # fmt: skip
    with pytest.raises(ValueError, match=r"'4 cut 1 2': .*node 2 does not hear node 1"):
        prepare(scenario(nodes=NODES, graph="path", steps=STEPS,
                         changes=("3 set graph=star", "4 cut 1 2")))  # fmt: skip


def test_arrays_keep_one_graph():
    setup = network(changes=("3 set graph=ring",))
    with pytest.raises(
        ValueError, match=r"another graph .* no array form; use --driver in-process"
    ):
        build_network(setup, [0])


def test_a_frame_of_nobody_that_comes_between_two_steps_is_counted_in_the_next():
    """Until the heartbeat comes, the next step may have any graph."""
    config = linear_network(path(3), PRIORS, steps=ONE_STEPS, rounds=ROUNDS).nodes[0]
    events = clean_events(config)
    first = events.index(heartbeat(1))
    frame = ShareHeard(2, share(config, 2, ROUNDS))
    waiting, _ = feed(config, [*events[:first], frame])
    assert "rejected stranger" not in waiting.counters and len(waiting.inbox.early) == 1
    state, sent = feed(config, [*events[:first], frame, *events[first:]])
    assert state.counters["rejected stranger"] == 1 and not state.inbox.early
    assert estimates(sent) == estimates(feed(config, events)[1])
