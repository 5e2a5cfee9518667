"""The zenoh links between the processes of one run, on one machine or several, as data."""

import re
import socket
import stat
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

ENVIRONMENT, RECORDER, ROUTER = "environment", "recorder", "router"
# Where the recorder lets others hear what it has recorded.
WATCH = "watch"
LOOPBACK = "127.0.0.1"
# Beyond this many neighbours on average a router moves the same messages with fewer sockets.
MESH_DEGREE_LIMIT = 8
# How long a process on one of several hosts looks for its router.
ROUTER_S = 30.0
_SOCKET = re.compile(r"unixsock-stream/[A-Za-z0-9/._-]+")
_ENDPOINT = re.compile(r"(tcp|tls)/(\[[0-9A-Fa-f:.]+\]|[A-Za-z0-9][A-Za-z0-9.-]*):([0-9]{1,5})")
_RUN = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}")


class ZenohEndpoints(NamedTuple):
    """How one process joins: zenoh mode and endpoints such as tcp/127.0.0.1:7447.

    Joining fails when an endpoint does not answer within `connect_s`; with None it succeeds at
    once, whoever is there, and goes on trying to reach the others. `keys` is the file that
    `concord keys` made for this process, for endpoints such as tls/localhost:7447.
    """

    mode: str
    listen: tuple[str, ...]
    connect: tuple[str, ...]
    connect_s: float | None = 60.0
    keys: str | None = None


def wants_router(neighbours: Sequence[Sequence[int]]) -> bool:
    """Whether the graph is too dense for one link per edge."""
    return sum(map(len, neighbours)) > MESH_DEGREE_LIMIT * len(neighbours)


def peers_of(node: int, neighbours: Sequence[Sequence[int]]) -> list[int]:
    """Whom a node hears or is heard by, ascending: a link carries frames both ways."""
    return [j for j, heard in enumerate(neighbours) if j in neighbours[node] or node in heard]


def names(neighbours: Sequence[Sequence[int]]) -> list[str]:
    """The processes that listen, in the order in which they are given ports."""
    if wants_router(neighbours):
        return [ROUTER, WATCH]
    return [ENVIRONMENT, RECORDER, *(str(node) for node in range(len(neighbours))), WATCH]


def plan_links(
    neighbours: Sequence[Sequence[int]], at: dict[str, str]
) -> dict[str, ZenohEndpoints]:
    """Return the links of every process of a run, by name; `at` has the endpoints of `names`.

    Mesh: one link per edge, opened by the higher index; all nodes link to environment and recorder.
    Router: every process is its client.
    """
    everyone = [ENVIRONMENT, RECORDER, *(str(node) for node in range(len(neighbours)))]
    watch = {WATCH: ZenohEndpoints("peer", (at[WATCH],), ())}
    if ROUTER in at:
        return {**watch, **{name: ZenohEndpoints("client", (), (at[ROUTER],)) for name in everyone}}
    links = {
        **watch,
        RECORDER: ZenohEndpoints("peer", (at[RECORDER],), ()),
        ENVIRONMENT: ZenohEndpoints("peer", (at[ENVIRONMENT],), (at[RECORDER],)),
    }
    for node in range(len(neighbours)):
        lower = tuple(at[str(j)] for j in peers_of(node, neighbours) if j < node)
        connect = (at[ENVIRONMENT], at[RECORDER], *lower)
        links[str(node)] = ZenohEndpoints("peer", (at[str(node)],), connect)
    return links


def endpoints_below(links: dict[str, ZenohEndpoints], node: int) -> dict[int, str]:
    """Where the nodes below one listen in a mesh, to which it would open a link."""
    below = {j: links[str(j)].listen for j in range(node) if str(j) in links}
    return {j: listen[0] for j, listen in below.items() if listen}


def links_to_routers(connect: Sequence[str], keys: str | None) -> ZenohEndpoints:
    """How a process on one of several hosts joins: through the first router that answers."""
    return ZenohEndpoints("client", (), tuple(connect), ROUTER_S, keys)


