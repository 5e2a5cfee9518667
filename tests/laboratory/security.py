"""Break-in attempts against a guarded router, in real sessions on loopback."""

import queue
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable
from datetime import timedelta
from functools import partial
from pathlib import Path
from typing import Any

import msgspec
from cryptography import x509
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric import ec

from benchmarks.measure import say
from concord.features.hosts.access_control import MONITOR, OPERATOR, ROUTER_NAME, certificate_name
from concord.features.hosts.certificates import (
    AUTHORITY,
    AUTHORITY_KEY,
    MAX_NODES,
    Authority,
    issue,
    make_keys,
    new_authority,
    zenoh_settings,
)
from concord.nodes.bounds import MAX_FRAME_BYTES, MAX_MESSAGE_BYTES
from concord.runtime.network.links import (
    ENVIRONMENT,
    LOOPBACK,
    RECORDER,
    ZenohEndpoints,
    free_ports,
)
from concord.runtime.network.zenoh_transport import LinkError, Transport, start_router
from concord.studies.progress import progress

RUN = "security-check"
TRIES = 3
_JOIN_S = 2.0
_SETTLE_S = 0.5
_DELIVERED, _REFUSED = "delivered", "refused"


class IntrusionAttempt(msgspec.Struct, frozen=True):
    """Attempt against a guarded network, its expected outcome, and its outcome."""

    who: str
    tried: str
    wanted: str
    outcome: str
    arrived: int
    tries: int

    @property
    def held(self) -> bool:
        """Whether the network did what it should."""
        return self.outcome == self.wanted


def read_authority(folder: Path) -> Authority:
    """Return the authority that `concord keys` left in a folder."""
    certificate = x509.load_pem_x509_certificate((folder / AUTHORITY).read_bytes())
    key = serialization.load_pem_private_key((folder / AUTHORITY_KEY).read_bytes(), None)
    assert isinstance(key, ec.EllipticCurvePrivateKey), "concord writes no other"
    return Authority(certificate, key)


