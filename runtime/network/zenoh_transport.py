"""The only file that knows zenoh: sessions, links, the readiness barrier, sending and receiving.

Sparse graphs get a mesh of peers with one explicit local link per edge of the sensor graph.
Peers do not forward, so the zenoh topology is the sensor graph. Dense graphs go through one router.
No multicast, no gossip: two runs on one machine never find each other.
"""

import os
import re
import threading
from collections.abc import Callable, Collection, Sequence
from contextlib import suppress
from functools import partial
from typing import Any

import msgspec
import zenoh

from concord.disk import RunFailed
from concord.runtime.network.links import ZenohEndpoints

# One worker thread per process instead of one per core and role; a router needs the default.
_ONE_THREAD = (
    "(rx:(handover:app),acc:(handover:app),tx:(handover:app),net:(handover:app),"
    "app:(worker_threads:1))"
)
# A process that answers queries does so in its receive thread. That thread must not also send, or a
# full queue blocks both for ever.
_TWO_THREADS = _ONE_THREAD.replace("tx:(handover:app)", "tx:(worker_threads:1)")
_LEASE_MS = 2000
# Larger messages are dropped (zenoh would assemble up to 1 GiB). A large network's
# description takes some MB.
_MOST_BYTES = 1 << 26
# Largest number of messages taken from a queue together.
_AT_ONCE = 256


class LinkError(RunFailed):
    """A session could not be opened: a port is taken or a peer does not answer."""


def _config(links: ZenohEndpoints) -> zenoh.Config:
    settings = {
        "mode": links.mode,
        "listen/endpoints": list(links.listen),
        "connect/endpoints": list(links.connect),
        "connect/timeout_ms": -1 if links.connect_s is None else round(links.connect_s * 1000),
        "connect/exit_on_failure": links.connect_s is not None,
        "connect/retry": {
            "period_init_ms": 20,
            "period_max_ms": 200,
            "period_increase_factor": 1.5,
        },
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "scouting/delay": 0,
        "transport/shared_memory/enabled": False,
        # Connections that say nothing keep members out only when there are so many of them, and
        # for so long.
        "transport/unicast/accept_pending": 1000,
        "transport/unicast/accept_timeout": 5000,
        "transport/link/rx/max_message_size": _MOST_BYTES,
        "transport/link/tx/lease": _LEASE_MS,
        "transport/link/tx/keep_alive": 4,
        # A droppable message waits this long for room, once; later ones drop until there is room.
        "transport/link/tx/queue/congestion_control/drop/wait_before_drop": 10_000,
        "transport/link/tx/queue/size/data": 16,
        # Nothing waits to travel with what may follow it.
        "transport/link/tx/queue/batching/time_limit": 0,
    }
    if links.mode == "router":
        # One host that is out of reach holds up all others as long as this.
        settings["transport/link/tx/queue/congestion_control/block/wait_before_close"] = 1_000_000
    config = zenoh.Config.from_file(links.keys) if links.keys else zenoh.Config()
    for key, value in settings.items():
        config.insert_json5(key, msgspec.json.encode(value).decode())
    return config


def _open(links: ZenohEndpoints) -> zenoh.Session:
    zenoh.init_log_from_env_or("off")
    try:
        return zenoh.open(_config(links))
    except zenoh.ZError as error:
        where = ", ".join(links.listen + links.connect)
        # The position in zenoh's own source is of no use here.
        why = re.sub(r" at /\S+?\.rs:\d+", "", str(error))
        raise LinkError(f"cannot join the network at {where}: {why}") from None


def start_router(
    endpoint: str, keys: str | None = None, others: Sequence[str] = ()
) -> zenoh.Session:
    """A router that listens at `endpoint`; keep the session for as long as it shall run.

    `keys`: its file of `concord keys`, with which it lets nobody in that cannot prove who it is;
    `others`: endpoints of routers to which it keeps a link, whenever they are there.

    Raises:
        LinkError: the port is taken.
    """
    # With a single worker thread a router was seen to hang at the start of a network.
    os.environ.pop("ZENOH_RUNTIME", None)
    return _open(
        ZenohEndpoints("router", (endpoint,), tuple(others), None if others else 60.0, keys)
    )


