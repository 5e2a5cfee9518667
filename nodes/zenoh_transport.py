"""The only file that knows zenoh: sessions, links, the readiness barrier, sending and receiving.

Sparse graphs get a mesh of peers with one explicit loopback link per edge of the sensor graph
(peers do not forward, so the zenoh topology is the sensor graph); dense graphs go through one
router. No multicast, no gossip: two runs on one machine never find each other.
"""

import os
from collections.abc import Collection, Sequence

import msgspec
import zenoh

from nodes.links import Links

# One worker thread per process instead of one per core and role; a router needs the default.
_ONE_THREAD = (
    "(rx:(handover:app),acc:(handover:app),tx:(handover:app),net:(handover:app),"
    "app:(worker_threads:1))"
)
_LEASE_MS = 2000


class LinkError(Exception):
    """A session could not be opened: a port is taken or a peer does not answer."""


def _config(links: Links) -> zenoh.Config:
    settings = {
        "mode": links.mode,
        "listen/endpoints": list(links.listen),
        "connect/endpoints": list(links.connect),
        "connect/timeout_ms": round(links.connect_s * 1000),
        "connect/exit_on_failure": True,
        "connect/retry": {
            "period_init_ms": 20,
            "period_max_ms": 200,
            "period_increase_factor": 1.5,
        },
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "scouting/delay": 0,
        "transport/shared_memory/enabled": False,
        "transport/link/tx/lease": _LEASE_MS,
        "transport/link/tx/keep_alive": 4,
    }
    config = zenoh.Config.from_file(links.keys) if links.keys else zenoh.Config()
    for key, value in settings.items():
        config.insert_json5(key, msgspec.json.encode(value).decode())
    return config


def _open(links: Links) -> zenoh.Session:
    zenoh.init_log_from_env_or("off")
    try:
        return zenoh.open(_config(links))
    except zenoh.ZError as error:
        where = ", ".join(links.listen + links.connect)
        raise LinkError(f"cannot join the network at {where}: {error}") from None


def start_router(endpoint: str, keys: str | None = None) -> zenoh.Session:
    """A router that listens at `endpoint`; keep the session for as long as it shall run.

    `keys`: its file of `concord keys`, with which it lets nobody in that cannot prove who it is.

    Raises:
        LinkError: the port is taken.
    """
    # With a single worker thread a router was seen to hang at the start of a network.
    os.environ.pop("ZENOH_RUNTIME", None)
    return _open(Links("router", (endpoint,), (), keys=keys))


class Transport:
    """One process's place in the network of a run: topics below `concord/<run>/`.

    Each subscription has its own queue, so a node can wait for exactly the neighbour it needs.
    """

    def __init__(self, run: str, links: Links, subscriptions: Sequence[str], queue: int) -> None:
        """Open a session and subscribe.

        Args:
            run: name of the run; the first part of every key.
            links: how to join.
            subscriptions: topics, or patterns such as `estimate/*`.
            queue: messages that may wait in each subscription before senders are held up.

        Raises:
            LinkError: a port is taken or a peer does not answer.
        """
        os.environ.setdefault("ZENOH_RUNTIME", _ONE_THREAD)
        self._prefix = f"concord/{run}/"
        self._session = _open(links)
        self._queues = {
            topic: self._session.declare_subscriber(
                self._prefix + topic, zenoh.handlers.FifoChannel(queue)
            )
            for topic in subscriptions
        }
        self._publishers: dict[str, zenoh.Publisher] = {}
        self._token: zenoh.LivelinessToken | None = None

    def join(self, name: str, awaited: Collection[str]) -> None:
        """Say that this process is ready, and wait until all of `awaited` have said so.

        Declarations keep their order on a link: who sees our token has our subscriptions too.
        """
        liveliness = self._session.liveliness()
        ready = self._prefix + "ready/"
        channel = zenoh.handlers.FifoChannel(4 * len(awaited) + 64)
        watch = liveliness.declare_subscriber(ready + "*", channel, history=True)
        self._token = liveliness.declare_token(ready + name)
        missing = set(awaited)
        while missing:
            sample = watch.recv()
            who = str(sample.key_expr).removeprefix(ready)
            if sample.kind == zenoh.SampleKind.PUT:
                missing.discard(who)
            elif who in awaited:
                missing.add(who)
        watch.undeclare()

    def send(self, topic: str, data: bytes) -> None:
        """Publish; waits rather than loses when a receiver is slow."""
        publisher = self._publishers.get(topic)
        if publisher is None:
            publisher = self._publishers[topic] = self._session.declare_publisher(
                self._prefix + topic,
                congestion_control=zenoh.CongestionControl.BLOCK,
                express=True,
            )
        publisher.put(data)

    def receive(self, subscription: str) -> tuple[str, bytes]:
        """Wait for the next message of one subscription: (topic, bytes)."""
        sample = self._queues[subscription].recv()
        return str(sample.key_expr)[len(self._prefix) :], sample.payload.to_bytes()

    def close(self) -> None:
        """Leave the network."""
        self._session.close()
