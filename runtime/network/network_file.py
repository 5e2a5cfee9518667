"""Addresses of a network of processes, written by the launcher for subscribers."""

from pathlib import Path

import msgspec

from concord.runtime.json_file import read_json, write_json

NETWORK = "network.json"


class NetworkAddresses(msgspec.Struct, frozen=True):
    """Addresses of a network: subscribers connect to all of `connect`; `pids` are processes."""

    run: str
    connect: list[str]
    pids: dict[str, int] = {}


def write_network(folder: Path, network: NetworkAddresses) -> None:
    """Write network.json whole, over an older one."""
    write_json(folder / NETWORK, network)


def read_network(folder: Path) -> NetworkAddresses:
    """Where the network of a run folder is, or was.

    Raises:
        ValueError: the folder says nothing of it.
    """
    cure = "name the folder of a run with --driver processes that has not ended"
    return read_json(folder / NETWORK, NetworkAddresses, cure, "not what a launcher has written")
