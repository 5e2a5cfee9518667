"""Three hosts with addresses of their own: cut apart for five seconds, and healed."""

import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from concord.experiments.__main__ import main
from concord.nodes.changes import Event, Gone, Joined
from concord.nodes.messages import decode
from concord.results.folder import read_description
from concord.results.records.trace import Trace
from concord.runtime.recording import read_recording
from tests.experiments.support import trace_of
from tests.features.hosts.hosts import hosts
from tests.namespaces import Lan, lan
from tests.processes import PROC, Family, family, holds_within

pytestmark = [
    pytest.mark.zenoh,
    pytest.mark.slow,
    pytest.mark.skipif(not PROC.is_dir(), reason="finds processes in /proc, which is not there"),
]
CUT_S = 5.0
STEPS = 260
FAR = (2, 3, 4, 5)
LISTENER = """
import sys
from concord.runtime.network.links import links_to_routers
from concord.runtime.network.zenoh_transport import Transport
heard = Transport("hosts", links_to_routers([sys.argv[1]], None), ["estimate/*"], 4096)
print("listening", flush=True)
while True:
    message = heard.receive("estimate/*")
    if message:
        print(message[0].partition("/")[2], message[1].decode(), flush=True)
"""


class Ear:
    """Listener at one host: the latest step of each node whose estimates it receives."""

    def __init__(self, process: Family) -> None:
        self.steps: dict[int, int] = {}
        self._process = process
        threading.Thread(target=self._listen, daemon=True).start()

    def _listen(self) -> None:
        stream = self._process.process.stdout
        assert stream is not None
        for line in stream:
            node, _, message = line.partition(" ")
            if node.isdecimal():
                self.steps[int(node)] = decode(f"estimate/{node}", message.encode()).step


@contextmanager
def network(folder: Path, there: Lan, *words: str) -> Iterator[tuple[Family, Ear]]:
    """World, recorder and two nodes on a, two on b, two on c; its environment, and an ear on b."""
    setup = folder / "setup.json"
    scenario = ("--scenario", "oscillator", "--nodes", "6", "--graph", "ring")
    main(["setup", *scenario, "--out", str(setup), "--name", "hosts", *words])
    a, b, c = map(there.endpoint, "abc")
    with hosts(folder) as started:
        started.router(a, prefix=there.at("a"))
        started.router(b, a, prefix=there.at("b"))
        started.router(c, a, b, prefix=there.at("c"))
        for nodes, host in (((0, 1), "a"), ((2, 3), "b"), ((4, 5), "c")):
            connect = ("--connect", there.endpoint(host))
            started.concord("node", setup, *nodes, *connect, prefix=there.at(host))
        listen = (*there.at("b"), sys.executable, "-c", LISTENER, b)
        with family(listen, folder) as listener:
            out = ("--connect", a, "--out", folder / "run", "--json")
            yield started.concord("environment", setup, *out, prefix=there.at("a")), Ear(listener)


def told(folder: Path) -> list[Event]:
    recorded = read_recording(folder / "run" / "run.mcap")
    return [decode(topic, data) for topic, data in recorded if topic == "event"]


def disagreement(trace: Trace, steps: slice) -> float:
    """Root mean square distance of the nodes from their mean."""
    mean = trace.mean[steps]
    return float(np.sqrt(np.nanmean((mean - np.nanmean(mean, axis=1, keepdims=True)) ** 2)))


def says_what_it_left_out(trace: Trace, node: int, steps: slice) -> bool:
    """Whether a node estimated every step, or counted that it was too far behind for some."""
    complete = not np.isnan(trace.mean[steps, node]).any()
    return complete or trace.counters[node].get("skipped ahead", 0) > 0


def cut_and_heal(there: Lan, ear: Ear) -> tuple[dict[int, int], dict[int, int]]:
    """Return the last step of each node that b heard at the cut, and at the end of the cut."""
    assert holds_within(120, lambda: len(ear.steps) == 6 and min(ear.steps.values()) > 60), (
        ear.steps
    )
    there.pull("a")
    time.sleep(0.5)
    cut = dict(ear.steps)
    time.sleep(CUT_S - 0.5)
    healed = dict(ear.steps)
    there.plug("a")
    return cut, healed


