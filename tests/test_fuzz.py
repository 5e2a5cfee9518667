"""Malformed messages against a network of real processes; `make fuzz` does it with a million."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import msgspec
import pytest

from benchmarks.fuzz import fuzz
from benchmarks.running import PROC, Running, neighbouring_ports
from nodes.commands import Speed
from nodes.links import WORLD, Links, names
from nodes.messages import END
from nodes.world_process import WORLD_QUEUE
from nodes.zenoh_transport import Transport
from scenarios.catalogue import kind_of
from scenarios.setup import prepare
from tests.processes import holds_within

pytestmark = [
    pytest.mark.zenoh,
    pytest.mark.skipif(not PROC.is_dir(), reason="reads memory in /proc, which is not there"),
]


@contextmanager
def pair(folder: Path) -> Iterator[tuple[Running, dict[str, int]]]:
    """A slow network of two nodes, and its ports; it must end in order."""
    wanted = {"nodes": 2, "graph": "path", "steps": 200}
    setup = prepare(msgspec.structs.replace(kind_of("oscillator").defaults, **wanted))
    ports = neighbouring_ports(names(setup.neighbours))
    running = Running(setup, "pair", folder, min(ports.values()))
    running.client.command(Speed(20.0))
    try:
        yield running, ports
    finally:
        running.end()


def test_malformed_messages_are_all_counted_and_change_no_bit():
    """Nodes, world and recorder each count what was said to them, more than queues hold."""
    outcome = fuzz(9000, seed=3, steps=400)
    assert outcome.refused == outcome.sent
    assert sum(outcome.sent.values()) == 9000
    assert outcome.same_estimates


@pytest.mark.parametrize(("topic", "data"), [("bid/0", b"no bid"), ("end", END)])
def test_a_flood_that_nobody_waits_for_leaves_the_world_hearing(
    topic: str, data: bytes, tmp_path: Path
):
    """Nobody contends here, so the world waits for estimates alone; and the end is far."""
    flood = WORLD_QUEUE + 2000
    with pair(tmp_path) as (running, ports):
        links = Links("peer", (), (f"tcp/127.0.0.1:{ports[WORLD]}",), 10.0)
        stranger = Transport("pair", links, [], 1)
        for _ in range(flood):
            stranger.send(topic, data)
        assert holds_within(20, lambda: running.client.state()["refused"] == flood)
        completed = running.client.state()["completed"]
        assert holds_within(20, lambda: running.client.state()["completed"] > completed)
        stranger.close()
