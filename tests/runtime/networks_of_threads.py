"""A network of processes whose processes are threads, and whose transport is a queue for each."""

import math
import os
import threading
import time
from collections.abc import Callable, Collection, Sequence
from fnmatch import fnmatchcase
from queue import Empty, SimpleQueue
from typing import Any

import msgspec
import pytest

from concord.runtime.network import control_client
from concord.runtime.network.links import ZenohEndpoints
from concord.runtime.processes.environment import process as environment_process
from concord.runtime.processes.job import Happened, Job, NodeEnded, Order
from concord.runtime.processes.node import lockstep, real_time
from concord.runtime.processes.recorder import process as recorder_process
from concord.runtime.processes.roles import be_environment, be_node, be_recorder
from concord.scenarios.build import build_node
from tests.processes import holds_within

LONGEST_S = 30.0
_WATCH = "watch"


class Killed(SystemExit):
    """The process of this thread was killed."""


class Hub:
    """All transports of a network, its liveliness tokens, and what answers questions."""

    def __init__(self) -> None:
        self.transports: list[Wire] = []
        self.present: dict[str, Wire] = {}
        self.answers: dict[str, Callable[[bytes], bytes]] = {}
        self.lock = threading.RLock()

    def deliver(self, topic: str, data: bytes) -> None:
        """Hand a message to each process."""
        with self.lock:
            for transport in self.transports:
                transport.arrivals.put((topic, data))

    def tell(self, name: str, is_there: bool) -> None:
        """Tell each process that has joined of another one."""
        for transport in set(self.present.values()):
            transport.arrivals.put((name, is_there))


class Wire:
    """A transport as that of zenoh: one thread takes arrivals in their order."""

    def __init__(
        self,
        hub: Hub,
        _run: str,
        links: ZenohEndpoints,
        topics: Sequence[str],
        *_: object,
        **__: object,
    ) -> None:
        self._hub = hub
        self.arrivals: SimpleQueue[tuple[str, Any] | None] = SimpleQueue()
        self._queues: dict[str, SimpleQueue[tuple[str, bytes] | None]] = {}
        self._listeners: list[tuple[str, Callable[[str, bytes], None]]] = []
        self._there: set[str] = set()
        self._presence = threading.Condition()
        self._told: Callable[[str, bool], None] = lambda name, is_there: None
        self.is_killed = False
        self.meet(None, topics)
        with hub.lock:
            hub.transports.append(self)
        threading.Thread(target=self._take, daemon=True).start()

    def _take(self) -> None:
        while (arrived := self.arrivals.get()) is not None and not self.is_killed:
            name, data = arrived
            if isinstance(data, bool):
                with self._presence:
                    (self._there.add if data else self._there.discard)(name)
                    self._presence.notify_all()
                self._told(name, data)
                continue
            for topic, waiting in list(self._queues.items()):
                # An empty message wakes one subscription of this process.
                if _matches(name, topic) if data else name == topic:
                    waiting.put((name, data) if data else None)
            for topic, heard in list(self._listeners) if data else ():
                if _matches(name, topic):
                    heard(name, data)

    def meet(self, _endpoint: str | None, topics: Sequence[str]) -> None:
        self._queues |= {topic: SimpleQueue() for topic in topics}

    def unsubscribe(self, topics: Sequence[str]) -> None:
        for topic in topics:
            del self._queues[topic]

    def join(self, name: str, awaited: Collection[str]) -> None:
        with self._hub.lock:
            for other in self._hub.present:
                self.arrivals.put((other, True))
            self._hub.present[name] = self
            self._hub.tell(name, True)
        self.await_present(awaited)

    def await_present(self, names: Collection[str], seconds: float | None = None) -> bool:
        with self._presence:
            return self._presence.wait_for(lambda: self._there.issuperset(names), seconds)

    def missing(self, names: Collection[str]) -> list[str]:
        with self._presence:
            return [name for name in names if name not in self._there]

    def watch(self, told: Callable[[str, bool], None]) -> None:
        self._told = told

    def listen(self, topic: str, heard: Callable[[str, bytes], None]) -> Callable[[], None]:
        listening = (topic, heard)
        self._listeners.append(listening)
        return lambda: self._listeners.remove(listening)

    def listened(self, _topic: str, told: Callable[[bool], None]) -> None:
        told(True)

    def answer(self, topic: str, reply: Callable[[bytes], bytes]) -> None:
        self._hub.answers[topic] = reply

    def ask(self, topic: str, payload: bytes = b"", seconds: float = 2.0) -> bytes | None:
        reply = self._hub.answers.get(topic)
        return None if reply is None else reply(payload)

    def send(self, topic: str, data: bytes) -> None:
        if not self.is_killed:
            self._hub.deliver(topic, data)

    offer = send

    def receive(self, subscription: str) -> tuple[str, bytes] | None:
        received = self._queues[subscription].get()
        self._look()
        return received

    def receive_all(self, subscription: str) -> tuple[list[tuple[str, bytes]], bool]:
        received = self.receive(subscription)
        return ([], True) if received is None else ([received], False)

    def receive_at_once(self, subscription: str) -> tuple[str, bytes] | None:
        self._look()
        try:
            while (received := self._queues[subscription].get_nowait()) is None:
                pass
        except (Empty, KeyError):
            return None
        return received

    def wake(self, subscription: str) -> None:
        self.arrivals.put((subscription, b""))

    def _look(self) -> None:
        if self.is_killed:
            raise Killed

    def close(self) -> None:
        """Leave the network; others see it."""
        with self._hub.lock:
            if self in self._hub.transports:
                self._hub.transports.remove(self)
            for name in [name for name, one in self._hub.present.items() if one is self]:
                del self._hub.present[name]
                self._hub.tell(name, False)
        self.arrivals.put(None)

    def kill(self) -> None:
        """End the process that has this transport, without a word."""
        self.is_killed = True
        for waiting in list(self._queues.values()):
            waiting.put(None)
        self.close()


