"""Which process of a network is on which host: `hosts.toml`, checked against the setup."""

import re
import tomllib
from collections import Counter
from pathlib import Path

import msgspec

from concord.features.hosts.host_place import key_files, read_setup
from concord.runtime.network.links import ENVIRONMENT, RECORDER, checked_endpoints, key_file

SETUP, KEYS = "setup.json", "keys"
TRUST = ("--trust", SETUP)
"""Here the setup was found to be the user's own, which the other hosts cannot know."""
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]*")
_DESTINATION = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.:@-]*")


class Host(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A host as the file describes it.

    Attributes:
        address: where the other hosts reach its router.
        nodes: the nodes that run on it.
        port: the port of its router.
        ssh: the destination of ssh, such as user@alpha; `address` where it is empty.
        concord: the program on that host.
    """

    address: str
    nodes: tuple[int, ...] = ()
    port: int = 7447
    ssh: str = ""
    concord: str = "concord"


class _File(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The whole file; `setup` and `keys` are paths beside it, `environment` is a host's name."""

    hosts: dict[str, Host]
    setup: str = SETUP
    keys: str = ""
    environment: str = ""


class Process(msgspec.Struct, frozen=True):
    """A command of concord on a host, with the name under which the log shows it.

    `words` follow the program; its files are in the folder where the command runs.
    """

    host: str
    name: str
    words: tuple[str, ...]


class NetworkPlan(msgspec.Struct, frozen=True):
    """The network of a hosts file.

    Attributes:
        run: the name of the run.
        nodes: how many nodes it has.
        hosts: the hosts by name, in the order of the file.
        environment: the host of environment and recorder.
        setup: the file of `concord setup` on this machine.
        keys: the files of `concord keys` that each host needs, that of its router first; none where
            the network has no keys.
    """

    run: str
    nodes: int
    hosts: dict[str, Host]
    environment: str
    setup: Path
    keys: dict[str, tuple[Path, ...]]

    @property
    def has_keys(self) -> bool:
        """Whether the processes identify themselves."""
        return any(self.keys.values())

    def endpoint(self, host: str) -> str:
        """Return where the router of a host listens."""
        scheme = "tls" if self.has_keys else "tcp"
        return f"{scheme}/{self.hosts[host].address}:{self.hosts[host].port}"

    def routers_before(self, host: str) -> list[str]:
        """Return the routers to which that of a host connects: each pair needs one link."""
        names = list(self.hosts)
        return [self.endpoint(name) for name in names[: names.index(host)]]

    def router(self, host: str) -> Process:
        """Return the router of a host."""
        others = self.routers_before(host)
        connect = ("--connect", *others) if others else ()
        keys = ("--keys", f"{KEYS}/{self.keys[host][0].name}") if self.has_keys else ()
        return Process(host, "router", ("router", "--listen", self.endpoint(host), *connect, *keys))

    def environment_process(self, out: str, *more: str) -> Process:
        """Return environment and recorder, whose results are in the folder `out` of their host."""
        joins = self._joins(self.environment)
        words = ("environment", SETUP, *TRUST, *joins, "--out", out, *more)
        return Process(self.environment, ENVIRONMENT, words)

    def node(self, host: str, *nodes: int) -> Process:
        """Return the command of some nodes of a host."""
        numbers = tuple(map(str, nodes))
        name = f"node {' '.join(numbers)}"
        return Process(host, name, ("node", SETUP, *numbers, *TRUST, *self._joins(host)))

    def _joins(self, host: str) -> tuple[str, ...]:
        keys = ("--keys", KEYS) if self.has_keys else ()
        return ("--connect", self.endpoint(host), *keys)


def read_plan(file: Path) -> NetworkPlan:
    """Return the network that a hosts file describes.

    Raises:
        ValueError: the file, its setup or its keys cannot be read, or do not fit each other.
    """
    try:
        read = msgspec.convert(tomllib.loads(file.read_text(encoding="utf-8")), _File)
    except OSError as error:
        raise ValueError(f"{file}: cannot be read ({error.strerror}); docs/deployment.md shows "
                         "such a file") from None  # fmt: skip
    except (tomllib.TOMLDecodeError, UnicodeError, msgspec.ValidationError) as error:
        raise ValueError(
            f"{file}: not a file of hosts ({error}); docs/deployment.md shows one"
        ) from None
    if not read.hosts:
        raise ValueError(f"{file}: it has no host; add a table such as [hosts.alpha]")
    description = read_setup(file.parent / read.setup)
    nodes = description.setup.scenario.nodes
    environment = read.environment or next(iter(read.hosts))
    if environment not in read.hosts:
        raise ValueError(
            f"{file}: environment {environment!r} is no host; choose one of {', '.join(read.hosts)}"
        )
    for name, host in read.hosts.items():
        if not (_NAME.fullmatch(name) and _DESTINATION.fullmatch(host.ssh or host.address)):
            raise ValueError(
                f"{file}: host {name!r}: its name and its destination of ssh have letters, digits, "
                "'.', '_' and '-' alone, with '@' and ':' in the destination; rename it"
            )
        endpoint = f"tcp/{host.address}:{host.port}"
        checked_endpoints(f"{file}: host {name}:", [endpoint], False)
    _check_nodes(file, read.hosts, nodes)
    folder = file.parent / read.keys if read.keys else None
    keys = {
        name: _keys_of(folder, host, name == environment, len(read.hosts))
        for name, host in read.hosts.items()
    }
    return NetworkPlan(
        description.run, nodes, read.hosts, environment, file.parent / read.setup, keys
    )


def _check_nodes(file: Path, hosts: dict[str, Host], count: int) -> None:
    """Refuse a network in which a node is nowhere, twice or unknown."""
    named = Counter(node for host in hosts.values() for node in host.nodes)
    expected = Counter(range(count))
    for wrong, words in (
        (named - expected, f"is named twice or unknown; name each of 0 to {count - 1} once"),
        (expected - named, "is on no host; add it to the nodes of one"),
    ):
        if wrong:
            raise ValueError(f"{file}: node {min(wrong)} {words}")


def _keys_of(
    folder: Path | None, host: Host, has_environment: bool, hosts: int
) -> tuple[Path, ...]:
    """Return the files of `concord keys` for a host, that of its router first."""
    if folder is None:
        return ()
    alone = folder / "router.json"
    own = alone if hosts == 1 and alone.is_file() else folder / f"router-{host.address}.json"
    router = key_file(own, f"give {host.address} to `concord keys --hosts`")
    cast = [*((ENVIRONMENT, RECORDER) if has_environment else ()), *map(str, host.nodes)]
    return tuple(map(Path, (router, *key_files(folder, cast).values())))
