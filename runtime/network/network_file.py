"""Addresses of a network of processes, written by the launcher for subscribers."""

from pathlib import Path

import msgspec

from concord.runtime.disk import writing
from concord.runtime.json_file import read_json

NETWORK = "network.json"


class NetworkAddresses(msgspec.Struct, frozen=True):
    """Addresses of a network: subscribers connect to all of `connect`; `pids` are processes."""

    run: str
    connect: list[str]
    pids: dict[str, int] = {}


def write_network(folder: Path, network: NetworkAddresses) -> None:
    """Write network.json whole, over an older one."""
    unfinished = folder / f"{NETWORK}.part"
    with writing(folder / NETWORK):
        unfinished.write_bytes(msgspec.json.format(msgspec.json.encode(network), indent=2) + b"\n")
        unfinished.rename(folder / NETWORK)


def read_network(folder: Path) -> NetworkAddresses:
    """Where the network of a run folder is, or was.

    Raises:
        ValueError: the folder says nothing of it.
    """
    cure = "name the folder of a run with --driver processes that has not ended"
    return read_json(folder / NETWORK, NetworkAddresses, cure, "not what a launcher has written")