def checked_endpoints(option: str, endpoints: Sequence[str], has_keys: bool) -> tuple[str, ...]:
    """Endpoints such as tcp/10.0.0.1:7447 that a user has given for an option.

    Raises:
        ValueError: there is none, one is no endpoint, or keys and TLS do not go together.
    """
    if not endpoints:
        raise ValueError(f"{option}: there is no endpoint; give one such as tcp/10.0.0.1:7447")
    for endpoint in endpoints:
        if _SOCKET.fullmatch(endpoint) and not has_keys:
            continue
        parts = _ENDPOINT.fullmatch(endpoint)
        if parts is None or not 1 <= int(parts[3]) <= 65535:
            raise ValueError(
                f"{option} {endpoint}: not an endpoint; write tcp/HOST:PORT or tls/HOST:PORT with "
                "a port from 1 to 65535"
            )
        if has_keys != (parts[1] == "tls"):
            cure = "write tls/HOST:PORT" if has_keys else "give --keys, or write tcp/HOST:PORT"
            raise ValueError(
                f"{option} {endpoint}: keys are shown over TLS and nowhere else; {cure}"
            )
    return tuple(endpoints)


def watcher_keys(file: Path | None, connect: Sequence[str]) -> str | None:
    """The file of `concord keys` of somebody who looks on, for these endpoints.

    Raises:
        ValueError: there is none, or endpoints and keys do not go together.
    """
    checked_endpoints("--connect", connect, file is not None)
    if file is None:
        return None
    return key_file(file, "name the monitor.json or operator.json that `concord keys` made")


def key_file(file: Path, cure: str) -> str:
    """The path of a file of `concord keys`, which other users of this machine cannot read or write.

    Raises:
        ValueError: there is none, which `cure` mends, or other users have access to it.
    """
    if not file.is_file():
        raise ValueError(f"--keys {file}: no such file; {cure}")
    check_private(file)
    return str(file)


def check_private(file: Path) -> None:
    """Refuse a secret file that users outside its group can read or write.

    Raises:
        ValueError: naming the file, its mode and the cure.
    """
    mode = stat.S_IMODE(file.stat().st_mode)
    if mode & stat.S_IRWXO:
        raise ValueError(
            f"{file}: a key that every user of this machine can read or write (mode {mode:04o}); "
            f"run chmod 600 {file}, and make new keys if others may have seen it"
        )


def checked_run(run: str) -> str:
    """The name of a run, which is a part of every zenoh key.

    Raises:
        ValueError: it is none.
    """
    if not _RUN.fullmatch(run):
        raise ValueError(
            f"run {run!r}: a name has 1 to 100 letters, digits, '.', '_' or '-' and begins with a "
            "letter or digit; choose another"
        )
    return run


def subscribers_endpoints(at: dict[str, str]) -> list[str]:
    """Where a watcher connects to: what is recorded, and who answers."""
    return [at[WATCH], at[ROUTER if ROUTER in at else ENVIRONMENT]]


def on_loopback(ports: dict[str, int]) -> dict[str, str]:
    """Return the endpoint of each loopback port."""
    return {name: f"tcp/{LOOPBACK}:{port}" for name, port in ports.items()}


def free_ports(names: Sequence[str]) -> dict[str, int]:
    """A free loopback port for each name.

    Another program may take one before we listen on it; the launcher process tries again then.
    """
    sockets = [socket.socket(socket.AF_INET, socket.SOCK_STREAM) for _ in names]
    try:
        for one in sockets:
            one.bind((LOOPBACK, 0))
        return {name: one.getsockname()[1] for name, one in zip(names, sockets, strict=True)}
    finally:
        for one in sockets:
            one.close()


def ports_from(first: int, names: Sequence[str]) -> dict[str, int]:
    """Consecutive ports beginning with the user's choice.

    Raises:
        ValueError: a port is out of range or in use.
    """
    last = first + len(names) - 1
    if first < 1024 or last > 65535:
        raise ValueError(
            f"--port {first}: the run needs ports {first} to {last}, which must lie in "
            "1024..65535; choose another first port or leave --port out"
        )
    for port in range(first, last + 1):
        with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind((LOOPBACK, port))
            except OSError as error:
                raise ValueError(
                    f"--port {first}: port {port} is in use ({error.strerror}); choose another "
                    "first port, or leave --port out to have free ones chosen"
                ) from None
    return dict(zip(names, range(first, last + 1), strict=True))
