"""The floor of a lockstep network: the same processes, links and messages, and no filter.

`python -m benchmarks.bare_loop` reads one JSON object (neighbours, rounds, steps, message sizes)
from standard input and prints the lockstep steps per second of a network that only passes messages.
"""

import secrets
import sys
import time
from functools import partial

import msgspec

from nodes.links import RECORDER, WORLD, Links, free_ports, names, plan_links
from nodes.supervisor import Supervisor
from nodes.zenoh_transport import Transport, start_router


class Load(msgspec.Struct, frozen=True):
    """What travels: bytes of a measurement, a share and an estimate; `lead` of the world."""

    neighbours: list[list[int]]
    rounds: int
    steps: int
    lead: int
    measured_bytes: int
    share_bytes: int
    estimate_bytes: int


def main() -> None:
    """Run the loop once and print {"steps_per_second": ...}."""
    load = msgspec.json.decode(sys.stdin.buffer.readline(), type=Load)
    run = f"bare-{secrets.token_hex(3)}"
    ports = free_ports(names(load.neighbours))
    links = plan_links(load.neighbours, ports)
    supervisor = Supervisor()
    try:
        if "router" in ports:
            supervisor.start("router", partial(_route, ports["router"]))
        supervisor.start(RECORDER, partial(_record, run, links[RECORDER], load))
        supervisor.start(WORLD, partial(_drive, run, links[WORLD], load))
        for node in range(len(load.neighbours)):
            supervisor.start(str(node), partial(_pass_on, run, links[str(node)], load, node))
        while True:
            ended = supervisor.wait(sys.stdin.fileno())
            if ended is not None and (ended.name == WORLD or ended.code):
                return
    finally:
        supervisor.stop()


def _route(port: int) -> None:
    session = start_router(f"tcp/127.0.0.1:{port}")
    time.sleep(600)
    session.close()


def _pass_on(run: str, links: Links, load: Load, node: int) -> None:
    neighbours = load.neighbours[node]
    shares = [f"share/{j}" for j in neighbours]
    transport = Transport(run, links, [f"measured/{node}", *shares], 1024)
    transport.join(str(node), {WORLD, RECORDER, *map(str, neighbours)})
    share, estimate = bytes(load.share_bytes), bytes(load.estimate_bytes)
    transport.send(f"hello/{node}", b"")
    for _ in range(load.steps):
        transport.receive(f"measured/{node}")
        for _ in range(load.rounds):
            transport.send(f"share/{node}", share)
            for topic in shares:
                transport.receive(topic)
        transport.send(f"estimate/{node}", estimate)
    time.sleep(600)


def _drive(run: str, links: Links, load: Load) -> None:
    nodes = len(load.neighbours)
    transport = Transport(run, links, ["hello/*", "estimate/*"], 16_384)
    transport.join(WORLD, {RECORDER, *map(str, range(nodes))})
    for _ in range(nodes):
        transport.receive("hello/*")
    measured = bytes(load.measured_bytes)
    started = time.perf_counter()
    for step in range(load.steps + load.lead):
        if step >= load.lead:
            for _ in range(nodes):
                transport.receive("estimate/*")
        if step < load.steps:
            for node in range(nodes):
                transport.send(f"measured/{node}", measured)
    rate = load.steps / (time.perf_counter() - started)
    sys.stdout.write(msgspec.json.encode({"steps_per_second": rate}).decode() + "\n")
    sys.stdout.flush()


def _record(run: str, links: Links, load: Load) -> None:
    transport = Transport(run, links, ["**"], 65_536)
    transport.join(RECORDER, set())
    while True:
        transport.receive("**")


if __name__ == "__main__":
    main()
