"""Run a network of processes under the control of a thread, while a test or a part disturbs it."""

import os
import signal
import threading
from contextlib import suppress
from pathlib import Path

from concord.nodes.commands import Speed
from concord.nodes.tempo import Tempo
from concord.runtime.drivers import over_processes
from concord.runtime.network.control_client import Client
from concord.runtime.network.links import ENVIRONMENT, ZenohEndpoints, ports_from
from concord.runtime.network.network_file import read_network
from concord.runtime.network.zenoh_transport import Transport
from concord.runtime.recording import read_recording
from concord.scenarios.catalogue import definition_named
from concord.scenarios.preparation import prepare
from concord.scenarios.setup import Setup

PROC = Path("/proc")
BEGIN_S, END_S, JOIN_S = 120.0, 120.0, 10.0


def oscillators(nodes: int, graph: str, steps: int) -> Setup:
    """Return the network that the laboratory disturbs."""
    defaults = definition_named("oscillator").defaults
    return prepare(defaults.with_(nodes=nodes, graph=graph, steps=steps))


class Running:
    """A network from its first step on, and a client of it; its files lie in `folder`.

    Raises:
        RuntimeError: it did not begin within two minutes.
    """

    def __init__(
        self,
        setup: Setup,
        run: str,
        folder: Path,
        port: int | None = None,
        tempo: Tempo | None = None,
    ) -> None:
        self.setup, self.folder = setup, folder
        self._arguments = setup, run, folder / "run.mcap", port
        self.tempo = tempo
        # Why it ended before its time, if it did.
        self.failure: Exception | None = None
        self._begun = threading.Event()
        self._thread = threading.Thread(target=self._work, daemon=True)
        self._thread.start()
        if not self._begun.wait(BEGIN_S) or self.failure:
            raise RuntimeError(f"the network did not begin within {BEGIN_S:g} s: {self.failure}")
        self.client = Client(read_network(folder).connect, run)

    def _work(self) -> None:
        try:
            over_processes(*self._arguments, lambda step: self._begun.set(), self.tempo)
        except Exception as error:
            self.failure = error
            self._begun.set()

    @property
    def pids(self) -> dict[str, int]:
        """Those that live, as the launcher says."""
        return read_network(self.folder).pids

    def end(self) -> None:
        """Let it go as fast as it can; what does not end is ended by the death of its environment.

        Raises:
            RuntimeError: it did not end by itself, or failed.
        """
        self.client.command(Speed(0))
        self.client.close()
        if not self.ended_within(END_S):
            os.kill(self.pids[ENVIRONMENT], signal.SIGKILL)
            raise RuntimeError(f"the network did not end within {END_S:g} s")
        if self.failure:
            raise self.failure

    def ended_within(self, seconds: float) -> bool:
        """Wait until it is over, however it ends."""
        self._thread.join(seconds)
        return not self._thread.is_alive()

    def recorded(self) -> list[tuple[str, bytes]]:
        """Return the messages of its recording, (topic, bytes)."""
        return list(read_recording(self.folder / "run.mcap"))


def neighbouring_ports(cast: list[str]) -> dict[str, int]:
    """Return free consecutive ports, so that an intruder knows the address of each process."""
    # Below those that machines give out by themselves.
    for first in range(20_000 + os.getpid() % 10_000, 32_000, len(cast)):
        with suppress(ValueError):
            return ports_from(first, cast)
    raise RuntimeError("no free ports")


def memory_mb(pids: dict[str, int]) -> dict[str, int]:
    """Resident memory of each process."""
    page_bytes = os.sysconf("SC_PAGE_SIZE")
    pages = {
        name: int((PROC / str(pid) / "statm").read_text().split()[1]) for name, pid in pids.items()
    }
    return {name: number * page_bytes // 1_000_000 for name, number in pages.items()}


def stranger(run: str, port: int) -> Transport:
    """Return a session without keys at the process of a network that listens at a port."""
    return Transport(run, ZenohEndpoints("peer", (), (f"tcp/127.0.0.1:{port}",), JOIN_S), [], 1)
