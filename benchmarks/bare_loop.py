"""The floor of a lockstep network: the same processes, links and messages, and the filter calls.

`python -m benchmarks.bare_loop` reads one JSON object (neighbours, rounds, steps, message sizes)
from standard input and prints the lockstep steps per second of a network whose nodes pass on bytes
that say nothing, and call the filters as a node does: a prediction of all it holds, an update, and
an average per round. No frame is made or checked, nothing is counted, and no state is kept.
"""

import secrets
import signal
import sys
import time
from functools import partial

import msgspec
import numpy as np

from benchmarks.cases import beliefs, readings, turn
from filters.fusion import covariance_intersection
from filters.sigma_points import scaled_unscented
from filters.ukf import predict, update
from nodes.links import RECORDER, WORLD, Links, free_ports, names, plan_links
from nodes.supervisor import Ended, Supervisor
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
            if isinstance(ended, Ended) and (ended.name == WORLD or ended.code):
                return
    finally:
        supervisor.stop()


def _route(port: int) -> None:
    session = start_router(f"tcp/127.0.0.1:{port}")
    signal.pause()
    session.close()


def _pass_on(run: str, links: Links, load: Load, node: int) -> None:
    neighbours = load.neighbours[node]
    shares = [f"share/{j}" for j in neighbours]
    transport = Transport(run, links, [f"measured/{node}", *shares], 1024)
    transport.join(str(node), {WORLD, RECORDER, *map(str, neighbours)})
    share, estimate = bytes(load.share_bytes), bytes(load.estimate_bytes)
    transport.send(f"hello/{node}", b"")
    filters = _Filters(len(neighbours))
    for _ in range(load.steps):
        transport.receive(f"measured/{node}")
        filters.step()
        for _ in range(load.rounds):
            transport.send(f"share/{node}", share)
            for topic in shares:
                transport.receive(topic)
            filters.fuse()
        transport.send(f"estimate/{node}", estimate)
    signal.pause()


class _Filters:
    """What a node of `target-tracking` asks of the filters, on numbers that stay the same."""

    def __init__(self, neighbours: int) -> None:
        case = turn()
        self._case, self._rule = case, scaled_unscented(len(case.start.mean))
        self._all = beliefs(case, (1 + neighbours + 1,))
        self._heard = beliefs(case, (1 + neighbours,))
        self._weights = np.full(1 + neighbours, 1 / (1 + neighbours))
        self._reading = readings(case, ())

    def step(self) -> None:
        case = self._case
        predict(self._all, case.transition, case.process_noise_cov, self._rule)
        update(
            case.start,
            self._reading,
            case.measure,
            case.measurement_noise_cov,
            self._rule,
            residual=case.residual,
        )

    def fuse(self) -> None:
        covariance_intersection(self._heard, self._weights)


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