def _matches(topic: str, pattern: str) -> bool:
    return pattern == topic or fnmatchcase(topic, pattern)


class NetworkOfThreads:
    """The processes of a job, each a thread that plays its role, and their launcher process."""

    def __init__(self, job: Job, monkeypatch: pytest.MonkeyPatch) -> None:
        self.job, self.hub = job, Hub()
        self.happened: list[Happened] = []
        self.orders: list[Order] = []
        names = ["recorder", "environment", _WATCH, *map(str, range(job.setup.scenario.nodes))]
        self._links = {name: ZenohEndpoints("peer", (name,), ()) for name in names}
        for module in (control_client, lockstep, real_time, environment_process, recorder_process):
            monkeypatch.setattr(module, "Transport", lambda *a, **k: Wire(self.hub, *a, **k))
        self._nodes = [build_node(job.setup, node) for node in range(job.setup.scenario.nodes)]
        self._lives = dict.fromkeys(range(len(self._nodes)), 0)
        # A process without a recorder ends after a minute: this one runs all tests.
        monkeypatch.setattr(environment_process, "_PEER_TIMEOUT_S", math.inf)
        usual = threading.excepthook
        monkeypatch.setattr(
            threading,
            "excepthook",
            lambda found: None if found.exc_type is Killed else usual(found),
        )

    def run(self, until: Callable[["NetworkOfThreads"], bool] = lambda network: True) -> None:
        """Run to the end, or fail after `LONGEST_S`; first wait for what a test does meanwhile."""
        orders, to_orders = os.pipe()
        self._ends, to_ends = os.pipe()
        self._to_ends = to_ends
        environment = (
            self.job,
            self._links["environment"],
            self.happened.append,
            to_orders,
            self._ends,
        )
        threads = [
            self._thread(be_recorder, self.job, self._links, self.happened.append),
            self._thread(be_environment, *environment),
            *(self._thread(be_node, self.job, self._links, node) for node in self._nodes),
        ]
        obeying = self._thread(self._obey, orders)
        try:
            assert holds_within(LONGEST_S, lambda: until(self)), self.happened
            for thread in threads[:2]:
                thread.join(LONGEST_S)
                assert not thread.is_alive(), self.happened
            assert holds_within(LONGEST_S, lambda: not self.hub.transports), "a node has not left"
        finally:
            os.close(to_orders)
            obeying.join(LONGEST_S)
            os.close(to_ends)
            os.close(self._ends)
            for transport in list(self.hub.transports):
                transport.kill()
            # Threads of killed processes look every 50 ms whether they live.
            time.sleep(0.1)

    @staticmethod
    def _thread(work: Callable[..., None], *known: object) -> threading.Thread:
        thread = threading.Thread(target=work, args=known, daemon=True)
        thread.start()
        return thread

    def _obey(self, orders: int) -> None:
        """Kill and start nodes as the launcher process does."""
        with os.fdopen(orders, "rb") as lines:
            for line in lines:
                order = msgspec.json.decode(line, type=Order)
                self.orders.append(order)
                if order.what == "kill":
                    with self.hub.lock:
                        present = self.hub.present.get(str(order.node))
                    if present is not None:
                        present.kill()
                    time.sleep(0.01)
                    ended = NodeEnded(order.node, self._lives[order.node])
                    os.write(self._to_ends, msgspec.json.encode(ended) + b"\n")
                elif order.what == "start":
                    self._lives[order.node] = order.life
                    self._thread(be_node, self.job, self._links, self._nodes[order.node], True)