class _Guarded:
    """A router with keys, and a recorder that hears everything below the run."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        port = free_ports([ROUTER_NAME])[ROUTER_NAME]
        self.endpoint = f"tls/{LOOPBACK}:{port}"
        self._router = start_router(self.endpoint, self.keys(ROUTER_NAME))
        self._recorder = self.join(self.keys(RECORDER), ("**",))
        self._environment = self.join(self.keys(ENVIRONMENT))
        self._counts: Counter[tuple[str, bytes]] = Counter()
        self._ends = 0

    def keys(self, name: str) -> str:
        return str(self._folder / f"{name}.json")

    def join(self, keys: str | None, hears: tuple[str, ...] = (), endpoint: str = "") -> Transport:
        links = ZenohEndpoints("client", (), (endpoint or self.endpoint,), _JOIN_S, keys)
        return Transport(RUN, links, hears, 1024)

    def settle(self) -> float:
        """Wait as long as many messages take here, at least half a second; return the seconds."""
        began_s = time.monotonic()
        self._ends += 1
        # The environment's link may not know yet that the recorder listens, and drop a word.
        while not self._heard(("end", str(self._ends).encode())):
            pass
        settle_s = max(_SETTLE_S, 50 * (time.monotonic() - began_s))
        time.sleep(settle_s)
        return settle_s

    def _heard(self, end: tuple[str, bytes]) -> bool:
        """Say a last word, and take what comes until it is there, for a moment at most."""
        self._environment.send(*end)
        until_s = time.monotonic() + _SETTLE_S
        while time.monotonic() < until_s:
            message = self._recorder.receive_at_once("**")
            if message == end:
                return True
            if message is None:
                time.sleep(0.001)
            elif message[0] != "end":
                self._counts[message] += 1
        return False

    def arrived(self) -> Counter[tuple[str, bytes]]:
        """How often each (topic, bytes) has come since the last call."""
        self.settle()
        self.settle()
        found, self._counts = self._counts, Counter()
        return found

    def answer(self, topic: str) -> None:
        """Make the environment answer queries on a topic."""
        self._environment.answer(topic, lambda question: question)

    def close(self) -> None:
        for session in (self._environment, self._recorder, self._router):
            session.close()


def _write_to(guarded: _Guarded, keys: str, topics: tuple[str, ...], mark: bytes) -> None:
    intruder = guarded.join(keys)
    # The subscriptions of the other sessions must arrive before the first message is sent.
    guarded.settle()
    for topic in topics:
        for _ in range(TRIES):
            intruder.send(topic, mark)
    guarded.settle()
    intruder.close()


def _writers(guarded: _Guarded) -> list[IntrusionAttempt]:
    """Check that members can publish on their own topics and on no others."""
    own = ("hello/0", "bid/0", "share/0", "estimate/0")
    of_another = tuple(topic.replace("0", "1") for topic in own)
    of_the_environment = ("measured/0", "grant", "truth", "finished", "end/0", "welcome/0")
    node = certificate_name(0)
    plan = [
        (node, "its own keys", own, _DELIVERED),
        (node, "a share too long for a frame", ("share/0",), _REFUSED),
        (node, "an estimate of more than 1 MiB", ("estimate/0",), _REFUSED),
        (node, "another node's keys", of_another, _REFUSED),
        (node, "the environment's keys", of_the_environment, _REFUSED),
        (MONITOR, "a node's keys", own, _REFUSED),
        (MONITOR, "the environment's keys", of_the_environment, _REFUSED),
    ]
    marks = [str(number).encode() for number in range(len(plan))]
    marks[1] = b"1".ljust(MAX_FRAME_BYTES + 1)
    marks[2] = b"2".ljust(MAX_MESSAGE_BYTES + 1)
    for (who, _, topics, _), mark in zip(plan, marks, strict=True):
        _write_to(guarded, guarded.keys(who), topics, mark)
    counts = guarded.arrived()
    attempts = []
    for (who, what, topics, wanted), mark in zip(plan, marks, strict=True):
        came = sum(counts.get((topic, mark), 0) for topic in topics)
        tries = TRIES * len(topics)
        attempts.append(_attempt(who, f"publishes {what}", wanted, came, tries))
    return attempts


def _attempt(who: str, tried: str, wanted: str, came: int, tries: int) -> IntrusionAttempt:
    outcome = {0: _REFUSED, tries: _DELIVERED}.get(came, "in part")
    return IntrusionAttempt(who, tried, wanted, outcome, came, tries)


def _reader(guarded: _Guarded) -> list[IntrusionAttempt]:
    """A monitor hears what a node says."""
    monitor = guarded.join(guarded.keys(MONITOR), ("share/*",))
    guarded.settle()
    _write_to(guarded, guarded.keys(certificate_name(0)), ("share/0",), b"heard")
    heard: queue.Queue[object] = queue.Queue()

    def listen() -> None:
        for _ in range(TRIES):
            heard.put(monitor.receive("share/*"))

    listening = threading.Thread(target=listen, daemon=True)
    listening.start()
    listening.join(_JOIN_S)
    return [_attempt(MONITOR, "hears a node's shares", _DELIVERED, heard.qsize(), TRIES)]


def _commands(guarded: _Guarded) -> list[IntrusionAttempt]:
    """Check access to the control interface: the environment answers each query that arrives."""
    guarded.answer("control")
    attempts = []
    for who, wanted in (
        (OPERATOR, _DELIVERED),
        (MONITOR, _REFUSED),
        (certificate_name(0), _REFUSED),
    ):
        session = guarded.join(guarded.keys(who))
        guarded.settle()
        came = int(session.ask("control", b"pause", _JOIN_S) is not None)
        attempts.append(_attempt(who, "commands the network", wanted, came, 1))
        session.close()
    return attempts


def _tokens(guarded: _Guarded) -> list[IntrusionAttempt]:
    """A node says that another is ready; then that other says so itself."""
    watcher = guarded.join(guarded.keys(MONITOR))
    wait = threading.Thread(target=watcher.join, args=(MONITOR, {"1"}), daemon=True)
    wait.start()
    attempts = []
    for node, wanted in ((0, _REFUSED), (1, _DELIVERED)):
        session = guarded.join(guarded.keys(certificate_name(node)))
        session.join("1", ())
        wait.join(2 * guarded.settle())
        tried = "says that node 1 is ready"
        came = int(not wait.is_alive())
        attempts.append(_attempt(certificate_name(node), tried, wanted, came, 1))
        session.close()
    return attempts


def _joiners(guarded: _Guarded, authority: Authority, folder: Path) -> list[IntrusionAttempt]:
    """Guests at the door: right and wrong certificates, none, or no TLS at all."""
    node, day = certificate_name(0), timedelta(days=1)
    stranger = new_authority(1)
    expired = zenoh_settings(authority, *issue(authority, node, ("localhost",), -day))
    # It trusts the real authority, so that only the router can refuse it.
    unknown = zenoh_settings(authority, *issue(stranger, node, ("localhost",), day))
    known = zenoh_settings(authority, *issue(authority, node, ("localhost",), day))
    nameless = zenoh_settings(authority, *issue(authority, "nobody", ("localhost",), day))
    outsider = certificate_name(MAX_NODES)
    numbered = zenoh_settings(authority, *issue(authority, outsider, ("localhost",), day))
    certificate, _ = issue(authority, node, ("localhost",), day)
    _, other_key = issue(authority, node, ("localhost",), day)
    mismatched = zenoh_settings(authority, certificate, other_key)
    bare = {"root_ca_certificate_base64": expired["root_ca_certificate_base64"]}
    guests = [
        # The first shows that the others are refused for what is wrong with them.
        ("new certificate", known, guarded.endpoint, _DELIVERED),
        ("unknown certificate", unknown, guarded.endpoint, _REFUSED),
        ("expired certificate", expired, guarded.endpoint, _REFUSED),
        ("no certificate", bare, guarded.endpoint, _REFUSED),
        ("no TLS", None, guarded.endpoint.replace("tls/", "tcp/"), _REFUSED),
        ("key of another certificate", mismatched, guarded.endpoint, _REFUSED),
        ("unlisted name", nameless, guarded.endpoint, _REFUSED),
        ("number of no node", numbered, guarded.endpoint, _REFUSED),
    ]
    attempts = []
    for who, tls, endpoint, wanted in guests:
        keys = None if tls is None else _keys_file(folder / "guest.json", tls)
        came = _knock(guarded, partial(guarded.join, keys, (), endpoint))
        attempts.append(_attempt(who, "joins, publishes share/0", wanted, came, TRIES))
    return attempts


def _keys_file(path: Path, tls: dict[str, Any]) -> str:
    path.write_bytes(msgspec.json.encode({"transport": {"link": {"tls": tls}}}))
    return str(path)


def _knock(guarded: _Guarded, enter: Callable[[], Transport]) -> int:
    """Return the number of messages that a client without access gets through."""
    try:
        guest = enter()
    except LinkError:
        return 0
    guarded.settle()
    for _ in range(TRIES):
        guest.send("share/0", b"guest")
    came = guarded.arrived().get(("share/0", b"guest"), 0)
    guest.close()
    return came


def _false_router(guarded: _Guarded, folder: Path) -> list[IntrusionAttempt]:
    """Check that a node refuses a router of another authority."""
    stranger = new_authority(1)
    tls = zenoh_settings(
        stranger, *issue(stranger, ROUTER_NAME, ("localhost", LOOPBACK), timedelta(days=1))
    )
    port = free_ports([ROUTER_NAME])[ROUTER_NAME]
    trap = f"tls/{LOOPBACK}:{port}"
    router = start_router(trap, _keys_file(folder / "router.json", tls))
    try:
        guarded.join(guarded.keys(certificate_name(0)), (), trap).close()
        came = 1
    except LinkError:
        came = 0
    finally:
        router.close()
    return [_attempt("false router", "lets node-0 join", _REFUSED, came, 1)]


def check(folder: Path) -> list[IntrusionAttempt]:
    """Make every attempt against a router with the keys in `folder`; takes about half a minute."""
    authority = read_authority(folder)
    guarded = _Guarded(folder)
    attempts: list[IntrusionAttempt] = []
    try:
        with tempfile.TemporaryDirectory() as scratch:
            trials: list[Callable[[], list[IntrusionAttempt]]] = [
                partial(_writers, guarded),
                partial(_reader, guarded),
                partial(_tokens, guarded),
                partial(_commands, guarded),
                partial(_joiners, guarded, authority, Path(scratch)),
                partial(_false_router, guarded, Path(scratch)),
            ]
            with progress("ways to break in", len(trials)) as told:
                for done, trial in enumerate(trials, 1):
                    attempts += trial()
                    told(done)
    finally:
        guarded.close()
    return attempts


def security() -> None:
    """Make keys for two nodes, try to break in, and print the outcome of each attempt."""
    with tempfile.TemporaryDirectory() as folder:
        make_keys(Path(folder), 2, (), 1)
        attempts = check(Path(folder))
    for one in attempts:
        outcome = one.outcome if one.held else f"{one.outcome}: BROKEN, not {one.wanted}"
        say(f"{one.who:28}{one.tried:42}{one.arrived}/{one.tries}  {outcome}")
    sys.exit(0 if all(one.held for one in attempts) else 1)
