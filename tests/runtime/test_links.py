import socket
from pathlib import Path

import networkx
import pytest
from hypothesis import given
from hypothesis import strategies as st

from concord.features.hosts.host_place import key_files
from concord.runtime.network.links import (
    ENVIRONMENT,
    RECORDER,
    ROUTER,
    WATCH,
    free_ports,
    names,
    on_loopback,
    peers_of,
    plan_links,
    ports_from,
    wants_router,
    watcher_keys,
)
from tests.nodes.networks import Adjacency, graphs


def neighbours_of(adjacency: Adjacency) -> list[list[int]]:
    return [[j for j, link in enumerate(row) if link] for row in adjacency]


def planned(neighbours: list[list[int]]):
    ports = {name: 7000 + place for place, name in enumerate(names(neighbours))}
    return plan_links(neighbours, on_loopback(ports)), ports


@given(graphs(most=8), st.randoms(use_true_random=False))
def test_a_mesh_has_one_link_per_edge_and_one_to_world_and_recorder(adjacency: Adjacency, random):
    """Whether both hear each other or one hears the other alone."""
    neighbours = neighbours_of(adjacency)
    for i, heard in enumerate(neighbours):
        for j in [j for j in heard if i in neighbours[j] and random.random() < 0.3]:
            heard.remove(j)
    links, ports = planned(neighbours)
    owner = {f"tcp/127.0.0.1:{port}": name for name, port in ports.items()}
    assert all(links[name].listen == (endpoint,) for endpoint, name in owner.items())
    opened = [(name, owner[at]) for name, link in links.items() for at in link.connect]
    assert len(opened) == len({frozenset(pair) for pair in opened})
    graph = networkx.Graph(opened)
    for i, linked in enumerate(neighbours_of(adjacency)):
        assert set(graph[str(i)]) == {ENVIRONMENT, RECORDER, *map(str, linked)}
        assert peers_of(i, neighbours) == linked
    assert graph.has_edge(ENVIRONMENT, RECORDER)
    assert {link.mode for link in links.values()} == {"peer"}


@given(graphs(most=8))
def test_nobody_waits_for_somebody_who_waits_for_him(adjacency: Adjacency):
    """`open` listens before it connects; still, no circle of connections keeps it simple."""
    links, ports = planned(neighbours_of(adjacency))
    owner = {f"tcp/127.0.0.1:{port}": name for name, port in ports.items()}
    opened = [(name, owner[at]) for name, link in links.items() for at in link.connect]
    assert networkx.is_directed_acyclic_graph(networkx.DiGraph(opened))


def test_a_dense_graph_goes_through_a_router():
    dense = [[j for j in range(20) if j != i] for i in range(20)]
    assert wants_router(dense)
    links, ports = planned(dense)
    assert list(ports) == [ROUTER, WATCH]
    assert set(links) == {ENVIRONMENT, RECORDER, WATCH, *map(str, range(20))}
    assert links.pop(WATCH).connect == ()
    clients = {(link.mode, link.listen, link.connect) for link in links.values()}
    assert clients == {("client", (), (f"tcp/127.0.0.1:{ports[ROUTER]}",))}


def test_a_sparse_graph_of_many_nodes_needs_none():
    ring = [[(i - 1) % 64, (i + 1) % 64] for i in range(64)]
    assert not wants_router(ring)


@given(st.integers(0, 40))
def test_free_ports_are_free_and_different(count: int):
    ports = free_ports([str(i) for i in range(count)])
    assert len(set(ports.values())) == len(ports) == count
    for port in ports.values():
        with socket.socket() as one:
            one.bind(("127.0.0.1", port))


def test_ports_from_a_first_one_are_consecutive():
    first = free_ports(["a"])["a"]
    if first > 65000:
        first = 30000
    assert list(ports_from(first, ["a"]).items()) == [("a", first)]


@pytest.mark.parametrize(("first", "count"), [(80, 3), (1023, 1), (65534, 3), (70000, 1), (-1, 1)])
def test_ports_out_of_range_are_refused(first: int, count: int):
    last = first + count - 1
    with pytest.raises(ValueError, match=rf"--port {first}: .* {first} to {last}.*1024\.\.65535"):
        ports_from(first, ["x"] * count)


def test_a_port_in_use_is_refused_by_number():
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        with pytest.raises(ValueError, match=rf"port {port} is in use.*leave --port out"):
            ports_from(port, ["a"])
        with pytest.raises(ValueError, match=rf"--port {port - 1}: port {port} is in use"):
            ports_from(port - 1, ["a", "b"])


@pytest.mark.parametrize("mode", [0o604, 0o602, 0o666, 0o777])
def test_a_key_that_all_users_can_reach_is_refused(mode: int, tmp_path: Path):
    file = tmp_path / "monitor.json"
    file.write_text("{}", encoding="utf-8")
    file.chmod(mode)
    with pytest.raises(ValueError, match=rf"mode {mode:04o}\); run chmod 600 .*monitor.json"):
        watcher_keys(file, ["tls/10.0.0.1:7447"])
    with pytest.raises(ValueError, match=f"mode {mode:04o}"):
        key_files(tmp_path, ["monitor"])


@pytest.mark.parametrize("mode", [0o600, 0o400, 0o440, 0o640])
def test_a_key_of_a_user_or_a_group_is_taken(mode: int, tmp_path: Path):
    """Kubernetes gives secrets to a group (deploy/kubernetes.yaml: 0440)."""
    file = tmp_path / "monitor.json"
    file.write_text("{}", encoding="utf-8")
    file.chmod(mode)
    assert watcher_keys(file, ["tls/10.0.0.1:7447"]) == str(file)
    assert key_files(tmp_path, ["monitor"]) == {"monitor": str(file)}