class _Listening:
    """A callback for the messages of a key, on one session or several."""

    def __init__(self, key: str, take: Callable[[zenoh.Sample], None]) -> None:
        self._key, self._take = key, take
        self._declared: list[zenoh.Subscriber[None]] = []

    def begin(self, session: zenoh.Session) -> None:
        """Listen on a session."""
        callback = zenoh.handlers.Callback(self._take, indirect=False)
        self._declared.append(session.declare_subscriber(self._key, callback))

    def end(self) -> None:
        """Listen no more."""
        for subscriber in self._declared:
            subscriber.undeclare()


class _Sessions:
    """The sessions of one process: the first one, and one to each peer that it met later."""

    def __init__(self, prefix: str, links: ZenohEndpoints) -> None:
        self._prefix, self._keys = prefix, links.keys
        self.first = _open(links)
        self._later: dict[str, zenoh.Session] = {}
        self._publishers: dict[tuple[str, bool], tuple[zenoh.Publisher, ...]] = {}
        self._listening: list[_Listening] = []
        self._name, self._see = "", lambda sample: None
        # A declaration with a callback lives as long as a reference to it.
        self._declared: list[object] = []

    @property
    def all(self) -> tuple[zenoh.Session, ...]:
        """Return the sessions in the order in which they were opened."""
        return (self.first, *self._later.values())

    def meet(self, endpoint: str | None, subscribe: Callable[[zenoh.Session], None]) -> None:
        """Subscribe on the session with a link to a peer (`Transport.meet`)."""
        if endpoint is None or endpoint in self._later:
            subscribe(self._later.get(endpoint or "", self.first))
            return
        session = _open(ZenohEndpoints("peer", (), (endpoint,), None, self._keys))
        for one in self._listening:
            one.begin(session)
        subscribe(session)
        self._later[endpoint] = session
        if self._name:
            self._announce(session)

    def announce(self, name: str, see: Callable[[zenoh.Sample], None]) -> None:
        """Say that the process `name` is ready, and have `see` called when others are."""
        self._name, self._see = name, see
        for session in self.all:
            self._announce(session)

    def _announce(self, session: zenoh.Session) -> None:
        liveliness, key = session.liveliness(), self._prefix + "ready/"
        seen = zenoh.handlers.Callback(self._see, indirect=False)
        self._declared.append(liveliness.declare_subscriber(key + "*", seen, history=True))
        self._declared.append(liveliness.declare_token(key + self._name))

    def listen(self, topic: str, take: Callable[[zenoh.Sample], None]) -> Callable[[], None]:
        """Have `take` called for every message of a topic; return what ends it."""
        listening = _Listening(self._prefix + topic, take)
        for session in self.all:
            listening.begin(session)
        self._listening.append(listening)

        def stop() -> None:
            self._listening.remove(listening)
            listening.end()

        return stop

    def publish(self, topic: str, data: bytes, *, waits: bool) -> None:
        """Publish on all sessions; wait for room, or drop what finds none."""
        made = self._publishers.get((topic, waits), ())
        if len(made) <= len(self._later):
            made = self._publishers[topic, waits] = self._with_all(made, topic, waits)
        for publisher in made:
            publisher.put(data)

    def _with_all(
        self, made: tuple[zenoh.Publisher, ...], topic: str, waits: bool
    ) -> tuple[zenoh.Publisher, ...]:
        # None is sent by itself ("express"): what follows at once shares the room that a link
        # has. Sixteen by themselves fill it, and a link that breaks while somebody waits for
        # room holds up all others of its process for longer than their lease.
        control = zenoh.CongestionControl.BLOCK if waits else zenoh.CongestionControl.DROP
        key = self._prefix + topic
        lacking = self.all[len(made) :]
        return made + tuple(
            session.declare_publisher(key, congestion_control=control) for session in lacking
        )

    def close(self) -> None:
        """Close all sessions."""
        for session in reversed(self.all):
            session.close()


