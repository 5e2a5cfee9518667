"""Deaths and hangs in a network of processes.

The part kills and restarts random nodes of sixteen in lockstep, and stops them for a while in
real time. In both, it restarts nodes of which a third dies while booting. It prints the cost to the
other nodes, and whether any process or port was left behind.
"""

import os
import signal
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Annotated

import msgspec
import numpy as np
import tyro

from benchmarks.measure import say
from concord.nodes.commands import Restart, Speed
from concord.nodes.tempo import Tempo
from concord.runtime.network.network_file import read_network
from concord.scenarios.setup import Setup
from concord.scenarios.tempo import tempo_of
from tests.laboratory.accounts import account, spread
from tests.laboratory.running import PROC, Running, oscillators

NODES, RATE = 16, 40.0
SHORT_S, LONG_S = 0.3, 2.6
# A process may take this long to end.
LEAVE_S = 10.0


@dataclass(frozen=True)
class KillOptions:
    """How often, and from which seed."""

    kills: int = 300
    """Kills and restarts in lockstep."""
    hangs: int = 100
    """Stops in real time: short ones, and ones beyond the lease."""
    boots: int = 100
    """Restarts in lockstep, and as many in real time; a third of the nodes dies while booting."""
    seed: int = 1
    """Which nodes, when."""
    graph: str = "4-regular"
    """Links of their own where it is sparse; `complete` goes through a router."""


class Network(Running):
    """A network that runs, what is told of it, and when."""

    def __init__(self, setup: Setup, folder: Path, tempo: Tempo | None) -> None:
        super().__init__(setup, "kills", folder, tempo=tempo)
        # When each step began, as a watcher hears it.
        self.heard_s: list[float] = []
        self.client.listen("truth", lambda topic, data: self.heard_s.append(time.monotonic()))
        # Each announced change, with the time at which it was heard.
        self._told: SimpleQueue[tuple[float, dict]] = SimpleQueue()
        self.client.listen("event", self._hear)

    def _hear(self, _topic: str, data: bytes) -> None:
        self._told.put((time.monotonic(), msgspec.json.decode(data)["change"]))

    def await_told(self, what: str, node: int, since_s: float, seconds: float = 60.0) -> float:
        """How long after a time it was told that a node is `gone` or has `joined`."""
        while True:
            try:
                told_s, change = self._told.get(timeout=seconds)
            except Empty:
                raise RuntimeError(f"nobody told in {seconds} s that {node} {what}") from None
            if told_s >= since_s and change["what"] == what and change["node"] == node:
                return told_s - since_s

    def kill(self, node: int) -> float:
        """Kill a node; return how long after that it was told."""
        killed_s = time.monotonic()
        os.kill(self.pids[str(node)], signal.SIGKILL)
        return self.await_told("gone", node, killed_s)

    def restart(self, node: int, delay_s: float | None) -> float:
        """Restart a node; return how long after the last command it joined.

        The node is killed `delay_s` after its first start, and restarted again.
        """
        before, asked_s = self.pids.get(str(node)), time.monotonic()
        self.client.command(Restart(node))
        if delay_s is not None:
            while (pid := self.pids.get(str(node), before)) in (None, before):
                time.sleep(0.002)
            time.sleep(delay_s)
            os.kill(pid, signal.SIGKILL)
            # A node that is on its way is not started again before the launcher sees its death.
            time.sleep(0.5)
            asked_s = time.monotonic()
            self.client.command(Restart(node))
        return self.await_told("joined", node, asked_s)

    def kill_all(self) -> str:
        """End it by the death of its environment; return which processes and sockets are left."""
        pids, connect = list(self.pids.values()), read_network(self.folder).connect
        self.client.close()
        os.kill(self.pids["environment"], signal.SIGKILL)
        self.ended_within(60)
        deadline_s = time.monotonic() + LEAVE_S
        while (left := [pid for pid in pids if (PROC / str(pid)).exists()]) and (
            time.monotonic() < deadline_s
        ):
            time.sleep(0.01)
        # An endpoint is unixsock-stream/PATH.
        taken = [one for one in connect if Path("/", one.partition("/")[2]).exists()]
        return f"processes left {left}, sockets that are still there {taken}"

    def open_files(self) -> dict[str, int]:
        """Return how many files and sockets some processes have open."""
        environment = PROC / str(self.pids["environment"])
        parent = (environment / "stat").read_text().rpartition(")")[2].split()[1]
        watched = {name: self.pids[name] for name in ("environment", "recorder")}
        return {
            name: len(list((PROC / str(pid) / "fd").iterdir()))
            for name, pid in {"launcher process": parent, **watched}.items()
        }


