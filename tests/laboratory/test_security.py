"""Break-in attempts: real sessions with right and wrong certificates on loopback."""

import multiprocessing
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import msgspec
import pytest

pytest.importorskip("cryptography")

from concord.features.hosts.certificates import make_keys
from tests.conftest import ROOT
from tests.laboratory.security import IntrusionAttempt, check
from tests.processes import PROC


def tried(keys: Path) -> list[IntrusionAttempt]:
    """Try in a new process: the first session of a process decides for all on zenoh's threads, and
    a router in a process of one thread does not pass on a message of a megabyte."""
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        return pool.submit(check, keys).result()


@pytest.mark.zenoh
@pytest.mark.slow
@pytest.mark.skipif(not PROC.is_dir(), reason="finds processes in /proc, which is not there")
def test_nobody_gets_in_and_a_hole_is_found(tmp_path: Path):
    keys = tmp_path / "keys"
    make_keys(keys, 2, (), 1)
    outcomes = {(one.who, one.tried): one.outcome for one in tried(keys)}
    assert outcomes == {
        ("node-0", "publishes its own keys"): "delivered",
        ("node-0", "publishes a share too long for a frame"): "refused",
        ("node-0", "publishes an estimate of more than 1 MiB"): "refused",
        ("node-0", "publishes another node's keys"): "refused",
        ("node-0", "publishes the environment's keys"): "refused",
        ("monitor", "publishes a node's keys"): "refused",
        ("monitor", "publishes the environment's keys"): "refused",
        ("monitor", "hears a node's shares"): "delivered",
        ("node-0", "says that node 1 is ready"): "refused",
        ("node-1", "says that node 1 is ready"): "delivered",
        ("operator", "commands the network"): "delivered",
        ("monitor", "commands the network"): "refused",
        ("node-0", "commands the network"): "refused",
        ("new certificate", "joins, publishes share/0"): "delivered",
        ("unknown certificate", "joins, publishes share/0"): "refused",
        ("expired certificate", "joins, publishes share/0"): "refused",
        ("no certificate", "joins, publishes share/0"): "refused",
        ("no TLS", "joins, publishes share/0"): "refused",
        ("key of another certificate", "joins, publishes share/0"): "refused",
        ("unlisted name", "joins, publishes share/0"): "refused",
        ("number of no node", "joins, publishes share/0"): "refused",
        ("false router", "lets node-0 join"): "refused",
    }

    # The page on security shows the printed outcomes.
    page = (ROOT / "docs" / "security.md").read_text()
    rows = [line.strip("| ").split(" | ") for line in page.splitlines() if line.startswith("| ")]
    shown = {(row[0], row[1]): row[2] for row in rows if row[-1] in ("delivered", "refused")}
    assert shown == outcomes

    # The same without access control and limits: certificates still hold, and what leaks is said.
    router = keys / "router.json"
    config = msgspec.json.decode(router.read_bytes())
    config["access_control"]["enabled"] = False
    config.pop("low_pass_filter")
    router.write_bytes(msgspec.json.encode(config))
    broken = {(one.who, one.tried) for one in tried(keys) if not one.held}
    assert ("node-0", "publishes a share too long for a frame") in broken
    assert ("node-0", "publishes another node's keys") in broken
    assert ("monitor", "publishes the environment's keys") in broken
    assert ("monitor", "commands the network") in broken
    assert ("node-0", "publishes an estimate of more than 1 MiB") in broken
    assert ("unlisted name", "joins, publishes share/0") in broken
    assert ("number of no node", "joins, publishes share/0") in broken
    assert not {who for who, _ in broken} & {"expired certificate", "no TLS", "false router"}