class Transport:
    """One process's place in the network of a run: topics below `concord/<run>/`.

    Each subscription has its own queue, so a node can wait for exactly the neighbour it needs.
    """

    def __init__(
        self,
        run: str,
        links: ZenohEndpoints,
        subscriptions: Sequence[str],
        queue: int,
        answers: bool = False,
    ) -> None:
        """Open a session and subscribe.

        Args:
            run: name of the run; the first part of every key.
            links: how to join.
            subscriptions: topics, or patterns such as `estimate/*`.
            queue: messages that may wait in each subscription before senders are held up.
            answers: whether this process will answer questions; the first of a process decides.

        Raises:
            LinkError: a port is taken or a peer does not answer.
        """
        os.environ.setdefault("ZENOH_RUNTIME", _TWO_THREADS if answers else _ONE_THREAD)
        self._prefix, self._queue = f"concord/{run}/", queue
        self._sessions = _Sessions(self._prefix, links)
        self._session = self._sessions.first
        self._queues: dict[str, Any] = {}
        self._subscribe(subscriptions, self._session)
        # A declaration with a callback lives as long as a reference to it.
        self._declared: list[object] = []
        self._present: set[str] = set()
        self._presence = threading.Condition()
        self._told = lambda name, is_there: None

    def _subscribe(self, topics: Sequence[str], session: zenoh.Session) -> None:
        for topic in topics:
            channel = zenoh.handlers.FifoChannel(self._queue)
            self._queues[topic] = session.declare_subscriber(self._prefix + topic, channel)

    def join(self, name: str, awaited: Collection[str]) -> None:
        """Say that this process is ready, and wait until all of `awaited` have said so.

        Declarations keep their order on a link: a peer that sees our token also has our
        subscriptions.
        """
        self._sessions.announce(name, self._see)
        self.await_present(awaited)

    def meet(self, endpoint: str | None, topics: Sequence[str]) -> None:
        """Subscribe to topics of a peer that has become a neighbour.

        The peer listens at `endpoint`, and a link is opened as soon as it answers; None where it
        opens the link, or a router is between.

        Raises:
            LinkError: there can be no such link.
        """
        self._sessions.meet(endpoint, partial(self._subscribe, topics))

    def unsubscribe(self, topics: Sequence[str]) -> None:
        """End the subscriptions to these topics; what waits in their queues is dropped."""
        for topic in topics:
            self._queues.pop(topic).undeclare()

    def await_present(self, names: Collection[str], seconds: float | None = None) -> bool:
        """Wait until all of `names` are ready: whether they are, after `seconds` at most."""
        with self._presence:
            return self._presence.wait_for(lambda: self._present.issuperset(names), seconds)

    def missing(self, names: Collection[str]) -> list[str]:
        """Return those of `names` that are not ready, in order."""
        with self._presence:
            return [name for name in names if name not in self._present]

    def watch(self, told: Callable[[str, bool], None]) -> None:
        """Have `told(name, is_there)` called, in another thread, when a process comes or goes."""
        self._told = told

    def _see(self, sample: zenoh.Sample) -> None:
        name = str(sample.key_expr).removeprefix(self._prefix + "ready/")
        is_there = sample.kind == zenoh.SampleKind.PUT
        with self._presence:
            (self._present.add if is_there else self._present.discard)(name)
            self._presence.notify_all()
        self._told(name, is_there)

    def listen(self, topic: str, heard: Callable[[str, bytes], None]) -> Callable[[], None]:
        """Have `heard(topic, bytes)` called, in another thread, for every message of a topic.

        Returns what ends it.
        """

        def take(sample: zenoh.Sample) -> None:
            heard(self._topic(sample), sample.payload.to_bytes())

        return self._sessions.listen(topic, take)

    def answer(self, topic: str, reply: Callable[[bytes], bytes]) -> None:
        """Answer questions on a topic with `reply(payload)`, in another thread."""
        key = self._prefix + topic

        def take(query: zenoh.Query) -> None:
            query.reply(key, reply(query.payload.to_bytes() if query.payload else b""))

        callback = zenoh.handlers.Callback(take, indirect=True)
        self._declared.append(self._session.declare_queryable(key, callback))

    def ask(self, topic: str, payload: bytes = b"", seconds: float = 2.0) -> bytes | None:
        """The first answer to a question on a topic; None if there is none in time."""
        for answer in self._session.get(self._prefix + topic, payload=payload, timeout=seconds):
            if answer.ok is not None:
                return answer.ok.payload.to_bytes()
        return None

    def send(self, topic: str, data: bytes) -> None:
        """Publish; waits rather than loses when a receiver is slow."""
        self._sessions.publish(topic, data, waits=True)

    def offer(self, topic: str, data: bytes) -> None:
        """Publish to subscribers; drop rather than wait. Without a subscriber it costs nothing."""
        self._sessions.publish(topic, data, waits=False)

    def listened(self, topic: str, told: Callable[[bool], None]) -> None:
        """Have `told(whether)` called, also in another thread, when somebody listens to a topic, or
        a part of a pattern, and when nobody does any more."""
        publisher = self._session.declare_publisher(self._prefix + topic)

        def see(status: zenoh.MatchingStatus) -> None:
            told(status.matching)

        callback = zenoh.handlers.Callback(see, indirect=False)
        self._declared += [publisher, publisher.declare_matching_listener(callback)]

    def receive(self, subscription: str) -> tuple[str, bytes] | None:
        """Wait for the next message of one subscription: (topic, bytes); None if woken up."""
        sample = self._queues[subscription].recv()
        data = sample.payload.to_bytes()
        if not data:
            return None
        # Only a pattern leaves open which topic it was; to ask zenoh costs more than to take it.
        return (self._topic(sample) if "*" in subscription else subscription), data

    def receive_all(self, subscription: str) -> tuple[list[tuple[str, bytes]], bool]:
        """Wait for messages of one subscription and take those that are there, (topic, bytes), but
        none that came after a call of `wake`: whether there was one is told with them."""
        queue = self._queues[subscription]
        came: list[tuple[str, bytes]] = []
        sample: zenoh.Sample | None = queue.recv()
        while sample is not None:
            data = sample.payload.to_bytes()
            if not data:
                return came, True
            came.append((self._topic(sample), data))
            sample = queue.try_recv() if len(came) < _AT_ONCE else None
        return came, False

    def receive_at_once(self, subscription: str) -> tuple[str, bytes] | None:
        """Return the next message of one subscription if it is there; None after leaving."""
        with suppress(zenoh.ZError, KeyError):
            while (sample := self._queues[subscription].try_recv()) is not None:
                data = sample.payload.to_bytes()
                if data:
                    return self._topic(sample), data
        return None

    def wake(self, subscription: str) -> None:
        """Wake the thread of this process that waits for this subscription."""
        # To this process only: an empty message is no message. A closed session needs no wake-up.
        key = self._prefix + subscription.replace("*", "-")
        here = zenoh.Locality.SESSION_LOCAL
        with suppress(zenoh.ZError):
            for session in self._sessions.all:
                session.put(key, b"", allowed_destination=here)

    def _topic(self, sample: zenoh.Sample) -> str:
        return str(sample.key_expr)[len(self._prefix) :]

    def close(self) -> None:
        """Leave the network."""
        self._sessions.close()