def kill_and_restart(network: Network, count: int, rng: np.random.Generator, boots: bool) -> None:
    """Kill and restart, one after the other; if `boots`, kill a third again while they boot."""
    if not boots:
        network.client.command(Speed(RATE))
    before, gone_s, back_s = network.open_files(), [], []
    for number in range(count):
        node = int(rng.integers(NODES))
        time.sleep(float(rng.uniform(0, 0.1)))
        gone_s.append(network.kill(node))
        dies = boots and number % 3 == 0
        back_s.append(network.restart(node, float(rng.uniform(0, 0.05)) if dies else None))
        if number % 50 == 49:
            sys.stderr.write(f"{number + 1} kills\n")
    after, living, stalls = network.open_files(), len(network.pids), np.diff(network.heard_s)
    left, graph = network.kill_all(), network.setup.scenario.network.graph
    what = "a third killed while booting" if boots else f"lockstep at {RATE:g} steps/s"
    say(f"{count} kills and restarts, {NODES} processes, {graph}, {what}")
    say(f"  told to be gone after {spread(gone_s)} s; back {spread(back_s)} s after the command")
    say(f"  longest time between two steps {max(stalls):.3f} s; processes at the end {living}")
    say(f"  files open before {before}, after {after}; {left}")
    account(network.setup, network.folder, network.tempo)


def hang_in_real_time(network: Network, count: int, rng: np.random.Generator) -> None:
    """Stop and continue, one after the other, half of them beyond the lease."""
    back_s = []
    for number in range(count):
        node = int(rng.integers(NODES))
        pid = network.pids[str(node)]
        is_long = number % 2 == 0
        os.kill(pid, signal.SIGSTOP)
        time.sleep(LONG_S if is_long else SHORT_S)
        continued_s = time.monotonic()
        os.kill(pid, signal.SIGCONT)
        # After a short one it was never out.
        if is_long:
            back_s.append(network.await_told("joined", node, continued_s))
        time.sleep(float(rng.uniform(0, 0.2)))
    stalls = np.diff(network.heard_s)
    left = network.kill_all()
    say(f"{count} hangs of {SHORT_S:g} and {LONG_S:g} s, {NODES} processes, real time")
    say(f"  longest time between two steps {max(stalls):.3f} s; back after {spread(back_s)} s")
    say(f"  {left}")
    account(network.setup, network.folder, network.tempo)


def kills(options: Annotated[KillOptions, tyro.conf.arg(name="")]) -> None:
    """Kill, restart and stop nodes of a network of processes, and print what it cost the others."""
    setup = oscillators(NODES, options.graph, 1_000_000)
    rng = np.random.default_rng(options.seed)
    plays: list[tuple[int, Tempo | None, Callable]] = [
        (options.kills, None, partial(kill_and_restart, boots=False)),
        (options.hangs, tempo_of(setup, None), hang_in_real_time),
        (options.boots, None, partial(kill_and_restart, boots=True)),
        (options.boots, tempo_of(setup, None), partial(kill_and_restart, boots=True)),
    ]
    for count, tempo, play in plays:
        if count:
            with tempfile.TemporaryDirectory() as folder:
                play(Network(setup, Path(folder), tempo), count, rng)
