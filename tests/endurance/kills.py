"""Deaths and hangs in a network of processes: `python -m tests.endurance.kills`.

The script kills and restarts random nodes of sixteen in lockstep, and stops them for a while in
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

import msgspec
import numpy as np
import tyro

from benchmarks.measure import say
from concord.nodes.commands import Restart, Speed
from concord.nodes.tempo import Tempo
from concord.runtime.network.network_file import read_network
from concord.scenarios.catalogue import definition_named
from concord.scenarios.preparation import prepare
from concord.scenarios.setup import Setup
from concord.scenarios.tempo import tempo_of
from tests.endurance.accounts import account, spread
from tests.endurance.running import PROC, Running

NODES, RATE = 16, 40.0
SHORT_S, LONG_S = 0.3, 2.6
# A process may take this long to end.
LEAVE_S = 10.0


@dataclass(frozen=True)
class Options:
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


class Network:
    """A network that runs, what is told of it, and when."""

    def __init__(self, setup: Setup, folder: Path, tempo: Tempo | None) -> None:
        self.setup, self.folder = setup, folder
        self._running = Running(setup, "kills", folder, tempo=tempo)
        self.client = self._running.client
        # When each step began, as a watcher hears it.
        self.heard_s: list[float] = []
        self.client.listen("truth", lambda topic, data: self.heard_s.append(time.monotonic()))
        # Each announced change, with the time at which it was heard.
        self._told: SimpleQueue[tuple[float, dict]] = SimpleQueue()
        self.client.listen("event", self._hear)

    def _hear(self, _topic: str, data: bytes) -> None:
        self._told.put((time.monotonic(), msgspec.json.decode(data)["change"]))

    @property
    def pids(self) -> dict[str, int]:
        """Those that live, as the launcher says."""
        return self._running.pids

    def await_told(self, what: str, node: int, since_s: float, seconds: float = 60.0) -> float:
        """How long after a time it was told that a node is `gone` or has `joined`."""
        while True:
            try:
                told_s, change = self._told.get(timeout=seconds)
            except Empty:
                raise RuntimeError(f"nobody told in {seconds} s that {node} {what}") from None
            if told_s >= since_s and change["what"] == what and change["node"] == node:
                return told_s - since_s

    def end(self) -> str:
        """End it by the death of its environment; return which processes and sockets are left."""
        pids, connect = list(self.pids.values()), read_network(self.folder).connect
        self.client.close()
        os.kill(self.pids["environment"], signal.SIGKILL)
        self._running.ended_within(60)
        deadline_s = time.monotonic() + LEAVE_S
        while (left := [pid for pid in pids if lives(pid)]) and time.monotonic() < deadline_s:
            time.sleep(0.01)
        taken = [endpoint for endpoint in connect if listens(endpoint)]
        return f"processes left {left}, sockets that are still there {taken}"


def lives(pid: int) -> bool:
    """Whether a process is there."""
    return (PROC / str(pid)).exists()


def listens(endpoint: str) -> bool:
    """Return whether the socket at unixsock-stream/PATH is still there."""
    return Path("/", endpoint.partition("/")[2]).exists()


def open_files(pids: dict[str, int], names: tuple[str, ...]) -> dict[str, int]:
    """How many files and sockets these processes have open."""
    return {name: len(list((PROC / str(pids[name]) / "fd").iterdir())) for name in names}


def launcher_process_of(pids: dict[str, int]) -> int:
    """The parent of all."""
    return int((PROC / str(pids["environment"]) / "stat").read_text().rpartition(")")[2].split()[1])


def kill_in_lockstep(network: Network, count: int, rng: np.random.Generator) -> None:
    """Kill and restart, one after the other."""
    client = network.client
    client.command(Speed(RATE))
    pids = network.pids
    family = {**pids, "launcher process": launcher_process_of(pids)}
    watched = ("launcher process", "environment", "recorder")
    before = open_files(family, watched)
    gone_s, back_s = [], []
    for number in range(count):
        node = int(rng.integers(NODES))
        time.sleep(float(rng.uniform(0, 0.1)))
        pid, killed_s = network.pids[str(node)], time.monotonic()
        os.kill(pid, signal.SIGKILL)
        gone_s.append(network.await_told("gone", node, killed_s))
        asked_s = time.monotonic()
        client.command(Restart(node))
        back_s.append(network.await_told("joined", node, asked_s))
        if number % 50 == 49:
            sys.stderr.write(f"{number + 1} kills\n")
    after = open_files(family, watched)
    living = sorted(network.pids)
    stalls = np.diff(network.heard_s) - 1 / RATE
    left = network.end()
    graph = network.setup.scenario.network.graph
    say(f"{count} kills and restarts, {NODES} processes, {graph}, lockstep at {RATE:g} steps/s")
    say(f"  told to be gone after {spread(gone_s)} s")
    say(f"  longest stall of the others {max(stalls):.3f} s")
    say(f"  rejoined {spread(back_s)} s after the command; processes at the end {len(living)}")
    say(f"  files open before {before}, after {after}; {left}")
    account(network.setup, network.folder)


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
    left = network.end()
    say(f"{count} hangs of {SHORT_S:g} and {LONG_S:g} s, {NODES} processes, real time")
    say(f"  longest time between two steps {max(stalls):.3f} s; back after {spread(back_s)} s")
    say(f"  {left}")
    account(network.setup, network.folder)


def die_while_booting(network: Network, count: int, rng: np.random.Generator) -> None:
    """Kill and restart, one after the other; kill a third of the nodes again while they boot."""
    client, back_s, killed = network.client, [], 0
    for number in range(count):
        node = int(rng.integers(NODES))
        time.sleep(float(rng.uniform(0, 0.1)))
        before, killed_s = network.pids[str(node)], time.monotonic()
        os.kill(before, signal.SIGKILL)
        network.await_told("gone", node, killed_s)
        asked_s = time.monotonic()
        client.command(Restart(node))
        if number % 3 == 0:
            while (pid := network.pids.get(str(node), before)) == before:
                time.sleep(0.002)
            time.sleep(float(rng.uniform(0, 0.05)))
            os.kill(pid, signal.SIGKILL)
            killed += 1
            # A node that is on its way is not started again before the launcher sees its death.
            time.sleep(0.5)
            asked_s = time.monotonic()
            client.command(Restart(node))
        back_s.append(network.await_told("joined", node, asked_s))
    living = sorted(network.pids)
    left = network.end()
    say(f"{count} restarts, {killed} killed while booting, {NODES} processes")
    say(f"  back after {spread(back_s)} s; processes at the end {len(living)}; {left}")
    account(network.setup, network.folder)


def main(options: Options) -> None:
    """All, one after the other."""
    defaults = definition_named("oscillator").defaults
    wanted = {"nodes": NODES, "graph": options.graph, "steps": 1_000_000}
    setup = prepare(defaults.with_(**wanted))
    rng = np.random.default_rng(options.seed)
    plays: list[tuple[int, Tempo | None, Callable]] = [
        (options.kills, None, kill_in_lockstep),
        (options.hangs, tempo_of(setup, None), hang_in_real_time),
        (options.boots, None, die_while_booting),
        (options.boots, tempo_of(setup, None), die_while_booting),
    ]
    for count, tempo, play in plays:
        if count:
            with tempfile.TemporaryDirectory() as folder:
                partial(play, Network(setup, Path(folder), tempo), count, rng)()


if __name__ == "__main__":
    main(tyro.cli(Options))