def test_in_real_time_both_sides_go_on_and_agree_again(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    """A step lasts a tenth of a second here."""
    words = ("--driver", "realtime", "--steps", str(STEPS))
    with lan("abc") as there, network(tmp_path, there, *words) as (environment, ear):
        cut, healed = cut_and_heal(there, ear)
        code, _, err = environment.end(90)
    assert code == 0, err
    setup = read_description(tmp_path / "run").setup
    trace = trace_of(setup, tmp_path / "run" / "run.mcap")
    # The far side, which hears of no environment, goes on estimating, step by step.
    progress = {node: healed[node] - cut[node] for node in range(6)}
    assert all(progress[node] > 25 for node in FAR), progress
    assert all(progress[node] < 5 for node in (0, 1)), progress
    assert trace.steps == STEPS
    assert all(says_what_it_left_out(trace, node, slice(None)) for node in (0, 1))
    events = told(tmp_path)
    gone = {e.change.node: e.step for e in events if isinstance(e.change, Gone)}
    back = {e.change.node: e.step for e in events if isinstance(e.change, Joined)}
    assert set(gone) == set(back) == set(FAR)
    later = slice(max(back.values()) + 1, None)
    assert all(says_what_it_left_out(trace, node, later) for node in FAR)
    before = disagreement(trace, slice(20, 50))
    after = disagreement(trace, slice(STEPS - 30, STEPS))
    assert after < 2 * before
    with capsys.disabled():
        healed_at = max(healed[node] for node in FAR)
        sys.stdout.write(
            f"\npartition of 3 hosts for {CUT_S:g} s, real time: far side estimated "
            f"{min(progress[j] for j in FAR)} steps meanwhile; given up at steps "
            f"{min(gone.values())}..{max(gone.values())}, healed at step {healed_at}, back at "
            f"{min(back.values())}..{max(back.values())}; disagreement before {before:.3g}, "
            f"after {after:.3g}\n"
        )


def test_in_lockstep_the_worlds_side_goes_on_and_the_others_come_back(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    with lan("abc") as there, network(tmp_path, there, "--steps", "100000") as (_, ear):
        cut, healed = cut_and_heal(there, ear)
        assert all(healed[node] - cut[node] < 5 for node in FAR), (cut, healed)
        began = time.monotonic()
        assert holds_within(40, lambda: min(ear.steps.values()) > max(healed.values()) + 20)
        back_s = time.monotonic() - began
        together = max(ear.steps.values())
        assert holds_within(40, lambda: min(ear.steps.values()) > together + 20)
    # The environment was killed with all other processes: the recording can be read.
    setup = read_description(tmp_path / "run").setup
    trace = trace_of(setup, tmp_path / "run" / "run.mcap")
    out = np.isnan(trace.mean[:, :, 0])
    assert not out[:, [0, 1]].any()
    assert out[:, FAR].any(axis=0).all()
    assert not out[-5:].any()
    assert disagreement(trace, slice(-5, None)) < 2 * disagreement(trace, slice(10, 50))
    with capsys.disabled():
        steps = int(out.sum(axis=0).max())
        sys.stdout.write(
            f"\npartition of 3 hosts for {CUT_S:g} s, lockstep: all estimate again "
            f"{back_s:.1f} s after the heal; {steps} steps without a far node\n"
        )


def test_a_network_bears_delay(tmp_path: Path):
    """Twenty milliseconds each way, in lockstep: slow, and the same bits."""
    with lan("abc") as there:
        if not all(there.delay(host, 20) for host in "bc"):
            pytest.skip("tc netem: this kernel has no network emulation (sch_netem)")
        with network(tmp_path, there, "--steps", "20") as (environment, _):
            code, _, err = environment.end(90)
    assert code == 0, err
    assert (
        trace_of(read_description(tmp_path / "run").setup, tmp_path / "run" / "run.mcap").steps
        == 20
    )
