"""Lower bound of a lockstep network: the same processes, links, messages and filter calls.

`python -m benchmarks.bare_loop` reads one JSON object (`Load`) from standard input and prints the
lockstep steps per second of a network. Its nodes call the filters as a node does and pass on bytes.
The bytes are encoded and decoded messages with checksums, or as many empty bytes. The network keeps
no state, and it counts, schedules, evaluates and records nothing.
"""

import secrets
import signal
import sys
import time
from collections.abc import Sequence
from functools import partial
from typing import Protocol

import msgspec
import numpy as np

from benchmarks.cases import beliefs, readings, turn
from concord.bus.ideal import TimelessBus
from concord.bus.schedule import full_publish
from concord.filters.fusion.averaging import INFORMATION
from concord.filters.gaussian import Gaussian
from concord.filters.linalg import pack_upper
from concord.filters.sigma_points import scaled_unscented
from concord.filters.ukf import predict, update
from concord.nodes.messages import Estimate, Measured, decode, encode, to_wire
from concord.nodes.vector_codec import BeliefCodec
from concord.runtime.network.links import (
    ENVIRONMENT,
    RECORDER,
    ZenohEndpoints,
    free_ports,
    names,
    on_loopback,
    plan_links,
)
from concord.runtime.network.zenoh_transport import Transport, start_router
from concord.runtime.processes.supervisor import Ended, Supervisor


class Load(msgspec.Struct, frozen=True):
    """Load of the loop: messages, or (`says` is False) as many bytes as a measurement, a share and
    an estimate have.

    `lead` is that of the environment; `sees` is the fraction of a node's steps with a reading.
    """

    neighbours: list[list[int]]
    rounds: int
    steps: int
    lead: int
    sees: float
    says: bool
    measured_bytes: int
    share_bytes: int
    estimate_bytes: int


def main() -> None:
    """Run the loop once and print {"steps_per_second": ...}."""
    load = msgspec.json.decode(sys.stdin.buffer.readline(), type=Load)
    run = f"bare-{secrets.token_hex(3)}"
    at = on_loopback(free_ports(names(load.neighbours)))
    links = plan_links(load.neighbours, at)
    supervisor = Supervisor()
    try:
        if "router" in at:
            supervisor.start("router", partial(_route, at["router"]))
        supervisor.start(RECORDER, partial(_record, run, links[RECORDER], load))
        supervisor.start(ENVIRONMENT, partial(_drive, run, links[ENVIRONMENT], load))
        for node in range(len(load.neighbours)):
            supervisor.start(str(node), partial(_pass_on, run, links[str(node)], load, node))
        while True:
            ended = supervisor.wait(sys.stdin.fileno())
            if isinstance(ended, Ended) and (ended.name == ENVIRONMENT or ended.code):
                return
    finally:
        supervisor.stop()


def _route(endpoint: str) -> None:
    session = start_router(endpoint)
    signal.pause()
    session.close()


class _Language(Protocol):
    """How what travels is made and read."""

    def measured(self, node: int, step: int) -> bytes: ...

    def share(self, node: int, cycle: int) -> bytes: ...

    def estimate(self, node: int, step: int) -> bytes: ...

    def hear_shares(self, cycle: int, came: Sequence[tuple[int, bytes]]) -> None: ...

    def hear(self, topic: str, data: bytes) -> None: ...


class _Bytes:
    """Bytes without content, which no node decodes."""

    def __init__(self, load: Load) -> None:
        self._measured = bytes(load.measured_bytes)
        self._share = bytes(load.share_bytes)
        self._estimate = bytes(load.estimate_bytes)

    def measured(self, node: int, step: int) -> bytes:
        return self._measured

    def share(self, node: int, cycle: int) -> bytes:
        return self._share

    def estimate(self, node: int, step: int) -> bytes:
        return self._estimate

    def hear_shares(self, cycle: int, came: Sequence[tuple[int, bytes]]) -> None: ...

    def hear(self, topic: str, data: bytes) -> None: ...


