"""Links of a scenario: every driver loses the same frames, and the neighbours are the union."""

import numpy as np
import pytest

from concord.results.records.trace import read_trace
from concord.runtime.drivers import in_memory
from concord.scenarios.links import link_state
from concord.scenarios.preparation import prepare, setup_of_run
from concord.scenarios.scenario_options import scenario_of
from concord.scenarios.warnings import warnings_of
from concord.topology.adjacency import neighbours_of
from concord.topology.graphs import build_graph
from tests.experiments.support import scenario, small
from tests.test_batched_agreement import check_agreement

PLANS = {
    "bernoulli": {"links": "bernoulli:0.3", "graph": "ring"},
    "markov": {"links": "markov:0.2,0.4", "graph": "star"},
    "switching": {"links": "switching:ring,star:2"},
    "with loss": {"links": "bernoulli:0.2", "loss": 0.2, "graph": "complete"},
    "in turns": {"links": "markov:0.2,0.4", "schedule": "hybrid", "occupancy": 0.5},
}


def test_a_file_decides_the_number_of_nodes(tmp_path):
    file = tmp_path / "three.edges"
    file.write_text("0 1\n1 2\n")
    assert scenario_of("oscillator", graph=f"file:{file}").nodes == 3
    with pytest.raises(ValueError, match=r"3 nodes, but 4 were asked for.*no --nodes"):
        prepare(scenario_of("oscillator", graph=f"file:{file}", nodes=4))


def test_a_run_says_what_of_a_file_is_not_used(tmp_path):
    file = tmp_path / "placed.gml"
    file.write_text(
        "graph [ node [ id 0 Latitude 1 Longitude 2 ] node [ id 1 Latitude 1 Longitude 3 ] "
        "edge [ source 0 target 1 weight 0.5 ] ]"
    )
    static = warnings_of(prepare(scenario_of("oscillator", graph=f"file:{file}")))
    assert any("chances of delivery" in line and "--links measured" in line for line in static)
    assert any("positions of its nodes are not used" in line for line in static)
    measured = scenario_of("oscillator", graph=f"file:{file}", links="measured")
    assert not any("chances" in line for line in warnings_of(prepare(measured)))


@pytest.mark.parametrize("name", PLANS)
def test_the_batched_driver_loses_the_same_frames(name):
    check_agreement(
        scenario("oscillator", nodes=5, steps=8, rounds=2, stretch=100.0, **PLANS[name])
    )


def test_nodes_that_wander_are_heard_where_they_are():
    asked = scenario("target-tracking", nodes=8, steps=6, links="moving:400,150,9")
    check_agreement(asked)
    setup = prepare(asked)
    up = link_state(setup).link_up
    assert up is not None
    heard = np.zeros((6, 8, 8), dtype=bool)
    for step, i, j in np.argwhere(~heard):
        heard[step, i, j] = i != j and up(step, j, i)
    assert heard.any(axis=0).tolist() == [[j in row for j in range(8)] for row in setup.neighbours]
    assert (heard.sum(axis=(1, 2)) < heard.any(axis=0).sum()).any()


def test_what_is_down_is_not_heard_and_the_rest_is():
    setup = small(links="switching:path,star:1", steps=6, rounds=1)
    path_, star_ = (neighbours_of(build_graph(name, 4, 1)) for name in ("path", "star"))
    assert setup.neighbours == [
        sorted({*one, *other}) for one, other in zip(path_, star_, strict=True)
    ]
    trace = read_trace(setup, in_memory(setup))
    for step in range(6):
        graph = (path_, star_)[step % 2]
        for node in range(4):
            fresh = [j for j in setup.neighbours[node] if trace.ages[step, node, j] == 0]
            assert fresh == graph[node], (step, node)


def test_runs_of_a_seed_have_links_of_their_own_on_one_network():
    setup = small(links="bernoulli:0.5", graph="complete")
    ups = [link_state(setup_of_run(setup, run)).link_up for run in (0, 1)]
    steps = np.arange(50)
    one, other = (up(steps, 0, 1) for up in ups if up is not None)
    assert (one != other).any()
    roam = prepare(scenario("target-tracking", nodes=8, steps=4, links="moving:400,150,9"))
    again = setup_of_run(roam, 5)
    assert link_state(roam).link_up(3, 0, 1) == link_state(again).link_up(3, 0, 1)  # type: ignore[misc]


def test_chances_in_a_file_are_those_of_the_links(tmp_path):
    file = tmp_path / "lossy.edges"
    file.write_text("0 1 0.9\n1 0 0.25\n1 2 0.5\n2 3 1\n")
    setup = small(graph=f"file:{file}", links="measured")
    losses = link_state(setup).losses
    assert losses[0, 1] == pytest.approx(0.1) and losses[1, 0] == pytest.approx(0.75)
    assert losses[1, 2] == losses[2, 1] == 0.5 and losses[3, 2] == 0


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"links": "measured"}, "no chances of delivery.*bernoulli"),
        ({"links": "moving:100"}, "nodes of scenario oscillator have no places"),
        ({"links": "switching:ring,rign:3"}, "unknown graph 'rign': did you mean 'ring'"),
        ({"links": "bernoulli:0.1", "rule": "centralised", "graph": "complete", "rounds": 1},
         "centralised with --links bernoulli:0.1"),
    ],
)  # fmt: skip
def test_links_that_cannot_be_are_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        small(**changes)


def test_one_way_links_want_weights_that_take_them(tmp_path):
    file = tmp_path / "one_way.edges"
    file.write_text("0 1\n1 2\n2 3\n3 0\n")
    with pytest.raises(ValueError, match=r"metropolis on a directed graph.*equal-neighbour"):
        small(graph=f"directed:{file}")
    assert small(graph=f"directed:{file}", weights="equal-neighbour").neighbours[1] == [0]
    cut = tmp_path / "cut.edges"
    cut.write_text("0 1\n1 2\n2 3\n")
    with pytest.raises(ValueError, match=r"4 pieces that do not all hear all"):
        small(graph=f"directed:{cut}", weights="equal-neighbour")
