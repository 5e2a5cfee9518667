"""Strangers and a dishonest member at a network whose processes have keys."""

from collections import Counter
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from concord.bus.flexray.share_frames import SHARE_FRAMES
from concord.experiments.__main__ import main
from concord.features.hosts.access_control import ROUTER_NAME, certificate_name
from concord.results.folder import read_description
from concord.runtime.drivers import in_memory
from concord.runtime.network.links import ZenohEndpoints, free_ports
from concord.runtime.network.zenoh_transport import LinkError, Transport
from concord.runtime.recorded import meaning
from concord.runtime.recording import read_recording
from tests.features.hosts.hosts import hosts
from tests.features.hosts.test_hosts import await_network, needs_proc, write_setup
from tests.laboratory.fuzz import REFUSED, believed
from tests.laboratory.intruder import BID, CUT, END, GONE, GRANT, LOST, WELCOME
from tests.laboratory.malformed import DAMAGED, JSON, malformed
from tests.processes import PATIENCE_S, holds_within

NODES, INSIDER, EACH = 4, 3, 600
FINISHED = b'{"step":0,"members":[]}'
# Each message is well-formed and reserved to one publisher; it would stop, mislead or end a run.
LIES = (
    ("end", END), ("finished", FINISHED), ("gone", GONE), ("gone/0", b'{"what":"gone","node":0}'),
    ("gone/1", GONE), ("event", CUT), ("grant", GRANT), ("welcome/0", WELCOME),
    ("measured/0", b'{"node":0,"step":1,"readings":[[1e9]]}'), ("truth", b'{"step":1,"state":[]}'),
    ("bid/1", BID), ("unreachable/1", LOST), ("recorded/1", END), ("hello/1", b"0" * 64),
)  # fmt: skip


def tell(transport: Transport, sound: dict[str, bytes]) -> None:
    """Garbage on what is the insider's own, and the lies."""
    rng = np.random.default_rng(5)
    for number in range(EACH):
        for topic, data in LIES:
            transport.send(topic, data)
        for topic, whole in sound.items():
            ways = DAMAGED if topic.startswith("share") else JSON
            transport.send(topic, malformed(number, ways, whole, rng))


@needs_proc
@pytest.mark.zenoh
def test_who_has_no_key_says_nothing_and_a_member_no_word_of_others(tmp_path: Path):
    """Garbage of a member is counted; of its lies in other names nothing arrives."""
    pytest.importorskip("cryptography", reason="the extra secure makes certificates")
    keys = tmp_path / "keys"
    main(["keys", str(keys), "--nodes", str(NODES)])
    port = free_ports([ROUTER_NAME])[ROUTER_NAME]
    endpoint, plain = f"tls/localhost:{port}", f"tcp/localhost:{port}"
    key = str(keys / f"{certificate_name(INSIDER)}.json")
    own = {
        f"share/{INSIDER}": bytes(60), f"estimate/{INSIDER}": LOST, f"bid/{INSIDER}": BID,
        f"hello/{INSIDER}": LOST, f"unreachable/{INSIDER}": LOST,
    }  # fmt: skip
    setup = write_setup(tmp_path)
    with hosts(tmp_path) as there:
        router = there.concord("router", "--listen", endpoint, "--keys", keys / "router.json")
        router.await_line("router at")
        joining = ("--connect", endpoint, "--keys", keys)
        there.concord("node", setup, 0, 1, 2, *joining)
        environment = there.concord(
            "environment", setup, *joining, "--out", tmp_path / "run", "--json"
        )
        await_network(endpoint, str(keys / "operator.json")).close()
        for where in (endpoint, plain):
            with suppress(LinkError):
                stranger = Transport("hosts", ZenohEndpoints("client", (), (where,), 1.0), [], 1)
                tell(stranger, own)
                stranger.close()
        insider = Transport("hosts", ZenohEndpoints("client", (), (endpoint,), 5.0, key), [], 1)
        tell(insider, own)
        there.concord("node", setup, INSIDER, *joining)
        code, out, err = environment.end(60)
        insider.close()
        assert (code, out[:1]) == (0, "{"), err
        assert "Traceback" not in err
    description = read_description(tmp_path / "run")
    recorded = list(read_recording(tmp_path / "run" / "run.mcap"))
    alone, quiet = believed(in_memory(description.setup), NODES)
    several, counters = believed(recorded, NODES)
    assert several == alone
    for node in description.setup.neighbours[INSIDER]:
        told = counters[str(node)] - quiet[str(node)]
        assert sum(n for name, n in told.items() if name.startswith(REFUSED)) == EACH
    came = Counter(
        topic for topic, data in recorded if meaning(topic, data, NODES, SHARE_FRAMES) is None
    )
    assert came == {topic: EACH for topic in own if not topic.startswith("hello")}


@needs_proc
@pytest.mark.zenoh
def test_a_lie_that_ends_a_network_without_keys_leaves_a_sentence(tmp_path: Path):
    """The message comes before the first step in the environment's name; only keys reveal it."""
    setup = write_setup(tmp_path)
    with hosts(tmp_path) as there:
        endpoint = f"tcp/localhost:{free_ports([ROUTER_NAME])[ROUTER_NAME]}"
        there.router(endpoint)
        there.concord("node", setup, 0, 1, 2, "--connect", endpoint)
        environment = there.concord(
            "environment", setup, "--connect", endpoint, "--out", tmp_path / "run"
        )
        await_network(endpoint).close()
        stranger = Transport("hosts", ZenohEndpoints("client", (), (endpoint,), 5.0), [], 1)

        def ended() -> bool:
            """The stranger says it again: the recorder may not have listened yet."""
            stranger.send("finished", FINISHED)
            return environment.process.poll() is not None

        # It ends when the recorder has gone, or when the environment has died of that.
        assert holds_within(PATIENCE_S, ended)
        code, _, err = environment.end()
        stranger.close()
    assert code != 0
    assert "Traceback" not in err, err