class _Messages:
    """The messages of a network, of numbers that stay the same."""

    def __init__(self, load: Load) -> None:
        case, places = turn(), range(len(load.neighbours))
        self._belief, self._reading = case.start, [to_wire(readings(case, ()))]
        self._codec = BeliefCodec(len(case.start.mean))
        self._bus = TimelessBus(full_publish(len(places)), self._codec.size)
        self._ages = [[0] * len(heard) for heard in load.neighbours]
        self._counters = {"sent": 1000, "heard": 1000}

    def measured(self, node: int, step: int) -> bytes:
        return encode(Measured(node, step, self._reading))

    def share(self, node: int, cycle: int) -> bytes:
        return self._bus.encode(node, cycle, self._codec.encode(self._belief))[0]

    def estimate(self, node: int, step: int) -> bytes:
        mean, cov = to_wire(self._belief.mean), to_wire(pack_upper(self._belief.cov))
        return encode(Estimate(node, step, mean, cov, self._ages[node], self._counters))

    def hear_shares(self, cycle: int, came: Sequence[tuple[int, bytes]]) -> None:
        codec, bodies = self._codec.vector, []
        for node, data in came:
            body = self._bus.due_body(data, node, cycle, codec.size)
            assert body is not None, "what is sent is what is due"
            bodies.append(codec.check(body))
        codec.unpack(*bodies)

    def hear(self, topic: str, data: bytes) -> None:
        decode(topic, data)


def language_of(load: Load) -> _Language:
    """Return how the messages of the loop are made and read."""
    return _Messages(load) if load.says else _Bytes(load)


def _pass_on(run: str, links: ZenohEndpoints, load: Load, node: int) -> None:
    shares = [f"share/{j}" for j in load.neighbours[node]]
    transport = Transport(run, links, [f"measured/{node}", *shares], 1024)
    pass_on(transport, load, node)
    signal.pause()


def pass_on(transport: Transport, load: Load, node: int) -> None:
    """A node from its first word to its last."""
    neighbours = load.neighbours[node]
    heartbeat = f"measured/{node}"
    shares = [(j, f"share/{j}") for j in neighbours]
    transport.join(str(node), {ENVIRONMENT, RECORDER, *map(str, neighbours)})
    transport.send(f"hello/{node}", b"")
    language, filters = language_of(load), _Filters(len(neighbours))
    seen = 0.0
    for step in range(load.steps):
        language.hear(heartbeat, _receive(transport, heartbeat))
        filters.predict()
        seen += load.sees
        if seen >= 1:
            seen -= 1
            filters.update()
        for cycle in range(step * load.rounds, (step + 1) * load.rounds):
            transport.send(f"share/{node}", language.share(node, cycle))
            came = [(j, _receive(transport, topic)) for j, topic in shares]
            language.hear_shares(cycle, came)
            filters.fuse()
        transport.send(f"estimate/{node}", language.estimate(node, step))


def _receive(transport: Transport, topic: str) -> bytes:
    received = transport.receive(topic)
    assert received is not None, "nobody wakes this process up"
    return received[1]


class _Filters:
    """Filter calls of a node of `target-tracking`, on constant numbers."""

    def __init__(self, neighbours: int) -> None:
        case = turn()
        self._case, self._rule = case, scaled_unscented(len(case.start.mean))
        self._all = beliefs(case, (1 + neighbours + 1,))
        self._own, self._heard = case.start, beliefs(case, (neighbours,))
        self._weights = np.full(1 + neighbours, 1 / (1 + neighbours))
        self._reading = readings(case, ())

    def predict(self) -> Gaussian:
        """Predict every belief that a node holds."""
        return predict(self._all, self._case.transition, self._case.process_noise_cov, self._rule)

    def update(self) -> None:
        case = self._case
        update(
            case.start,
            self._reading,
            case.measure,
            case.measurement_noise_cov,
            self._rule,
            residual=case.residual,
        )

    def fuse(self) -> Gaussian:
        """Covariance intersection by weights that favour the sharp."""
        return INFORMATION.fuse(self._own, self._heard, self._weights, True).belief


def _drive(run: str, links: ZenohEndpoints, load: Load) -> None:
    nodes = len(load.neighbours)
    transport = Transport(run, links, ["hello/*", "estimate/*"], 16_384)
    transport.join(ENVIRONMENT, {RECORDER, *map(str, range(nodes))})
    for _ in range(nodes):
        transport.receive("hello/*")
    language = language_of(load)
    started = time.perf_counter()
    for step in range(load.steps + load.lead):
        if step >= load.lead:
            for _ in range(nodes):
                received = transport.receive("estimate/*")
                assert received is not None, "nobody wakes this process up"
                language.hear(*received)
        if step < load.steps:
            for node in range(nodes):
                transport.send(f"measured/{node}", language.measured(node, step))
    rate = load.steps / (time.perf_counter() - started)
    sys.stdout.write(msgspec.json.encode({"steps_per_second": rate}).decode() + "\n")
    sys.stdout.flush()


def _record(run: str, links: ZenohEndpoints, load: Load) -> None:
    transport = Transport(run, links, ["**"], 65_536)
    transport.join(RECORDER, set())
    while True:
        transport.receive("**")


if __name__ == "__main__":
    main()
